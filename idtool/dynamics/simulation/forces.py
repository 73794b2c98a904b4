"""`Forces`: the forces on a mechanism, from its state to its accelerations.

Letters: q, v positions and velocities (n, W); s direction of the dry friction (n, W). W rollouts; n coordinates as in
`rigid_body_dynamics`: the nv joints, then the motor sides of those with a transmission.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Motion
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.rigid_body_dynamics import RigidBodyDynamics, motor_coordinates
from idtool.dynamics.simulation.rollout_state import RolloutState, solve_acceleration
from idtool.dynamics.simulation.transmission import Transmissions

# t (w,), q and v (nv, w) and indices of the rollouts (w,) to torque (nv, w):
InputTorqueFunction = Callable[[Array, Array, Array, Indices], Array]
# t (w,) and indices of the rollouts (w,) to velocity and acceleration of a floating base, as in `RobotModel`, (12, w):
BaseMotionFunction = Callable[[Array, Indices], Array]

_NUDGE = 1e-6  # rad/s, rad: for central differences


class Forces:
    """The forces on a mechanism.

    Attributes
    ----------
    motor_coordinates
        Coordinate of each joint's motor side, shape (nv,).
    has_dry_friction
        True for coordinates with dry friction, shape (n, 1).
    any_dry_friction
        True if any coordinate has it.
    gap_slopes
        Gradient of the gaps by the coordinates, shape (gaps, n); see `gaps`.

    Parameters
    ----------
    mechanism
        The forward model.
    input_torque
        The torque that acts, a continuous function of time and of the state of the motor sides.
    log
        File name of the log whose torque it is; empty: none, or several.
    base_motion
        Measured motion of a floating base; None: the base is fixed.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        input_torque: InputTorqueFunction,
        log: str = "",
        base_motion: BaseMotionFunction | None = None,
    ) -> None:
        self._dynamics = RigidBodyDynamics(mechanism)
        self._input_torque = input_torque
        self._base_motion = base_motion
        self._log = log
        self._transmissions = Transmissions(mechanism) if mechanism.transmissions else None
        self.motor_coordinates = motor_coordinates(mechanism)
        nv = len(self.motor_coordinates)
        n = nv + len(mechanism.transmissions)

        link, motor = mechanism.link_and_motor_sides()
        self._link_smooth_torque = link.smooth_torque()
        self._link_friction_level = link.friction_level()
        self._motor_smooth_torque = motor.smooth_torque()
        self._motor_friction_level = motor.friction_level()

        self._hysteresis_terms = link.grouped_hysteresis_terms()
        for term, joints, coefficients in motor.grouped_hysteresis_terms():
            self._hysteresis_terms.append((term, self.motor_coordinates[joints], coefficients))

        self.has_dry_friction = np.zeros((n, 1), dtype=bool)
        self.has_dry_friction[:nv, 0] = link.has_dry_friction
        self.has_dry_friction[self.motor_coordinates[motor.has_dry_friction]] = True
        self.any_dry_friction = bool(self.has_dry_friction.any())
        self._velocity_deadband = np.zeros(nv)

        breakpoints = [(np.eye(n)[joint], position) for joint, position in mechanism.breakpoints]
        if self._transmissions is not None:
            breakpoints += self._transmissions.breakpoints(n)
        self.gap_slopes = np.array([gradient for gradient, _ in breakpoints]).reshape(-1, n)
        self._gap_origins = np.array([[position] for _, position in breakpoints]).reshape(-1, 1)

    def gaps(self, q: Array) -> Array:
        """Distances from the points where a spring begins: end stops and teeth, shape (gaps, W)."""
        return np.asarray(self.gap_slopes @ q - self._gap_origins)

    def initial_state(self, t: Array, q: Array, v: Array) -> RolloutState:
        """The first state, from that of the motor sides, shape (nv, W).

        A transmission is deflected by the torque that acts on it then; hysteresis begins in the middle of its loop.
        """
        rollout_ids = np.arange(len(t))
        if self._transmissions is not None:
            zero = np.zeros((len(self.has_dry_friction), 1))
            M, _ = self._dynamics(zero, zero)
            self._transmissions.set_damping(M[0])
            q, v = self._transmissions.deflect(q, v, self._input_torque(t, q, v, rollout_ids))
        count = sum(len(joints) for _, joints, _ in self._hysteresis_terms)
        return self.state_at(rollout_ids, t, q, v, np.zeros((count, len(t))))

    def state_at(self, rollout_ids: Indices, t: Array, q: Array, v: Array, hysteresis: Array) -> RolloutState:
        """State from all that its future depends on; the directions of dry friction are not yet known."""
        sticking = np.zeros(q.shape, dtype=bool)
        return self._state(rollout_ids, t.copy(), q.copy(), v.copy(), np.zeros(q.shape), sticking, hysteresis)

    def state_after(self, start: RolloutState, h: Array, q: Array, v: Array) -> RolloutState:
        """State a time h, shape (W,) [s], after another one, with the same directions of dry friction."""
        hysteresis = self._hysteresis_after(start, q)
        return self._state(start.rollout_ids, start.t + h, q, v, start.s, start.sticking, hysteresis)

    def damping_and_stiffness(self, state: RolloutState) -> tuple[Array, Array]:
        """Approximate decrease of the forces with velocities and positions, shape (W, n, n)."""
        identity = np.eye(len(state.q))
        damping = self._decrease(state, 0.0, _NUDGE).T[:, :, None] * identity
        stiffness = self._decrease(state, _NUDGE, 0.0).T[:, :, None] * identity
        if self._transmissions is not None:
            self._transmissions.include_stiffness(damping, stiffness)
        return damping, stiffness

    def _decrease(self, state: RolloutState, dq: float, dv: float) -> Array:
        """Decrease of the forces, at least 0, with all positions or all velocities, shape (n, W)."""
        ids = state.rollout_ids
        ahead, _ = self._force_and_level(state.t, state.q + dq, state.v + dv, state.hysteresis, ids)
        behind, _ = self._force_and_level(state.t, state.q - dq, state.v - dv, state.hysteresis, ids)
        return np.maximum((behind - ahead) / (2 * _NUDGE), 0.0)

    def _state(
        self, rollout_ids: Indices, t: Array, q: Array, v: Array, s: Array, sticking: Mask, hysteresis: Array
    ) -> RolloutState:
        base_motion = None if self._base_motion is None else self._base_motion(t, rollout_ids)
        M, h = self._dynamics(q, v, base_motion)
        force, level = self._force_and_level(t, q, v, hysteresis, rollout_ids)
        force -= h
        a = solve_acceleration(M, force - s * level, sticking)
        return RolloutState(rollout_ids, t, q, v, M, force, level, s, sticking, a, hysteresis)

    def _force_and_level(
        self, t: Array, q: Array, v: Array, hysteresis: Array, rollout_ids: Indices
    ) -> tuple[Array, Array]:
        """All torque but the bias and dry friction, and the level of the latter, shape (n, w)."""
        nv = len(self.motor_coordinates)
        if self._transmissions is None:
            tau = self._input_torque(t, q, v, rollout_ids)
            motion = Motion(t, q, v, v, tau, tau, self._velocity_deadband, 0.0, log=self._log)
            force = tau - self._link_smooth_torque(motion)
            level = self._link_friction_level(motion) if self.any_dry_friction else np.zeros_like(q)
        else:
            motor = self.motor_coordinates
            tau = self._input_torque(t, q[motor], v[motor], rollout_ids)
            link_motion = Motion(t, q[:nv], v[:nv], v[:nv], tau, tau, self._velocity_deadband, 0.0, log=self._log)
            motor_motion = replace(link_motion, q=q[motor], v=v[motor])
            force = self._transmissions.torque(q, v)
            force[motor] += tau
            force[:nv] -= self._link_smooth_torque(link_motion)
            force[motor] -= self._motor_smooth_torque(motor_motion)
            level = np.zeros_like(q)
            level[:nv] = self._link_friction_level(link_motion)
            level[motor] += self._motor_friction_level(motor_motion)
        first = 0
        for term, coordinates, coefficients in self._hysteresis_terms:
            states = hysteresis[first : first + len(coordinates)]
            force[coordinates] -= coefficients * term.torque(states, v[coordinates])
            first += len(coordinates)
        return force, level

    def _hysteresis_after(self, start: RolloutState, q: Array) -> Array:
        """States of the hysteresis terms when the joints have moved to q."""
        if not self._hysteresis_terms:
            return start.hysteresis
        states = []
        first = 0
        for term, coordinates, _ in self._hysteresis_terms:
            before = start.hysteresis[first : first + len(coordinates)]
            states.append(term.next_state(before, q[coordinates] - start.q[coordinates]))
            first += len(coordinates)
        return np.concatenate(states)

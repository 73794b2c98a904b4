"""`Forces`: all that acts on a mechanism, from its state to its accelerations.

Letters: q, v positions and velocities (n, W); s direction of the dry friction (n, W). W rollouts; n coordinates as in
`dynamics`: the nv joints, then the motor sides of those whose gear gives way.
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

InputTorqueFunction = Callable[
    [Array, Array, Array, Indices], Array
]  # t (w,), q, v (nv, w), which rollouts → torque (nv, w)

_NUDGE = 1e-6  # rad/s, rad: for central differences


class Forces:
    """What acts on a mechanism.

    Attributes
    ----------
    motor
        The coordinate of each joint's motor side, shape (nv,).
    rubbing
        Which coordinates have dry friction, shape (n, 1).
    rubs
        Whether any has.
    slopes
        How the gaps of springs with a beginning change with the coordinates, shape (gaps, n).

    Parameters
    ----------
    mechanism
        What moves.
    drive
        The torque that acts, a continuous function of time and of the state of the motors' sides.
    """

    def __init__(self, mechanism: Mechanism, drive: InputTorqueFunction) -> None:
        self._dynamics, self._drive = RigidBodyDynamics(mechanism), drive
        link, motor = mechanism.link_and_motor_sides()
        self._resisting, self._level = link.smooth_torque(), link.friction_level()
        self._motor_resisting, self._motor_level = motor.smooth_torque(), motor.friction_level()
        self._gears = Transmissions(mechanism) if mechanism.transmissions else None
        self.motor_coordinates = motor_coordinates(mechanism)
        self._loops = [
            *link.grouped_hysteresis_terms(),
            *(
                (term, self.motor_coordinates[joints], factors)
                for term, joints, factors in motor.grouped_hysteresis_terms()
            ),
        ]
        self.has_dry_friction = np.pad(link.has_dry_friction, (0, len(mechanism.transmissions)))[:, None]
        self.has_dry_friction[self.motor_coordinates[motor.has_dry_friction]] = True
        self.any_dry_friction = bool(self.has_dry_friction.any())
        self._still = np.zeros(len(self.motor_coordinates))
        stops = [(np.eye(len(self.has_dry_friction))[joint], position) for joint, position in mechanism.breakpoints]
        stops += self._gears.breakpoints(len(self.has_dry_friction)) if self._gears is not None else []
        self.gap_slopes = np.array([slope for slope, _ in stops]).reshape(-1, len(self.has_dry_friction))
        self._where = np.array([[position] for _, position in stops]).reshape(-1, 1)

    def gaps(self, q: Array) -> Array:
        """How far springs with a beginning are from it, shape (gaps, W)."""
        return np.asarray(self.gap_slopes @ q - self._where)

    def initial_state(self, t: Array, q: Array, v: Array) -> RolloutState:
        """The first moment, from the state of the motors' sides, shape (nv, W).

        A gear is deflected by the torque that acts on it then; hysteresis begins in the middle of its loop.
        """
        rollout_ids = np.arange(len(t))
        if self._gears is not None:
            self._gears.set_damping(self._dynamics(*np.zeros((2, len(self.has_dry_friction), 1)))[0][0])
            q, v = self._gears.deflect(q, v, self._drive(t, q, v, rollout_ids))
        loops = np.zeros((sum(len(joints) for _, joints, _ in self._loops), len(t)))
        return self.state_at(rollout_ids, t, q, v, loops)

    def state_at(self, rollout_ids: Indices, t: Array, q: Array, v: Array, loops: Array) -> RolloutState:
        """A first moment in which all that the future depends on is known."""
        rests = np.zeros(q.shape, dtype=bool)
        return self._moment(rollout_ids, t.copy(), q.copy(), v.copy(), np.zeros(q.shape), rests, loops)

    def state_after(self, start: RolloutState, h: Array, q: Array, v: Array) -> RolloutState:
        """The moment h, shape (W,) [s], after another one, the directions of dry friction being the same."""
        return self._moment(start.rollout_ids, start.t + h, q, v, start.s, start.sticking, self._looped(start, q))

    def damping_and_stiffness(self, now: RolloutState) -> tuple[Array, Array]:
        """By how much the forces fall with velocities and positions, about, shape (W, n, n)."""

        def slope(q: float, v: float) -> Array:
            ahead, behind = (
                self._free(now.t, now.q + way * q, now.v + way * v, now.hysteresis, now.rollout_ids)[0]
                for way in (1, -1)
            )
            return (behind - ahead) / (2 * _NUDGE)

        damping, stiffness = (
            np.maximum(x, 0.0).T[:, :, None] * np.eye(len(x)) for x in (slope(0.0, _NUDGE), slope(_NUDGE, 0.0))
        )
        if self._gears is not None:
            self._gears.include_stiffness(damping, stiffness)
        return damping, stiffness

    def _moment(
        self, rollout_ids: Indices, t: Array, q: Array, v: Array, s: Array, held: Mask, loops: Array
    ) -> RolloutState:
        M, h = self._dynamics(q, v)
        force, level = self._free(t, q, v, loops, rollout_ids)
        force -= h
        return RolloutState(
            rollout_ids, t, q, v, M, force, level, s, held, solve_acceleration(M, force - s * level, held), loops
        )

    def _free(self, t: Array, q: Array, v: Array, loops: Array, rollout_ids: Indices) -> tuple[Array, Array]:
        """All torque but the bias and dry friction, and the level of the latter, shape (n, w)."""
        if self._gears is None:
            tau = self._drive(t, q, v, rollout_ids)
            motion = Motion(t, q, v, v, tau, tau, self._still, 0.0)
            force = tau - self._resisting(motion)
            level = self._level(motion) if self.any_dry_friction else np.zeros_like(q)
        else:
            nv = len(self.motor_coordinates)
            tau = self._drive(t, q[self.motor_coordinates], v[self.motor_coordinates], rollout_ids)
            motion = Motion(t, q[:nv], v[:nv], v[:nv], tau, tau, self._still, 0.0)
            force, level = self._gears.torque(q, v), np.zeros_like(q)
            force[self.motor_coordinates] += tau
            force[:nv] -= self._resisting(motion)
            level[:nv] = self._level(motion)
            ahead = replace(motion, q=q[self.motor_coordinates], v=v[self.motor_coordinates])
            force[self.motor_coordinates] -= self._motor_resisting(ahead)
            level[self.motor_coordinates] += self._motor_level(ahead)
        first = 0
        for term, joints, factors in self._loops:
            force[joints] -= factors * term.torque(loops[first : first + len(joints)], v[joints])
            first += len(joints)
        return force, level

    def _looped(self, start: RolloutState, q: Array) -> Array:
        """States of the hysteretic terms when the joints have moved to q."""
        if not self._loops:
            return start.hysteresis
        states, first = [], 0
        for term, joints, _ in self._loops:
            before = start.hysteresis[first : first + len(joints)]
            states.append(term.next_state(before, q[joints] - start.q[joints]))
            first += len(joints)
        return np.concatenate(states)

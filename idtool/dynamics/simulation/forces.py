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
from idtool.dynamics.simulation.dynamics import Dynamics, motor_sides
from idtool.dynamics.simulation.gears import Gears
from idtool.dynamics.simulation.moment import Moment, solve

Drive = Callable[[Array, Array, Array, Indices], Array]  # t (w,), q, v (nv, w), which rollouts → torque (nv, w)

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

    def __init__(self, mechanism: Mechanism, drive: Drive) -> None:
        self._dynamics, self._drive = Dynamics(mechanism), drive
        link, motor = mechanism.sides()
        self._resisting, self._level = link.resisting(), link.level()
        self._motor_resisting, self._motor_level = motor.resisting(), motor.level()
        self._gears = Gears(mechanism) if mechanism.gears else None
        self.motor = motor_sides(mechanism)
        self._loops = [
            *link.hysteresis(),
            *((term, self.motor[joints], factors) for term, joints, factors in motor.hysteresis()),
        ]
        self.rubbing = np.pad(link.rubbing, (0, len(mechanism.gears)))[:, None]
        self.rubbing[self.motor[motor.rubbing]] = True
        self.rubs = bool(self.rubbing.any())
        self._still = np.zeros(len(self.motor))
        stops = [(np.eye(len(self.rubbing))[joint], position) for joint, position in mechanism.stops]
        stops += self._gears.stops(len(self.rubbing)) if self._gears is not None else []
        self.slopes = np.array([slope for slope, _ in stops]).reshape(-1, len(self.rubbing))
        self._where = np.array([[position] for _, position in stops]).reshape(-1, 1)

    def gaps(self, q: Array) -> Array:
        """How far springs with a beginning are from it, shape (gaps, W)."""
        return np.asarray(self.slopes @ q - self._where)

    def start(self, t: Array, q: Array, v: Array) -> Moment:
        """The first moment, from the state of the motors' sides, shape (nv, W).

        A gear is deflected by the torque that acts on it then; hysteresis begins in the middle of its loop.
        """
        lanes = np.arange(len(t))
        if self._gears is not None:
            self._gears.damp(self._dynamics(*np.zeros((2, len(self.rubbing), 1)))[0][0])
            q, v = self._gears.apart(q, v, self._drive(t, q, v, lanes))
        loops = np.zeros((sum(len(joints) for _, joints, _ in self._loops), len(t)))
        return self.at(lanes, t, q, v, loops)

    def at(self, lanes: Indices, t: Array, q: Array, v: Array, loops: Array) -> Moment:
        """A first moment in which all that the future depends on is known."""
        rests = np.zeros(q.shape, dtype=bool)
        return self._moment(lanes, t.copy(), q.copy(), v.copy(), np.zeros(q.shape), rests, loops)

    def later(self, start: Moment, h: Array, q: Array, v: Array) -> Moment:
        """The moment h, shape (W,) [s], after another one, the directions of dry friction being the same."""
        return self._moment(start.lanes, start.t + h, q, v, start.s, start.held, self._looped(start, q))

    def steepness(self, now: Moment) -> tuple[Array, Array]:
        """By how much the forces fall with velocities and positions, about, shape (W, n, n)."""

        def slope(q: float, v: float) -> Array:
            ahead, behind = (
                self._free(now.t, now.q + way * q, now.v + way * v, now.loops, now.lanes)[0] for way in (1, -1)
            )
            return (behind - ahead) / (2 * _NUDGE)

        damping, stiffness = (
            np.maximum(x, 0.0).T[:, :, None] * np.eye(len(x)) for x in (slope(0.0, _NUDGE), slope(_NUDGE, 0.0))
        )
        if self._gears is not None:
            self._gears.stiffen(damping, stiffness)
        return damping, stiffness

    def _moment(self, lanes: Indices, t: Array, q: Array, v: Array, s: Array, held: Mask, loops: Array) -> Moment:
        M, h = self._dynamics(q, v)
        force, level = self._free(t, q, v, loops, lanes)
        force -= h
        return Moment(lanes, t, q, v, M, force, level, s, held, solve(M, force - s * level, held), loops)

    def _free(self, t: Array, q: Array, v: Array, loops: Array, lanes: Indices) -> tuple[Array, Array]:
        """All torque but the bias and dry friction, and the level of the latter, shape (n, w)."""
        if self._gears is None:
            tau = self._drive(t, q, v, lanes)
            motion = Motion(t, q, v, v, tau, tau, self._still, 0.0)
            force = tau - self._resisting(motion)
            level = self._level(motion) if self.rubs else np.zeros_like(q)
        else:
            nv = len(self.motor)
            tau = self._drive(t, q[self.motor], v[self.motor], lanes)
            motion = Motion(t, q[:nv], v[:nv], v[:nv], tau, tau, self._still, 0.0)
            force, level = self._gears.torque(q, v), np.zeros_like(q)
            force[self.motor] += tau
            force[:nv] -= self._resisting(motion)
            level[:nv] = self._level(motion)
            ahead = replace(motion, q=q[self.motor], v=v[self.motor])
            force[self.motor] -= self._motor_resisting(ahead)
            level[self.motor] += self._motor_level(ahead)
        first = 0
        for term, joints, factors in self._loops:
            force[joints] -= factors * term.torque(loops[first : first + len(joints)], v[joints])
            first += len(joints)
        return force, level

    def _looped(self, start: Moment, q: Array) -> Array:
        """States of the hysteretic terms when the joints have moved to q."""
        if not self._loops:
            return start.loops
        states, first = [], 0
        for term, joints, _ in self._loops:
            before = start.loops[first : first + len(joints)]
            states.append(term.after(before, q[joints] - start.q[joints]))
            first += len(joints)
        return np.concatenate(states)

"""`RolloutState`: rollouts at one moment each, and the accelerations that the forces on them give.

Letters: q, v, a positions, velocities, accelerations (n, W), M mass matrix (W, n, n), s direction of the dry friction
(n, W): ±1 sliding, 0 sticking. W rollouts, n coordinates as in `rigid_body_dynamics`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass

_BY_COLUMN = ("q", "v", "force", "friction_level", "s", "sticking", "a", "hysteresis")


@dataclass(frozen=True)
class RolloutState:
    """Rollouts at one moment each, with the forces that act.

    Attributes
    ----------
    rollout_ids
        Indices of the rollouts, shape (W,).
    t
        Times [s], shape (W,).
    q, v
        Positions and velocities, shape (n, W).
    M
        Mass matrix, shape (W, n, n).
    force
        All torque but dry friction, shape (n, W).
    friction_level
        Torque of dry friction when sliding, and the most that it can hold, shape (n, W).
    s
        Direction of the dry friction, shape (n, W).
    sticking
        True where dry friction holds a coordinate, shape (n, W).
    a
        Acceleration, shape (n, W).
    hysteresis
        States of the hysteresis terms, shape (terms, W).
    """

    rollout_ids: Indices
    t: Array
    q: Array
    v: Array
    M: Array
    force: Array
    friction_level: Array
    s: Array
    sticking: Mask
    a: Array
    hysteresis: Array

    def select(self, columns: Indices) -> RolloutState:
        """State of some of the rollouts."""
        by_column = {name: getattr(self, name)[:, columns] for name in _BY_COLUMN}
        return replace(self, rollout_ids=self.rollout_ids[columns], t=self.t[columns], M=self.M[columns], **by_column)

    def assign(self, columns: Indices, part: RolloutState) -> None:
        """Overwrite some of the rollouts in place."""
        self.t[columns] = part.t
        self.M[columns] = part.M
        for name in _BY_COLUMN:
            getattr(self, name)[:, columns] = getattr(part, name)

    @property
    def motion(self) -> Array:
        """Position, velocity and acceleration, shape (3, n, W)."""
        return np.stack([self.q, self.v, self.a])

    @property
    def friction_margin(self) -> Array:
        """Torque by which sticking friction could hold more than it does, shape (n, W)."""
        return np.asarray(self.friction_level - np.abs(self.holding_force))

    @property
    def holding_force(self) -> Array:
        """Torque that friction holds where it sticks, shape (n, W)."""
        return self.force - self.s * self.friction_level - multiply(self.M, self.a)


def interpolate(start: Array, end: Array, h: Array, share: Array) -> tuple[Array, Array]:
    """Position and velocity within a step, by the polynomials of lowest order through what is known at its ends.

    Parameters
    ----------
    start, end
        Position, velocity and acceleration at its ends, with the same direction of friction, shape (3, n, W).
    h
        Its length, shape (W,) [s].
    share
        The part of it that has passed, shape (W,), from 0 to 1.

    Returns
    -------
    q, by the polynomial of order 5, and v, by that of order 3, shape (n, W).
    """
    x = share
    q0, v0, a0 = start[0], h * start[1], h**2 * start[2]
    q1, v1, a1 = end[0], h * end[1], h**2 * end[2]
    rise = q1 - q0
    c3 = 10 * rise - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * rise + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * rise - 3 * (v0 + v1) - 0.5 * (a0 - a1)
    q = q0 + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5))))
    v = cubic_hermite(x, v0, v1, a0, a1) / h
    return q, v


def cubic_hermite(x: Array, v0: Array, v1: Array, a0: Array, a1: Array) -> Array:
    """Value at x of the cubic with values v0, v1 and slopes a0, a1 at 0 and 1."""
    c2 = 3 * (v1 - v0) - 2 * a0 - a1
    c3 = 2 * (v0 - v1) + a0 + a1
    return np.asarray(v0 + x * (a0 + x * (c2 + x * c3)))


def multiply(M: Array, a: Array) -> Array:
    """M a, shape (n, W)."""
    return np.asarray((M @ a.T[:, :, None])[:, :, 0].T)


def solve_acceleration(M: Array, force: Array, sticking: Mask) -> Array:
    """Acceleration under a force, zero for sticking coordinates; shape (n, W)."""
    if sticking.any():
        free = ~sticking.T
        M = M * (free[:, :, None] & free[:, None, :])
        diagonal = np.arange(M.shape[1])
        M[:, diagonal, diagonal] += sticking.T
        force = np.where(sticking, 0.0, force)
    return np.asarray(np.linalg.solve(M, force.T[:, :, None])[:, :, 0].T)

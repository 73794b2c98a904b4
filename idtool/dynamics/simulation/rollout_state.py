"""`RolloutState`: rollouts at one moment each, and the accelerations that the forces on them give.

Letters: q, v, a positions, velocities, accelerations (n, W), M mass matrix (W, n, n), s direction of the dry friction
(n, W): ±1 sliding, 0 held. W rollouts, n coordinates as in `dynamics`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array, Indices, Mask

_HALVINGS = 40
_BY_ROLLOUT = ("q", "v", "force", "friction_level", "s", "sticking", "a", "hysteresis")


@dataclass(frozen=True)
class RolloutState:
    """Rollouts at one moment each, with the forces that act.

    Attributes
    ----------
    rollout_ids
        Which rollouts.
    force
        All torque but dry friction, shape (n, W).
    level
        What dry friction can hold or takes when sliding, shape (n, W).
    a
        Acceleration, shape (n, W).
    loops
        States of the hysteretic terms, shape (terms, W).
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

    def select(self, some: Indices) -> RolloutState:
        """A part of the rollouts."""
        by_rollout = {name: getattr(self, name)[:, some] for name in _BY_ROLLOUT}
        return replace(self, rollout_ids=self.rollout_ids[some], t=self.t[some], M=self.M[some], **by_rollout)

    def assign(self, some: Indices, part: RolloutState) -> None:
        """Overwrite a part of the rollouts."""
        self.t[some], self.M[some] = part.t, part.M
        for name in _BY_ROLLOUT:
            getattr(self, name)[:, some] = getattr(part, name)

    @property
    def friction_margin(self) -> Array:
        """By how much dry friction could hold more than it does, where it holds; shape (n, W)."""
        return np.asarray(self.friction_level - np.abs(self.holding_force))

    @property
    def holding_force(self) -> Array:
        """What friction holds, where it holds; shape (n, W)."""
        return self.force - self.s * self.friction_level - multiply(self.M, self.a)


def interpolate(start: RolloutState, end: RolloutState, h: Array, share: Array) -> tuple[Array, Array]:
    """Position and velocity within a step, by the polynomials of lowest order through what is known at its ends.

    Parameters
    ----------
    start, end
        Its ends, with the same direction of friction.
    h
        Its length, shape (W,) [s].
    share
        The part of it that has gone, shape (W,), from 0 to 1.

    Returns
    -------
    q, by the polynomial of order 5, and v, by that of order 3, shape (n, W).
    """
    x, rise = share, end.q - start.q
    v0, v1, a0, a1 = h * start.v, h * end.v, h**2 * start.a, h**2 * end.a
    c3 = 10 * rise - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * rise + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * rise - 3 * (v0 + v1) - 0.5 * (a0 - a1)
    return start.q + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5)))), cubic_hermite(x, v0, v1, a0, a1) / h


def cubic_hermite(x: Array, v0: Array, v1: Array, a0: Array, a1: Array) -> Array:
    """At x, the polynomial with these values and slopes at 0 and 1."""
    return np.asarray(v0 + x * (a0 + x * (3 * (v1 - v0) - 2 * a0 - a1 + x * (2 * (v0 - v1) + a0 + a1))))


def first_crossing(curve: Callable[[Array], Array], sign: Array) -> Array:
    """Just beyond where in [0, 1] curves that begin with a sign first have another, by bisection; shape (m,)."""
    low, high = np.zeros_like(sign), np.ones_like(sign)
    for _ in range(_HALVINGS):
        x = (low + high) / 2
        beyond = curve(x) * sign < 0
        low, high = np.where(beyond, low, x), np.where(beyond, x, high)
    return high


def multiply(M: Array, a: Array) -> Array:
    """M a, shape (n, W)."""
    return np.asarray((M @ a.T[:, :, None])[:, :, 0].T)


def solve_acceleration(M: Array, force: Array, held: Mask) -> Array:
    """Acceleration of the joints that are not held, shape (n, W)."""
    if held.any():
        free = ~held.T
        M = M * (free[:, :, None] & free[:, None, :])
        joint = np.arange(M.shape[1])
        M[:, joint, joint] += held.T
        force = np.where(held, 0.0, force)
    return np.asarray(np.linalg.solve(M, force.T[:, :, None])[:, :, 0].T)

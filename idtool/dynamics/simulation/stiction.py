"""Dry friction at rest: which joints it holds, and when in a step that changes.

Shapes: n coordinates, W rollouts, as in `rollout_state`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.simulation.rollout_state import RolloutState, cubic_hermite, solve_acceleration

_SECTIONS = 32  # that an interval in which a curve crosses zero is divided into, …
_DIVISIONS = 8  # … so many times: less than 1e-12 of it is left
_TOLERANCE = 1e-8  # relative: friction this near its level no longer holds


def resolve_stiction(state: RolloutState) -> RolloutState:
    """State in which friction holds the joints at rest that it can, and the others start against their friction.

    One joint per rollout at a time: the one that takes the most friction beyond its level is released, one that then
    starts with its friction is held again.
    """
    resting = state.sticking | (state.v == 0) & (state.s != 0)
    rollouts = np.arange(len(state.t))
    for _ in range(2 * len(resting) + 2):
        excess = np.where(state.sticking, -state.friction_margin - _TOLERANCE * state.friction_level, 0.0)
        against = np.where(resting & ~state.sticking, -state.a * state.s, 0.0)
        released = excess.max(axis=0) > 0
        stopped = (against.max(axis=0) > 0) & ~released
        if not (released.any() or stopped.any()):
            break
        s = state.s.copy()
        sticking = state.sticking.copy()
        loosest = excess.argmax(axis=0)
        direction = np.sign(state.holding_force[loosest, rollouts])
        s[loosest[released], rollouts[released]] = direction[released]
        sticking[loosest[released], rollouts[released]] = False
        wrong = against.argmax(axis=0)
        s[wrong[stopped], rollouts[stopped]] = 0.0
        sticking[wrong[stopped], rollouts[stopped]] = True
        a = solve_acceleration(state.M, state.force - s * state.friction_level, sticking)
        state = replace(state, s=s, sticking=sticking, a=a)
    return state


def transition_times(start: RolloutState, end: RolloutState, h: Array) -> Array:
    """Share of a step at which each joint stops or slips; 2 where it does neither. Shape (n, W)."""
    share = np.full(start.v.shape, 2.0)
    stops = (start.s != 0) & (end.v * start.s <= 0)
    if stops.any():
        length = h[np.nonzero(stops)[1]]
        v0, v1 = start.v[stops], end.v[stops]
        a0, a1 = length * start.a[stops], length * end.a[stops]
        share[stops] = first_crossing(lambda x: cubic_hermite(x, v0, v1, a0, a1), start.s[stops])
    if start.sticking.any():
        before, after = start.friction_margin, end.friction_margin
        threshold = 2 * _TOLERANCE * start.friction_level
        slips = start.sticking & (after < -threshold) & (before > -threshold)
        share[slips] = (before + threshold)[slips] / (before[slips] - after[slips])
    return share


def first_crossing(curve: Callable[[Array], Array], sign: Array) -> Array:
    """Point in [0, 1] just beyond where curves that begin with a sign change it, shape (m,).

    By division of the interval into sections, at whose ends all curves are evaluated at once.

    Parameters
    ----------
    curve
        Values of all m curves at points of shape (sections, m).
    sign
        Of each at 0, shape (m,); it has changed at 1.
    """
    low, width = np.zeros_like(sign), 1.0
    ends = np.arange(1, _SECTIONS + 1)[:, None] / _SECTIONS
    for _ in range(_DIVISIONS):
        is_beyond = curve(low + width * ends) * sign < 0
        is_beyond[-1] = True
        width /= _SECTIONS
        low = low + width * is_beyond.argmax(axis=0)
    return low + width

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
    """State in which every joint at rest either sticks or slips.

    A joint sticks if the friction that holds it is within its level; otherwise it slips, and friction opposes its
    acceleration. One joint per rollout changes at a time: the one farthest beyond its level is released, then one whose
    acceleration is along its friction is held again. After many changes, the last state is taken.
    """
    at_rest = state.sticking
    rollouts = np.arange(len(state.t))
    for _ in range(2 * len(at_rest) + 2):
        excess = np.where(state.sticking, -state.friction_margin - _TOLERANCE * state.friction_level, 0.0)
        along_friction = np.where(at_rest & ~state.sticking, -state.a * state.s, 0.0)
        released = excess.max(axis=0) > 0
        held_again = (along_friction.max(axis=0) > 0) & ~released
        if not (released.any() or held_again.any()):
            break
        s = state.s.copy()
        sticking = state.sticking.copy()
        most_loaded = excess.argmax(axis=0)
        direction = np.sign(state.holding_force[most_loaded, rollouts])
        s[most_loaded[released], rollouts[released]] = direction[released]
        sticking[most_loaded[released], rollouts[released]] = False
        most_along = along_friction.argmax(axis=0)
        s[most_along[held_again], rollouts[held_again]] = 0.0
        sticking[most_along[held_again], rollouts[held_again]] = True
        a = solve_acceleration(state.M, state.force - s * state.friction_level, sticking)
        state = replace(state, s=s, sticking=sticking, a=a)
    return state


def transition_fractions(start: RolloutState, end: RolloutState, h: Array) -> Array:
    """Fraction of a step after which each joint stops or slips; infinite where it does neither. Shape (n, W)."""
    fraction = np.full(start.v.shape, np.inf)
    stops = (start.s != 0) & (end.v * start.s <= 0)
    if stops.any():
        length = h[np.nonzero(stops)[1]]
        v0, v1 = start.v[stops], end.v[stops]
        a0, a1 = length * start.a[stops], length * end.a[stops]
        fraction[stops] = first_crossing(lambda x: cubic_hermite(x, v0, v1, a0, a1), start.s[stops])
    if start.sticking.any():
        before, after = start.friction_margin, end.friction_margin
        threshold = 2 * _TOLERANCE * start.friction_level  # twice, so that `resolve_stiction` releases the joint
        slips = start.sticking & (after < -threshold) & (before > -threshold)
        distance = before[slips] + threshold[slips]
        change = before[slips] - after[slips]
        fraction[slips] = distance / change  # as if the margin changed linearly
    return fraction


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

"""Dry friction: which joints at rest it holds, and when in a step that changes.

Shapes: n coordinates, W rollouts, as in `moment`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.simulation.rollout_state import RolloutState, cubic_hermite, first_crossing, solve_acceleration

_SLIPS = 1e-8  # relative: friction this near its level no longer holds


def resolve_stiction(now: RolloutState) -> RolloutState:
    """Which of the joints at rest friction holds, and which way the others start.

    One joint a rollout at a time: the one that is held by the most too much friction is let go, one that then starts
    against its friction is held again.
    """
    resting, rollout = now.sticking | (now.v == 0) & (now.s != 0), np.arange(len(now.t))
    for _ in range(2 * len(resting) + 2):
        excess = np.where(now.sticking, -now.friction_margin - _SLIPS * now.friction_level, 0.0)
        against = np.where(resting & ~now.sticking, -now.a * now.s, 0.0)
        lets_go, stops = excess.max(axis=0) > 0, against.max(axis=0) > 0
        stops &= ~lets_go
        if not (lets_go.any() or stops.any()):
            break
        s, held = now.s.copy(), now.sticking.copy()
        loosest, wrong = excess.argmax(axis=0), against.argmax(axis=0)
        s[loosest[lets_go], rollout[lets_go]] = np.sign(now.holding_force[loosest, rollout])[lets_go]
        held[loosest[lets_go], rollout[lets_go]] = False
        s[wrong[stops], rollout[stops]] = 0.0
        held[wrong[stops], rollout[stops]] = True
        now = replace(now, s=s, sticking=held, a=solve_acceleration(now.M, now.force - s * now.friction_level, held))
    return now


def transition_times(start: RolloutState, end: RolloutState, h: Array) -> Array:
    """When in a step each joint's dry friction changes, in steps; 2 where it doesn't. Shape (n, W)."""
    share = np.full(start.v.shape, 2.0)
    stops = (start.s != 0) & (end.v * start.s <= 0)
    if stops.any():
        length = h[np.nonzero(stops)[1]]
        v0, v1, a0, a1 = start.v[stops], end.v[stops], length * start.a[stops], length * end.a[stops]
        share[stops] = first_crossing(lambda x: cubic_hermite(x, v0, v1, a0, a1), start.s[stops])
    if start.sticking.any():
        before, after = start.friction_margin, end.friction_margin
        aim = 2 * _SLIPS * start.friction_level
        slips = start.sticking & (after < -aim) & (before > -aim)
        share[slips] = (before + aim)[slips] / (before[slips] - after[slips])
    return share

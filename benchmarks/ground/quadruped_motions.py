"""Motions of the quadruped: standing and swaying, trotting, and hanging with all legs in the air."""

from __future__ import annotations

import numpy as np

from ground.motions import Motion, Reference, begins, swinging, tones
from ground.quadruped import LEGS
from ground.robot import Array

STANCE = np.tile([0.0, 0.75, -1.5], 4)  # rad
STANCE_HEIGHT = 0.329  # m, of the trunk
HANGING_HEIGHT = 1.0  # m


def quadruped_motion(kind: str, seed: int) -> Motion:
    """A motion of a kind, ``stand``, ``walk`` or ``hang``, with a chance of its own."""
    rng = np.random.default_rng([seed, 3])
    stiff, soft = (np.full(12, 120.0), np.full(12, 3.0)), (np.full(12, 40.0), np.full(12, 1.0))
    if kind == "stand":
        return Motion(_swaying(rng), *stiff, STANCE_HEIGHT)
    if kind == "walk":
        return Motion(_trotting(rng), *stiff, STANCE_HEIGHT)
    return Motion(swinging(rng, STANCE, np.tile([0.25, 0.4, 0.4], 4)), *soft, HANGING_HEIGHT, is_held=True)


def _swaying(rng: np.random.Generator) -> Reference:
    """The trunk moves in all directions while the feet stay."""
    patterns = _sway_patterns()
    sway = tones(rng, np.array([0.04, 0.02, 0.05, 0.02, 0.03, 0.02]), 0.1, 0.9)

    def at(t: float) -> tuple[Array, Array]:
        x, dx = sway(t)
        return STANCE + x @ patterns, dx @ patterns

    return at


def _sway_patterns() -> Array:
    """Changes of the joints that sway the trunk: forward, sideways, up, and about x, y, z; shape (6, 12)."""
    forward = np.tile([0.0, 1.0, 0.0], 4)
    sideways = np.tile([1.0, 0.0, 0.0], 4)
    up = np.tile([0.0, 1.0, -2.0], 4)
    left = np.repeat([1.0 if leg[1] == "L" else -1.0 for leg in LEGS], 3)
    front = np.repeat([1.0 if leg[0] == "F" else -1.0 for leg in LEGS], 3)
    return np.stack([forward, sideways, up, up * left, up * front, sideways * front])


def _trotting(rng: np.random.Generator) -> Reference:
    """Diagonal pairs of legs step in turn, with different heights and lengths of step."""
    frequency = rng.uniform(1.6, 2.0)
    lift = rng.uniform(0.25, 0.35)
    sway = tones(rng, np.array([0.02, 0.015, 0.03, 0.015, 0.02, 0.015]), 0.1, 0.8)
    patterns = _sway_patterns()
    offsets = np.array([0.0, np.pi, np.pi, 0.0])  # phase of each leg

    def at(t: float) -> tuple[Array, Array]:
        share, rate = begins(t)
        x, dx = sway(t)
        q, v = STANCE + x @ patterns, dx @ patterns
        for leg, offset in enumerate(offsets):
            phase = 2 * np.pi * frequency * t + offset
            raised = max(np.sin(phase), 0.0) ** 2
            rising = 2 * np.sin(phase) * np.cos(phase) * 2 * np.pi * frequency if np.sin(phase) > 0 else 0.0
            bend = lift * np.array([0.0, 1.0, -2.0])
            q[3 * leg : 3 * leg + 3] += share * raised * bend
            v[3 * leg : 3 * leg + 3] += (share * rising + rate * raised) * bend
        return q, v

    return at

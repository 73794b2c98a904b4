"""Motions of the quadruped: standing and swaying, trotting, and hanging with all legs in the air."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ground.robot import JOINTS, LEGS, Array

STANCE = np.tile([0.0, 0.75, -1.5], 4)  # rad
STANCE_HEIGHT = 0.329  # m, of the trunk
HANGING_HEIGHT = 1.0  # m

Reference = Callable[[float], tuple[Array, Array]]  # positions and velocities of the joints at a time


@dataclass(frozen=True)
class Motion:
    """A motion to be followed by joint controllers.

    Attributes
    ----------
    reference
        Positions and velocities at a time [s].
    kp, kd
        Gains of the joint controllers [N m/rad, N m s/rad].
    height
        Of the trunk at the beginning [m].
    is_held
        True if the trunk hangs in the air.
    """

    reference: Reference
    kp: float
    kd: float
    height: float
    is_held: bool = False


def motion(kind: str, seed: int) -> Motion:
    """A motion of a kind, ``stand``, ``walk`` or ``hang``, with a chance of its own."""
    rng = np.random.default_rng([seed, 3])
    if kind == "stand":
        return Motion(_swaying(rng), 120.0, 3.0, STANCE_HEIGHT)
    if kind == "walk":
        return Motion(_trotting(rng), 120.0, 3.0, STANCE_HEIGHT)
    return Motion(_swinging(rng), 40.0, 1.0, HANGING_HEIGHT, is_held=True)


def _begins(t: float) -> tuple[float, float]:
    """Share of a motion that is there at a time, and its rate: it grows over two seconds."""
    x = min(t / 2, 1.0)
    return x * x * (3 - 2 * x), 3 * x * (1 - x)


def _tones(rng: np.random.Generator, size: Array, low: float, high: float) -> Callable[[float], tuple[Array, Array]]:
    """Sums of four sines on each coordinate, of rms ``size``, and their derivatives."""
    w = 2 * np.pi * rng.uniform(low, high, (len(size), 4))
    phase = rng.uniform(0, 2 * np.pi, w.shape)
    amplitude = size[:, None] * np.sqrt(2 / 4) * rng.uniform(0.5, 1.5, w.shape)

    def at(t: float) -> tuple[Array, Array]:
        share, rate = _begins(t)
        x = (amplitude * np.sin(w * t + phase)).sum(axis=1)
        dx = (amplitude * w * np.cos(w * t + phase)).sum(axis=1)
        return share * x, share * dx + rate * x

    return at


def _swaying(rng: np.random.Generator) -> Reference:
    """The trunk moves in all directions while the feet stay."""
    patterns = _sway_patterns()
    tones = _tones(rng, np.array([0.04, 0.02, 0.05, 0.02, 0.03, 0.02]), 0.1, 0.9)

    def at(t: float) -> tuple[Array, Array]:
        x, dx = tones(t)
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
    tones = _tones(rng, np.array([0.02, 0.015, 0.03, 0.015, 0.02, 0.015]), 0.1, 0.8)
    patterns = _sway_patterns()
    offsets = np.array([0.0, np.pi, np.pi, 0.0])  # phase of each leg

    def at(t: float) -> tuple[Array, Array]:
        share, rate = _begins(t)
        x, dx = tones(t)
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


def _swinging(rng: np.random.Generator) -> Reference:
    """All joints swing."""
    tones = _tones(rng, np.tile([0.25, 0.4, 0.4], 4), 0.2, 2.0)

    def at(t: float) -> tuple[Array, Array]:
        x, dx = tones(t)
        return STANCE + x, dx

    return at


def joint_count() -> int:
    """Number of joints."""
    return len(JOINTS)

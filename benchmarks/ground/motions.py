"""Motions that joint controllers follow, and what all robots' motions are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ground.robot import Array

Reference = Callable[[float], tuple[Array, Array]]  # positions and velocities of the joints at a time


@dataclass(frozen=True)
class Motion:
    """A motion to be followed by joint controllers.

    Attributes
    ----------
    reference
        Positions and velocities at a time [s].
    kp, kd
        Gains of the joint controllers, shape (n,) [N m/rad, N m s/rad].
    height
        Of the base at the beginning [m].
    is_held
        True if the base hangs in the air.
    balance
        Further torque of the joints, shape (n,) [N m], at a time, a position and a velocity of the base [m, m/s].
    """

    reference: Reference
    kp: Array
    kd: Array
    height: float
    is_held: bool = False
    balance: Callable[[float, Array, Array], Array] | None = None


def begins(t: float) -> tuple[float, float]:
    """Share of a motion that is there at a time, and its rate: it grows over two seconds."""
    x = min(t / 2, 1.0)
    return x * x * (3 - 2 * x), 3 * x * (1 - x)


def tones(rng: np.random.Generator, size: Array, low: float, high: float) -> Callable[[float], tuple[Array, Array]]:
    """Sums of four sines on each coordinate, of rms ``size``, and their derivatives."""
    w = 2 * np.pi * rng.uniform(low, high, (len(size), 4))
    phase = rng.uniform(0, 2 * np.pi, w.shape)
    amplitude = size[:, None] * np.sqrt(2 / 4) * rng.uniform(0.5, 1.5, w.shape)

    def at(t: float) -> tuple[Array, Array]:
        share, rate = begins(t)
        x = (amplitude * np.sin(w * t + phase)).sum(axis=1)
        dx = (amplitude * w * np.cos(w * t + phase)).sum(axis=1)
        return share * x, share * dx + rate * x

    return at


def swinging(rng: np.random.Generator, stance: Array, size: Array) -> Reference:
    """All joints swing about a stance, each with an rms of ``size``; shape (n,) both [rad]."""
    swing = tones(rng, size, 0.2, 2.0)

    def at(t: float) -> tuple[Array, Array]:
        x, dx = swing(t)
        return stance + x, dx

    return at


def played(commands: Mapping[str, Array], joints: Sequence[str]) -> Reference:
    """Positions and velocities that a log of commands asks for, by its columns, shape (N,)."""
    t = commands["t"]
    q = np.stack([commands[f"qcmd_{joint}"] for joint in joints])
    v = np.stack([commands[f"vcmd_{joint}"] for joint in joints])

    def at(time: float) -> tuple[Array, Array]:
        k = min(max(round((time - t[0]) / (t[1] - t[0])), 0), len(t) - 1)
        return q[:, k], v[:, k]

    return at

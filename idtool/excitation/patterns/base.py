"""`Pattern`: a family of motions from rest at one pose back to rest at the same pose.

Every part of a trajectory begins and ends at the same pose, the home pose, at rest: so parts follow one another in any
order and number, and position, velocity and acceleration are continuous where they meet.

Letters: q, v, a positions, velocities, accelerations, shape (nv, N) [rad or m, s]; t times within the part, shape (N,)
[s]; x the numbers that tell one motion of the family from another, shape (n,), of no unit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array
from idtool.excitation.limits import Limits
from idtool.robot.model import Model


class MotionSamples(NamedTuple):
    """Positions, velocities and accelerations, or derivatives by them; shape (nv, N) each."""

    q: Array
    v: Array
    a: Array


@dataclass(frozen=True)
class PatternSpec:
    """What a pattern is for.

    Attributes
    ----------
    model
        The robot.
    limits
        What the motion is to keep to; it need not by itself, but is of about that size.
    home
        Where it begins and ends, shape (nv,) [rad or m].
    duration
        How long it takes [s].
    max_frequency
        The highest frequency in it [Hz].
    tip
        Link that a motion in space is for; None: the last of the URDF.
    """

    model: Model
    limits: Limits
    home: Array
    duration: float
    max_frequency: float = 1.0
    tip: str | None = None


class Pattern(ABC):
    """A family of motions.

    Attributes
    ----------
    name
        What it is called on the command line and in reports.
    draws
        How many motions to draw before one is chosen to be improved.

    Parameters
    ----------
    setting
        What it is for.
    """

    name: str
    draws: int = 3

    def __init__(self, setting: PatternSpec) -> None:
        self.limits, self.home, self.duration = setting.limits, setting.home, setting.duration

    @property
    def max_excursion(self) -> Array:
        """How far every joint may go from home to either side, shape (nv,) [rad or m]."""
        return np.minimum(self.limits.upper - self.home, self.home - self.limits.lower)

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Array:
        """A motion at random, of about the size that the limits allow, shape (n,)."""

    @abstractmethod
    def motion(self, x: Array, t: Array) -> MotionSamples:
        """The motion at times from 0 to ``duration``."""

    @abstractmethod
    def scaled(self, x: Array, share: Array) -> Array:
        """The same motion with its way from home this much as long, shape (nv,), from 0 to 1."""

    def gradient(self, x: Array, t: Array, by: MotionSamples) -> Array:
        """Derivative by x, shape (n,), of what has the derivatives ``by`` by q, v and a at the times t.

        A family without one gives zeros: its motions are drawn, and the best of them is taken.
        """
        return np.zeros(len(x))


def smooth_step(x: Array) -> MotionSamples:
    """The smooth step from 0 to 1 over 0 <= x <= 1 and its two derivatives: 10 x³ − 15 x⁴ + 6 x⁵, shape (N,) each.

    It is 0 before and 1 after; velocity and acceleration are zero at both ends. Its largest velocity is 15/8, its
    largest acceleration 10/√3.
    """
    x = np.clip(x, 0.0, 1.0)
    return MotionSamples(x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x))


STEP_SPEED, STEP_ACCELERATION = 15 / 8, 10 / np.sqrt(3)


def max_step_distance(velocity: Array, acceleration: Array, seconds: float) -> Array:
    """How far a smooth step may go in so many seconds within limits of velocity and acceleration."""
    return np.asarray(np.minimum(velocity * seconds / STEP_SPEED, acceleration * seconds**2 / STEP_ACCELERATION))

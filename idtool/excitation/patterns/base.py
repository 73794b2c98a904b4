"""`Pattern`: a family of motions from rest at one pose back to rest at the same pose.

Every segment of a trajectory begins and ends at rest at the home pose. So segments follow one another in any order and
number, and position, velocity and acceleration are continuous where they meet.

Letters: q, v, a positions, velocities, accelerations, shape (nv, N) [rad or m, s]; t times within the segment, shape
(N,) [s]; x dimensionless parameters of a motion of the family, shape (n,).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.excitation.limits import Limits
from idtool.robot.model import RobotModel


class MotionSamples(NamedTuple):
    """Positions, velocities and accelerations, or derivatives by them; shape (nv, N) each."""

    q: Array
    v: Array
    a: Array


@dataclass(frozen=True)
class PatternSpec:
    """Robot, limits and duration that a pattern is made for.

    Attributes
    ----------
    model
        The robot.
    limits
        Limits for the magnitude of the motion, which may still exceed them.
    home
        Pose at the start and end, shape (nv,) [rad or m].
    duration
        Duration of the motion [s].
    max_frequency
        Highest frequency of the motion [Hz].
    tip
        Link whose motion in space is designed; None: the last of the URDF.
    """

    model: RobotModel
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
        Name on the command line and in reports.
    draws
        Number of random motions of which the best is improved.

    Parameters
    ----------
    spec
        Robot, limits and duration.
    """

    name: str
    draws: int = 3

    def __init__(self, spec: PatternSpec) -> None:
        self.limits = spec.limits
        self.home = spec.home
        self.duration = spec.duration

    @property
    def max_excursion(self) -> Array:
        """Largest excursion of every joint from home to either side, shape (nv,) [rad or m]."""
        return np.minimum(self.limits.upper - self.home, self.home - self.limits.lower)

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Array:
        """A random motion of about the magnitude that the limits allow, shape (n,)."""

    @abstractmethod
    def motion(self, x: Array, t: Array) -> MotionSamples:
        """The motion at times t from 0 to ``duration``."""

    @abstractmethod
    def scaled(self, x: Array, share: Array) -> Array:
        """The motion with its excursion from home times ``share``, shape (nv,), from 0 to 1."""

    def gradient(self, x: Array, t: Array, by: MotionSamples) -> Array:
        """Gradient with respect to x, shape (n,), of a function with the derivatives ``by`` with respect to q, v and a.

        A family without gradient gives zeros: of its motions, the best random one is taken.
        """
        return np.zeros(len(x))


def smooth_step(x: Array) -> MotionSamples:
    """The smooth step from 0 to 1 over 0 <= x <= 1 and its two derivatives: 10 x³ − 15 x⁴ + 6 x⁵, shape (N,) each.

    It is 0 before and 1 after; velocity and acceleration are zero at both ends. Its largest velocity is 15/8, its
    largest acceleration 10/√3.
    """
    x = np.clip(x, 0.0, 1.0)
    value = x**3 * (10 - 15 * x + 6 * x**2)
    first = 30 * x**2 * (1 - x) ** 2
    second = 60 * x * (1 - x) * (1 - 2 * x)
    return MotionSamples(value, first, second)


STEP_VELOCITY = 15 / 8
STEP_ACCELERATION = 10 / np.sqrt(3)


def max_step_distance(velocity: Array, acceleration: Array, duration: float) -> Array:
    """Largest distance of a smooth step of a duration [s] within limits of velocity and acceleration, shape (nv,)."""
    by_velocity = velocity * duration / STEP_VELOCITY
    by_acceleration = acceleration * duration**2 / STEP_ACCELERATION
    return np.asarray(np.minimum(by_velocity, by_acceleration))

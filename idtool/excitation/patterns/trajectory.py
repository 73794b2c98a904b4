"""`Trajectory`: parts one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, Pattern

_BLOCK = 8192  # samples


@dataclass(frozen=True)
class TrajectorySegment:
    """A motion of a pattern's family."""

    pattern: Pattern
    x: Array

    def motion(self, t: Array) -> MotionSamples:
        """At times since its start, shape (N,) [s]."""
        return self.pattern.motion(self.x, np.clip(t, 0.0, self.pattern.duration))

    def blocks(self, dt: float) -> Iterator[tuple[Array, MotionSamples]]:
        """Times no more than dt [s] apart, both ends among them, and the motion then, block by block."""
        t = np.linspace(0, self.pattern.duration, max(int(np.ceil(self.pattern.duration / dt)) + 1, 2))
        for start in range(0, len(t), _BLOCK):
            some = t[start : start + _BLOCK]
            yield some, self.motion(some)


@dataclass(frozen=True)
class Trajectory:
    """Parts that all begin and end at rest at the home pose."""

    segments: tuple[TrajectorySegment, ...]

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return sum(part.pattern.duration for part in self.segments)

    @property
    def starts(self) -> Array:
        """When each part begins [s], and the end."""
        return np.cumsum([0.0, *(part.pattern.duration for part in self.segments)])

    def motion(self, t: Array) -> MotionSamples:
        """At times since its start, shape (N,) [s], ascending."""
        starts = self.starts
        index = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(self.segments) - 1)
        pieces = [part.motion(t[index == i] - starts[i]) for i, part in enumerate(self.segments)]
        return MotionSamples(*(np.concatenate(signal, axis=1) for signal in zip(*pieces, strict=True)))

    def sampled(self, rate: float) -> tuple[Array, MotionSamples]:
        """At an even rate [Hz]: times (N,) [s] and the motion."""
        t = np.arange(int(np.floor(self.duration * rate + 1e-9)) + 1) / rate
        blocks = [self.motion(t[start : start + _BLOCK]) for start in range(0, len(t), _BLOCK)]
        return t, MotionSamples(*(np.concatenate(signal, axis=1) for signal in zip(*blocks, strict=True)))

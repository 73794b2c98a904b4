"""`Trajectory`: segments one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.excitation.patterns.base import MotionSamples, Pattern

_BLOCK = 8192  # samples


@dataclass(frozen=True)
class TrajectorySegment:
    """One motion of a pattern, given by its parameters x."""

    pattern: Pattern
    x: Array

    def motion(self, t: Array) -> MotionSamples:
        """The motion at times since its start, shape (N,) [s]."""
        return self.pattern.motion(self.x, np.clip(t, 0.0, self.pattern.duration))

    def blocks(self, dt: float) -> Iterator[tuple[Array, MotionSamples]]:
        """Times no more than dt [s] apart, both ends included, and the motion at these, block by block."""
        duration = self.pattern.duration
        count = max(int(np.ceil(duration / dt)) + 1, 2)
        for t in _split(np.linspace(0, duration, count)):
            yield t, self.motion(t)


@dataclass(frozen=True)
class Trajectory:
    """Segments that all begin and end at rest at the home pose."""

    segments: tuple[TrajectorySegment, ...]

    @property
    def home(self) -> Array:
        """Pose of the joints at start and end, shape (nv,) [rad or m]."""
        return self.segments[0].pattern.home

    @property
    def duration(self) -> float:
        """Duration of all segments [s]."""
        return sum(segment.pattern.duration for segment in self.segments)

    @property
    def starts(self) -> Array:
        """Start time of each segment, and the end [s]."""
        return np.cumsum([0.0, *(segment.pattern.duration for segment in self.segments)])

    def motion(self, t: Array) -> MotionSamples:
        """The motion at ascending times since its start, shape (N,) [s]."""
        starts = self.starts
        index = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(self.segments) - 1)
        motions = [segment.motion(t[index == i] - starts[i]) for i, segment in enumerate(self.segments)]
        return _concatenate(motions)

    def sampled(self, rate: float) -> tuple[Array, MotionSamples]:
        """Times at an even rate [Hz], shape (N,) [s], and the motion at these."""
        t = np.arange(int(np.floor(self.duration * rate + 1e-9)) + 1) / rate
        return t, _concatenate([self.motion(block) for block in _split(t)])


def _split(t: Array) -> Iterator[Array]:
    for start in range(0, len(t), _BLOCK):
        yield t[start : start + _BLOCK]


def _concatenate(motions: Sequence[MotionSamples]) -> MotionSamples:
    return MotionSamples(*(np.concatenate(signal, axis=1) for signal in zip(*motions, strict=True)))

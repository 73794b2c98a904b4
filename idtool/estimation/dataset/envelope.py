"""`Envelope`: curves for drawing, of bounded size, in which no spike is lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass

_POINTS = 2000  # a curve is drawn as the least and greatest value in this many stretches of time


@dataclass
class Trace:
    """Curves of a log for drawing, of bounded size.

    Each short interval of time has two points at its centre: the minimum and the maximum of the curve in it. So points
    of two curves do not belong to the same instant; errors and scatter plots need the samples themselves.

    Attributes
    ----------
    name
        Name of the log.
    t
        Times [s], shape (points,), each interval's centre twice.
    curves
        Values by name, shape (nv, points): ``measured``, ``residual`` (measured minus the first model's) or a model's.
    """

    name: str
    t: Array
    curves: dict[str, Array] = field(default_factory=dict)


class Envelope:
    """Collects the least and greatest value of every curve in stretches of time, so that no spike is lost."""

    def __init__(self, parts: Sequence[slice], t: Array, points: int = _POINTS) -> None:
        self.start, self.stop = float(t[parts[0].start]), float(t[parts[-1].stop - 1])
        samples = sum(part.stop - part.start for part in parts)
        self.bins = min(points, max(samples, 1))
        self.low: dict[str, Array] = {}
        self.high: dict[str, Array] = {}

    @classmethod
    def of_stretches(cls, start: float, stop: float, bins: int) -> Envelope:
        """An envelope without values, of stretches of time between two times [s]."""
        envelope = cls.__new__(cls)
        envelope.start, envelope.stop, envelope.bins = float(start), float(stop), int(bins)
        envelope.low, envelope.high = {}, {}
        return envelope

    def add(self, t: Array, curves: Mapping[str, Array]) -> None:
        """Add values of curves, shape (nv, N) each, at times [s], shape (N,)."""
        if not len(t):
            return
        index = self.bins_of(t)
        first = np.flatnonzero(np.diff(index, prepend=-1))
        for name, x in curves.items():
            low = self.low.setdefault(name, np.full((len(x), self.bins), np.inf))
            high = self.high.setdefault(name, np.full((len(x), self.bins), -np.inf))
            bins = index[first]
            low[:, bins] = np.minimum(low[:, bins], np.minimum.reduceat(x, first, axis=1))
            high[:, bins] = np.maximum(high[:, bins], np.maximum.reduceat(x, first, axis=1))

    def merge(self, other: Envelope) -> None:
        """Add the values of another envelope of the same stretches of time."""
        for name, low in other.low.items():
            self.low[name] = np.minimum(self.low[name], low) if name in self.low else low
            high = other.high[name]
            self.high[name] = np.maximum(self.high[name], high) if name in self.high else high

    def bins_of(self, t: Array) -> Indices:
        """The stretch of each of some times [s], shape (N,)."""
        share = (t - self.start) / max(self.stop - self.start, np.finfo(float).tiny)
        return np.asarray(np.clip((share * self.bins).astype(int), 0, self.bins - 1))

    @property
    def centres(self) -> Array:
        """Centre of each stretch of time [s], shape (bins,)."""
        shares = (np.arange(self.bins) + 0.5) / self.bins
        return np.asarray(self.start + (self.stop - self.start) * shares)

    def trace(self, name: str) -> Trace:
        """The curves, two points per stretch; NaN, a break in the line, where nothing was measured."""
        curves = {}
        for curve, low in self.low.items():
            pairs = np.stack([low, self.high[curve]], axis=-1).reshape(len(low), -1)
            curves[curve] = np.where(np.isfinite(pairs), pairs, np.nan)
        return Trace(name, np.repeat(self.centres, 2), curves)

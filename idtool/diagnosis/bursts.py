"""Stretches of time in which something acts on the robot that does not otherwise.

A model fitted to data with a contact is bent by it, and leaves something everywhere; so what is left is that of a fit
which does not heed the contact. A contact is told from friction, gears and the rest by its shape: its torque comes
and goes within milliseconds, between these it is never small and changes only as slowly as the pose.

Letters: nv joints, n samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from idtool.diagnosis.course import pieces
from idtool.diagnosis.robust import robust
from idtool.experiment import Experiment, Progress

Array = NDArray[np.float64]

_SMOOTH = 9  # samples, four or more of which make a period of the band: a level is their median
_NEAR = 10  # samples around an edge in which it is looked for, and on each side of which it is judged
_SIDE = 3  # samples of each side that a jump is the difference of
_RAISED = 3.0  # times the usual level
_BURST = 4.0  # times it, in the middle
_APART, _SHORTEST = 0.15, 0.25  # s
_PART = 0.3  # of a burst's level: lower it never is for long
_EVEN = 2.2  # times it, that the level at its edges is at most
_SHARP, _KICK = 0.6, 1.4  # of the level at an edge, that the jump there is at least and at most
_OUTSIDE = 0.3  # of it, that there may be just outside
_ROUGH = 0.3  # of the level, that may change faster than a pose does
_POSE = 0.1  # s in which a pose hardly changes
_MOST = 10
_SMALL = 1e-3  # of a joint's torque: less is not looked at


def bursts(experiment: Experiment, theta: Array, progress: Progress) -> tuple[tuple[float, float], ...]:
    """Stretches of time in which the residual torque is out of the ordinary, as in a contact.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    progress
        Told how far it has come.

    Returns
    -------
    Begin and end of each [s] from the log's first sample, in order of time, at most 10: the strongest. None where
    there are several logs, since a contact's windows count from the first sample of each.
    """
    if len({run.signals.log.path.resolve() for run in experiment.runs}) > 1:
        return ()
    t, r, kept, starts = _normalised(experiment, theta, progress)
    log = experiment.runs[0].signals.log
    levels = _levels(r, kept)
    usual = float(np.median(levels))
    found: list[tuple[float, float, float]] = []
    for first, last in zip(starts, (*starts[1:], len(t)), strict=True):
        part = slice(first, last)
        if last - first > 2:
            stretch = _Stretch(r[:, part], kept[:, part], levels[part], usual, float(t[first + 1] - t[first]))
            half = stretch.step / 2
            for a, b, strength in stretch.bursts():
                begin = t[first + a] - half if first + a > 0 else 0.0
                end = t[first + b - 1] + half if first + b < len(t) else log.t[-1] - log.t[0]
                found.append((float(begin), float(end), strength))
    strongest = sorted(found, key=lambda one: -one[2])[:_MOST]
    return tuple(sorted((begin, end) for begin, end, _ in strongest))


def _normalised(
    experiment: Experiment, theta: Array, progress: Progress
) -> tuple[Array, Array, NDArray[np.bool_], list[int]]:
    """What a fit leaves that does not heed bursts, in units of each joint's noise.

    Returns
    -------
    Times [s], shape (n,), what is left, shape (nv, n), which of it counts, shape (nv, n), and where stretches begin.
    """
    model = (experiment.equation, robust(experiment, theta, progress))
    found, starts, count, torque, seconds = [], [], 0, np.zeros(len(experiment.equation.joints)), 0
    for piece in pieces(experiment, [model], progress, "looking for contacts"):
        starts += [count] * len(piece.starts)
        count += len(piece.t)
        torque, seconds = torque + np.square(piece.tau).sum(axis=1), seconds + len(piece.t)
        found.append((piece.t, piece.left[0], piece.kept))
    t, left, kept = (np.concatenate(x, axis=-1) for x in zip(*found, strict=True))
    noise = [1.4826 * float(np.median(np.abs(x[k]))) if k.any() else 0.0 for x, k in zip(left, kept, strict=True)]
    least = np.maximum(_SMALL * np.sqrt(torque / max(seconds, 1)), 1e-300)
    return t, left / np.maximum(noise, least)[:, None], kept, starts


def _levels(r: Array, kept: NDArray[np.bool_]) -> Array:
    """Rms over the joints that count, shape (n,); where none does, the lesser of the nearest before and after."""
    count = kept.sum(axis=0)
    known = np.flatnonzero(count)
    if not len(known):
        return np.zeros(r.shape[1])
    level = np.sqrt(np.square(r * kept).sum(axis=0) / np.maximum(count, 1))
    after = np.minimum(np.searchsorted(known, np.arange(len(level))), len(known) - 1)
    before = np.maximum(after - 1, 0)
    return np.asarray(np.where(count > 0, level, np.minimum(level[known[before]], level[known[after]])))


@dataclass(frozen=True)
class _Stretch:
    """A stretch without a gap.

    Attributes
    ----------
    r
        What is left, in units of each joint's noise, shape (nv, n).
    kept
        Whether it says something, shape (nv, n).
    levels
        Its rms over the joints, shape (n,).
    usual
        The level at most times.
    step
        From one sample to the next [s].
    """

    r: Array
    kept: NDArray[np.bool_]
    levels: Array
    usual: float
    step: float

    def bursts(self) -> Iterator[tuple[int, int, float]]:
        """First sample, the one after the last, and energy of each."""
        level = median_filter(self.levels, _SMOOTH, mode="nearest")
        jumps = self._jumps()
        for raised in self._runs(level > _RAISED * self.usual):
            height = float(np.median(level[raised]))
            high = np.flatnonzero(level[raised] > _PART * height) + raised.start
            a, b = (self._edge(int(end), jumps) for end in (high[0], high[-1] + 1))
            if height > _BURST * self.usual and (b - a) * self.step >= _SHORTEST and self._is_one(a, b, height, jumps):
                yield a, b, height**2 * (b - a)

    def _runs(self, raised: NDArray[np.bool_]) -> Iterator[slice]:
        """Runs that are raised, across short gaps."""
        edges = np.flatnonzero(np.diff(raised, prepend=False, append=False)).reshape(-1, 2)
        if len(edges):
            gap = (edges[1:, 0] - edges[:-1, 1]) * self.step >= _APART
            first, last = edges[np.insert(gap, 0, True), 0], edges[np.append(gap, True), 1]
            yield from (slice(a, b) for a, b in zip(first, last, strict=True) if (b - a) * self.step > _SHORTEST / 2)

    def _jumps(self) -> Array:
        """Change from before to after each place between samples, rms over the joints, shape (n + 1,)."""
        n, m = len(self.levels), _SIDE
        jumps = np.zeros(n + 1)
        if n < 2 * m:
            return jumps
        total, count = (np.cumsum(np.insert(x, 0, 0.0, axis=1), axis=1) for x in (self.r * self.kept, self.kept * 1.0))
        i = np.arange(m, n + 1 - m)
        before, after = count[:, i] - count[:, i - m], count[:, i + m] - count[:, i]
        change = (total[:, i + m] - total[:, i]) / np.maximum(after, 1) - (total[:, i] - total[:, i - m]) / np.maximum(
            before, 1
        )
        known = np.minimum(before, after) >= m / 3
        jumps[i] = np.sqrt((np.square(change) * known).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
        return jumps

    def _edge(self, near: int, jumps: Array) -> int:
        """The place of the greatest jump near another, or an end of the stretch that is as near."""
        reach, n = _NEAR, len(self.levels)
        if near <= reach or near >= n - reach:
            return 0 if near <= reach else n
        return near - reach + int(np.argmax(jumps[near - reach : near + reach + 1]))

    def _is_one(self, a: int, b: int, height: float, jumps: Array) -> bool:
        """Whether it comes and goes at once, and changes slowly in between."""
        edges = [(end, way) for end, way in ((a, 1), (b, -1)) if 0 < end < len(self.levels)]
        if not edges or not all(self._is_edge(end, way, height, float(jumps[end])) for end, way in edges):
            return False
        inner = slice(a + _SIDE, b - _SIDE)
        low = float(np.quantile(median_filter(self.levels[inner], _SMOOTH), 0.1))
        r = np.stack([_bridged(x[inner], k[inner]) for x, k in zip(self.r, self.kept, strict=True)])
        rough = r - uniform_filter1d(r, max(round(_POSE / self.step), 1), axis=1, mode="nearest")
        return low > _PART * height and float(np.square(rough).sum()) < _ROUGH**2 * float(np.square(r).sum())

    def _is_edge(self, end: int, way: int, height: float, jump: float) -> bool:
        """Whether a burst may begin, 1, or end, −1, at a place."""
        after, before = self.levels[end + _SIDE - 1 : end + _NEAR], self.levels[max(end - _NEAR, 0) : end - _SIDE + 1]
        if not len(after) or not len(before):
            return False
        inside, outside = (float(np.median(x)) for x in ((after, before)[::way]))
        return (
            _PART * height < inside < _EVEN * height
            and outside < _OUTSIDE * inside
            and _SHARP * inside < jump < _KICK * inside
        )


def _bridged(x: Array, kept: NDArray[np.bool_]) -> Array:
    """A line across samples that do not count; zero where none does."""
    known = np.flatnonzero(kept)
    return np.interp(np.arange(len(x)), known, x[known]) if len(known) else np.zeros_like(x)

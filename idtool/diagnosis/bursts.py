"""Stretches of time in which something acts on the robot that does not otherwise.

A model fitted to data with a contact is bent by it, and leaves something everywhere; so what is left is that of a fit
which does not heed the contact. A contact is told from friction, gears and the rest by its shape: its torque comes
and goes within milliseconds, between these it is never small and changes only as slowly as the pose.

Letters: nv joints, n samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from idtool.common.arrays import Array, Indices, Mask
from idtool.diagnosis.residual_series import pieces
from idtool.diagnosis.robust import robust
from idtool.estimation.dataset.experiment import Experiment, Progress

_SMOOTH = 9  # samples, four or more of which make a period of the band: a level is their median
_NEAR = 10  # samples around an edge in which it is looked for, and on each side of which it is judged
_SIDE = 3  # samples of each side that a jump is the difference of
_RAISED = 3.0  # times the usual level
_BURST = 4.0  # times it, in the middle
_APART, _SHORTEST = 0.15, 0.25  # s
_OUTERMOST = (0.0, 0.1, 0.3)  # of a burst's level: where its edges are looked for
_PART = 0.25  # of it: lower it never is for long
_EVEN = 3.0  # times it, that the level at its edges is at most
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
    if len(experiment.runs) > 1:
        return ()
    t, r, v, kept, starts = _normalised(experiment, theta, progress)
    log = experiment.runs[0].signals.log
    levels = _levels(r, kept)
    usual = float(np.median(levels))
    found: list[tuple[float, float, float]] = []
    for first, last in zip(starts, (*starts[1:], len(t)), strict=True):
        part = slice(first, last)
        if last - first > 2:
            turns = [np.flatnonzero(np.diff(np.sign(x))) for x in v[:, part]]
            step = float(t[first + 1] - t[first])
            stretch = _Stretch(r[:, part], kept[:, part], levels[part], turns, usual, step)
            for a, b, strength in stretch.bursts():
                begin = t[first + a] - step / 2 if first + a > 0 else 0.0
                end = t[first + b - 1] + step / 2 if first + b < len(t) else log.t[-1] - log.t[0]
                found.append((float(begin), float(end), strength))
    strongest = sorted(found, key=lambda one: -one[2])[:_MOST]
    return tuple(sorted((round(begin, 4), round(end, 4)) for begin, end, _ in strongest))


def _normalised(
    experiment: Experiment, theta: Array, progress: Progress
) -> tuple[Array, Array, Array, Mask, list[int]]:
    """What a fit leaves that does not heed bursts, in units of each joint's noise.

    Returns
    -------
    Times [s], shape (n,), what is left, velocities and which samples count, shape (nv, n), and where stretches begin.
    """
    model = (experiment.equation, robust(experiment, theta, progress))
    found, starts, count, torque = [], [], 0, np.zeros(len(experiment.equation.joints))
    for piece in pieces(experiment, [model], progress, "looking for contacts"):
        starts += [count] * len(piece.starts)
        count += len(piece.t)
        torque = torque + np.square(piece.tau).sum(axis=1)
        found.append((piece.t, piece.left[0], piece.v, piece.kept))
    t, left, v, kept = (np.concatenate(x, axis=-1) for x in zip(*found, strict=True))
    noise: Array = np.array(
        [1.4826 * float(np.median(np.abs(x[k]))) if k.any() else 0.0 for x, k in zip(left, kept, strict=True)]
    )
    noise = np.maximum(noise, _SMALL * np.sqrt(torque / max(count, 1)))
    return t, left / np.where(noise > 0, noise, 1.0)[:, None], v, kept, starts


def _levels(r: Array, kept: Mask) -> Array:
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
    turns
        By joint, samples at which its velocity changes sign.
    usual
        The level at most times.
    step
        From one sample to the next [s].
    """

    r: Array
    kept: Mask
    levels: Array
    turns: Sequence[Indices]
    usual: float
    step: float

    def bursts(self) -> Iterator[tuple[int, int, float]]:
        """First sample, the one after the last, and energy of each."""
        level = median_filter(self.levels, _SMOOTH, mode="nearest")
        for raised in self._runs(level > _RAISED * self.usual):
            height = float(np.median(level[raised]))
            a, b = (self._end(raised, level[raised], height, way) for way in (1, -1))
            if height < _BURST * self.usual or a is None or b is None or (b - a) * self.step < _SHORTEST:
                continue
            if (a > 0 or b < len(self.levels)) and self._stays(a, b, height) and not self._recurs(a, b):
                yield a, b, height**2 * (b - a)

    def _runs(self, raised: Mask) -> Iterator[slice]:
        """Runs that are raised, across short gaps."""
        edges = np.flatnonzero(np.diff(raised, prepend=False, append=False)).reshape(-1, 2)
        if len(edges):
            gap = (edges[1:, 0] - edges[:-1, 1]) * self.step >= _APART
            first, last = edges[np.insert(gap, 0, True), 0], edges[np.append(gap, True), 1]
            yield from (slice(a, b) for a, b in zip(first, last, strict=True) if (b - a) * self.step > _SHORTEST / 2)

    @cached_property
    def _changes(self) -> Array:
        """From before to after each place between samples, NaN where that is not known, shape (nv, n + 1)."""
        n, m = len(self.levels), _SIDE
        changes = np.full((len(self.r), n + 1), np.nan)
        if n >= 2 * m:
            sums = (np.cumsum(np.insert(x, 0, 0.0, axis=1), axis=1) for x in (self.r * self.kept, 1.0 * self.kept))
            total, count = (x[:, m:] - x[:, :-m] for x in sums)
            mean = np.where(count >= m / 3, total / np.maximum(count, 1), np.nan)
            changes[:, m : n + 1 - m] = mean[:, m:] - mean[:, :-m]
        return changes

    @cached_property
    def _jumps(self) -> Array:
        """Rms of the changes over the joints, shape (n + 1,)."""
        known = np.isfinite(self._changes)
        squares = np.square(np.where(known, self._changes, 0.0)).sum(axis=0)
        return np.asarray(np.sqrt(squares / np.maximum(known.sum(axis=0), 1)))

    def _end(self, raised: slice, level: Array, height: float, way: int) -> int | None:
        """Where a burst begins, 1, or ends, −1: the outermost sharp edge, or an end of the stretch; None: nowhere."""
        n = len(self.levels)
        for share in _OUTERMOST:
            high = np.flatnonzero(level > share * height) + raised.start
            near = int(high[0] if way > 0 else high[-1] + 1)
            if near <= _NEAR or near >= n - _NEAR:
                return 0 if near <= _NEAR else n
            place = near - _NEAR + int(np.argmax(self._jumps[near - _NEAR : near + _NEAR + 1]))
            if self._is_edge(place, way, height):
                return place
        return None

    def _is_edge(self, end: int, way: int, height: float) -> bool:
        """Whether a burst may begin, 1, or end, −1, at a place."""
        after, before = self.levels[end + _SIDE - 1 : end + _NEAR], self.levels[max(end - _NEAR, 0) : end - _SIDE + 1]
        if not len(after) or not len(before):
            return False
        inside, outside = (float(np.median(x)) for x in ((after, before)[::way]))
        jump = float(self._jumps[end])
        return (
            _PART * height < inside < _EVEN * height
            and outside < _OUTSIDE * inside
            and _SHARP * inside < jump < _KICK * inside
        )

    def _stays(self, a: int, b: int, height: float) -> bool:
        """Whether between two places the level never falls low for long, and changes slowly."""
        inner = slice(a + _SIDE, b - _SIDE)
        known = [_bridged(x[inner], k[inner]) for x, k in zip(self.r, self.kept, strict=True) if k[inner].any()]
        if not known:
            return False
        r = np.stack(known)
        low = float(np.quantile(median_filter(np.sqrt(np.square(r).mean(axis=0)), _SMOOTH), 0.1))
        rough = r - uniform_filter1d(r, max(round(_POSE / self.step), 1), axis=1, mode="nearest")
        return low > _PART * height and float(np.square(rough).sum()) < _ROUGH**2 * float(np.square(r).sum())

    def _recurs(self, a: int, b: int) -> bool:
        """Whether what begins at a place is what most reversals of a joint begin with."""
        if not np.isfinite(self._changes[:, a]).any():
            return False
        sizes = np.abs(np.nan_to_num(self._changes))
        j = int(np.argmax(sizes[:, a]))
        turns = self.turns[j]
        others = turns[(turns < a - _NEAR) | (turns > b + _NEAR)]
        if not len(others) or not (np.abs(turns - a) <= _NEAR // 2).any():
            return False
        nearby = np.clip(others[:, None] + np.arange(-_NEAR // 2, _NEAR // 2 + 1), 0, len(self.levels))
        return bool(np.mean(sizes[j, nearby].max(axis=1) > sizes[j, a] / 2) > 0.5)


def _bridged(x: Array, kept: Mask) -> Array:
    """Straight lines across samples that do not count."""
    known = np.flatnonzero(kept)
    return np.interp(np.arange(len(x)), known, x[known])

"""Bursts: time intervals in which something acts on the robot that usually does not, such as a contact.

A model fitted to data with a contact is biased by it and leaves a residual everywhere. So the residual is that of a
robust fit, which ignores the contact. A contact is distinguished from friction, gears and the rest by its shape: its
torque appears and vanishes within milliseconds, is never small in between, and changes only as slowly as the pose. It
may as well be a push, see `pushes`, which may also come and go slowly.

Letters: nv joints, n samples. The level is the rms over the joints of the residual, in units of each joint's noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from idtool.common.arrays import Array, Indices, Mask, joined_runs
from idtool.common.dataclass import dataclass
from idtool.data.logs import JointLog
from idtool.diagnosis.pushes import find_pushes, raised_windows
from idtool.diagnosis.robust_residual import RobustResidual, robust_residual
from idtool.dynamics.effects.data_summary import Burst
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.model import RobotModel

_SMOOTHING = 9  # samples of the median filter; four or more make a period of the band
_EDGE_REACH = 10  # samples to each side in which an edge is looked for and evaluated
_EDGE_MEAN = 3  # samples of each side whose means differ by the jump
_RAISED = 3.0  # times the usual level
_MIN_LEVEL = 4.0  # times the usual level, for the median of a burst
_MIN_GAP = 0.15  # s between bursts
_MIN_DURATION = 0.25  # s
_EDGE_LEVELS = (0.0, 0.1, 0.3)  # of a burst's level, at which its edges are looked for, the outermost first
_MIN_INSIDE = 0.25  # of a burst's level: it is never lower for long
_MAX_INSIDE = 3.0  # of a burst's level, just inside an edge
_MIN_JUMP, _MAX_JUMP = 0.6, 1.4  # of the level just inside an edge
_MAX_OUTSIDE = 0.3  # of the level just inside an edge, for that just outside
_MAX_ROUGHNESS = 0.3  # of the level, that may change faster than a pose does
_POSE_SECONDS = 0.1  # in which a pose hardly changes
_MAX_BURSTS = 10


def find_bursts(experiment: Experiment, theta: Array, progress: Progress) -> tuple[Burst, ...]:
    """Time intervals in which the residual torque is unusually large, as in a contact.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    Hypotheses about contacts, for each training log separately. A burst may have several windows of time.

    A residual that begins or ends within milliseconds may be a contact. Its link is unknown. All windows of contacts
    are one burst. If the residual is large in other windows too, a burst with all windows comes before it.

    A residual that comes and goes slowly may be a push, and so may a contact, whose force seldom is constant. There is
    a burst for each link on which a push explains it.
    """
    residual = robust_residual(experiment, theta, progress, "looking for contacts")
    if len(experiment.runs) == 1:
        return _bursts_of_log(experiment.model, residual, experiment.runs[0].signals.log)
    bursts = []
    start = 0.0
    for run in experiment.runs:
        log = run.signals.log
        stop = start + log.duration + log.dt
        first, end = np.searchsorted(residual.t, [start - log.dt / 2, stop - log.dt / 2])
        if run.train and end > first:
            own = residual.part(slice(int(first), int(end)), start)
            bursts += [replace(burst, log=log.path.name) for burst in _bursts_of_log(experiment.model, own, log)]
        start = stop
    return tuple(bursts)


def _bursts_of_log(model: RobotModel, residual: RobustResidual, log: JointLog) -> tuple[Burst, ...]:
    """Bursts in one log."""
    windows = _contact_windows(residual, log.duration)
    pushes = find_pushes(model, residual)
    if not windows:
        return pushes
    others = []
    for raised in raised_windows(residual):
        window = _high_part(residual, raised)
        if window is not None and not any(_overlap(window, other) for other in windows):
            others.append(window)
    if not others:
        return Burst(windows), *pushes
    return Burst(tuple(sorted([*windows, *others]))), Burst(windows), *pushes


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """True if two time intervals have a time in common."""
    return a[0] <= b[1] and b[0] <= a[1]


def _high_part(series: RobustResidual, window: slice) -> tuple[float, float] | None:
    """Begin and end of the part of a window with at least half of its usual level [s]; None if it is short."""
    level = median_filter(series.levels[window], _SMOOTHING, mode="nearest")
    high = np.flatnonzero(level > np.median(level) / 2)
    t = series.t[window]
    begin, end = float(t[high[0]]), float(t[high[-1]])
    return (round(begin, 4), round(end, 4)) if end - begin > _MIN_DURATION else None


def _contact_windows(series: RobustResidual, log_seconds: float) -> tuple[tuple[float, float], ...]:
    """Begin and end of each window whose level begins or ends sharply and is steady between [s], in order of time.

    The strongest, `_MAX_BURSTS` at most.
    """
    t = series.t
    levels = series.levels
    usual_level = float(np.median(levels))
    bursts: list[tuple[float, float, float]] = []
    for part in series.segments:
        first, end = part.start, part.stop
        if end - first <= 2:
            continue
        dt = float(t[first + 1] - t[first])
        reversals = [np.flatnonzero(np.diff(np.sign(joint_v))) for joint_v in series.v[:, part]]
        segment = _Segment(series.e[:, part], series.valid[:, part], levels[part], reversals, usual_level, dt)
        for a, b, energy in segment.bursts():
            begin_time = t[first + a] - dt / 2 if first + a > 0 else 0.0
            end_time = t[first + b - 1] + dt / 2 if first + b < len(t) else log_seconds
            bursts.append((float(begin_time), float(end_time), energy))
    strongest = sorted(bursts, key=lambda burst: -burst[2])[:_MAX_BURSTS]
    return tuple(sorted((round(begin, 4), round(end, 4)) for begin, end, _ in strongest))


@dataclass(frozen=True)
class _Segment:
    """Part of the log without a gap.

    Attributes
    ----------
    residual
        In units of each joint's noise, shape (nv, n).
    valid
        Mask of the samples at which it is known, shape (nv, n).
    levels
        Its rms over the joints, shape (n,).
    reversals
        By joint, samples at which its velocity changes sign.
    usual_level
        Median level of the log.
    dt
        Sample time [s].
    """

    residual: Array
    valid: Mask
    levels: Array
    reversals: Sequence[Indices]
    usual_level: float
    dt: float

    def bursts(self) -> Iterator[tuple[int, int, float]]:
        """First sample of each burst, the one after its last, and its energy."""
        level = median_filter(self.levels, _SMOOTHING, mode="nearest")
        for first, end in joined_runs(level > _RAISED * self.usual_level, _MIN_GAP / self.dt):
            if (end - first) * self.dt <= _MIN_DURATION / 2:
                continue
            raised = slice(first, end)
            height = float(np.median(level[raised]))
            a = self._burst_edge(raised, level[raised], height, is_begin=True)
            b = self._burst_edge(raised, level[raised], height, is_begin=False)
            if height < _MIN_LEVEL * self.usual_level or a is None or b is None:
                continue
            if (b - a) * self.dt < _MIN_DURATION:
                continue
            has_edge = a > 0 or b < len(self.levels)
            if has_edge and self._is_steady(a, b, height) and not self._recurs_at_reversals(a, b):
                yield a, b, height**2 * (b - a)

    @cached_property
    def _changes(self) -> Array:
        """Change of the mean residual across each place between samples, shape (nv, n + 1); NaN if not known."""
        n = len(self.levels)
        m = _EDGE_MEAN
        changes = np.full((len(self.residual), n + 1), np.nan)
        if n >= 2 * m:
            total = _moving_sum(self.residual * self.valid, m)
            count = _moving_sum(self.valid.astype(float), m)
            mean = np.where(count >= m / 3, total / np.maximum(count, 1), np.nan)
            changes[:, m : n + 1 - m] = mean[:, m:] - mean[:, :-m]
        return changes

    @cached_property
    def _jumps(self) -> Array:
        """Rms of the changes over the joints, shape (n + 1,)."""
        known = np.isfinite(self._changes)
        squares = np.square(np.where(known, self._changes, 0.0)).sum(axis=0)
        return np.asarray(np.sqrt(squares / np.maximum(known.sum(axis=0), 1)))

    def _burst_edge(self, raised: slice, level: Array, height: float, is_begin: bool) -> int | None:
        """Place where a burst begins, or else ends: its outermost sharp edge, or an end of the segment.

        None if there is neither.
        """
        n = len(self.levels)
        for share in _EDGE_LEVELS:
            high = np.flatnonzero(level > share * height) + raised.start
            near = int(high[0] if is_begin else high[-1] + 1)
            if near <= _EDGE_REACH:
                return 0
            if near >= n - _EDGE_REACH:
                return n
            first = near - _EDGE_REACH
            place = first + int(np.argmax(self._jumps[first : near + _EDGE_REACH + 1]))
            if self._is_edge(place, height, is_begin):
                return place
        return None

    def _is_edge(self, place: int, height: float, is_begin: bool) -> bool:
        """True if a burst may begin, or else end, at a place."""
        after = self.levels[place + _EDGE_MEAN - 1 : place + _EDGE_REACH]
        before = self.levels[max(place - _EDGE_REACH, 0) : place - _EDGE_MEAN + 1]
        if not len(after) or not len(before):
            return False
        inner, outer = (after, before) if is_begin else (before, after)
        inside = float(np.median(inner))
        outside = float(np.median(outer))
        jump = float(self._jumps[place])
        is_high_inside = _MIN_INSIDE * height < inside < _MAX_INSIDE * height
        is_low_outside = outside < _MAX_OUTSIDE * inside
        is_sharp = _MIN_JUMP * inside < jump < _MAX_JUMP * inside
        return is_high_inside and is_low_outside and is_sharp

    def _is_steady(self, a: int, b: int, height: float) -> bool:
        """True if the level between two places never is low for long, and changes slowly."""
        inner = slice(a + _EDGE_MEAN, b - _EDGE_MEAN)
        rows = []
        for x, keep in zip(self.residual, self.valid, strict=True):
            if keep[inner].any():
                rows.append(_interpolated(x[inner], keep[inner]))
        if not rows:
            return False
        residual = np.stack(rows)
        level = median_filter(np.sqrt(np.square(residual).mean(axis=0)), _SMOOTHING)
        low = float(np.quantile(level, 0.1))
        pose_samples = max(round(_POSE_SECONDS / self.dt), 1)
        rough = residual - uniform_filter1d(residual, pose_samples, axis=1, mode="nearest")
        is_smooth = float(np.square(rough).sum()) < _MAX_ROUGHNESS**2 * float(np.square(residual).sum())
        return low > _MIN_INSIDE * height and is_smooth

    def _recurs_at_reversals(self, a: int, b: int) -> bool:
        """True if the residual changes as much at most other reversals of the joint as where the burst begins.

        Then it is friction.
        """
        if not np.isfinite(self._changes[:, a]).any():
            return False
        sizes = np.abs(np.nan_to_num(self._changes))
        j = int(np.argmax(sizes[:, a]))
        reversals = self.reversals[j]
        half_reach = _EDGE_REACH // 2
        is_outside = (reversals < a - _EDGE_REACH) | (reversals > b + _EDGE_REACH)
        others = reversals[is_outside]
        begins_at_reversal = bool((np.abs(reversals - a) <= half_reach).any())
        if not len(others) or not begins_at_reversal:
            return False
        around = np.arange(-half_reach, half_reach + 1)
        nearby = np.clip(others[:, None] + around, 0, len(self.levels))
        has_change = sizes[j, nearby].max(axis=1) > sizes[j, a] / 2
        return bool(np.mean(has_change) > 0.5)


def _moving_sum(x: Array, m: int) -> Array:
    """Sums of m samples in a row, shape (nv, n − m + 1)."""
    total = np.cumsum(np.insert(x, 0, 0.0, axis=1), axis=1)
    return np.asarray(total[:, m:] - total[:, :-m])


def _interpolated(x: Array, valid: Mask) -> Array:
    """Samples with straight lines across the invalid ones."""
    known = np.flatnonzero(valid)
    return np.interp(np.arange(len(x)), known, x[known])

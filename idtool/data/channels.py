"""`Channels`: the signals of a log at evenly spaced instants.

Stamps that jitter are either true sampling times, then the signals are interpolated to an even clock; or they are only
the times of writing, then the samples themselves are taken as even. The lag of a measured velocity is undone.

Shapes: nv joints, N samples. Units: rad or m, s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.inspection.velocity import velocity_agreement
from idtool.data.logs.log import Log

MAX_ANALYZED_SAMPLES = 1 << 16  # samples from which a log is judged
_MAX_JITTER = 0.01  # rms of the stamps' jitter, in samples, above which the signals are put on an even clock
_SPEED_REACH = 10  # samples to either side that tell the speed at which a sample was taken
_MIN_AGREEMENT = 0.8  # share of a measured velocity's power that dq/dt must explain
_MAX_GAIN_ERROR = 0.1  # by which a measured velocity may be larger or smaller than dq/dt
_MIN_TRAVEL = 0.01  # rad or m of travel below which noise may hide the motion
_MIN_BIAS = 2e-3  # rad/s or m/s: mean error of a measured velocity that is more than rounding
_MIN_LAG = 0.01  # samples of lag that are none
_MAX_LAG_ERROR = 0.2  # samples, or share of the lag, that the lag's standard error may be


class Channels:
    """The signals of a model's joints on an even clock.

    Attributes
    ----------
    jitter
        Root mean square of the stamps' steps about the sample time, in samples.
    lag
        Per joint, how late the measured velocity is [s]; 0 where it cannot be told. It is undone.
    bias
        Per joint, by how much the measured velocity is off on average [rad/s or m/s]; 0 where it cannot be told. It is
        undone.
    has_consistent_velocity
        Per joint, whether there is a measured velocity that follows the position; shape (nv,).

    Parameters
    ----------
    log
        The log.
    joints
        Names of the nv joints, all in the log.
    """

    def __init__(self, log: Log, joints: Sequence[str]) -> None:
        self.log = log
        self._columns = [log.joints.index(name) for name in joints]
        self.jitter = self._step_jitter()
        self._resampled = self.jitter > _MAX_JITTER and self._stamps_are_true()
        self.lag = np.zeros(len(joints))
        self.has_velocity = np.array([log.has("v", name) for name in joints])
        self.has_consistent_velocity = self.has_velocity.copy()
        if self.has_velocity.any():
            self.lag, self.has_consistent_velocity = self._judge_velocity()
        self.bias = self._velocity_bias()

    def stretches(self) -> list[slice]:
        """Stretches with all signals and no gap; a sample keeps the index of the logged one nearest to it."""
        early, late = (int(np.ceil(max(lag, 0.0) / self.log.dt)) for lag in (-self.lag.min(), self.lag.max()))
        return [slice(s.start + early, s.start + self._count(s) - late) for s in self.log.segments]

    def times(self, part: slice) -> Array:
        """Times of samples [s]; sample i of a segment is i sample times after its first."""
        return self._even(part) if self._resampled else self.log.t[part]

    def signal(self, name: str, part: slice) -> Array:
        """A signal of the joints, shape (nv, N)."""
        return self._read(name, part, np.zeros(len(self._columns)))

    def velocity(self, part: slice) -> Array:
        """The measured velocity of the joints, its lag and bias undone, shape (nv, N)."""
        return self._read("v", part, self.lag) - self.bias[:, None]

    def _read(self, name: str, part: slice, late: Array) -> Array:
        """A signal as it stands in the log ``late`` [s] after the samples, shape (nv, N)."""
        x = self.log.signals[name]
        if not self._resampled and not late.any():
            return np.ascontiguousarray(x[part][:, self._columns].T)
        t, segment = self._even(part), self._segment(part)
        if self._resampled:
            stamps = self.log.t[segment]
            first = int(np.searchsorted(stamps, t[0] + late.min())) - 1
            last = int(np.searchsorted(stamps, t[-1] + late.max(), side="right")) + 1
            near = slice(segment.start + max(first, 0), min(segment.start + last, segment.stop))
            stamps = np.maximum.accumulate(self.log.t[near])
        else:  # by count: stamps that jitter and are not true would put their jitter into the signal
            first, last = (int(lag / self.log.dt) for lag in (late.min() - self.log.dt, late.max() + self.log.dt))
            near = slice(max(part.start + first, segment.start), min(part.stop + last, segment.stop))
            stamps = self._even(near)
        return np.stack([np.interp(t + lag, stamps, x[near, c]) for lag, c in zip(late, self._columns, strict=True)])

    def _even(self, part: slice) -> Array:
        """The even clock [s], shape (N,)."""
        segment = self._segment(part)
        return np.asarray(self.log.t[segment.start] + self.log.dt * (np.arange(part.start, part.stop) - segment.start))

    def longest_stretch(self, parts: Sequence[slice]) -> slice:
        """A stretch to judge the log by, of bounded length."""
        longest = max(parts, key=lambda s: s.stop - s.start)
        return slice(longest.start, min(longest.stop, longest.start + MAX_ANALYZED_SAMPLES))

    def _segment(self, part: slice) -> slice:
        return next(s for s in self.log.segments if s.start <= part.start < s.stop)

    def _count(self, segment: slice) -> int:
        """Samples of a segment on the even clock, never more than were logged."""
        count = int(segment.stop - segment.start)
        if self._resampled:
            count = min(count, int((self.log.t[segment.stop - 1] - self.log.t[segment.start]) / self.log.dt) + 1)
        return count

    def _step_jitter(self) -> float:
        ends = np.cumsum([s.stop - s.start - 1 for s in self.log.segments])
        enough = self.log.segments[: int(np.searchsorted(ends, MAX_ANALYZED_SAMPLES)) + 1]
        steps = np.concatenate([np.diff(self.log.t[s][: MAX_ANALYZED_SAMPLES + 1]) for s in enough])
        return float(np.std(steps[:MAX_ANALYZED_SAMPLES])) / self.log.dt

    def _stamps_are_true(self) -> bool:
        """Whether jittering stamps tell when samples were taken, or only when they were written.

        Told by which clock the positions' increments agree with, at the speed of the samples around them.
        """
        error = np.zeros(2)
        for s in self.log.segments:
            t, q = self.log.t[s][:MAX_ANALYZED_SAMPLES], self.log.signals["q"][s, self._columns][:MAX_ANALYZED_SAMPLES]
            if len(t) > 2 * _SPEED_REACH + 1:
                speed = (q[2 * _SPEED_REACH :] - q[: -2 * _SPEED_REACH]) / (
                    t[2 * _SPEED_REACH :] - t[: -2 * _SPEED_REACH]
                )[:, None]
                step = np.diff(q[_SPEED_REACH:-_SPEED_REACH], axis=0)
                for k, time in enumerate((np.diff(t[_SPEED_REACH:-_SPEED_REACH]), np.full(len(step), self.log.dt))):
                    error[k] += np.square(step - speed[:-1] * time[:, None]).sum()
        return bool(error[0] < error[1])

    def _velocity_bias(self) -> Array:
        """Mean error of the measured velocity against the distance covered, shape (nv,) [rad/s or m/s]."""
        if not self.has_consistent_velocity.any():
            return np.zeros(len(self._columns))
        part = self.longest_stretch(self.stretches())
        q, v = self.signal("q", part), self._read("v", part, self.lag)
        mean_velocity = (q[:, -1] - q[:, 0]) / (self.log.dt * (q.shape[1] - 1))
        bias = (v[:, 1:] + v[:, :-1]).mean(axis=1) / 2 - mean_velocity
        return np.where(self.has_consistent_velocity & (np.abs(bias) > _MIN_BIAS), bias, 0.0)

    def _judge_velocity(self) -> tuple[Array, Mask]:
        """Lag of each measured velocity [s], and whether it follows the position; shape (nv,) each.

        Joints whose own lag is not sure share the mean of the others', as drives of one robot filter alike. A joint
        that hardly moves tells nothing against its velocity.
        """
        part = self.longest_stretch(self.stretches())
        q, v = self.signal("q", part), self.signal("v", part)
        agreements = [velocity_agreement(x, y, self.log.dt) for x, y in zip(q, v, strict=True)]
        lag, gain, agreement, error = np.array(agreements).T
        follows = (agreement > _MIN_AGREEMENT) & (np.abs(gain - 1) < _MAX_GAIN_ERROR)
        sure = (
            self.has_velocity
            & follows
            & (error < np.maximum(_MAX_LAG_ERROR * self.log.dt, _MAX_LAG_ERROR * np.abs(lag)))
        )
        trusted = self.has_velocity & (follows | np.isnan(agreement) | (np.ptp(q, axis=1) < _MIN_TRAVEL))
        if not sure.any():
            return np.zeros(len(lag)), trusted
        shared = float(np.average(lag[sure], weights=error[sure] ** -2))
        lag = np.where(sure, lag, np.where(trusted, shared, 0.0))
        return np.where(np.abs(lag) < _MIN_LAG * self.log.dt, 0.0, lag), trusted

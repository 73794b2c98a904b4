"""`Channels`: the signals of a log at evenly spaced instants.

Stamps that jitter are either true sampling times, then the signals are interpolated to an even clock; or they are only
the times of writing, then the samples themselves are taken as even. The lag of a measured velocity is undone.

Shapes: nv joints, N samples. Units: rad or m, s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.threads import in_threads
from idtool.data.logs.log import JointLog
from idtool.data.logs.stored_arrays import release_pages
from idtool.data.velocity_agreement import velocity_agreement

MAX_ANALYZED_SAMPLES = 1 << 16  # samples from which the clock and the velocities are checked
_MAX_JITTER = 0.01  # rms of the stamps' jitter, in samples, above which the signals are put on an even clock
_SPEED_REACH = 10  # samples to either side that tell the speed at which a sample was taken
_SPECTRA = 10  # of each signal, about as many as `velocity_agreement` computes
_MIN_AGREEMENT = 0.8  # share of a measured velocity's power that dq/dt must explain
_MAX_GAIN_ERROR = 0.1  # by which a measured velocity may be larger or smaller than dq/dt
_MIN_TRAVEL = 0.01  # rad or m of travel below which noise may hide the motion
_MIN_BIAS = 2e-3  # rad/s or m/s: mean error of a measured velocity that is more than rounding
_MIN_LAG = 0.01  # samples: a smaller lag counts as none
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

    def __init__(self, log: JointLog, joints: Sequence[str]) -> None:
        self.log = log
        self._columns = [log.joints.index(name) for name in joints]
        self.jitter = self._step_jitter()
        self._is_resampled = self.jitter > _MAX_JITTER and self._stamps_are_true()
        self.lag = np.zeros(len(joints))
        self.has_velocity = np.array([log.has("v", name) for name in joints])
        self.has_consistent_velocity = self.has_velocity.copy()
        if self.has_velocity.any():
            self.lag, self.has_consistent_velocity = self._check_velocity()
        self.bias = self._velocity_bias()

    def stretches(self) -> list[slice]:
        """Stretches with all signals and no gap; a sample keeps the index of the logged one nearest to it."""
        largest_lead = max(-self.lag.min(), 0.0)
        largest_lag = max(self.lag.max(), 0.0)
        skip = int(np.ceil(largest_lead / self.log.dt))
        cut = int(np.ceil(largest_lag / self.log.dt))
        return [slice(s.start + skip, s.start + self._sample_count(s) - cut) for s in self.log.segments]

    def times(self, part: slice) -> Array:
        """Times of samples [s]; sample i of a segment is i sample times after its first."""
        if self._is_resampled:
            return self._even_times(part)
        return self.log.t[part]

    def signal(self, name: str, part: slice) -> Array:
        """A signal of the joints, shape (nv, N)."""
        return self._read(name, part, np.zeros(len(self._columns)))

    def velocity(self, part: slice) -> Array:
        """The measured velocity of the joints, its lag and bias undone, shape (nv, N)."""
        return self._read("v", part, self.lag) - self.bias[:, None]

    def _read(self, name: str, part: slice, lag: Array) -> Array:
        """A signal as it stands in the log ``lag`` [s], shape (nv,), after the samples; shape (nv, N)."""
        x = self.log.signals[name]
        values = self._values(x, part, lag)
        release_pages([x])
        return values

    def _values(self, x: Array, part: slice, lag: Array) -> Array:
        """`_read`, of a signal of the log, shape (samples, joints)."""
        if not self._is_resampled and not lag.any():
            return np.ascontiguousarray(x[part][:, self._columns].T)
        dt = self.log.dt
        t = self._even_times(part)
        segment = self._segment(part)
        if self._is_resampled:
            stamps = self.log.t[segment]
            first = int(np.searchsorted(stamps, t[0] + lag.min())) - 1
            last = int(np.searchsorted(stamps, t[-1] + lag.max(), side="right")) + 1
            window = slice(segment.start + max(first, 0), min(segment.start + last, segment.stop))
            stamps = np.maximum.accumulate(self.log.t[window])
        else:  # by count: stamps that jitter and are not true would put their jitter into the signal
            first = int((lag.min() - dt) / dt)
            last = int((lag.max() + dt) / dt)
            window = slice(max(part.start + first, segment.start), min(part.stop + last, segment.stop))
            stamps = self._even_times(window)
        rows = []
        for own_lag, column in zip(lag, self._columns, strict=True):
            rows.append(np.interp(t + own_lag, stamps, x[window, column]))
        return np.stack(rows)

    def _even_times(self, part: slice) -> Array:
        """Times of the even clock [s], shape (N,)."""
        segment = self._segment(part)
        samples = np.arange(part.start, part.stop) - segment.start
        return np.asarray(self.log.t[segment.start] + self.log.dt * samples)

    def longest_stretch(self, stretches: Sequence[slice]) -> slice:
        """The longest stretch, cut to a bounded length."""
        longest = max(stretches, key=lambda s: s.stop - s.start)
        return slice(longest.start, min(longest.stop, longest.start + MAX_ANALYZED_SAMPLES))

    def _segment(self, part: slice) -> slice:
        return next(s for s in self.log.segments if s.start <= part.start < s.stop)

    def _sample_count(self, segment: slice) -> int:
        """Samples of a segment on the even clock, never more than were logged."""
        count = int(segment.stop - segment.start)
        if self._is_resampled:
            duration = self.log.t[segment.stop - 1] - self.log.t[segment.start]
            count = min(count, int(duration / self.log.dt) + 1)
        return count

    def _step_jitter(self) -> float:
        step_counts = np.cumsum([s.stop - s.start - 1 for s in self.log.segments])
        segments = self.log.segments[: int(np.searchsorted(step_counts, MAX_ANALYZED_SAMPLES)) + 1]
        steps = np.concatenate([np.diff(self.log.t[s][: MAX_ANALYZED_SAMPLES + 1]) for s in segments])
        return float(np.std(steps[:MAX_ANALYZED_SAMPLES])) / self.log.dt

    def _stamps_are_true(self) -> bool:
        """True if jittering stamps are the times of sampling; False if they are only the times of writing.

        The clock is chosen that the positions' increments agree with, at the speed of the samples around them.
        """
        r = _SPEED_REACH
        stamp_error = 0.0
        even_error = 0.0
        for segment in self.log.segments:
            t = self.log.t[segment][:MAX_ANALYZED_SAMPLES]
            q = self.log.signals["q"][segment][:MAX_ANALYZED_SAMPLES, self._columns]
            if len(t) > 2 * r + 1:
                speed = (q[2 * r :] - q[: -2 * r]) / (t[2 * r :] - t[: -2 * r])[:, None]
                step = np.diff(q[r:-r], axis=0)
                time = np.diff(t[r:-r])
                stamp_error += np.square(step - speed[:-1] * time[:, None]).sum()
                even_error += np.square(step - speed[:-1] * self.log.dt).sum()
        return bool(stamp_error < even_error)

    def _velocity_bias(self) -> Array:
        """Mean error of the measured velocity against the distance covered, shape (nv,) [rad/s or m/s]."""
        if not self.has_consistent_velocity.any():
            return np.zeros(len(self._columns))
        part = self.longest_stretch(self.stretches())
        q, v = self.signal("q", part), self._read("v", part, self.lag)
        mean_velocity = (q[:, -1] - q[:, 0]) / (self.log.dt * (q.shape[1] - 1))
        bias = (v[:, 1:] + v[:, :-1]).mean(axis=1) / 2 - mean_velocity
        return np.where(self.has_consistent_velocity & (np.abs(bias) > _MIN_BIAS), bias, 0.0)

    def _check_velocity(self) -> tuple[Array, Mask]:
        """Lag of each measured velocity [s], and True where it follows the position; shape (nv,) each.

        Joints whose own lag is uncertain share the mean of the others', as drives of one robot filter alike. A joint
        that hardly moves tells nothing against its velocity.
        """
        part = self.longest_stretch(self.stretches())
        q, v = self.signal("q", part), self.signal("v", part)
        pairs = list(zip(q, v, strict=True))
        agreements = in_threads(lambda pair: velocity_agreement(*pair, self.log.dt), pairs, _SPECTRA * q.size)
        lag, gain, agreement, error = np.array(agreements).T
        follows = (agreement > _MIN_AGREEMENT) & (np.abs(gain - 1) < _MAX_GAIN_ERROR)
        max_error = np.maximum(_MAX_LAG_ERROR * self.log.dt, _MAX_LAG_ERROR * np.abs(lag))
        is_certain = self.has_velocity & follows & (error < max_error)
        hardly_moves = np.ptp(q, axis=1) < _MIN_TRAVEL
        is_consistent = self.has_velocity & (follows | np.isnan(agreement) | hardly_moves)
        if not is_certain.any():
            return np.zeros(len(lag)), is_consistent
        shared_lag = float(np.average(lag[is_certain], weights=error[is_certain] ** -2))
        lag = np.where(is_certain, lag, np.where(is_consistent, shared_lag, 0.0))
        return np.where(np.abs(lag) < _MIN_LAG * self.log.dt, 0.0, lag), is_consistent

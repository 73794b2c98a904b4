"""`Signals` without a look ahead: the motion as an estimator that runs along with the robot has it.

The chain is that of `signals`, each of its filters run forwards twice in place of forwards and backwards: the same
magnitude, and one delay for q, v, a and tau alike. The torque equation is linear in its columns, so the band's delay
leaves it exact; the wide filter's delay is the same at all frequencies of the motion but for its dispersion, which a
band five times as narrow makes small. Differences are symmetric, and what is not differenced waits as many samples.

Beforehand, and so from the whole log, comes only what a robot in operation knows from its calibration: the sample
time and the segments, which velocity is used and how late it is, the speed below which a joint counts as at rest, how
late the IMU is, and when a contact is closed whose flag is found from the torque.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import signal

from idtool.common.arrays import Array
from idtool.data.filters import DIFFERENCE_REACH, LowPass, differentiate
from idtool.data.signals import BATCH_SAMPLES, WIDE_BAND_FACTOR, Batch, Motion, Signals, with_coordinates

_MAX_CUT_WEIGHT = 1e-14  # of the response's weight may be forgotten: rounding
_MAX_MISSING_WEIGHT = 0.02  # of it may be missing at the start of the data
_RESPONSE_PERIODS = 40.0  # of the cut-off that the slowest response lasts
_COLUMN_REACH = 1  # samples to either side that a column may look at


class CausalLowPass(LowPass):
    """`LowPass` without a look ahead: the same Butterworth run forwards twice.

    As its magnitude is that of the zero-phase filter, so is its `redundancy`. Before the data it takes everything as
    zero, which is linear as the torque equation is. It keeps no state: it is given the `reach` samples before those
    that are asked for, and what came before them no longer matters.

    Attributes
    ----------
    delay
        Delay of slow signals [s].

    Parameters
    ----------
    cutoff, order, dt, stride
        See `LowPass`.
    """

    def __init__(self, cutoff: float, order: int, dt: float, stride: int = 1) -> None:
        super().__init__(cutoff, order, dt, stride)
        self._sections: Array = np.tile(signal.butter(order, cutoff, fs=1 / dt, output="sos"), (2, 1))
        impulse = np.zeros(int(np.ceil(_RESPONSE_PERIODS / min(cutoff * dt, 0.5 - cutoff * dt))))
        impulse[0] = 1.0
        response = signal.sosfilt(self._sections, impulse)
        remaining_weight = np.cumsum(np.abs(response)[::-1])[::-1]
        self.reach = int(np.count_nonzero(remaining_weight > _MAX_CUT_WEIGHT * remaining_weight[0]))
        missing_weight = np.abs(1 - np.cumsum(response))
        self.edge = int(np.flatnonzero(missing_weight > _MAX_MISSING_WEIGHT)[-1]) + 1
        self.delay = float(response @ np.arange(len(response))) * dt

    def __call__(self, x: Array, before: int, after: int) -> Array:
        """Filter and decimate.

        Parameters
        ----------
        x
            Shape (..., before + N + after).
        before, after
            Samples of x before and after those asked for; the latter have no influence.

        Returns
        -------
        Samples 0, stride, 2 stride, … of the N, filtered; shape (..., ceil(N / stride)).
        """
        y = signal.sosfilt(self._sections, x[..., : x.shape[-1] - after], axis=-1)
        return np.asarray(y[..., before :: self.stride])

    def filter_from_constant(self, x: Array) -> Array:
        """Filter all samples of a signal, shape (nv, N), taken as constant before the first one."""
        start = signal.sosfilt_zi(self._sections)[:, None, :] * x[None, :, :1]
        return np.asarray(signal.sosfilt(self._sections, x, axis=-1, zi=start)[0])


def causal_batches(signals: Signals, order: int, ranges: Sequence[slice] | None = None) -> Iterator[Batch]:
    """The log in batches of bounded size, like `Signals.batches`, with no sample that is later than its time.

    A batch's ``motion.t`` is when the last sample was taken that has any influence on the motion, not when the motion
    was; the band's filter delays the columns by its `CausalLowPass.delay` further.

    Parameters
    ----------
    signals
        The signals of a log.
    order
        Order of one pass of the filters.
    ranges
        Parts of the signals' own; default: all of them.
    """
    reader = _MotionReader(signals, order)
    low_pass = CausalLowPass(signals.band_hz, order, signals.log.dt, signals.low_pass.stride)
    size = max(BATCH_SAMPLES, 8 * low_pass.reach)
    size += -size % low_pass.stride
    for samples in signals.ranges if ranges is None else ranges:
        first, last = reader.usable_range(samples)
        for start in range(first + low_pass.edge, last, size):
            stop = min(start + size, last)
            before = min(low_pass.reach, start - first)
            motion = reader.motion(slice(start - before, stop + _COLUMN_REACH))
            yield Batch(motion, before, _COLUMN_REACH, low_pass)


class _MotionReader:
    """The motion at samples of the log, from samples up to `lookahead` later."""

    def __init__(self, signals: Signals, order: int) -> None:
        log = signals.log
        self._signals = signals
        self._channels = signals.channels
        self._controller = signals.controller
        wide = WIDE_BAND_FACTOR * signals.band_hz
        self._wide = CausalLowPass(wide, order, log.dt) if wide < 0.4 / log.dt else None
        self._memory = self._wide.reach if self._wide else 0
        # Two differences, a velocity that is read later by its lag, a reading between two samples, a column's own.
        latest = max(float(signals.lag.max()), 0.0, signals.sensor_lookahead)
        lag_samples = int(np.ceil(latest / log.dt))
        self.lookahead = 2 * DIFFERENCE_REACH + lag_samples + 1 + _COLUMN_REACH

    def usable_range(self, samples: slice) -> tuple[int, int]:
        """First and last of the samples of a range whose motion is there, the filter's start left out."""
        stretch = self._stretch_of(samples.start)
        first = self._first_sample(stretch) + self._memory + 2 * DIFFERENCE_REACH
        last = stretch.stop - self.lookahead - _COLUMN_REACH
        return max(samples.start, first), min(samples.stop, last)

    def motion(self, part: slice) -> Motion:
        """Samples of the motion, all from one segment."""
        dt = self._signals.log.dt
        r = DIFFERENCE_REACH
        outer = slice(part.start - 2 * r, part.stop + 2 * r)
        q = self._smooth(outer, "q")
        v = differentiate(q, dt)
        from_position = self._signals.velocity_from_position[:, None]
        if not from_position.all():
            v = np.where(from_position, v, self._smooth(outer, "v")[:, r:-r])
        a = differentiate(v, dt)
        availability = self._channels.times(slice(part.start + self.lookahead, part.stop + self.lookahead))
        motion = Motion(
            t=availability - self._signals.log.start,
            q=q[:, 2 * r : -2 * r],
            v=v[:, r:-r],
            a=a,
            tau=self._smooth(part, "tau"),
            logged_tau=self._read("tau", part),
            velocity_deadband=self._signals.velocity_deadband,
            dt=dt,
            log=self._signals.log.path.name,
            recording=self._signals.recording,
            unknown_torque=self._signals.unknown_torque,
        )
        return self._with_sensors(motion, part)

    def _with_sensors(self, motion: Motion, part: slice) -> Motion:
        """Motion with the coordinates of wrench sensors and of a floating base, and with contacts."""
        signals = self._signals
        inner = partial(self._smooth_at, part)
        if signals.wrench_channels is not None:
            wrenches = signals.wrench_channels.wrenches(self._times_before(part), inner)
            zero = np.zeros_like(wrenches)
            motion = with_coordinates(motion, zero, zero, wrenches)
        if signals.base_sensors is not None:
            r = 2 * DIFFERENCE_REACH
            outer = slice(part.start - r, part.stop + r)
            smooth = partial(self._smooth_at, outer)
            v, a = signals.base_sensors.kinematics(self._times_before(outer), signals.log.dt, smooth)
            motion = with_coordinates(motion, v, a, np.zeros_like(v))
        if signals.contact_channels is not None:
            # flags and orientation are not filtered, and so are read when the filtered motion was
            delay = self._wide.delay if self._wide else 0.0
            times = self._channels.times(part) - delay
            contacts = signals.contact_channels.samples(times, self._times_before(part), inner)
            motion = replace(motion, contacts=contacts)
        return motion

    def _times_before(self, part: slice) -> Array:
        """Times of samples and of those before them that the wide filter remembers [s]."""
        return self._channels.times(slice(self._start(part), part.stop))

    def _smooth_at(self, part: slice, x: Array) -> Array:
        """Values at `_times_before` samples through the wide filter, at the samples."""
        if not self._wide:
            return x
        return self._wide.filter_from_constant(x)[:, part.start - self._start(part) :]

    def _start(self, part: slice) -> int:
        """The first sample that the wide filter takes for samples of the log."""
        if not self._wide:
            return int(part.start)
        first = self._first_sample(self._stretch_of(part.start))
        return max(int(part.start) - self._memory, first)

    def _stretch_of(self, sample: int) -> slice:
        """The stretch that a sample lies in."""
        return next(s for s in self._channels.stretches() if s.start <= sample < s.stop)

    def _first_sample(self, stretch: slice) -> int:
        """The first sample of a stretch that has every signal."""
        delay_samples = int(np.ceil(self._controller.delay / self._signals.log.dt)) + 1
        return int(stretch.start) + delay_samples + DIFFERENCE_REACH

    def _smooth(self, part: slice, name: str) -> Array:
        """A signal through the wide filter, which starts as far before the part as it can remember."""
        return self._smooth_at(part, self._read(name, slice(self._start(part), part.stop)))

    def _read(self, name: str, part: slice) -> Array:
        """A signal as it was logged, shape (nv, N); the controller's torque where none was."""
        if name == "v":
            return self._channels.velocity(part)
        if name == "q":
            return self._channels.signal("q", part)
        joints = self._controller.joints
        if joints.all():
            return self._controller.torque(self._channels, part)
        tau = self._channels.signal("tau", part)
        if joints.any():
            tau[joints] = self._controller.torque(self._channels, part)[joints]
        return tau

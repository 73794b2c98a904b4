"""`Log` → `Motion`: positions, velocities, accelerations and torques of the model's joints, batch after batch.

The torque equation is linear in its unknowns, so a low-pass on every column and on the torque alike keeps it exact,
where one on the signals alone does not. Here the signals get a wide zero-phase filter against differentiated noise;
`LowPass` is then applied to the columns. Both are symmetric kernels of finite length, so that a log taken in batches
gives what the whole gives, and nothing reaches across a gap.

Shapes: nv joints, N samples at the logged rate, n samples after decimation. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from idtool.config import Config
from idtool.exceptions import ConfigError, LogError
from idtool.inspection.clock import jitter
from idtool.inspection.velocity import velocity_agreement
from idtool.logs.log import Log

Array = NDArray[np.float64]

BATCH = 8192  # samples
_WIDE = 5.0  # the signals' own filter, in units of the band
_DEFAULT_CUTOFF = 40.0  # Hz
_EDGE = 0.02
_TAIL = 1e-6  # of a kernel's weight may be cut off
_RESAMPLED = 0.01  # rms of the stamps' jitter, in samples, above which the signals are put on a uniform clock
_JITTERY = 0.1  # rms of the stamps' jitter, in samples, above which differentiating q is not trusted
_LAGS = 0.25  # samples of lag of a measured velocity that are worth a word
_AGREES = 0.8  # share of a measured velocity's power that dq/dt must explain for their lag to be believed
_SURE = 0.2  # samples, or share of the lag, that its standard error may be
_QUIETER = 0.5  # a measured velocity is used where its noise is below this share of the differentiated one's
_STILL = 3e-3  # rad/s or m/s: least velocity whose sign is believed
_SIGN_WIDTH = 1.25  # tanh(v / (1.25 sigma)) is nearest to the mean of the true v's sign under noise of sigma
_AROUND = 10  # samples to either side that tell the speed at which a sample was taken
_SAMPLES_FOR_CHOICE = 1 << 16
# Maximally flat central difference, 4 samples to each side: within 1 % up to a fifth of the sampling rate.
_DIFFERENCE = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_REACH = len(_DIFFERENCE) // 2


@dataclass(frozen=True)
class Motion:
    """Samples of one batch.

    Attributes
    ----------
    t
        Time as logged [s], shape (N,).
    q, v, a
        Position, velocity and acceleration, shape (nv, N).
    tau
        Torque at the joint output, shape (nv, N).
    logged
        The same as it was logged, where the others have been through the signals' filter; shape (nv, N).
    still
        Speed below which the sign of v is not known, shape (nv,).
    dt
        Sample time [s].
    """

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    logged: Array
    still: Array
    dt: float


class LowPass:
    """A zero-phase Butterworth low-pass that decimates to its band.

    The kernel is the impulse response of the filter run forwards and backwards, cut where what is left of it weighs
    less than 1e-6. At an end of the data it is cut short and scaled to the weight that is left.

    Parameters
    ----------
    cutoff
        Corner frequency of one pass [Hz]; the two passes together are 6 dB down there.
    order
        Of one pass.
    dt
        Sample time [s].
    stride
        Every how many samples to keep one.
    """

    def __init__(self, cutoff: float, order: int, dt: float, stride: int = 1) -> None:
        self.stride = stride
        sections = signal.butter(order, cutoff, fs=1 / dt, output="sos")
        # Long enough for the slowest pole of any order up to 8 to die away.
        impulse = np.zeros(int(np.ceil(20 / (cutoff * dt))))
        impulse[0] = 1.0
        response = signal.sosfilt(sections, impulse)
        kernel = signal.correlate(response, response)
        weight = np.cumsum(np.abs(kernel[: len(impulse)]))
        cut = int(np.searchsorted(weight, _TAIL * weight[-1]))
        kernel = kernel[cut : len(kernel) - cut]
        pad = -(len(kernel) // 2) % stride
        self.kernel: Array = np.pad(kernel / kernel.sum(), pad)
        self.reach = len(self.kernel) // 2
        # Closer to an end than this, more than 2 % of the weight is missing and what comes out is not of the band.
        beyond = np.abs(np.cumsum(self.kernel)[: self.reach]) > _EDGE
        self.edge = self.reach - int(np.argmax(beyond))

    @property
    def redundancy(self) -> float:
        """How many of the kept samples of white noise are worth one independent one."""
        return max(1.0, 1 / (self.stride * float(self.kernel @ self.kernel)))

    def __call__(self, x: Array, before: int, after: int) -> Array:
        """Filter and decimate.

        Parameters
        ----------
        x
            Shape (..., before + N + after).
        before, after
            Samples of x that serve as surroundings only: `reach`, or fewer at an end of the data.

        Returns
        -------
        Samples 0, stride, 2 stride, … of the N, filtered; shape (..., ceil(N / stride)).
        """
        count = -(-(x.shape[-1] - before - after) // self.stride)
        short = (self.reach - before, self.reach - after)
        padded = np.pad(x, [(0, 0)] * (x.ndim - 1) + [short]) if any(short) else x
        first = 2 * self.reach // self.stride
        filtered = signal.upfirdn(self.kernel, padded, down=self.stride, axis=-1)[..., first : first + count]
        if any(short):
            ones = np.pad(np.ones(x.shape[-1]), [short])
            filtered = filtered / signal.upfirdn(self.kernel, ones, down=self.stride)[first : first + count]
        return np.ascontiguousarray(filtered)


@dataclass(frozen=True)
class Batch:
    """A stretch of one segment: motion with its surroundings, and the filter that takes columns to the band.

    Attributes
    ----------
    motion
        ``before`` + N + ``after`` samples.
    before, after
        Surroundings, there only for the filter.
    low_pass
        The band.
    """

    motion: Motion
    before: int
    after: int
    low_pass: LowPass

    def filter(self, x: Array) -> Array:
        """Columns of the motion's samples, shape (..., before + N + after), in the band and decimated: (..., n)."""
        return self.low_pass(x, self.before, self.after)

    @property
    def t(self) -> Array:
        """Times of the filtered samples [s], shape (n,)."""
        return self.motion.t[self.before : len(self.motion.t) - self.after : self.low_pass.stride]


class Signals:
    """A log seen as the model's joints' motion.

    Attributes
    ----------
    band_hz
        The low-pass's cut-off [Hz].
    differentiated
        Per joint, whether v comes from q.
    lag
        Per joint, how late the measured velocity is [s]; undone where it is used.
    still
        Speed below which the sign of v is not known, shape (nv,).
    warnings
        What was decided and why, a plain sentence each.

    Raises
    ------
    LogError
        If a joint has neither torque nor a command with a controller, or no segment is long enough.
    ConfigError
        If the cut-off lies above half the sampling rate.
    """

    def __init__(self, log: Log, joints: Sequence[str], config: Config) -> None:
        self.log = log
        self.joints = tuple(joints)
        self.controller = config.controller
        self.warnings: list[str] = []
        self._columns = [log.joints.index(name) for name in joints]
        rate = 1 / log.dt
        self.band_hz = _band(log, config)
        # Twice the band is sampled four times: what would alias is 48 dB down.
        stride = max(1, int(rate / (4 * self.band_hz)))
        self.low_pass = LowPass(self.band_hz, config.filter.order, log.dt, stride)
        self.every_sample = LowPass(self.band_hz, config.filter.order, log.dt)
        wide = _WIDE * self.band_hz
        self._wide = LowPass(wide, config.filter.order, log.dt) if wide < 0.4 * rate else None
        self._jitter = jitter(log.t, log.dt, log.segments)
        self._resampled = self._jitter > _RESAMPLED and self._stamps_are_true()
        self._commanded = [self._check_torque(name) for name in joints]
        self._delay = self.controller.delay / log.dt if self.controller and any(self._commanded) else 0.0
        self._margin = (self._wide.reach if self._wide else 0) + 2 * _REACH
        self.lag = np.zeros(len(self.joints))
        self.lag = self._velocity_lags()
        self.differentiated = self._choose_velocity(config)
        late = np.where(self.differentiated, 0.0, np.abs(self.lag))
        if late.max() > _LAGS * log.dt:
            self.warnings.append(f"the measured velocity is up to {late.max() * 1e3:.1f} ms late, which is undone")
        self.ranges = self._ranges()
        self.still = self._stillness()

    def _check_torque(self, joint: str) -> bool:
        """Whether the torque is the controller's."""
        if not self.log.has("q", joint):
            raise LogError(self.log.path, f"joint {joint} has no position; log it, or leave it out of joints")
        if self.log.has("tau", joint):
            return False
        if not self.log.has("qcmd", joint):
            raise LogError(
                self.log.path,
                f"joint {joint} has neither torque nor position command; log one, or leave it out of joints",
            )
        if self.controller is None or joint not in self.controller.kp:
            raise LogError(
                self.log.path, f"joint {joint} has no torque; give the gains under controller.kp and kd in the config"
            )
        return True

    def _stamps_are_true(self) -> bool:
        """Whether jittering stamps tell when samples were taken, or only when they were written.

        Told by which clock the positions' increments agree with, at the speed of the samples around them.
        """
        error = np.zeros(2)
        for s in self.log.segments:
            t, q = self.log.t[s][:_SAMPLES_FOR_CHOICE], self.log.signals["q"][s, self._columns][:_SAMPLES_FOR_CHOICE]
            if len(t) > 2 * _AROUND + 1:
                speed = (q[2 * _AROUND :] - q[: -2 * _AROUND]) / (t[2 * _AROUND :] - t[: -2 * _AROUND])[:, None]
                step = np.diff(q[_AROUND:-_AROUND], axis=0)
                for k, time in enumerate((np.diff(t[_AROUND:-_AROUND]), np.full(len(step), self.log.dt))):
                    error[k] += np.square(step - speed[:-1] * time[:, None]).sum()
        return bool(error[0] < error[1])

    def _velocity_lags(self) -> Array:
        """How late each measured velocity is [s], 0 where it cannot be told; shape (nv,).

        Joints whose own lag is not sure share the mean of the others', as drives of one robot filter alike.
        """
        part = self._longest([slice(s.start, s.start + self._count(s)) for s in self.log.segments])
        measured = np.array([self.log.has("v", name) for name in self.joints])
        if not measured.any():
            return np.zeros(len(self.joints))
        q, v = self._signal("q", part), self._signal("v", part)
        found = [velocity_agreement(q[j], v[j], self.log.dt) for j in range(len(self.joints))]
        lag, error, agreement = (np.array([getattr(f, k) for f in found]) for k in ("lag", "lag_error", "agreement"))
        sure = measured & (agreement > _AGREES) & (error < np.maximum(_SURE * self.log.dt, _SURE * np.abs(lag)))
        if not sure.any():
            return np.zeros(len(self.joints))
        shared = float(np.average(lag[sure], weights=error[sure] ** -2))
        return np.where(sure, lag, np.where(measured, shared, 0.0))

    def _choose_velocity(self, config: Config) -> NDArray[np.bool_]:
        missing = np.array([not self.log.has("v", name) for name in self.joints])
        if missing.any():
            names = ", ".join(name for name, lacks in zip(self.joints, missing, strict=True) if lacks)
            self.warnings.append(f"no velocity logged, differentiated from q: {names}")
        if config.velocity != "auto":
            return missing | (config.velocity == "differentiated")
        if self._jitter > _JITTERY:
            self.warnings.append(f"time stamps jitter by {self._jitter:.2f} samples rms: the measured velocity is used")
            return missing
        part = self._longest(self._ranges())
        noise = []
        for differentiated in (True, False):
            self.differentiated = missing | differentiated
            noise.append(_noise(self._kinematics(part)[1], self.every_sample))
        return missing | (noise[1] > _QUIETER * noise[0])

    def _longest(self, parts: Sequence[slice]) -> slice:
        """A stretch to judge the log by, of bounded length."""
        longest = max(parts, key=lambda s: s.stop - s.start)
        return slice(longest.start, min(longest.stop, longest.start + _SAMPLES_FOR_CHOICE))

    def _ranges(self) -> list[slice]:
        """What is left of the segments when derivatives and delays have taken their margin."""
        first = self._margin + int(np.ceil(self._delay))
        ranges = [slice(s.start + first, s.start + self._count(s) - self._margin) for s in self.log.segments]
        kept = [r for r in ranges if r.stop > r.start]
        if not kept:
            raise LogError(
                self.log.path,
                f"no stretch without a gap is longer than the {(first + self._margin) * self.log.dt:.2f} s that the "
                f"{self.band_hz:g} Hz filter and the derivatives need",
            )
        if len(kept) < len(ranges):
            self.warnings.append(f"{len(ranges) - len(kept)} stretches between gaps were too short for the filter")
        return kept

    def _stillness(self) -> Array:
        """Speed at which the sign of v is as good as lost in its noise."""
        v = self._kinematics(self._longest(self.ranges))[1]
        return np.asarray(np.maximum(_STILL, _SIGN_WIDTH * _noise(v, self.every_sample)))

    def batches(self, ranges: Sequence[slice] | None = None, every_sample: bool = False) -> Iterator[Batch]:
        """The log in batches of bounded size.

        Parameters
        ----------
        ranges
            Parts of the log; default: all that is usable.
        every_sample
            Whether the batches' filter keeps every sample rather than decimate to the band.
        """
        low_pass = self.every_sample if every_sample else self.low_pass
        size = max(BATCH, 8 * low_pass.reach)
        size += -size % low_pass.stride
        for whole in self.ranges if ranges is None else ranges:
            last = whole.stop - low_pass.edge
            for start in range(whole.start + low_pass.edge, last, size):
                stop = min(start + size, last)
                before = min(low_pass.reach, start - whole.start)
                after = min(low_pass.reach, whole.stop - stop)
                yield Batch(self._motion(slice(start - before, stop + after)), before, after, low_pass)

    def _motion(self, part: slice) -> Motion:
        q, v, a = self._kinematics(part)
        tau, logged = self._torque(part)
        return Motion(self._times(part), q, v, a, tau, logged, self.still, self.log.dt)

    def _count(self, segment: slice) -> int:
        """Samples of a segment on the uniform clock, never more than were logged."""
        count = int(segment.stop - segment.start)
        if self._resampled:
            count = min(count, int((self.log.t[segment.stop - 1] - self.log.t[segment.start]) / self.log.dt) + 1)
        return count

    def _times(self, part: slice) -> Array:
        """Times of samples on the clock in use [s]; sample i of a segment is i sample times after its first."""
        if not self._resampled:
            return self.log.t[part]
        segment = next(s for s in self.log.segments if s.start <= part.start < s.stop)
        return np.asarray(self.log.t[segment.start] + self.log.dt * (np.arange(part.start, part.stop) - segment.start))

    def _signal(self, name: str, part: slice) -> Array:
        """A signal of the model's joints as it was at the samples of the clock in use, shape (nv, N)."""
        x = self.log.signals[name]
        late = self.lag if name == "v" else np.zeros(len(self.joints))
        if not self._resampled and not late.any():
            return np.ascontiguousarray(x[part][:, self._columns].T)
        segment = next(s for s in self.log.segments if s.start <= part.start < s.stop)
        t = self._times(part)
        stamps = self.log.t[segment]
        first = int(np.searchsorted(stamps, t[0] + late.min())) - 1
        last = int(np.searchsorted(stamps, t[-1] + late.max(), side="right")) + 1
        near = slice(segment.start + max(first, 0), min(segment.start + last, segment.stop))
        stamps = np.maximum.accumulate(self.log.t[near])
        return np.stack([np.interp(t + lag, stamps, x[near, c]) for lag, c in zip(late, self._columns, strict=True)])

    def _kinematics(self, part: slice) -> tuple[Array, Array, Array]:
        m = self._margin
        outer = slice(part.start - m, part.stop + m)
        q = self._smooth(self._signal("q", outer))
        slope = _differentiate(q, self.log.dt)
        v = slope
        if not self.differentiated.all():
            measured = self._smooth(self._signal("v", outer))[:, _REACH:-_REACH]
            v = np.where(self.differentiated[:, None], slope, measured)
        return q[:, 2 * _REACH : -2 * _REACH], v[:, _REACH:-_REACH], _differentiate(v, self.log.dt)

    def _smooth(self, x: Array) -> Array:
        return self._wide(x, self._wide.reach, self._wide.reach) if self._wide else x

    def _torque(self, part: slice) -> tuple[Array, Array]:
        """The logged torque or the controller's, through the same wide filter as the motion, and without."""
        m = self._wide.reach if self._wide else 0
        outer = slice(part.start - m, part.stop + m)
        tau = np.empty((len(self.joints), outer.stop - outer.start))
        if not all(self._commanded):
            tau[:] = self._signal("tau", outer)
        if any(self._commanded):
            commanded = self._controller_torque(outer)
            rows = np.flatnonzero(self._commanded)
            tau[rows] = commanded[rows]
        return self._smooth(tau), tau[:, m : m + part.stop - part.start]

    def _controller_torque(self, part: slice) -> Array:
        """Kp (qcmd − q) + kd (vcmd − v), the command late by the controller's delay (contract section 2)."""
        controller = self.controller
        if controller is None:
            raise AssertionError  # ruled out by _check_torque
        kp, kd = (np.array([g.get(name, 0.0) for name in self.joints])[:, None] for g in (controller.kp, controller.kd))
        q = self._signal("q", part)
        v = self._signal("v", part) if "v" in self.log.signals else np.full_like(q, np.nan)
        lacking = np.isnan(v).any(axis=1)
        if lacking.any():
            v[lacking] = np.gradient(q[lacking], self.log.dt, axis=1)
        return kp * (self._late("qcmd", part) - q) + kd * (self._late("vcmd", part) - v)

    def _late(self, name: str, part: slice) -> Array:
        """A command as it was `controller.delay` before; zero where the log has none."""
        if name not in self.log.signals:
            return np.zeros((1, 1))
        whole = int(np.floor(self._delay))
        share = self._delay - whole
        earlier = slice(part.start - whole, part.stop - whole)
        x = self._signal(name, earlier)
        if share:
            x = (1 - share) * x + share * self._signal(name, slice(earlier.start - 1, earlier.stop - 1))
        return np.nan_to_num(x, nan=0.0)


def _band(log: Log, config: Config) -> float:
    """The low-pass's cut-off [Hz]; one that would need a kernel far longer than the log is refused."""
    rate, duration = 1 / log.dt, len(log) * log.dt
    band = config.filter.cutoff_hz or min(_DEFAULT_CUTOFF, rate / 5)
    if band >= 0.45 * rate:
        raise ConfigError("filter.cutoff_hz", f"{band:g} Hz is too high for {log.path}, sampled at {rate:.0f} Hz")
    if band * duration < 1:
        raise LogError(
            log.path,
            f"lasts {duration:.3g} s, less than a period of the {band:g} Hz filter; log for longer, or set a higher "
            "filter.cutoff_hz",
        )
    return band


def _noise(x: Array, low_pass: LowPass) -> Array:
    """Robust standard deviation of what lies above the band, shape (nv,)."""
    above = x - low_pass(x, 0, 0)
    return np.asarray(1.4826 * np.median(np.abs(above - np.median(above, axis=1, keepdims=True)), axis=1))


def _differentiate(x: Array, dt: float) -> Array:
    """Time derivative; 4 samples shorter at each end. Shape (nv, N) to (nv, N − 8)."""
    windows = np.lib.stride_tricks.sliding_window_view(x, len(_DIFFERENCE), axis=-1)
    return np.asarray(windows @ _DIFFERENCE / dt)

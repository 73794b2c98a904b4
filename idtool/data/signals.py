"""`JointLog` → `Motion`: positions, velocities, accelerations and torques of the model's joints, batch after batch.

The torque equation is linear in its unknowns, so it remains exact if every column and the torque pass through the same
low-pass. It does not if only q, v and a do, because the columns are nonlinear in them. Here the signals get a wide
zero-phase filter against differentiated noise; a batch's own filter is then applied to the columns. Nothing reaches
across a gap.

Shapes: nv joints, N samples at the logged rate, n samples after decimation. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import field, replace
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import count_text, join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.base_sensors import BaseSensors
from idtool.data.batches import Batches, BatchSpan
from idtool.data.channels import Channels
from idtool.data.column_cache import KeptColumns
from idtool.data.contact_channels import ContactChannels, ContactSamples
from idtool.data.controller import JointController
from idtool.data.filters import DIFFERENCE_REACH, LowPass, differentiate, noise_above_band
from idtool.data.logs.log import JointLog
from idtool.data.logs.times import suspected_unit
from idtool.data.wrench_channels import WrenchChannels
from idtool.robot.config import Config

Value = TypeVar("Value")

BATCH_SAMPLES = 8192  # samples
WIDE_BAND_FACTOR = 5.0  # the signals' own filter, in units of the band
# Cut-off in units of the band's: decimated to four times the band, what lies above 2.4 bands would fold into 1.6 of it.
_ANTI_ALIASING = 1.6
_DEFAULT_CUTOFF = 40.0  # Hz
_MAX_JITTER = 0.1  # rms of the stamps' jitter, in samples, above which differentiating q is not trusted
_MIN_LAG = 0.25  # samples of lag of a measured velocity that are worth a word
_MAX_NOISE_RATIO = 0.5  # a measured velocity is used where its noise is below this share of the differentiated one's
_MIN_DEADBAND = 3e-3  # rad/s or m/s
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_KEPT_BYTES = 32 << 20  # a freed block of up to this size is kept
_DEADBAND_FACTOR = 1.25  # tanh(v / (1.25 sigma)) is nearest to the mean of the true v's sign under noise of sigma


@dataclass(frozen=True)
class Motion:
    """Samples of one batch.

    Attributes
    ----------
    t
        Time since the log's first complete sample [s], shape (N,).
    q, v, a
        Position, velocity and acceleration, shape (nv, N); those of wrench sensors, which are 0, come after those of
        the joints, and those of a floating base last, see `RobotModel`.
    tau
        Torque at the joint output, and measured wrenches, shape (nv, N); 0 for a floating base.
    logged_tau
        Logged torque, or that of the controller, without the wide filter; shape (nv, N).
    velocity_deadband
        Speed below which the sign of v is lost in its noise, shape (nv,) [rad/s or m/s].
    dt
        Sample time [s]; 0 for states that are no samples of a log.
    motor_minus_link
        By joint with a compliant transmission: q, v and a of the motor less those of the link, which are above;
        shape (3, N).
    delayed_torques
        Torque for each of the K delays given to `Signals.batches`, shape (K, nv, N). The delay applies to joints whose
        torque is the controller's; a logged torque is repeated.
    kept_columns
        Columns along these q, v and a that are kept for other models; None: none are.
    log
        File name of the log; empty: the motion is of no log.
    recording
        Name of the log that no other log of an experiment has; empty: the motion is of no log.
    contacts
        Contacts; None: the base is fixed, and there are none.
    unknown_torque
        Joints whose torque is not known.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    logged_tau: Array
    velocity_deadband: Array
    dt: float
    motor_minus_link: Mapping[int, Array] = field(default_factory=dict)
    delayed_torques: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    kept_columns: KeptColumns | None = None
    log: str = ""
    recording: str = ""
    contacts: ContactSamples | None = None
    unknown_torque: tuple[int, ...] = ()
    _evaluated: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def once(self, key: Hashable, evaluate: Callable[[], Value]) -> Value:
        """Value of a key, which several parts of a model need along this motion: evaluated when it is first asked for.

        It is kept as long as the motion, if that is not kept itself for other models: that would take much memory.

        Parameters
        ----------
        key
            What it is a value of.
        evaluate
            Function that gives it.
        """
        if self.kept_columns is not None:
            return evaluate()
        if key not in self._evaluated:
            self._evaluated[key] = evaluate()
        return cast("Value", self._evaluated[key])

    @property
    def is_log(self) -> bool:
        """True for samples in the order of time; False for states that have nothing to do with each other."""
        return self.dt > 0


@dataclass(frozen=True)
class Batch:
    """A stretch of one segment: motion with its surroundings, and the filter that takes columns to the band.

    Attributes
    ----------
    motion
        Motion of ``before`` + N + ``after`` samples.
    before, after
        Numbers of samples at the ends that only the filter needs.
    low_pass
        The low-pass that takes columns and torque to the band.
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
        """Times of the filtered samples since the log's first [s], shape (n,)."""
        return self.at_filtered_samples(self.motion.t)

    def at_filtered_samples(self, x: Array) -> Array:
        """Unfiltered values at the times of the filtered samples, from shape (..., before + N + after) to (..., n)."""
        return x[..., self.before : len(self.motion.t) - self.after : self.low_pass.stride]


class Signals:
    """A log seen as the model's joints' motion.

    Attributes
    ----------
    channels, controller
        The signals on an even clock, and the controller.
    band_hz
        The low-pass's cut-off [Hz].
    low_pass, full_rate_low_pass
        The low-pass: one that decimates to its band, one that keeps every sample.
    anti_aliasing
        Low-pass that decimates as `low_pass` does, but leaves the band as it is; None: nothing is decimated.
    velocity_from_position
        Per joint, whether v comes from q; else it is the measured one, its lag undone.
    lag
        Per joint, how late the measured velocity is [s].
    velocity_deadband
        Speed below which the sign of v is lost in its noise, shape (nv,) [rad/s or m/s].
    ranges
        Stretches of samples that have all derivatives and commands.
    notices
        The decisions about the velocity and the stretches, with their reasons.
    base_sensors
        Sensors of a floating base; None: it is fixed.
    wrench_channels
        Sensors of wrenches; None: there are none.
    contact_channels
        Contacts; None: the base is fixed, and there are none.
    unknown_torque
        Joints whose torque was not logged.
    recording
        Name of the log that no other log of an experiment has.

    Parameters
    ----------
    log
        The log.
    joints
        Names of the moving joints.
    config
        The configuration.
    base_sensors
        Sensors of a floating base, whose coordinates come after all others; None: the base is fixed.
    wrench_channels
        Sensors of wrenches, whose coordinates come after the joints; None: there are none.
    contact_channels
        Contacts; None: the base is fixed, and there are none.
    recording
        Name of the log that no other log of an experiment has; empty: its file name.
    batch_samples
        Number of samples in a batch, but for a long filter; None: the usual one.

    Raises
    ------
    LogError
        If a joint has neither torque nor a command with a controller, or no segment is long enough.
    ConfigError
        If the cut-off lies above what the sampling rate allows.
    """

    def __init__(
        self,
        log: JointLog,
        joints: Sequence[str],
        config: Config,
        base_sensors: BaseSensors | None = None,
        wrench_channels: WrenchChannels | None = None,
        contact_channels: ContactChannels | None = None,
        recording: str = "",
        batch_samples: int | None = None,
    ) -> None:
        self.log = log
        self.batch_samples = batch_samples
        self.recording = recording or log.path.name
        self.base_sensors = base_sensors
        self.wrench_channels = wrench_channels
        self.contact_channels = contact_channels
        self.joints = tuple(joints)
        self.unknown_torque = tuple(j for j, name in enumerate(self.joints) if name in log.unknown_torque)
        self.notices: list[Notice] = []
        rate = 1 / log.dt
        self.band_hz = _band(log, config)
        # The decimated rate is at least four times the cut-off. At its Nyquist frequency, a zero-phase filter of
        # order 4 attenuates by 48 dB.
        stride = max(1, int(rate / (4 * self.band_hz)))
        self.low_pass = LowPass(self.band_hz, config.filter.order, log.dt, stride)
        self.full_rate_low_pass = LowPass(self.band_hz, config.filter.order, log.dt)
        self.anti_aliasing = LowPass(_ANTI_ALIASING * self.band_hz, 8, log.dt, stride) if stride > 1 else None
        wide = WIDE_BAND_FACTOR * self.band_hz
        self._wide = LowPass(wide, config.filter.order, log.dt) if wide < 0.4 * rate else None
        self.channels = Channels(log, joints)
        self.controller = JointController.from_log(log, self.joints, config.controller)
        self._margin = (self._wide.reach if self._wide else 0) + 2 * DIFFERENCE_REACH
        self.lag = self.channels.lag
        self.ranges = self._ranges()
        self.velocity_from_position = self._choose_velocity(config)
        self._note_velocity_errors()
        self.velocity_deadband = self._measure_deadband()

    @property
    def row_step(self) -> float:
        """Time from one filtered sample to the next [s]."""
        return self.low_pass.stride * self.log.dt

    @property
    def sensor_lookahead(self) -> float:
        """Time after a sample until all values of sensors that belong to it are there [s]."""
        latest = 0.0
        if self.wrench_channels is not None:
            latest = max(latest, self.wrench_channels.lookahead)
        if self.base_sensors is not None:
            latest = max(latest, self.base_sensors.lookahead)
        if self.contact_channels is not None:
            latest = max(latest, self.contact_channels.lookahead)
        return latest

    def _choose_velocity(self, config: Config) -> Mask:
        """True for the joints whose velocity is differentiated from q, shape (nv,)."""
        missing = ~self.channels.has_velocity
        advice = "if the positions have a coarse resolution, also log the velocity"
        message = "no velocity was logged; it is differentiated from q"
        notice = Notice("velocity_differentiated", "note", None, message, advice)
        self._note(notice, missing)
        if config.velocity != "auto":
            return np.asarray(missing | (config.velocity == "differentiated"))
        unrelated = self.channels.has_velocity & ~self.channels.has_consistent_velocity
        message = "the logged velocity is not the derivative of q; q is differentiated instead"
        advice = "compare the unit, sign and order of the velocities with those of the positions"
        self._note(Notice("velocity_unrelated", "warning", None, message, advice), unrelated)
        if self.channels.jitter > _MAX_JITTER:
            jitter = f"a jitter of {self.channels.jitter:.2f} sample periods rms"
            message = f"the time stamps have {jitter}, so the measured velocity is used"
            advice = "use the time at which a sample is taken as its time stamp, not the time at which it is written"
            self.notices.append(Notice("time_jitter", "warning", None, message, advice))
            return np.asarray(missing | unrelated)
        is_noisy = self._measured_velocity_noise > _MAX_NOISE_RATIO * self._differentiated_velocity_noise
        return np.asarray(missing | unrelated | is_noisy)

    @cached_property
    def _differentiated_velocity_noise(self) -> Array:
        """Noise above the band of the velocity that is differentiated from q, shape (nv,) [rad/s or m/s]."""
        return self._velocity_noise(np.ones_like(self.channels.has_velocity))

    @cached_property
    def _measured_velocity_noise(self) -> Array:
        """Noise above the band of the measured velocity, of the other where it is missing, shape (nv,)."""
        return self._velocity_noise(~self.channels.has_velocity)

    def _velocity_noise(self, from_position: Mask) -> Array:
        """Noise above the band of the velocity, differentiated from q for some joints, shape (nv,)."""
        part = self.channels.longest_stretch(self.ranges)
        _, v, _ = self._kinematics(part, from_position)
        return noise_above_band(v, self.full_rate_low_pass)

    def _note(self, notice: Notice, mask: Mask) -> None:
        """Add a notice about some of the joints, if any, with their names."""
        if mask.any():
            names = [name for name, is_concerned in zip(self.joints, mask, strict=True) if is_concerned]
            self.notices.append(replace(notice, message=f"{notice.message}: {join_names(names)}"))

    def _note_velocity_errors(self) -> None:
        lags = np.where(self.velocity_from_position, 0.0, self.lag)
        for relation, largest in (("lags", float(lags.max())), ("leads", float(-lags.min()))):
            if largest > _MIN_LAG * self.log.dt:
                time = f"{1e3 * largest:.1f} ms"
                message = f"the measured velocity {relation} the derivative of the position by up to {time}"
                self.notices.append(Notice("velocity_lag", "note", None, f"{message}; idtool corrects it"))
        if self.channels.bias.any():
            bias = float(np.abs(self.channels.bias).max())
            message = f"the measured velocity has an offset of up to {short_number(bias, 2)} rad/s or m/s"
            notice = Notice("velocity_bias", "note", None, message, "idtool corrects it")
            self._note(notice, self.channels.bias != 0)

    def _ranges(self) -> list[slice]:
        """Samples of each stretch for which derivatives and delayed commands exist; LogError if there are none."""
        first = self._margin + int(np.ceil(self.controller.delay / self.log.dt))
        ranges = [slice(s.start + first, s.stop - self._margin) for s in self.channels.stretches()]
        long_enough = [r for r in ranges if r.stop > r.start]
        if not long_enough:
            raise LogError(
                self.log.path,
                f"no segment without gaps is longer than the {(first + self._margin) * self.log.dt:.2f} s that the "
                f"{self.band_hz:g} Hz filter and the derivatives need; give a longer log, or one with fewer gaps "
                "(idtool inspect shows them)",
            )
        if len(long_enough) < len(ranges):
            count = len(ranges) - len(long_enough)
            were = "was" if count == 1 else "were"
            message = f"{count_text(count, 'segment')} between gaps {were} too short for the filter"
            advice = "if there are many of them, find out why samples are lost"
            notice = Notice("short_stretches", "note", None, message, advice)
            self.notices.append(notice)
        return long_enough

    def _measure_deadband(self) -> Array:
        from_position = self.velocity_from_position
        noise = self._differentiated_velocity_noise if from_position.any() else self._measured_velocity_noise
        if not from_position.all():
            noise = np.where(from_position, noise, self._measured_velocity_noise)
        return np.asarray(np.maximum(_MIN_DEADBAND, _DEADBAND_FACTOR * noise))

    def delayed_ranges(self, delay: float, parts: Sequence[slice]) -> list[slice]:
        """Parts of `ranges` without the samples at the start of each that have no command so long before [s]."""
        delay_samples = int(np.ceil(delay / self.log.dt))
        own_delay_samples = int(np.ceil(self.controller.delay / self.log.dt))
        skip = max(delay_samples - own_delay_samples, 0)
        ranges = []
        for part in parts:
            for known in self.ranges:
                start = max(part.start, known.start + skip)
                stop = min(part.stop, known.stop)
                if stop > start:
                    ranges.append(slice(start, stop))
        return ranges

    def with_controller(self, controller: JointController) -> Signals:
        """The signals with other gains of the joints' controller, of the same delay."""
        signals = copy(self)
        signals.controller = controller
        return signals

    def batches(
        self, ranges: Sequence[slice] | None = None, every_sample: bool = False, delays: Sequence[float] = ()
    ) -> Batches[Batch]:
        """The log in batches of bounded size.

        Parameters
        ----------
        ranges
            Parts of `ranges`; default: all of them.
        every_sample
            Whether the batches' filter keeps every sample rather than decimate to the band.
        delays
            Further delays of the commands for which the motion has the torque too [s]; see `delayed_ranges`.
        """
        low_pass = self.full_rate_low_pass if every_sample else self.low_pass
        spans = self._spans(self.ranges if ranges is None else ranges, low_pass)
        _keep_freed_memory()
        return Batches(spans, lambda span: self.batch(span, low_pass, delays))

    def _spans(self, ranges: Sequence[slice], low_pass: LowPass) -> list[BatchSpan]:
        """Batches of parts of the log."""
        size = max(self.batch_samples or BATCH_SAMPLES, 4 * low_pass.reach)
        size += -size % low_pass.block
        spans = []
        for samples in ranges:
            last = samples.stop - low_pass.edge
            for start in range(samples.start + low_pass.edge, last, size):
                stop = min(start + size, last)
                before = min(low_pass.reach, start - samples.start)
                after = min(low_pass.reach, samples.stop - stop)
                rows = -(-(stop - start) // low_pass.stride)
                spans.append(BatchSpan(start, stop, before, after, rows))
        return spans

    def batch(self, span: BatchSpan, low_pass: LowPass, delays: Sequence[float] = ()) -> Batch:
        """One batch of the log.

        Parameters
        ----------
        span
            Its samples.
        low_pass
            Its filter, whose number of rows the span has.
        delays
            As in `batches`.
        """
        motion = self.motion(slice(span.start - span.before, span.stop + span.after), delays)
        self.log.release_memory()
        return Batch(motion, span.before, span.after, low_pass)

    def velocity(self, part: slice) -> Array:
        """Velocities at samples of the log, shape (nv, N); NaN where derivatives would reach across an end or gap."""
        v = np.full((len(self.joints), part.stop - part.start), np.nan)
        for known in self.ranges:
            start, stop = max(known.start, part.start), min(known.stop, part.stop)
            if stop > start:
                _, known_v, _ = self._kinematics(slice(start, stop), self.velocity_from_position)
                v[:, start - part.start : stop - part.start] = known_v
        return v

    def motion(self, part: slice, delays: Sequence[float] = ()) -> Motion:
        """Motion at samples of one of the `ranges`, with the torque for further delays of the commands [s]."""
        times = self.channels.times(part)
        t = times - self.log.start
        q, v, a = self._kinematics(part, self.velocity_from_position)
        (tau, *delayed), logged_tau = self._torques(part, (self.controller.delay, *delays))
        delayed_torques = np.array(delayed).reshape(-1, *tau.shape)
        motion = Motion(
            t=t,
            q=q,
            v=v,
            a=a,
            tau=tau,
            logged_tau=logged_tau,
            velocity_deadband=self.velocity_deadband,
            dt=self.log.dt,
            delayed_torques=delayed_torques,
            log=self.log.path.name,
            recording=self.recording,
            unknown_torque=self.unknown_torque,
        )
        if self.wrench_channels is None and self.base_sensors is None and self.contact_channels is None:
            return motion
        margin = self._margin
        outer = self.channels.times(slice(part.start - margin, part.stop + margin))
        r = 2 * DIFFERENCE_REACH
        inner = outer[r : len(outer) - r]
        if self.wrench_channels is not None:
            wrenches = self.wrench_channels.wrenches(inner, self._smooth)
            zero = np.zeros_like(wrenches)
            motion = with_coordinates(motion, zero, zero, wrenches)
        if self.base_sensors is not None:
            v, a = self.base_sensors.kinematics(outer, self.log.dt, self._smooth)
            motion = with_coordinates(motion, v, a, np.zeros_like(v))
        if self.contact_channels is not None:
            motion = replace(motion, contacts=self.contact_channels.samples(times, inner, self._smooth))
        return motion

    def _kinematics(self, part: slice, from_position: Mask) -> tuple[Array, Array, Array]:
        """q, v and a at samples of the log, shape (nv, N); v from q where ``from_position``, shape (nv,)."""
        r = DIFFERENCE_REACH
        outer = slice(part.start - self._margin, part.stop + self._margin)
        q = self._smooth(self.channels.signal("q", outer))
        v = differentiate(q, self.log.dt)
        if not from_position.all():
            measured = self._smooth(self.channels.velocity(outer))[:, r:-r]
            v = np.where(from_position[:, None], v, measured)
        return q[:, 2 * r : -2 * r], v[:, r:-r], differentiate(v, self.log.dt)

    def _smooth(self, x: Array) -> Array:
        if self._wide is None:
            return x
        return self._wide(x, self._wide.reach, self._wide.reach)

    def controller_torques(self, controller: JointController, part: slice, delays: Sequence[float]) -> Array:
        """Torque of a controller at samples of one of the `ranges` for each of some delays [s], as `Motion` has it.

        Shape (delays, nv, N).
        """
        m = self._wide.reach if self._wide else 0
        return self._smooth(controller.torques(self.channels, slice(part.start - m, part.stop + m), delays))

    def _torques(self, part: slice, delays: Sequence[float]) -> tuple[Array, Array]:
        """The logged torque or the controller's: for each delay through the wide filter, and for the first without it.

        Shapes (delays, nv, N) and (nv, N).
        """
        m = self._wide.reach if self._wide else 0
        outer = slice(part.start - m, part.stop + m)
        by_command = self.controller.joints
        if by_command.all():
            tau = self.controller.torques(self.channels, outer, delays)
        else:
            tau = np.repeat(self.channels.signal("tau", outer)[None], len(delays), axis=0)
            if by_command.any():
                tau[:, by_command] = self.controller.torques(self.channels, outer, delays)[:, by_command]
        return self._smooth(tau), tau[0, :, m : m + part.stop - part.start]


def with_coordinates(motion: Motion, v: Array, a: Array, tau: Array) -> Motion:
    """Motion with further coordinates, shape (k, N), whose position is 0."""
    delayed_torques = motion.delayed_torques
    if len(delayed_torques):
        delayed = np.repeat(tau[None], len(delayed_torques), axis=0)
        delayed_torques = np.concatenate([delayed_torques, delayed], axis=1)
    return replace(
        motion,
        q=np.concatenate([motion.q, np.zeros_like(v)]),
        v=np.concatenate([motion.v, v]),
        a=np.concatenate([motion.a, a]),
        tau=np.concatenate([motion.tau, tau]),
        logged_tau=np.concatenate([motion.logged_tau, tau]),
        velocity_deadband=np.append(motion.velocity_deadband, np.full(len(v), _MIN_DEADBAND)),
        delayed_torques=delayed_torques,
    )


def default_cutoff(dt: float) -> float:
    """The low-pass's cut-off where the configuration has none [Hz]: 40 Hz, or a fifth of the rate if that is lower.

    Parameters
    ----------
    dt
        Sample time [s].
    """
    return min(_DEFAULT_CUTOFF, 0.2 / dt)


def _band(log: JointLog, config: Config) -> float:
    """Cut-off of the low-pass [Hz]; refused if too high for the sampling rate, or with a period longer than the log."""
    rate, duration = 1 / log.dt, len(log) * log.dt
    band = config.filter.cutoff_hz or default_cutoff(log.dt)
    if band >= 0.45 * rate:
        unit = suspected_unit(log.dt, log.segments, log.signals)
        times = f"; its times seem to be in {unit}, not in s" if unit else ""
        raise ConfigError(
            "filter.cutoff_hz", f"{band:g} Hz is too high for {log.path} sampled at {short_number(rate, 4)} Hz{times}"
        )
    if band * duration < 1:
        what = f"lasts {short_number(duration)} s, less than a period of the {band:g} Hz filter"
        raise LogError(log.path, f"{what}; log for longer, or set a higher filter.cutoff_hz")
    return band


def _keep_freed_memory() -> None:
    """Let one batch have the memory that the last one freed.

    glibc returns large blocks to the system, which is slow, until one of nearly 32 MiB has been freed, and always if
    the environment has MALLOC_TRIM_THRESHOLD_, as in Dask's workers; see mallopt(3). Elsewhere this does nothing.
    """
    with suppress(OSError, AttributeError, TypeError):  # no glibc
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, 2 * _KEPT_BYTES)


def reversals(v: Array) -> Mask:
    """Samples right before and after a change of the velocity's sign, however fast, shape (N,)."""
    mask = np.zeros(len(v), dtype=bool)
    before = np.flatnonzero(v[1:] * v[:-1] < 0)
    mask[before] = True
    mask[before + 1] = True
    return mask

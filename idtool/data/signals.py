"""`Log` → `Motion`: positions, velocities, accelerations and torques of the model's joints, batch after batch.

The torque equation is linear in its unknowns, so a low-pass on every column and on the torque alike keeps it exact,
where one on the signals alone does not. Here the signals get a wide zero-phase filter against differentiated noise; a
batch's own filter is then applied to the columns. Nothing reaches across a gap.

Shapes: nv joints, N samples at the logged rate, n samples after decimation. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.channels import Channels
from idtool.data.command import Command
from idtool.data.filters import DIFFERENCE_REACH, LowPass, differentiate, noise_above
from idtool.data.logs.log import Log
from idtool.data.logs.times import suspected_unit
from idtool.robot.config import Config

BATCH = 8192  # samples
WIDE = 5.0  # the signals' own filter, in units of the band
_DEFAULT_CUTOFF = 40.0  # Hz
_JITTERY = 0.1  # rms of the stamps' jitter, in samples, above which differentiating q is not trusted
_LAGS = 0.25  # samples of lag of a measured velocity that are worth a word
_QUIETER = 0.5  # a measured velocity is used where its noise is below this share of the differentiated one's
_MIN_DEADBAND = 3e-3  # rad/s or m/s
_SIGN_WIDTH = 1.25  # tanh(v / (1.25 sigma)) is nearest to the mean of the true v's sign under noise of sigma


@dataclass(frozen=True)
class Motion:
    """Samples of one batch.

    Attributes
    ----------
    t
        Time since the log's first sample [s], shape (N,).
    q, v, a
        Position, velocity and acceleration, shape (nv, N).
    tau
        Torque at the joint output, shape (nv, N).
    logged
        The same as it was logged, where the others have been through the signals' filter; shape (nv, N).
    velocity_deadband
        Speed below which the sign of v is lost in its noise, shape (nv,) [rad/s or m/s].
    dt
        Sample time [s]; 0 for states that are no samples of a log.
    motor_minus_link
        By joint with a compliant transmission: q, v and a of the motor less those of the link, which are above;
        shape (3, N).
    torques
        The torque if the commands were later by other delays, as `Signals.batches` was asked for; shape (K, nv, N).
    """

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    logged: Array
    velocity_deadband: Array
    dt: float
    motor_minus_link: Mapping[int, Array] = field(default_factory=dict)
    torques: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

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
        """Times of the filtered samples since the log's first [s], shape (n,)."""
        return self.motion.t[self.before : len(self.motion.t) - self.after : self.low_pass.stride]


class Signals:
    """A log seen as the model's joints' motion.

    Attributes
    ----------
    channels, command
        The signals on an even clock, and the controller.
    band_hz
        The low-pass's cut-off [Hz].
    low_pass, every_sample
        It, decimating to its band and keeping every sample.
    differentiated
        Per joint, whether v comes from q; else it is the measured one, its lag undone.
    lag
        Per joint, how late the measured velocity is [s].
    velocity_deadband
        Speed below which the sign of v is lost in its noise, shape (nv,) [rad/s or m/s].
    ranges
        Stretches of samples that have all derivatives and commands.
    notices
        What was decided, and why.

    Raises
    ------
    LogError
        If a joint has neither torque nor a command with a controller, or no segment is long enough.
    ConfigError
        If the cut-off lies above what the sampling rate allows.
    """

    def __init__(self, log: Log, joints: Sequence[str], config: Config) -> None:
        self.log = log
        self.joints = tuple(joints)
        self.notices: list[Notice] = []
        rate = 1 / log.dt
        self.band_hz = _band(log, config)
        # Twice the band is sampled four times: what would alias is 48 dB down.
        stride = max(1, int(rate / (4 * self.band_hz)))
        self.low_pass = LowPass(self.band_hz, config.filter.order, log.dt, stride)
        self.every_sample = LowPass(self.band_hz, config.filter.order, log.dt)
        wide = WIDE * self.band_hz
        self._wide = LowPass(wide, config.filter.order, log.dt) if wide < 0.4 * rate else None
        self.channels = Channels(log, joints)
        self.command = Command.of(log, self.joints, config.controller)
        self._margin = (self._wide.reach if self._wide else 0) + 2 * DIFFERENCE_REACH
        self.lag = self.channels.lag
        self.differentiated = self._choose_velocity(config)
        self.ranges = self._ranges()
        self._note_velocity_errors()
        self.velocity_deadband = self._measure_deadband()

    def _choose_velocity(self, config: Config) -> Mask:
        missing = ~self.channels.measured
        advice = "no action is needed; log the velocity too if positions are coarse"
        notice = Notice(
            "velocity_differentiated", "note", None, "no velocity was logged; it is differentiated from q", advice
        )
        self._note(notice, missing)
        if config.velocity != "auto":
            return np.asarray(missing | (config.velocity == "differentiated"))
        strange = self.channels.measured & ~self.channels.trusted
        message = "the logged velocity is not the derivative of q; q is differentiated instead"
        advice = "compare the unit, sign and order of the velocities with those of the positions"
        self._note(Notice("velocity_unrelated", "warning", None, message, advice), strange)
        if self.channels.jitter > _JITTERY:
            message = f"the stamps jitter by {self.channels.jitter:.2f} samples rms, so the measured velocity is used"
            advice = "stamp samples when they are taken, not when they are written"
            self.notices.append(Notice("time_jitter", "warning", None, message, advice))
            return np.asarray(missing | strange)
        part = self.channels.longest(self._ranges())
        noise = []
        for differentiated in (True, False):
            self.differentiated = missing | differentiated
            noise.append(noise_above(self._kinematics(part)[1], self.every_sample))
        return np.asarray(missing | strange | (noise[1] > _QUIETER * noise[0]))

    def _note(self, notice: Notice, which: Mask) -> None:
        """Add a notice about some of the joints, if any, with their names."""
        if which.any():
            names = [name for name, chosen in zip(self.joints, which, strict=True) if chosen]
            self.notices.append(replace(notice, message=f"{notice.message}: {join_names(names)}"))

    def _note_velocity_errors(self) -> None:
        late = float(np.where(self.differentiated, 0.0, np.abs(self.lag)).max())
        if late > _LAGS * self.log.dt:
            message = f"the measured velocity is up to {late * 1e3:.1f} ms late; the lag is corrected"
            self.notices.append(Notice("velocity_lag", "note", None, message, "no action is needed"))
        if self.channels.bias.any():
            off = float(np.abs(self.channels.bias).max())
            message = (
                f"the measured velocity is off by up to {off:.2g} rad/s (m/s) on average; this offset is corrected"
            )
            self._note(Notice("velocity_bias", "note", None, message, "no action is needed"), self.channels.bias != 0)

    def _ranges(self) -> list[slice]:
        """What is left of the segments when derivatives and delays have taken their margin."""
        first = self._margin + int(np.ceil(self.command.delay / self.log.dt))
        ranges = [slice(s.start + first, s.stop - self._margin) for s in self.channels.parts()]
        kept = [r for r in ranges if r.stop > r.start]
        if not kept:
            raise LogError(
                self.log.path,
                f"no segment without gaps is longer than the {(first + self._margin) * self.log.dt:.2f} s that the "
                f"{self.band_hz:g} Hz filter and the derivatives need",
            )
        if len(kept) < len(ranges):
            message = f"{len(ranges) - len(kept)} segments between gaps were too short for the filter"
            advice = "no action is needed if they are few; otherwise find out why samples are lost"
            notice = Notice("short_stretches", "note", None, message, advice)
            if notice not in self.notices:
                self.notices.append(notice)
        return kept

    def _measure_deadband(self) -> Array:
        v = self._kinematics(self.channels.longest(self.ranges))[1]
        return np.asarray(np.maximum(_MIN_DEADBAND, _SIGN_WIDTH * noise_above(v, self.every_sample)))

    def after(self, delay: float, parts: Sequence[slice]) -> list[slice]:
        """What is left of parts of `ranges` where commands are to be so late [s]: less at each stretch's beginning."""
        lost = int(np.ceil(delay / self.log.dt)) - int(np.ceil(self.command.delay / self.log.dt))
        begun = [(known.start + max(lost, 0), known.stop) for known in self.ranges]
        pairs = [(max(part.start, start), min(part.stop, stop)) for part in parts for start, stop in begun]
        return [slice(start, stop) for start, stop in pairs if stop > start]

    def batches(
        self, ranges: Sequence[slice] | None = None, every_sample: bool = False, delays: Sequence[float] = ()
    ) -> Iterator[Batch]:
        """The log in batches of bounded size.

        Parameters
        ----------
        ranges
            Parts of `ranges`; default: all of them.
        every_sample
            Whether the batches' filter keeps every sample rather than decimate to the band.
        delays
            Of commands, for which the motion has the torque too [s]; none longer than `ranges` leave out.
        """
        low_pass = self.every_sample if every_sample else self.low_pass
        size = max(BATCH, 8 * low_pass.reach)
        size += -size % low_pass.block
        _keep_freed_memory()
        for whole in self.ranges if ranges is None else ranges:
            last = whole.stop - low_pass.edge
            for start in range(whole.start + low_pass.edge, last, size):
                stop = min(start + size, last)
                before = min(low_pass.reach, start - whole.start)
                after = min(low_pass.reach, whole.stop - stop)
                yield Batch(self._motion(slice(start - before, stop + after), delays), before, after, low_pass)

    def velocity(self, part: slice) -> Array:
        """Velocities at samples of the log, shape (nv, N); NaN where derivatives would reach across an end or gap."""
        v = np.full((len(self.joints), part.stop - part.start), np.nan)
        for known in self.ranges:
            start, stop = max(known.start, part.start), min(known.stop, part.stop)
            if stop > start:
                v[:, start - part.start : stop - part.start] = self._kinematics(slice(start, stop))[1]
        return v

    def _motion(self, part: slice, delays: Sequence[float]) -> Motion:
        t = self.channels.times(part) - self.log.t[0]
        q, v, a = self._kinematics(part)
        (tau, *others), logged = self._torques(part, (self.command.delay, *delays))
        torques = np.array(others).reshape(-1, *tau.shape)
        return Motion(t, q, v, a, tau, logged, self.velocity_deadband, self.log.dt, torques=torques)

    def _kinematics(self, part: slice) -> tuple[Array, Array, Array]:
        r = DIFFERENCE_REACH
        outer = slice(part.start - self._margin, part.stop + self._margin)
        q = self._smooth(self.channels.signal("q", outer))
        v = differentiate(q, self.log.dt)
        if not self.differentiated.all():
            measured = self._smooth(self.channels.velocity(outer))[:, r:-r]
            v = np.where(self.differentiated[:, None], v, measured)
        return q[:, 2 * r : -2 * r], v[:, r:-r], differentiate(v, self.log.dt)

    def _smooth(self, x: Array) -> Array:
        return self._wide(x, self._wide.reach, self._wide.reach) if self._wide else x

    def _torques(self, part: slice, delays: Sequence[float]) -> tuple[Array, Array]:
        """The logged torque or the controller's: by delay through the motion's wide filter; without, at the first.

        Shapes (delays, nv, N) and (nv, N).
        """
        m = self._wide.reach if self._wide else 0
        outer = slice(part.start - m, part.stop + m)
        by_command = self.command.joints
        if by_command.all():
            tau = self.command.torques(self.channels, outer, delays)
        else:
            tau = np.repeat(self.channels.signal("tau", outer)[None], len(delays), axis=0)
            if by_command.any():
                tau[:, by_command] = self.command.torques(self.channels, outer, delays)[:, by_command]
        return self._smooth(tau), tau[0, :, m : m + part.stop - part.start]


def default_cutoff(dt: float) -> float:
    """The low-pass's cut-off where the configuration has none [Hz]: 40 Hz, or a fifth of the rate if that is lower.

    Parameters
    ----------
    dt
        Sample time [s].
    """
    return min(_DEFAULT_CUTOFF, 0.2 / dt)


def _band(log: Log, config: Config) -> float:
    """The low-pass's cut-off [Hz]; one whose kernel would be far longer than the log is refused."""
    rate, duration = 1 / log.dt, len(log) * log.dt
    band = config.filter.cutoff_hz or default_cutoff(log.dt)
    if band >= 0.45 * rate:
        unit = suspected_unit(log.dt, log.segments, log.signals)
        times = f"; its times seem to be in {unit}, not in s" if unit else ""
        raise ConfigError("filter.cutoff_hz", f"{band:g} Hz is too high for {log.path} sampled at {rate:.4g} Hz{times}")
    if band * duration < 1:
        what = f"lasts {duration:.3g} s, less than a period of the {band:g} Hz filter"
        raise LogError(log.path, f"{what}; log for longer, or set a higher filter.cutoff_hz")
    return band


def _keep_freed_memory() -> None:
    """Let one batch have the memory that the last one freed.

    glibc returns large blocks to the system, which is slow, until one of nearly 32 MiB has been freed: M_MMAP_THRESHOLD
    in mallopt(3). Elsewhere this does nothing.
    """
    np.empty(31 << 20, np.uint8)

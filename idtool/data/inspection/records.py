"""The results of an inspection: plain frozen records that turn into JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

from idtool.common.dataclass import dataclass
from idtool.common.notice import Notice

FaultKind = Literal[
    "wrong_unit",
    "wrong_sign",
    "wrong_joint_order",
    "dropped_samples",
    "clipped",
    "stale",
    "velocity_lag",
    "time_jitter",
    "wrapped_position",
    "imu_mount",
    "foot_slip",
]
FAULT_KINDS: tuple[FaultKind, ...] = get_args(FaultKind)


def data_fault(notice: Notice) -> FaultKind | None:
    """Kind of data fault that a notice is about; None for all other notices. A fault of severity ``note`` is undone."""
    return next((kind for kind in FAULT_KINDS if kind == notice.code), None)


@dataclass(frozen=True)
class Gap:
    """A gap in the stamps: when it begins [s after the first stamp], and the time that was lost [s]."""

    start: float
    lost: float


@dataclass(frozen=True)
class Sampling:
    """The real instants of the samples, as the joints' positions and velocities tell them.

    Attributes
    ----------
    skipped
        Share of steps that took the time of two samples or more.
    jitter_ms
        Standard deviation of the instants about an even spacing [ms].
    stamp_error_ms
        The same about the stamps [ms]: less than ``jitter_ms`` where the stamps tell the truth.
    """

    skipped: float
    jitter_ms: float
    stamp_error_ms: float


@dataclass(frozen=True)
class Stamps:
    """The time stamps of a log.

    Attributes
    ----------
    step_jitter
        Standard deviation of the steps from stamp to stamp, in samples.
    jitter_rms_ms, jitter_max_ms
        Deviation from a uniform clock, fitted per segment [ms].
    step_ms
        Smallest common step of the stamps [ms], None where there is none.
    duplicates, backward
        Stamps equal to, or earlier than, the one before.
    gaps, lost
        Number of gaps and the time lost in them [s].
    longest_gaps
        The longest few, longest first.
    short
        Share of the samples in segments of less than half a second.
    repeated
        Share of samples, while anything moves, that equal the one before in the q and v of every joint.
    sampling
        The real instants, where the motion tells them.
    """

    step_jitter: float
    jitter_rms_ms: float
    jitter_max_ms: float
    step_ms: float | None
    duplicates: int
    backward: int
    gaps: int
    lost: float
    longest_gaps: tuple[Gap, ...]
    short: float
    repeated: float
    sampling: Sampling | None


@dataclass(frozen=True)
class Signal:
    """One signal of one joint, in the signal's unit.

    Attributes
    ----------
    minimum, maximum, rms
        Over all finite samples.
    not_finite
        Number of samples that are not finite.
    step
        Quantisation step, None where the signal is continuous.
    noise
        Standard deviation of the white noise.
    stale
        Share of samples that repeat the one before while the signal is on its way, those that repeat in every joint
        left out; None where it hardly ever is.
    stuck
        Share of samples that sit at the lowest or highest value as on an end stop; 0 where q or v rests there, by the
        other of the two.
    """

    minimum: float
    maximum: float
    rms: float
    not_finite: int
    step: float | None
    noise: float
    stale: float | None
    stuck: float

    @property
    def constant(self) -> bool:
        """True if the signal never changes."""
        return self.minimum == self.maximum


@dataclass(frozen=True)
class FrozenStretches:
    """The stretches in which a channel repeats one value while its joint moves.

    Attributes
    ----------
    stretches
        Number of them.
    seconds
        Their length in all [s].
    start
        Where the first begins [s after the first stamp].
    """

    stretches: int
    seconds: float
    start: float


@dataclass(frozen=True)
class Velocity:
    """A measured velocity against the derivative of the position.

    Attributes
    ----------
    lag_ms, lag_error_ms
        Lag of v [ms], positive where v is late, and its standard error; None where v has nothing to do with q.
    gain
        Of v over dq/dt; None likewise.
    agreement
        Share of v's power in the band of the motion that dq/dt explains, 0..1.
    residual
        The rest, root mean square [rad/s or m/s].
    """

    lag_ms: float | None
    lag_error_ms: float | None
    gain: float | None
    agreement: float
    residual: float


@dataclass(frozen=True)
class TorqueSource:
    """Apparent source of tau, measured or commanded, and the reason."""

    kind: Literal["measured", "commanded", "unknown"]
    reason: str


@dataclass(frozen=True)
class InspectedJoint:
    """One joint of a log.

    Attributes
    ----------
    signals
        Those that are present, by name: q, v, tau, qcmd, vcmd.
    moves
        Whether the joint moves more than its own noise and resolution.
    standstill
        Share of the time at standstill: slower than 2 % of its fastest motion.
    speed_rms
        Root mean square velocity, averaged over 50 ms [rad/s or m/s].
    band_hz
        Frequency below which 99 % of the velocity's power lies; None at standstill.
    jumps
        Number of single steps of q that the joint's own speed can't explain.
    wraps
        Whether those jumps are about a full turn.
    velocity
        None where v is missing or constant, q jumps, or the log is too short to tell.
    torque
        None where tau is missing or constant.
    """

    signals: Mapping[str, Signal]
    moves: bool
    standstill: float
    speed_rms: float
    band_hz: float | None
    jumps: int
    wraps: bool
    velocity: Velocity | None
    torque: TorqueSource | None


SensorKind = Literal["imu", "pose", "contact_flag", "force", "wrench", "other"]


@dataclass(frozen=True)
class LoggedSensor:
    """A sensor of a log that is of no joint.

    Attributes
    ----------
    name
        Name of the sensor: of a force or a wrench, without the words of its channels.
    kind
        Its kind; a ``wrench`` is a force with a moment.
    channels
        Its channels.
    rate_hz
        Median rate of its values [Hz]; None with fewer than two values.
    """

    name: str
    kind: SensorKind
    channels: tuple[str, ...]
    rate_hz: float | None


@dataclass(frozen=True)
class Inspection:
    """The contents of a log, and what is wrong with it.

    Attributes
    ----------
    path
        The file.
    duration
        From the first to the last stamp [s].
    samples
        Rows of the log.
    dt
        Nominal sample time: the median step of the stamps [s].
    rate_hz
        Its inverse.
    mean_rate_hz
        Samples over time within the segments; less than ``rate_hz`` where samples were lost without a gap.
    segments
        Number of runs without a gap.
    stamps
        The time stamps.
    joints
        By name, in the log's order.
    sensors
        The sensors that are of no joint.
    findings
        Problems first, then warnings, then notes; those with the same advice side by side.
    reading
        Notices of the reader, but for those that are among the findings.
    """

    path: str
    duration: float
    samples: int
    dt: float
    rate_hz: float
    mean_rate_hz: float
    segments: int
    stamps: Stamps
    joints: Mapping[str, InspectedJoint]
    sensors: tuple[LoggedSensor, ...]
    findings: tuple[Notice, ...]
    reading: tuple[Notice, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, finite or None, as JSON takes them."""
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(x) for key, x in value.items()}
    if isinstance(value, tuple):
        return [_plain(x) for x in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

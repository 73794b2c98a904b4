"""Records of `idtool inspect`."""

from __future__ import annotations

from typing import Annotated, Literal

from idtool.reporting.results.base import Keys, ReadOnly, Record, Result, field


class GapReport(Record):
    """A gap in the stamps."""

    start: float = field("Start of the gap, measured from the first stamp [s].")
    lost: float = field("Time that was lost [s].")


class SamplingReport(Record):
    """Actual sampling times, estimated from q and v."""

    skipped: float = field("Fraction of steps that are two or more sample periods long.")
    jitter_ms: float | None = field("RMS deviation of the sampling times from an even spacing [ms].")
    stamp_error_ms: float | None = field("RMS difference between the sampling times and the stamps [ms].")


class StampsReport(Record):
    """The time stamps of a log."""

    step_jitter: float | None = field("Standard deviation of the steps between stamps, in sample periods.")
    jitter_rms_ms: float | None = field("RMS deviation from evenly spaced stamps [ms].")
    jitter_max_ms: float | None = field("Largest deviation from evenly spaced stamps [ms].")
    step_ms: float | None = field("Step of which all stamps are multiples [ms]; null if there is none.")
    duplicates: int = field("Number of stamps equal to the previous one.")
    backward: int = field("Number of stamps earlier than the previous one.")
    gaps: int = field("Number of gaps.")
    lost: float = field("Time lost in gaps [s].")
    longest_gaps: tuple[GapReport, ...] = field("The longest gaps, longest first.")
    short: float = field("Fraction of the samples in segments shorter than half a second.")
    repeated: float = field("Fraction of the samples during motion that equal the previous one in all joints.")
    sampling: SamplingReport | None = field("Actual sampling times; null if the motion does not determine them.")


class SignalReport(Record):
    """A signal of a joint, in its own unit."""

    minimum: float | None = field("Smallest finite sample.")
    maximum: float | None = field("Largest finite sample.")
    rms: float | None = field("RMS of the finite samples.")
    not_finite: int = field("Number of samples that are not finite.")
    step: float | None = field("Quantization step; null if the signal is continuous.")
    noise: float | None = field("Standard deviation of the white noise.")
    stale: float | None = field("Fraction of samples that repeat the previous one while the signal changes.")
    stuck: float = field("Fraction of samples at the smallest or largest value, as in a clipped signal.")


class VelocityReport(Record):
    """Comparison of the measured velocity with the derivative of the position."""

    lag_ms: float | None = field("Lag of v [ms]; null if v is unrelated to q.")
    lag_error_ms: float | None = field("Standard error of the lag [ms].")
    gain: float | None = field("Ratio of v to dq/dt.")
    agreement: float | None = field("Fraction of the power of v that dq/dt explains.")
    residual: float | None = field("RMS of the remainder [rad/s or m/s].")


class TorqueSourceReport(Record):
    """Assessment of the torque as measured or commanded."""

    kind: Literal["measured", "commanded", "unknown"] = field("`measured`, `commanded` or `unknown`.")
    reason: str = field("Reason for this assessment.")


class JointReport(Record):
    """A joint of a log."""

    signals: Annotated[ReadOnly[SignalReport], Keys("signal")] = field(
        "Those of `q`, `v`, `tau`, `qcmd`, `vcmd` that are present."
    )
    moves: bool = field("Whether the joint moves.")
    standstill: float | None = field("Fraction of the time at rest.")
    speed_rms: float | None = field("RMS speed [rad/s or m/s].")
    band_hz: float | None = field("Frequency below which 99 % of the velocity's power lies [Hz]; null at rest.")
    jumps: int = field("Number of steps of q that are too large for its speed.")
    wraps: bool = field("Whether these jumps are full turns.")
    velocity: VelocityReport | None = field("Comparison of v with the derivative of q; null if it is not possible.")
    torque: TorqueSourceReport | None = field("Source of the torque; null if there is no torque or it is constant.")


class SensorReport(Record):
    """A sensor of a log that is of no joint."""

    name: str = field("Name of the sensor.")
    kind: Literal["imu", "pose", "contact_flag", "force", "wrench", "other"] = field(
        "`imu`, `pose`, `contact_flag`, `force`, `wrench` (a force with a moment) or `other`."
    )
    channels: tuple[str, ...] = field("Its channels.")
    rate_hz: float | None = field("Median rate of its values [Hz]; null with fewer than two values.")


class FindingReport(Record):
    """A fault or a notable property of a log."""

    severity: Literal["note", "warning", "problem"] = field(
        "`note`: no action needed; `warning`: it makes the fit worse; `problem`: the log cannot be used as it is."
    )
    joint: str | None = field("The joint; null: the whole log.")
    what: str = field("What was found.")
    meaning: str = field("What it means for the fit, and what to do.")
    fault: str | None = field("Id of the data fault, as in a diagnosis; null: too small to affect a fit.")
    undone: bool = field("Whether idtool corrects it, so that no action is needed.")


class InspectionReport(Result):
    """Result of `idtool inspect`; units are those after `log.scale`: rad, rad/s, N·m."""

    path: str = field("The log.")
    duration: float = field("Time from the first to the last stamp [s].")
    samples: int = field("Number of rows.")
    dt: float = field("Median step of the stamps [s].")
    rate_hz: float = field("1/`dt` [Hz].")
    mean_rate_hz: float = field("Number of samples divided by the duration of the segments [Hz].")
    segments: int = field("Number of segments without a gap.")
    stamps: StampsReport = field("The time stamps.")
    joints: Annotated[ReadOnly[JointReport], Keys("joint")] = field("The joints.")
    sensors: tuple[SensorReport, ...] = field("The sensors that are of no joint.")
    findings: tuple[FindingReport, ...] = field("Problems first, then warnings, then notes.")

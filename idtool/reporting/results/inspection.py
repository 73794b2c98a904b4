"""Records of `idtool inspect`."""

from __future__ import annotations

from typing import Annotated, Literal

from idtool.reporting.results.base import Keys, ReadOnly, Record, Result, field


class GapReport(Record):
    """A gap in the stamps."""

    start: float = field("When it begins, after the first stamp [s].")
    lost: float = field("Time that was lost [s].")


class SamplingReport(Record):
    """The instants at which samples were really taken, as q and v tell them."""

    skipped: float = field("Share of steps that took the time of two samples or more.")
    jitter_ms: float | None = field("Standard deviation of the instants about an even spacing [ms].")
    stamp_error_ms: float | None = field("Standard deviation of the instants about the stamps [ms].")


class StampsReport(Record):
    """The time stamps of a log."""

    step_jitter: float | None = field("Standard deviation of the steps from stamp to stamp, in samples.")
    jitter_rms_ms: float | None = field("RMS deviation from an even clock [ms].")
    jitter_max_ms: float | None = field("Largest deviation from an even clock [ms].")
    step_ms: float | None = field("Smallest common step of the stamps [ms]; null: none.")
    duplicates: int = field("Stamps equal to the one before.")
    backward: int = field("Stamps earlier than the one before.")
    gaps: int = field("Number of gaps.")
    lost: float = field("Time lost in gaps [s].")
    longest_gaps: tuple[GapReport, ...] = field("The longest gaps, longest first.")
    short: float = field("Share of the samples in stretches of less than half a second.")
    repeated: float = field("Share of the samples, while anything moves, that equal the one before in all joints.")
    sampling: SamplingReport | None = field("Real instants of the samples; null where the motion does not tell them.")


class SignalReport(Record):
    """A signal of a joint, in its own unit."""

    minimum: float | None = field("Least finite sample.")
    maximum: float | None = field("Greatest finite sample.")
    rms: float | None = field("RMS of the finite samples.")
    not_finite: int = field("Samples that are not finite.")
    step: float | None = field("Quantisation step; null where the signal is continuous.")
    noise: float | None = field("Standard deviation of the white noise.")
    stale: float | None = field("Share of samples that repeat the one before while the signal changes.")
    stuck: float = field("Share of samples at the least or greatest value, as on an end stop.")


class VelocityReport(Record):
    """A measured velocity against the derivative of the position."""

    lag_ms: float | None = field("Lag of v [ms]; null where v has nothing to do with q.")
    lag_error_ms: float | None = field("Standard error of the lag [ms].")
    gain: float | None = field("v over dq/dt.")
    agreement: float | None = field("Share of the power of v that dq/dt explains.")
    residual: float | None = field("RMS of the rest [rad/s or m/s].")


class TorqueSourceReport(Record):
    """Whether the torque looks measured or commanded."""

    kind: Literal["measured", "commanded", "unknown"] = field("`measured`, `commanded` or `unknown`.")
    reason: str = field("Why.")


class JointReport(Record):
    """A joint of a log."""

    signals: Annotated[ReadOnly[SignalReport], Keys("signal")] = field(
        "Of `q`, `v`, `tau`, `qcmd`, `vcmd` those present."
    )
    moves: bool = field("Whether the joint moves.")
    standstill: float | None = field("Share of the time at rest.")
    speed_rms: float | None = field("RMS speed [rad/s or m/s].")
    band_hz: float | None = field("Frequency below which 99 % of the velocity's power lies [Hz]; null at rest.")
    jumps: int = field("Single steps of q that its speed cannot explain.")
    wraps: bool = field("Whether these jumps are full turns.")
    velocity: VelocityReport | None = field("v against the derivative of q; null where that cannot be told.")
    torque: TorqueSourceReport | None = field("Source of the torque; null without a torque that changes.")


class FindingReport(Record):
    """Something that is wrong with a log, or worth knowing."""

    severity: Literal["note", "warning", "problem"] = field(
        "`note`: nothing to do; `warning`: the fit gets worse by it; `problem`: not to be used like this."
    )
    joint: str | None = field("The joint; null: the whole log.")
    what: str = field("What was found.")
    meaning: str = field("What it means for the fit, and what to do.")
    fault: str | None = field("Id of the data fault, which a diagnosis names too; null: too little to spoil a fit.")
    undone: bool = field("Whether idtool undoes it, so that nothing is to be done.")


class InspectionReport(Result):
    """Result of `idtool inspect`; units are those of the log as `log.scale` turns them: rad, rad/s, N·m."""

    path: str = field("The log.")
    duration: float = field("Time from the first to the last stamp [s].")
    samples: int = field("Rows of the log.")
    dt: float = field("Median step of the stamps [s].")
    rate_hz: float = field("1/`dt` [Hz].")
    mean_rate_hz: float = field("Samples over time within the segments [Hz].")
    segments: int = field("Stretches without a gap.")
    stamps: StampsReport = field("The time stamps.")
    joints: Annotated[ReadOnly[JointReport], Keys("joint")] = field("The joints.")
    findings: tuple[FindingReport, ...] = field("Problems first, then warnings, then notes.")

"""Records of `idtool reduce`."""

from __future__ import annotations

from idtool.reporting.results.base import Record, Result, field


class ReducedLogReport(Record):
    """A log that was reduced."""

    path: str = field("The log.")
    train: int = field("Number of samples for fitting.")
    validation: int = field("Number of samples for validation.")


class ReductionReport(Result):
    """Result of `idtool reduce`."""

    file: str = field("The file that was written.")
    bytes: int = field("Its size.")
    urdf: str = field("The URDF.")
    joints: tuple[str, ...] = field("The joints.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    holdout: float = field("Fraction at the end of every log that is kept for validation.")
    logs: tuple[ReducedLogReport, ...] = field("The logs.")

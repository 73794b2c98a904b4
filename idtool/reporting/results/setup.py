"""Records of `idtool init`."""

from __future__ import annotations

from typing import Any

from idtool.reporting.results.base import ByJoint, Record, Result, Sentences, field


class StartErrors(Record):
    """Held-out RMS torque errors by joint; `overall` is the RMS over all joints and samples."""

    friction: ByJoint = field("With viscous and Coulomb friction only [N·m or N].")
    found: ByJoint = field("With all terms that were found.")


class TrialReport(Record):
    """A term that was tried."""

    effect: str = field("Its id, see [Effects](effects.md).")
    joint: str | None = field("The joint; null: all joints.")
    value: float = field("Identified value [SI].")
    before: float | None = field("Held-out RMS torque error of the joint without it; null if nothing was held out.")
    after: float | None = field("Held-out RMS torque error with it.")
    kept: bool = field("Whether it was added to the configuration.")


class TodoReport(Record):
    """A key that has to be filled in."""

    key: str = field("Key of the configuration.")
    what: str = field("What is missing.")
    needed: bool = field("Whether `idtool fit` requires it.")


class InitReport(Result):
    """Result of `idtool init`."""

    file: str = field("Path of the configuration.")
    urdf: str = field("The URDF.")
    logs: tuple[str, ...] = field("The logs.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    config: dict[str, Any] = field("The [configuration](config.md) that was written.")
    rms: StartErrors | None = field("Held-out torque errors; null if nothing was fitted.")
    trials: tuple[TrialReport, ...] = field("Terms that were tried.")
    found: Sentences = field("Findings, one line each.")
    left: tuple[TodoReport, ...] = field("Keys that have to be filled in.")
    needed: tuple[str, ...] = field("Keys of `left` that `idtool fit` requires.")
    next: str = field("The next command.")

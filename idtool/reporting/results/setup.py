"""Records of `idtool init`."""

from __future__ import annotations

from typing import Any

from idtool.reporting.results.base import ByJoint, Record, Result, Sentences, field


class StartErrors(Record):
    """Held-out RMS torque errors by joint, and `overall` joints and samples."""

    friction: ByJoint = field("With viscous and Coulomb friction alone [N·m or N].")
    found: ByJoint = field("With all that was found.")


class TrialReport(Record):
    """A term that was tried."""

    effect: str = field("Its id, see [Effects](effects.md).")
    joint: str | None = field("The joint; null: all joints.")
    value: float = field("Value that a fit gives it [SI].")
    before: float | None = field("Held-out RMS of the joint's torque without it; null where nothing was held out.")
    after: float | None = field("Held-out RMS with it.")
    kept: bool = field("Whether it is in the configuration.")


class TodoReport(Record):
    """Something that is left to fill in."""

    key: str = field("Key of the configuration.")
    what: str = field("What is missing.")
    needed: bool = field("Whether `idtool fit` cannot do without it.")


class InitReport(Result):
    """Result of `idtool init`."""

    file: str = field("The configuration that is written.")
    urdf: str = field("The URDF.")
    logs: tuple[str, ...] = field("The logs.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    config: dict[str, Any] = field("The [configuration](config.md) that was written.")
    rms: StartErrors | None = field("Held-out torque errors; null where nothing was fitted.")
    trials: tuple[TrialReport, ...] = field("What was tried.")
    found: Sentences = field("What was found, one line each.")
    left: tuple[TodoReport, ...] = field("What is left to fill in.")
    needed: tuple[str, ...] = field("Keys of `left` that `idtool fit` cannot do without.")
    next: str = field("The next command.")

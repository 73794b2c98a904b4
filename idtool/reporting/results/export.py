"""Records of `idtool export`."""

from __future__ import annotations

from idtool.reporting.results.base import Record, Result, field


class ExportedPart(Record):
    """A part of the model, and how the file represents it or what is missing."""

    what: str = field("Kind: an effect's id, `inertial`, `rotor`, `gravity`, `joint_limit`, `mimic`, …")
    of: str = field("Joint, link or rotor.")
    detail: str = field("How the file represents it, or what is missing.")
    value: float | None = field("Its size; null if it has none.")
    unit: str | None = field("Unit of the size.")


class ExportReport(Result):
    """Result of `idtool export`."""

    file: str | None = field("The file that was written; null if none was.")
    carried: tuple[ExportedPart, ...] = field("Parts that the file contains.")
    not_carried: tuple[ExportedPart, ...] = field("Parts that the simulator cannot represent.")
    patched: str | None = field("The simulator's file that it is a copy of; null without `--patch`.")

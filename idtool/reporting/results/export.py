"""Records of `idtool export`."""

from __future__ import annotations

from idtool.reporting.results.base import Record, Result, field


class ExportedPart(Record):
    """A part of the model, and how the file carries it or what it leaves out."""

    what: str = field("Kind: an effect's id, `inertial`, `rotor`, `gravity`, `joint_limit`, `mimic`, …")
    of: str = field("Joint, link or rotor.")
    detail: str = field("How the file carries it, or what is left out.")
    value: float | None = field("Its size; null where it has none.")
    unit: str | None = field("Unit of the size.")


class ExportReport(Result):
    """Result of `idtool export`."""

    file: str | None = field("The model that was written; null where none was.")
    carried: tuple[ExportedPart, ...] = field("What is in it.")
    not_carried: tuple[ExportedPart, ...] = field("What the simulator cannot hold.")

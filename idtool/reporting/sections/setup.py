"""The section of a first configuration: errors without and with the terms found."""

from __future__ import annotations

from typing_extensions import override

from idtool.reporting.results.setup import InitReport
from idtool.reporting.sections.base import Cell, Column, Section, Table, name_column, number_cell


class StartErrorsSection(Section[InitReport]):
    """Torque errors with friction alone and with all terms found, by joint."""

    title = "Torque error"

    @override
    def table(self, report: InitReport) -> Table | None:
        if not report.rms:
            return None
        before, after = report.rms.friction, report.rms.found
        rows = [[Cell(name), number_cell(before[name]), number_cell(after.get(name))] for name in before]
        title = f"Held-out RMS torque error, N·m or N, below {report.band_hz:g} Hz"
        return Table(title, [name_column("joint"), Column("friction only"), Column("with all terms found")], rows)

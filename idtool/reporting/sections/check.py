"""The section of a check of a URDF's inertials."""

from __future__ import annotations

from typing_extensions import override

from idtool.reporting.number_text import percent
from idtool.reporting.results.ellipsoids import CheckReport
from idtool.reporting.sections.base import Cell, Column, Section, Table, name_column, number_cell, realizable_cell


class LinksSection(Section[CheckReport]):
    """Links whose inertia no body can have, and the nearest inertias that some body can have."""

    title = "Links"

    @override
    def table(self, report: CheckReport) -> Table:
        is_repaired = any(link.nearest for link in report.links.values())
        columns = [name_column("link"), Column("mass", "kg"), Column("realizable")]
        if is_repaired:
            columns += [
                Column("repaired mass", "kg"),
                Column("change", help="Largest change of the inertia, relative to its largest entry", attached=True),
            ]
        rows = []
        for name, link in report.links.items():
            row = [Cell(name), number_cell(link.mass), realizable_cell(not link.violations)]
            if is_repaired and link.nearest:
                row += [number_cell(link.nearest.mass), Cell(percent(link.nearest.moved), link.nearest.moved)]
            elif is_repaired:
                row += [Cell(""), Cell("")]
            rows.append(row)
        return Table(self.title, columns, rows)

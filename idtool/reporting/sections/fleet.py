"""The section on a fleet: its robots' errors, and which of them stands out."""

from __future__ import annotations

from typing_extensions import override

from idtool.common.units import units_text
from idtool.reporting.results.fit import FitReport
from idtool.reporting.sections.base import Cell, Column, Section, Table, name_column, number_cell


class FleetSection(Section[FitReport]):
    """Errors of each robot of a fleet, and how it differs from the others."""

    title = "Robots of the fleet"
    template = "fleet.html"

    @override
    def table(self, report: FitReport) -> Table | None:
        if report.fleet is None:
            return None
        columns = [
            name_column("robot"),
            Column("logs"),
            Column("fleet's bodies", help="Error with the bodies of the fleet and the robot's own friction."),
            Column("fitted alone", help="Error of a model that was fitted to the robot's logs alone."),
            Column("differs from the others", kind="words"),
        ]
        rows = []
        for name, robot in report.fleet.robots.items():
            row = [Cell(name, emphasis="bad" if robot.outliers else None), Cell(str(len(robot.logs)), len(robot.logs))]
            row += [number_cell(robot.rms), number_cell(robot.rms_alone)]
            row.append(Cell.of_lines(robot.outliers) if robot.outliers else Cell("no"))
            rows.append(row)
        return Table(f"Robots of the fleet: RMS torque error, {units_text(report.units)}", columns, rows)

    @override
    def text(self, report: FitReport) -> str:
        return (
            "All robots have the same bodies, and friction of their own. A robot differs if a value of its friction is "
            "more than four standard errors and 30 % away from the others' median, or if a model fitted to its logs "
            "alone has at least 15 % less error. The other tables have the mean of the robots' friction; the model of "
            "each robot is in the folder robots/."
        )

"""The section on a fleet: its robots' errors, and which of them stands out."""

from __future__ import annotations

from typing_extensions import override

from idtool.common.names import join_names
from idtool.common.units import units_text
from idtool.reporting.results.fit import FitReport
from idtool.reporting.sections.base import Cell, Column, Section, Table, name_column, number_cell


class FleetSection(Section[FitReport]):
    """Errors of each robot of a fleet, and how it differs from the others."""

    title = "Robots of the fleet"
    template = "friction.html"

    @override
    def table(self, report: FitReport) -> Table | None:
        if report.fleet is None:
            return None
        columns = [
            name_column("robot"),
            Column("logs"),
            Column("fleet's bodies", help="Error with the bodies of the fleet and what the robot has of its own."),
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
        own = report.fleet.own if report.fleet else ()
        return (
            f"All robots have the same bodies; each has its own {join_names(own)}. A robot stands out if one of these "
            "values differs from the median of the other robots by more than four times the scatter (its standard "
            "error combined with the standard errors and the spread of the others) and by more than 30 % of the "
            "largest value, or if a model fitted to its logs alone has at least 15 % less error. The other tables show "
            "the mean over the robots; the model of each is in the folder robots/."
        )

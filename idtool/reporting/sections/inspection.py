"""The sections of an inspection: joints and sensors of a log."""

from __future__ import annotations

from typing_extensions import override

from idtool.reporting.results.inspection import InspectionReport
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Section,
    Table,
    name_column,
    number_cell,
    percent_cell,
)


class JointsSection(Section[InspectionReport]):
    """Signals and motion of each joint of a log."""

    title = "Joints"

    @override
    def table(self, report: InspectionReport) -> Table:
        columns = [
            name_column("joint"),
            Column("signals", kind="words"),
            Column("q min"),
            Column("q max", attached=True),
            Column("v rms"),
            Column("tau rms"),
            Column("band", "Hz"),
            Column("at rest"),
            Column("v lag", "ms"),
            Column("tau source", kind="words", help="Whether the torque seems to be measured or commanded"),
        ]
        rows = []
        for name, joint in report.joints.items():
            q, tau, velocity = joint.signals.get("q"), joint.signals.get("tau"), joint.velocity
            row = [
                Cell(name),
                Cell(" ".join(joint.signals)),
                number_cell(q.minimum if q else None),
                number_cell(q.maximum if q else None),
                number_cell(joint.speed_rms),
                number_cell(tau.rms if tau else None),
                number_cell(joint.band_hz),
                percent_cell(joint.standstill),
                number_cell(velocity.lag_ms if velocity else None),
                Cell(joint.torque.kind if joint.torque else NO_VALUE),
            ]
            rows.append(row)
        return Table(self.title, columns, rows)


class SensorsSection(Section[InspectionReport]):
    """Sensors of a log that are of no joint."""

    title = "Sensors"

    @override
    def table(self, report: InspectionReport) -> Table | None:
        if not report.sensors:
            return None
        columns = [name_column("sensor"), Column("kind", kind="words"), Column("channels"), Column("rate", "Hz")]
        rows = []
        for sensor in report.sensors:
            kind = Cell(sensor.kind.replace("_", " "))
            rows.append([Cell(sensor.name), kind, Cell(str(len(sensor.channels))), number_cell(sensor.rate_hz)])
        return Table(self.title, columns, rows)

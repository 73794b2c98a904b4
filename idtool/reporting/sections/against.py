"""The sections of a robot against its simulator: the changes to make, and the gap before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from typing_extensions import override

from idtool.common.number_text import number, with_error
from idtool.common.units import common_unit, position_units
from idtool.reporting.diagnosis_text import effect_name, owner_name
from idtool.reporting.results.diagnosis import ChangeReport, ComparedParameter, DiagnosisReport
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Section,
    Table,
    name_column,
    number_cell,
    percent_cell,
    unit_cells,
    unit_columns,
)
from idtool.robot.inertia import round_to_digits

_SHARE = "Fraction of the removed mean square torque error that returns without this change"


class ChangesSection(Section[DiagnosisReport]):
    """Changes to make in the simulator, one row a parameter."""

    title = "Changes to make in the simulator"

    @override
    def table(self, report: DiagnosisReport) -> Table | None:
        if report.against is None or not report.against.changes:
            return None
        columns = [*_parameter_columns(), Column("gap", help=_SHARE)]
        rows = []
        for change in report.against.changes:
            for i, cells in enumerate(_parameter_rows(change)):
                rows.append([*cells, percent_cell(change.share) if i == 0 else Cell("")])
        return Table(self.title, columns, rows, key_columns=3)

    @override
    def text(self, report: DiagnosisReport) -> str:
        return (
            "Values are in SI units, ± their standard errors; the simulator's values are identified from its logs. "
            "Gap: the fraction of the removed mean square torque error that returns without the change. For the "
            "inertia of links it is that of all links together, which must be changed together."
        )


class UnchangedSection(Section[DiagnosisReport]):
    """Effects that need no change, and why."""

    title = "Effects that need no change"

    @override
    def table(self, report: DiagnosisReport) -> Table | None:
        if report.against is None or not report.against.unchanged:
            return None
        columns = [*_parameter_columns(), Column("reason", kind="words")]
        rows = []
        for change in report.against.unchanged:
            rows += [[*cells, Cell(change.reason)] for cells in _parameter_rows(change)]
        return Table(self.title, columns, rows, key_columns=3)


class SimulatorGapSection(Section[DiagnosisReport]):
    """Errors of the simulator's model on the robot's logs, before and after the changes."""

    title = "Gap between simulator and robot"

    @override
    def table(self, report: DiagnosisReport) -> Table | None:
        against = report.against
        if against is None:
            return None
        lengths = position_units(report.units)
        is_simulated = against.position_before is not None and against.position_after is not None
        columns = [name_column("joint"), *unit_columns(report.units), Column("before"), Column("after", attached=True)]
        if is_simulated:
            columns += [Column("simulation before"), Column("simulation after", attached=True)]
        rows = []
        for name in (*report.joints, "overall"):
            row = [Cell(name), *unit_cells(report.units, name)]
            row += [number_cell(against.torque_before[name], 3), number_cell(against.torque_after[name], 3)]
            if against.position_before is not None and against.position_after is not None:
                row += [number_cell(against.position_before[name], 3), number_cell(against.position_after[name], 3)]
            rows.append(row)
        title = f"RMS torque error of the simulator's model on the robot's logs, {common_unit(report.units)}"
        if is_simulated:
            title += f"; position error of its simulation, {common_unit(lengths)}"
        return Table(title, columns, rows)

    @override
    def text(self, report: DiagnosisReport) -> str:
        if report.against is None:
            return ""
        lengths = common_unit(position_units(report.units))
        sentences = [
            "Before: the model identified from the simulator's logs, evaluated on the robot's logs. After: the same "
            "model with the changes above."
        ]
        for pair in report.against.pairs:
            difference = f"{number(pair.position_rms['overall'])} {lengths}"
            if pair.torque_rms is not None:
                difference += f" and {number(pair.torque_rms['overall'])} {common_unit(report.units)}"
            sentences.append(
                f"As logged, {pair.log} and {pair.simulation} differ by {difference} RMS over {number(pair.seconds)} s "
                f"(the simulator's log starts {number(pair.offset)} s after the robot's)."
            )
        return " ".join(sentences)


def _parameter_columns() -> list[Column]:
    return [
        Column("effect", kind="words"),
        Column("on", kind="words", attached=True),
        Column("parameter", kind="words", attached=True),
        Column("in the simulator"),
        Column("on the robot", attached=True),
        Column("unit", kind="words", attached=True),
    ]


def _parameter_rows(change: ChangeReport) -> list[list[Cell]]:
    """A row of cells for each parameter; none for one that both leave out."""
    return [
        [
            Cell(effect_name(change.effect)),
            Cell(owner_name(change)),
            Cell(name.replace("_", " ")),
            Cell(_text(parameter.simulator, parameter.simulator_standard_error)),
            Cell(_text(parameter.robot, parameter.robot_standard_error)),
            Cell(parameter.unit or ""),
        ]
        for name, parameter in change.parameters.items()
        if not _is_left_out(parameter)
    ]


def _is_left_out(parameter: ComparedParameter) -> bool:
    """True if a parameter is 0 or absent in the simulator and on the robot, without an error."""
    values = (parameter.simulator, parameter.robot)
    errors = (parameter.simulator_standard_error, parameter.robot_standard_error)
    return all(value in (None, 0.0) for value in values) and not any(errors)


def _text(value: Any, error: Any) -> str:
    """A value with its standard error."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(number(x) for x in round_to_digits(value, 3).tolist())}]"
    if value is None:
        return NO_VALUE
    if isinstance(value, str):
        return value
    if not error:  # not known, or exact
        return number(value)
    return " ± ".join(with_error(value, error))

"""The sections on a fit's uncertainty: base parameters, repeatability, bias."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from typing_extensions import override

from idtool.common.units import units_text
from idtool.reporting.number_text import interval_text
from idtool.reporting.results.fit import (
    BaseParameter,
    BiasParameter,
    FitReport,
    RepeatabilityReport,
    RepeatedParameter,
)
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Emphasis,
    Section,
    Table,
    error_cells,
    error_column,
    name_column,
    number_cell,
    percent_cell,
    unit_cells,
    unit_columns,
)
from idtool.reporting.uncertainty_report import MAX_PULL

MAX_ROWS = 60  # of a table of base parameters
MAX_COMPARED = 20  # parameters of which the logs are compared
MAX_LOGS = 8  # side by side; as many colours there are
_MAX_TERMINAL_ROWS = 8  # parameters
_MAX_TERMINAL_LOGS = 4  # logs in the terminal
_MAX_CROSS_RATIO = 1.5  # times the error of the model fitted to the log itself


class TorqueStandardErrorsSection(Section[FitReport]):
    """Standard errors of the predicted torque, by joint."""

    title = "Standard error of the predicted torque"

    @override
    def table(self, report: FitReport) -> Table:
        errors = report.uncertainty
        units = unit_columns(report.units)
        columns = [
            name_column("joint"),
            *units,
            Column("independent samples"),
            Column("rms"),
            Column("largest"),
            Column("undetermined"),
        ]
        rows = []
        for joint in report.joints:
            samples = errors.independent_samples[joint]
            row = [Cell(joint), *unit_cells(report.units, joint), Cell(f"{samples:.0f}", samples)]
            row.append(number_cell(errors.torque_standard_error[joint]))
            row.append(number_cell(errors.torque_standard_error_largest[joint]))
            row.append(percent_cell(errors.torque_undetermined[joint]))
            rows.append(row)
        title = f"Standard error of the predicted torque, {units_text(report.units)}"
        return Table(title, columns, rows, key_columns=1 + len(units))

    @override
    def text(self, report: FitReport) -> str:
        is_held_out = report.rms.validation is not None
        data = "On the held-out data" if is_held_out else "On the data that the model was fitted to"
        return (
            "Independent samples: the number of independent samples that would contain the same information as the "
            f"correlated ones. {data}. The standard errors contain only the errors of the parameters, not effects that "
            "the model lacks. Undetermined: percentage of the samples whose torque the fitted data do not determine."
        )


class BaseParametersSection(Section[FitReport]):
    """The base parameters: those held away from the data first, then those that the logs do not determine."""

    title = "Base parameters"
    template = "base_parameters.html"
    parts = (TorqueStandardErrorsSection(),)

    @override
    def table(self, report: FitReport) -> Table | None:
        base = report.base_parameters
        if base is None:
            return None
        pulled = [p for p in base.parameters if p.pull is not None and p.pull > MAX_PULL]
        groups: dict[str, list[BaseParameter]] = {
            "changed by prior or constraints": sorted(pulled, key=lambda p: -(p.pull or 0.0)),
            "not determined": [p for p in base.parameters if p.pull is None],
            "from the data": [p for p in base.parameters if p.pull is not None and p.pull <= MAX_PULL],
        }
        columns = [
            Column("base parameter", kind="words"),
            Column("unit", kind="name"),
            Column("value"),
            error_column(),
            Column("95 % interval", attached=True),
            Column("pull"),
            Column("estimate", kind="name"),
        ]
        rows = []
        for group, parameters in groups.items():
            emphasis: Emphasis | None = "note" if group == "changed by prior or constraints" else None
            for p in parameters:
                pull = Cell(NO_VALUE) if p.pull is None else Cell(f"{p.pull:.1f}", p.pull, emphasis)
                values = error_cells(p.value, p.standard_error)
                interval = Cell(interval_text(p.interval))
                rows.append([Cell(p.name), Cell(p.unit), *values, interval, pull, Cell(group, None, emphasis)])
        counts = ", ".join(f"{len(parameters)} {group}" for group, parameters in groups.items() if parameters)
        return Table(f"Base parameters: {counts}", columns, rows[:MAX_ROWS])

    @override
    def text(self, report: FitReport) -> str:
        return (
            "± se: one standard error; –: these logs do not determine the value. Pull: distance between the value and "
            "the estimate from the data alone, in standard errors, due to prior and constraints; changed by prior or "
            f"constraints: a pull of more than {MAX_PULL:g}. The interval contains both values. …: smaller terms; "
            "report.json lists all of them."
        )


class CrossValidationSection(Section[FitReport]):
    """Errors of the model of one log on another."""

    title = "Fitted to one log, validated on another"

    @override
    def table(self, report: FitReport) -> Table | None:
        repeatability = report.repeatability
        if repeatability is None:
            return None
        shown = shown_logs(repeatability)
        errors = repeatability.cross_rms
        columns = [name_column("fitted to"), *(Column(f"error on {repeatability.logs[k]}") for k in shown)]
        rows = []
        for fitted in shown:
            row = [Cell(repeatability.logs[fitted])]
            for on in shown:
                is_far = errors[fitted][on] > _MAX_CROSS_RATIO * errors[on][on]
                row.append(number_cell(errors[fitted][on], emphasis="bad" if is_far else None))
            rows.append(row)
        return Table("RMS torque error over all joints, in units of each joint's noise", columns, rows)

    @override
    def text(self, report: FitReport) -> str:
        return "Red and bold: more than 1.5 times the error of the model that was fitted to the log of the column."


class RepeatabilitySection(Section[FitReport]):
    """The base parameters that scatter most between the logs: by log, and of many logs the extremes."""

    title = "Do the logs agree?"
    template = "repeatability.html"
    parts = (CrossValidationSection(),)

    @override
    def table(self, report: FitReport) -> Table | None:
        repeatability = report.repeatability
        if repeatability is None:
            return None
        shown = shown_logs(repeatability)
        is_long = len(repeatability.logs) > _MAX_TERMINAL_LOGS
        columns = [Column("parameter", kind="words"), Column("unit", kind="name", page_only=True)]
        for k in shown:
            columns += [Column(repeatability.logs[k], page_only=is_long), error_column(page_only=True)]
        if is_long:
            columns += [Column("smallest"), Column("in", kind="name", attached=True)]
            columns += [Column("largest"), Column("in", kind="name", attached=True)]
        columns += [Column("scatter / expected"), Column("significant", attached=True)]
        rows = []
        for p in compared_parameters(repeatability)[:MAX_COMPARED]:
            row = [Cell(p.name), Cell(p.unit)]
            for k in shown:
                row += error_cells(p.value[k], p.standard_error[k])
            if is_long:
                row += _extreme_cells(p.value, repeatability.logs)
            emphasis: Emphasis | None = None if p.agrees else "bad"
            row += [number_cell(p.ratio, emphasis=emphasis), Cell("" if p.agrees else "yes", None, emphasis)]
            rows.append(row)
        return Table(
            "Parameters that differ most between the logs", columns, rows, max_terminal_rows=_MAX_TERMINAL_ROWS
        )


class BiasSection(Section[FitReport]):
    """Estimates by least squares and by instruments: those that differ first."""

    title = "Least squares and instrumental variables"
    template = "bias.html"

    @override
    def table(self, report: FitReport) -> Table | None:
        if report.bias is None:
            return None
        columns = [
            Column("base parameter", kind="words"),
            Column("unit", kind="name"),
            Column("least squares"),
            Column("instrumental variables"),
            Column("difference", help="Instrumental-variables estimate minus least-squares estimate"),
            error_column(),
            Column("differs"),
        ]
        rows = []
        for p in sorted(report.bias.parameters, key=lambda p: (not p.differs, -bias_distance(p)))[:MAX_ROWS]:
            differs = Cell("yes", emphasis="bad") if p.differs else Cell("no")
            estimates = [number_cell(p.ls), number_cell(p.iv), *error_cells(p.iv - p.ls, p.standard_error)]
            rows.append([Cell(p.name), Cell(p.unit), *estimates, differs])
        return Table("Both estimates", columns, rows)


def shown_logs(repeatability: RepeatabilityReport) -> list[int]:
    """The first logs, and the odd one among them."""
    shown = list(range(len(repeatability.logs)))[:MAX_LOGS]
    if repeatability.odd_one_out is not None:
        odd = repeatability.logs.index(repeatability.odd_one_out)
        if odd not in shown:
            shown[-1] = odd
    return shown


def compared_parameters(repeatability: RepeatabilityReport) -> list[RepeatedParameter]:
    """Parameters that more than one log determines: first those that do not agree, then by how far they scatter."""
    order = sorted(repeatability.parameters, key=lambda p: (p.agrees, -(p.ratio or 0.0)))
    return [p for p in order if sum(error is not None for error in p.standard_error) > 1]


def _extreme_cells(values: Iterable[float | None], logs: Sequence[str]) -> list[Cell]:
    """The least and the greatest value, each with its log."""
    known = [(value, name) for value, name in zip(values, logs, strict=True) if value is not None]
    if not known:
        return [Cell(NO_VALUE)] * 4
    least, least_log = min(known)
    greatest, greatest_log = max(known)
    return [number_cell(least), Cell(least_log), number_cell(greatest), Cell(greatest_log)]


def bias_distance(p: BiasParameter) -> float:
    """Distance of the two estimates in standard errors."""
    if not p.standard_error:
        return 0.0
    return abs(p.iv - p.ls) / p.standard_error

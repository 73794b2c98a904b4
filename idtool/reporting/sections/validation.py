"""The sections of a validation, and of the regression."""

from __future__ import annotations

from typing_extensions import override

from idtool.common.units import units_text
from idtool.reporting.results.validation import RegressionReport, ValidationReport
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Section,
    Table,
    kind_label,
    kind_units,
    name_column,
    number_cell,
    percent_cell,
    unit_cells,
    unit_columns,
)


class ModelErrorsSection(Section[ValidationReport]):
    """Torque errors of a model and, where one was given, of the prior, by joint; and their bounds."""

    title = "Torque error"

    @override
    def table(self, report: ValidationReport) -> Table:
        units = unit_columns(report.units)
        has_prior = report.rms.prior is not None
        columns = [name_column("joint"), *units, Column("model")]
        if has_prior:
            columns.append(Column("prior"))
        columns.append(Column("error / torque", help="Error divided by the measured torque's standard deviation"))
        columns.append(Column("as logged", help="Error of the model relative to the unfiltered torque"))
        if has_prior:
            columns.append(Column("prior, as logged", page_only=True))
        if report.bound:
            columns += [Column("bound"), Column("result", kind="name", attached=True)]
        rows = []
        for name in (*report.joints, "overall"):
            row = [Cell(name), *unit_cells(report.units, name), number_cell(report.rms.model[name])]
            if report.rms.prior:
                row.append(number_cell(report.rms.prior[name]))
            row.append(percent_cell(report.nrms.get(name)))
            row.append(number_cell(report.rms_raw.model[name]))
            if has_prior:
                row.append(number_cell(report.rms_raw.prior[name] if report.rms_raw.prior else None))
            if report.bound:
                row += _bound_cells(report, name)
            rows.append(row)
        title = f"RMS torque error, {units_text(report.units)}, below {report.band_hz:g} Hz"
        return Table(title, columns, rows, key_columns=1 + len(units))

    @override
    def text(self, report: ValidationReport) -> str:
        return (
            "Root mean square of predicted minus measured torque, both filtered by the same zero-phase low-pass. As "
            "logged: relative to the unfiltered torque, so noise above the band counts as error too. Error / torque: "
            "the model's error divided by the standard deviation of the measured torque."
        )


class ModelErrorsByKindSection(Section[ValidationReport]):
    """Errors of the joints, and of the forces and moments on the base and in sensors."""

    title = "Error by kind"

    @override
    def table(self, report: ValidationReport) -> Table | None:
        errors = report.rms_by_kind
        if errors is None:
            return None
        columns = [Column("quantity", kind="words"), name_column("unit"), Column("model")]
        if errors.prior is not None:
            columns.append(Column("prior"))
        units = kind_units(errors.model, report.units)
        rows = []
        for kind in errors.model:
            row = [Cell(kind_label(kind)), Cell(units[kind]), number_cell(errors.model[kind])]
            if errors.prior is not None:
                row.append(number_cell(errors.prior[kind]))
            rows.append(row)
        return Table("RMS error by kind; for forces and moments, of the error vector's magnitude", columns, rows)


class RegressionCasesSection(Section[RegressionReport]):
    """Every case of the regression against its bound."""

    title = "Regression test"

    @override
    def table(self, report: RegressionReport) -> Table:
        columns = [
            Column("case", kind="words"),
            name_column("joint"),
            Column("prior"),
            Column("fit"),
            Column("bound"),
            Column("result", kind="name", attached=True),
        ]
        rows = []
        for case in report.cases:
            errors = [number_cell(case.prior), number_cell(case.rms), number_cell(case.bound)]
            rows.append([Cell(case.case), Cell(case.joint), *errors, result_cell(case.ok)])
        return Table("Regression test: RMS torque error in the band, N·m or N", columns, rows, key_columns=2)


def result_cell(ok: bool) -> Cell:
    """The cell of a bound that is met or not."""
    return Cell("ok") if ok else Cell("NOT MET", emphasis="bad")


def _bound_cells(report: ValidationReport, name: str) -> list[Cell]:
    bound = report.bound.get(name)
    if bound is None:
        return [Cell(NO_VALUE), Cell("")]
    return [Cell(f"{bound:g}", bound), result_cell(report.ok[name])]

"""The sections of a study: constraint sets, estimators, learning curves and the online estimate."""

from __future__ import annotations

from typing_extensions import override

from idtool.common.units import units_text
from idtool.reporting.results.study import StudyErrors, StudyReport
from idtool.reporting.sections.base import (
    Cell,
    Column,
    Section,
    Table,
    name_column,
    number_cell,
    unit_cells,
    unit_columns,
)


class ErrorsBySetSection(Section[StudyReport]):
    """Held-out error of each joint with each constraint set."""

    title = "Held-out error by joint"

    @override
    def table(self, report: StudyReport) -> Table:
        units = unit_columns(report.units)
        columns = [name_column("joint"), *units, *(Column(name) for name in report.sets)]
        rows = []
        for joint in report.units:
            errors = [number_cell(entry.rms.validation[joint]) for entry in report.sets.values()]
            rows.append([Cell(joint), *unit_cells(report.units, joint), *errors])
        return Table(f"RMS torque error, {units_text(report.units)}", columns, rows, key_columns=1 + len(units))


class MassesBySetSection(Section[StudyReport]):
    """Mass of each body with each constraint set."""

    title = "Masses"

    @override
    def table(self, report: StudyReport) -> Table | None:
        if not report.sets:
            return None
        columns = [name_column("body"), *(Column(name, "kg") for name in report.sets)]
        rows = []
        for body in next(iter(report.sets.values())).masses:
            masses = [entry.masses[body] for entry in report.sets.values()]
            cells = [number_cell(mass, emphasis="bad" if mass <= 0 else None) for mass in masses]
            rows.append([Cell(body), *cells])
        return Table(self.title, columns, rows)


class ConstraintSetsSection(Section[StudyReport]):
    """The fit within each constraint set."""

    title = "Constraint sets"
    template = "study_sets.html"
    parts = (ErrorsBySetSection(), MassesBySetSection())

    @override
    def table(self, report: StudyReport) -> Table:
        columns = [
            name_column("set"),
            Column("inequalities", help="Inequalities for one body"),
            Column("train"),
            Column("held out"),
            Column("not realizable", help="Bodies whose parameters no mass density can have"),
            Column("worst margin", page_only=True),
            Column("solved in", "ms"),
            Column("iterations", page_only=True),
            Column("duality gap"),
            Column("objective", page_only=True),
        ]
        rows = []
        for name, entry in report.sets.items():
            violations = f"{entry.violations} of {len(entry.masses)}"
            row = [Cell(name), Cell(entry.lmi), *_error_cells(entry.rms)]
            row.append(Cell(violations, entry.violations, "bad" if entry.violations else None))
            row += [number_cell(entry.worst_margin, 2), number_cell(1000 * entry.seconds)]
            row += [Cell(str(entry.iterations)), _gap_cell(entry.duality_gap), number_cell(entry.objective)]
            rows.append(row)
        title = f"Constraint sets: RMS torque error, {units_text(report.units)}, below {report.band_hz:g} Hz"
        return Table(title, columns, rows)


class EstimatorsSection(Section[StudyReport]):
    """The fit with each prior and local solver."""

    title = "Estimators"
    template = "study_estimators.html"

    @override
    def table(self, report: StudyReport) -> Table:
        columns = [
            name_column("estimator"),
            Column("train"),
            Column("held out"),
            Column("solved in", "ms"),
            Column("duality gap"),
            Column("iterations"),
            Column("status", kind="words", page_only=True),
        ]
        rows = []
        for name, entry in report.estimators.items():
            solution = [
                number_cell(1000 * entry.seconds),
                _gap_cell(entry.duality_gap),
                Cell(str(entry.iterations)),
                Cell(entry.status),
            ]
            rows.append([Cell(name), *_error_cells(entry.rms), *solution])
        return Table(f"Estimators: RMS torque error, {units_text(report.units)}", columns, rows)


class LearningCurvesSection(Section[StudyReport]):
    """Median held-out error and violation of realizability against the number of samples."""

    title = "Error against the number of samples"
    template = "study_learning.html"

    @override
    def table(self, report: StudyReport) -> Table:
        learning = report.learning
        columns = [name_column("samples")]
        columns += [Column(name) for name in learning.curves]
        columns += [Column(f"{name} violation") for name in learning.violation]
        rows = []
        for k, count in enumerate(learning.counts):
            medians = [number_cell(float(curve.median[k])) for curve in learning.curves.values()]
            violations = [number_cell(float(violation[k])) for violation in learning.violation.values()]
            rows.append([Cell(str(count), count), *medians, *violations])
        unit = units_text(report.units)
        title = f"Median held-out RMS, {unit}, against training samples, {learning.draws} draws"
        return Table(title, columns, rows)


class OnlineSection(Section[StudyReport]):
    """The time that each constraint set's online estimate takes."""

    title = "Online"
    template = "study_online.html"

    @override
    def table(self, report: StudyReport) -> Table | None:
        if not report.adaptation.error:
            return None
        columns = [name_column("set"), Column("time", "s", help="Time after which the error remains below 10 %")]
        rows = []
        for name, seconds in report.adaptation.time_to_10_percent.items():
            rows.append([Cell(name), Cell("not reached") if seconds is None else number_cell(seconds)])
        return Table("Online: time to 10 % parameter error", columns, rows)


def _error_cells(rms: StudyErrors) -> list[Cell]:
    return [number_cell(rms.train["overall"]), number_cell(rms.validation["overall"])]


def _gap_cell(gap: float | None) -> Cell:
    return number_cell(None if gap is None else abs(gap), 1)

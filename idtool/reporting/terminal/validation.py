"""The results of `idtool validate`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.figures import figure
from idtool.reporting.results.validation import RegressionReport, ValidationReport
from idtool.reporting.terminal.base import Terminal, new_table, units_of
from idtool.reporting.terminal.simulation import show_simulation
from idtool.reporting.terminal.tables import Words


def show_validation(terminal: Terminal, report: ValidationReport, folder: Path) -> None:
    """The result of a validation."""
    errors = {"model": report.rms.model, **({"prior": report.rms.prior} if report.rms.prior else {})}
    columns = [*errors, "raw", "of torque", "bound"]
    table = new_table(f"RMS torque error, {units_of(report.units)}, below {report.band_hz:g} Hz", "joint", *columns)
    for name in (*report.joints, "overall"):
        bound = report.bound.get(name)
        met = "" if bound is None else " ok" if report.ok[name] else " NOT MET"
        share = report.nrms.get(name)
        table.add_row(
            name,
            *(figure(errors[model][name]) for model in errors),
            figure(report.rms_raw.model[name]),
            "" if share is None else f"{share:.1%}",
            "" if bound is None else f"{bound:g}{met}",
        )
    terminal.show(table)
    show_simulation(terminal, report.simulation)
    terminal.notices(report.notices)
    terminal.say(f"written: {folder}/validation.json, validation.html")


def show_regression(terminal: Terminal, report: RegressionReport) -> None:
    """Every case against its bounds."""
    table = new_table(
        "Regression: RMS torque error in the band, N·m or N", (Words("case"), "joint"), "prior", "fit", ("bound", "")
    )
    for case in report.cases:
        met = "ok" if case.ok else "NOT MET"
        table.add_row(case.case, case.joint, figure(case.prior), figure(case.rms), figure(case.bound), met)
    terminal.show(table)

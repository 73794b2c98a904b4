"""The results of `idtool validate`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.validation import RegressionReport, ValidationReport
from idtool.reporting.sections.validation import (
    ModelErrorsByKindSection,
    ModelErrorsSection,
    RegressionCasesSection,
)
from idtool.reporting.terminal.output import Output
from idtool.reporting.terminal.simulation import show_simulation
from idtool.reporting.terminal.verdict import show_verdict


def show_validation(terminal: Output, report: ValidationReport, folder: Path | None = None) -> None:
    """The result of a validation."""
    show_verdict(terminal, report.verdict, report.verdict_reasons, report.next)
    terminal.sections([ModelErrorsSection(), ModelErrorsByKindSection()], report)
    show_simulation(terminal, report.simulation)
    terminal.notices(report.notices)
    if folder is not None:
        terminal.say(f"written: {folder}/validation.json, validation.html")


def show_regression(terminal: Output, report: RegressionReport) -> None:
    """Every case against its bounds."""
    terminal.sections([RegressionCasesSection()], report)

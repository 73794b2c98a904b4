"""The result of `idtool adapt`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.adapt import FinalBodiesSection, PredictionErrorsSection
from idtool.reporting.terminal.output import Output


def show_adaptation(terminal: Output, report: AdaptationReport, folder: Path | None = None) -> None:
    """The error of the prediction one sample ahead, and the bodies at the end."""
    terminal.sections([PredictionErrorsSection(), FinalBodiesSection()], report)
    terminal.notices(report.notices)
    updates = f"{report.samples} updates, one for each decimated row: {report.update_hz:.4g} Hz"
    terminal.say(f"{updates}, in {report.seconds:.1f} s")
    if folder is not None:
        terminal.say(f"written: {folder}/adapt.json, adapt.html")

"""The result of `idtool adapt`."""

from __future__ import annotations

from pathlib import Path

from idtool.common.number_text import short_number
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.adapt import FinalBodiesSection, PredictionErrorsSection
from idtool.reporting.terminal.output import Output


def show_adaptation(terminal: Output, report: AdaptationReport, folder: Path | None = None) -> None:
    """The error of the prediction one sample ahead, and the bodies at the end."""
    terminal.sections([PredictionErrorsSection(), FinalBodiesSection()], report)
    terminal.notices(report.notices)
    updates = f"{report.samples} updates, one per downsampled sample: {short_number(report.update_hz, 4)} Hz"
    terminal.say(f"{updates}, in {report.seconds:.1f} s")
    if folder is not None:
        terminal.say(f"written: {folder}/adapt.json, adapt.html")

"""The result of `idtool study`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.study import StudyReport
from idtool.reporting.sections.study import (
    ConstraintSetsSection,
    EstimatorsSection,
    LearningCurvesSection,
    OnlineSection,
)
from idtool.reporting.terminal.output import Output

SECTIONS = (ConstraintSetsSection(), EstimatorsSection(), LearningCurvesSection(), OnlineSection())


def show_study(terminal: Output, report: StudyReport, folder: Path | None = None) -> None:
    """Constraint sets, estimators, learning curves and Remark 5 in tables."""
    terminal.sections(SECTIONS, report)
    terminal.notices(report.notices)
    if folder is not None:
        terminal.say(f"written: {folder}/study.json, study.html ({report.seconds:.0f} s)")

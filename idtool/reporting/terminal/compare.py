"""The result of `idtool compare`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.comparison import Answer, ComparisonReport
from idtool.reporting.sections.compare import (
    FRICTION,
    OTHERS,
    ComparedBaseParametersSection,
    ComparedBodiesSection,
    ComparedErrorsSection,
    ComparedResultsSection,
    ComparedRolloutsSection,
    SettingsSection,
)
from idtool.reporting.terminal.output import STYLE, Output

_STYLES: dict[Answer, str] = {"agree": STYLE["good"], "differ": STYLE["warning"], "unknown": STYLE["warning"]}
_SECTIONS = (
    ComparedResultsSection(),
    ComparedBaseParametersSection(),
    ComparedErrorsSection(),
    ComparedRolloutsSection(),
    ComparedBodiesSection(),
    FRICTION,
    OTHERS,
    SettingsSection(),
)


def show_comparison(terminal: Output, report: ComparisonReport, folder: Path | None = None) -> None:
    """The answer, the two results side by side, and where the files are, if any were written."""
    terminal.say(f"{report.summary}\n", _STYLES[report.answer])
    terminal.sections(_SECTIONS, report)
    if not report.settings:
        terminal.say("settings, files and versions: the same\n")
    terminal.notices(report.notices)
    if folder is not None:
        terminal.say(f"written: {folder}/comparison.json, comparison.html")

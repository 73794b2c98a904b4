"""The result of `idtool excite`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.excitation import ExcitationReport
from idtool.reporting.sections.excite import CriteriaSection, ExpectedErrorsSection, LimitsSection
from idtool.reporting.terminal.base import Terminal


def show_excitation(terminal: Terminal, report: ExcitationReport) -> None:
    """The errors to expect, the limits, and where the files are."""
    terminal.sections([ExpectedErrorsSection(), LimitsSection(), CriteriaSection()], report)
    near = report.clearance
    if near and near.distance is not None:
        links = " and ".join(near.links)
        terminal.say(f"nearest links: {links}, {1000 * near.distance:.3g} mm after {near.t:.4g} s")
    terminal.notices(report.notices)
    if report.file is not None:
        terminal.say(f"written: {report.file} and {Path(report.file).with_suffix('.html').name}")

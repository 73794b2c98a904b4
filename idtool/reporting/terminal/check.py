"""The result of `idtool ellipsoids --check`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.ellipsoids import CheckReport
from idtool.reporting.sections.check import LinksSection
from idtool.reporting.terminal.output import STYLE, Output


def show_check(terminal: Output, report: CheckReport, repair: Path | None) -> None:
    """Print the links whose inertia no body can have, and the repaired file."""
    terminal.sections([LinksSection()], report)
    for name, link in report.links.items():
        for violation in link.violations:
            terminal.say(f"{name}: {violation}", STYLE["problem"])
    wrong = sum(bool(link.violations) for link in report.links.values())
    terminal.say(f"{wrong} of {len(report.links)} links have an inertia that is not physically realizable")
    if repair:
        terminal.say(f"written: {repair}")

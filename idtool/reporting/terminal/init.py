"""The result of `idtool init`."""

from __future__ import annotations

from idtool.reporting.results.setup import InitReport
from idtool.reporting.sections.setup import StartErrorsSection
from idtool.reporting.terminal.base import Terminal


def show_start(terminal: Terminal, report: InitReport) -> None:
    """What was tried and found, what is left to fill in, and the next command."""
    terminal.sections([StartErrorsSection()], report)
    terminal.notices(report.notices)
    for line in report.found:
        terminal.say(f"found: {line}")
    for left in report.left:
        terminal.say(f"to fill in: {left.key}: {left.what}", "yellow" if left.needed else None)
    terminal.say(f"written: {report.file}")
    then = f"next, after filling in {' and '.join(report.needed)}" if report.needed else "next"
    terminal.say(f"{then}: {report.next}")

"""The result of `idtool init`."""

from __future__ import annotations

from idtool.reporting.results.setup import InitReport
from idtool.reporting.sections.setup import StartErrorsSection
from idtool.reporting.terminal.output import Output
from idtool.robot.config.schema import SCHEMA_FILE


def show_initial_config(terminal: Output, report: InitReport, is_written: bool = True) -> None:
    """Print the errors, the findings, the keys to fill in, and the next command."""
    terminal.sections([StartErrorsSection()], report)
    terminal.notices(report.notices)
    for line in report.found:
        terminal.say(f"found: {line}")
    for item in report.left:
        terminal.say(f"to fill in: {item.key}: {item.what}", "yellow" if item.needed else None)
    if is_written:
        terminal.say(f"written: {report.file}, {SCHEMA_FILE}")
    then = f"next, after filling in {' and '.join(report.needed)}" if report.needed else "next"
    terminal.say(f"{then}: {report.next}")

"""The result of `idtool sample`."""

from __future__ import annotations

from idtool.reporting.results.sample import SampleReport
from idtool.reporting.terminal.output import Output


def show_sample(terminal: Output, report: SampleReport) -> None:
    """Print the files and a first command for them."""
    for file in report.files:
        terminal.say(f"{'written' if file in report.written else 'already there'}: {file}")
    terminal.say(f"next: {report.next}")

"""The result of `idtool init`."""

from __future__ import annotations

from idtool.reporting.figures import figure
from idtool.reporting.results.setup import InitReport
from idtool.reporting.terminal.base import Terminal, new_table


def show_start(terminal: Terminal, report: InitReport) -> None:
    """What was tried and found, what is left to fill in, and the next command."""
    if report.rms:
        columns = ("joint", "friction alone", "as found")
        table = new_table(f"Held-out RMS torque error, N·m or N, below {report.band_hz:g} Hz", *columns)
        before, after = report.rms.friction, report.rms.found
        for name in before:
            table.add_row(name, figure(before[name]), figure(after.get(name)))
        terminal.show(table)
    terminal.notices(report.notices)
    for line in report.found:
        terminal.say(f"found: {line}")
    for left in report.left:
        terminal.say(f"to fill in: {left.key}: {left.what}", "yellow" if left.needed else None)
    terminal.say(f"written: {report.file}")
    then = f"next, once {' and '.join(report.needed)} is filled in" if report.needed else "next"
    terminal.say(f"{then}: {report.next}")

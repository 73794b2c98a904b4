"""The result of `idtool reduce`."""

from __future__ import annotations

from idtool.reporting.results.reduction import ReductionReport
from idtool.reporting.terminal.base import Terminal


def show_reduction(terminal: Terminal, report: ReductionReport) -> None:
    """Print what was reduced, and the file.

    Parameters
    ----------
    terminal
        Terminal that is written to.
    report
        The result.
    """
    for log in report.logs:
        terminal.say(f"reduced: {log.path}, {log.train} samples for fitting and {log.validation} for validation")
    terminal.notices(report.notices)
    terminal.say(f"written: {report.file} ({report.bytes / 2**20:.1f} MiB)")

"""The result of `idtool reduce`."""

from __future__ import annotations

from idtool.reporting.results.reduction import ReductionReport
from idtool.reporting.terminal.output import Output


def show_reduction(terminal: Output, report: ReductionReport) -> None:
    """Print what was reduced, and the file.

    Parameters
    ----------
    terminal
        The terminal, or a notebook.
    report
        The result.
    """
    for log in report.logs:
        terminal.say(f"reduced: {log.path}, {log.train} samples for fitting and {log.validation} for validation")
    terminal.notices(report.notices)
    terminal.say(f"written: {report.file} ({report.bytes / 2**20:.1f} MiB)")

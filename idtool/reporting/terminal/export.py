"""The result of `idtool export`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.results.export import ExportedPart, ExportReport
from idtool.reporting.terminal.output import Output


def show_export(terminal: Output, report: ExportReport, left: Path | None = None) -> None:
    """Print the parts in the file, one line for each kind, and those that are missing, alike ones on one line.

    Of a patched file every change has a line of its own.

    Parameters
    ----------
    terminal
        The terminal, or a notebook.
    report
        The result.
    left
        File that was left as it was, since a copy without a change would have replaced it; None: there is none.
    """
    if report.patched is not None:
        for part in report.carried:
            terminal.say(f"changed: {part.what} of {part.of}: {part.detail}")
        if not report.carried:
            terminal.say("nothing to change in the file")
    for what in dict.fromkeys(part.what for part in report.carried if report.patched is None):
        names = dict.fromkeys(part.of for part in report.carried if part.what == what)
        terminal.say(f"exported: {what} of {', '.join(names)}")
    groups: dict[tuple[str, str], list[ExportedPart]] = {}
    for part in report.not_carried:
        groups.setdefault((part.what, part.detail), []).append(part)
    for (what, detail), parts in groups.items():
        sizes = [(abs(part.value), part.unit) for part in parts if part.value is not None]
        bound = "up to " if len(sizes) > 1 else ""
        size = ", {}{:.3g} {}".format(bound, *max(sizes)) if sizes and report.patched is None else ""
        terminal.say(f"not exported: {what} of {', '.join(part.of for part in parts)}: {detail}{size}", "yellow")
    if left is not None:
        terminal.say(f"not written: {left} is left as it was")
    elif report.file is not None:
        terminal.say(f"written: {report.file}")
    terminal.notices(report.notices)

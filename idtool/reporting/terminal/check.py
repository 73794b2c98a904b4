"""The result of `idtool ellipsoids --check`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.figures import figure
from idtool.reporting.results.ellipsoids import CheckReport
from idtool.reporting.terminal.base import STYLE, Terminal, new_table


def show_check(terminal: Terminal, report: CheckReport, repair: Path | None) -> None:
    """Which links' inertias no body can have, and what was written for them."""
    table = new_table("Links", "link", "mass kg", "can exist", *([("repaired kg", "moved")] if repair else []))
    for name, link in report.links.items():
        nearest = link.nearest
        moved = [figure(nearest.mass), f"{nearest.moved:.2%}"] if nearest else ["", ""]
        table.add_row(name, figure(link.mass), "NO" if link.violations else "yes", *(moved if repair else []))
    terminal.show(table)
    for name, link in report.links.items():
        for violation in link.violations:
            terminal.say(f"{name}: {violation}", STYLE["problem"])
    wrong = sum(bool(link.violations) for link in report.links.values())
    terminal.say(f"{wrong} of {len(report.links)} links have an inertia that no body can have")
    if repair:
        terminal.say(f"written: {repair}")

"""What all commands print with: lines, tables, JSON, and a progress bar on what takes more than two seconds."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

_PLAIN_WIDTH = 200  # characters
_PATIENCE = 2.0  # s before a progress bar appears
STYLE = {"problem": "bold red", "warning": "yellow", "note": "dim"}


class Terminal:
    """Where a command prints to.

    Parameters
    ----------
    quiet
        Print nothing but errors and what `json` asks for.
    as_json
        Print the result as JSON on standard output, everything else on standard error.
    """

    def __init__(self, quiet: bool, as_json: bool) -> None:
        self.as_json = as_json
        self.console = _console(quiet, sys.stderr if as_json else sys.stdout)
        self.errors = _console(quiet, sys.stderr)

    def say(self, text: str, style: str | None = None) -> None:
        """One line of plain text."""
        self.console.print(escape(text), style=style, soft_wrap=True)

    def show(self, table: Table) -> None:
        """A table under its title, which may be wider than the table."""
        self.say(str(table.title), "bold")
        table.title = None
        self.console.print(table)
        self.console.print()

    def warn(self, warnings: Sequence[str]) -> None:
        """What a user should know, at the end."""
        for warning in warnings:
            self.say(f"note: {warning}", "yellow")

    def result(self, result: Mapping[str, Any]) -> None:
        """The result as JSON, if it was asked for."""
        if self.as_json:
            sys.stdout.write(json.dumps(result, indent=2, allow_nan=False) + "\n")

    @contextmanager
    def progress(self) -> Iterator[Callable[[str, float], None]]:
        """A function to be told the stage and its share done; shows a bar once two seconds have gone by."""
        bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(), console=self.errors, transient=True
        )
        started = time.monotonic()
        tasks: list[TaskID] = []

        def tell(stage: str, share: float) -> None:
            if not self.errors.is_terminal or time.monotonic() - started < _PATIENCE:
                return
            if not tasks:
                bar.start()
                tasks.append(bar.add_task(stage, total=1.0))
            bar.update(tasks[0], description=escape(stage), completed=share)

        try:
            yield tell
        finally:
            if tasks:
                bar.stop()


def _console(quiet: bool, file: TextIO) -> Console:
    """A console; one that is no terminal has lines as long as they need."""
    return Console(quiet=quiet, file=file, highlight=False, width=None if file.isatty() else _PLAIN_WIDTH)


def new_table(title: str, *columns: str) -> Table:
    """A table whose first column is text and whose others are figures."""
    table = Table(title=title, box=None, pad_edge=False, header_style="dim")
    table.add_column(columns[0])
    for column in columns[1:]:
        table.add_column(column, justify="right")
    return table


def units_of(report: dict[str, Any]) -> str:
    """The units of a report's torques."""
    return " or ".join(dict.fromkeys(report["units"].values()))


def figure(x: float | None) -> str:
    """A figure to four digits; a dash for none."""
    return "-" if x is None else f"{x:.4g}"

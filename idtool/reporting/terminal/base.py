"""`Terminal`: prints lines, tables, notices, JSON and progress of all commands."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TextIO

from rich.console import Console
from rich.text import Text
from typing_extensions import override

from idtool.common.interrupt import restore_keyboard_interrupt
from idtool.common.memory import resume_garbage_collection
from idtool.reporting.sections.base import Table
from idtool.reporting.terminal.layout import table_lines
from idtool.reporting.terminal.output import STYLE, Output, without_control_characters
from idtool.reporting.terminal.progress import progress_bar

_UNLIMITED_WIDTH = 100_000  # characters: what is read by a program has lines as long as they need
__all__ = ["STYLE", "Terminal"]


class Terminal(Output):
    """Output of a command.

    Parameters
    ----------
    quiet
        Print nothing but errors and what `json` asks for.
    as_json
        Print the result as JSON on standard output, everything else on standard error.
    """

    def __init__(self, quiet: bool, as_json: bool) -> None:
        resume_garbage_collection()  # heavy modules are loaded
        self.as_json = as_json
        self.console = _console(quiet, sys.stderr if as_json else sys.stdout)
        self.errors = _console(quiet, sys.stderr)

    @override
    def say(self, text: str, style: str | None = None) -> None:
        """Print plain text, usually one line, which the terminal may wrap."""
        lines = (without_control_characters(line) for line in text.split("\n"))
        self.console.print(Text("\n".join(lines)), style=style, soft_wrap=True)

    @override
    def show(self, table: Table) -> None:
        """Print a table under its title, which may be wider than the table."""
        self.say(table.title, "bold")
        for line in table_lines(table.in_terminal(), self.console.width):
            self.console.print(line, soft_wrap=True)
        self.say("")

    def result(self, result: Mapping[str, Any]) -> None:
        """Print the result as JSON if it was asked for."""
        if self.as_json:
            sys.stdout.write(json.dumps(result, indent=2, allow_nan=False) + "\n")

    @contextmanager
    def progress(self) -> Iterator[Callable[[str, float], None]]:
        """A callback for the stage and its share done; shows a bar once that takes long."""
        restore_keyboard_interrupt()  # heavy modules are loaded
        with progress_bar(self.errors) as update:
            yield update


def _console(quiet: bool, file: TextIO) -> Console:
    """A console that prints characters missing in its encoding as question marks."""
    if isinstance(file, io.TextIOWrapper):
        file.reconfigure(errors="replace")
    return Console(quiet=quiet, file=file, highlight=False, width=None if file.isatty() else _UNLIMITED_WIDTH)

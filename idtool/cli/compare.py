"""`idtool compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import JsonOption, QuietOption, command_line, finish, output_folder

_HELP = "Result of idtool fit: the folder that it wrote, or its report.json."


@app.command("compare", epilog="Example: idtool compare leg_idtool other_leg_idtool")
def compare_command(
    a: Annotated[Path, typer.Argument(metavar="A", help=_HELP, show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", help=_HELP, show_default=False)],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder to write to; default: comparison_idtool/.")
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare two results of a fit: two runs, two robots of a type, or two versions."""
    from idtool.api.compare import compare
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.compare import show_comparison

    terminal = Terminal(quiet, as_json)
    folder = output_folder(Path("comparison"), out)
    with terminal.progress() as progress:
        progress("reading", 0.0)
        result = compare(a, b)
        result.save(folder, command_line())
    show_comparison(terminal, result, folder)
    finish(terminal, result, {})

"""`idtool inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import LOG_FORMATS, JsonOption, QuietOption, finish, log_path_or_url


@app.command("inspect", epilog="Example: idtool inspect run1.mcap")
def inspect_command(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG", help=f"A log ({LOG_FORMATS}), or its URL.", show_default=False, parser=log_path_or_url
        ),
    ],
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Configuration that describes the log format and the sensors."),
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf",
            help="URDF against which the configured sensors are checked; default: the URDF of the same name beside the "
            "configuration.",
            show_default=False,
        ),
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show the contents of a log, its faults, and their effect on the fit."""
    from idtool.api.inspect import inspect
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.inspection import show_inspection

    terminal = Terminal(quiet, as_json)
    with terminal.progress() as progress:
        progress("inspecting", 0.0)
        result = inspect(log, config=config, urdf=urdf)
    show_inspection(terminal, result)
    finish(terminal, result, {})

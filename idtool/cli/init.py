"""`idtool init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import JsonOption, LogsArgument, QuietOption, UrdfArgument, finish, output_file


@app.command("init", epilog="Example: idtool init leg.urdf run1.mcap run2.mcap")
def init_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            help="Configuration with known keys, such as controller gains, which are copied unchanged.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder, or YAML file to write; default: <urdf stem>.yaml beside the URDF."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a commented configuration from URDF and logs, with templates for what has to be filled in."""
    from idtool.api.init import check_configuration, default_configuration, init
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.init import show_initial_config

    terminal = Terminal(quiet, as_json)
    default = default_configuration(urdf)
    file = output_file(out, default.name) if out else default
    check_configuration(file, [urdf, *logs], force)
    with terminal.progress() as progress:
        progress("reading", 0.0)
        result = init(urdf, logs, config=config, file=file, progress=progress)
        result.save(force=force)
    show_initial_config(terminal, result)
    finish(terminal, result, {})

"""`idtool adapt`."""

from __future__ import annotations

from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    ConfigOption,
    JsonOption,
    LogsArgument,
    OutOption,
    QuietOption,
    UrdfArgument,
    command_line,
    finish,
    output_folder,
)


@app.command("adapt", epilog="Example: idtool adapt leg.urdf run1.mcap --forgetting 10")
def adapt_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    forgetting: Annotated[float, typer.Option(help="Time constant of forgetting, s; inf: no forgetting.")] = 20.0,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Identify the model online, with one update per downsampled sample, and write the parameters over time."""
    from idtool.api.adapt import adapt
    from idtool.api.model import Model
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.adapt import show_adaptation

    terminal = Terminal(quiet, as_json)
    folder = output_folder(urdf, out)
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        result = adapt(model, logs, forgetting=forgetting, progress=progress)
        result.save(folder, command_line())
    show_adaptation(terminal, result, folder)
    finish(terminal, result, {})

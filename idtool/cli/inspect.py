"""`idtool inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import FIRST_STEPS, app
from idtool.cli.options import LOG_FORMATS, JsonOption, QuietOption, finish


@app.command("inspect", rich_help_panel=FIRST_STEPS, epilog="Example: idtool inspect run1.mcap")
def inspect_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help=f"A log ({LOG_FORMATS}).", show_default=False)],
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Configuration; only its sections on logs, base, contacts and sensors are used."),
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show the contents of a log, its faults, and their effect on the fit."""
    from idtool.api.inspect import inspect
    from idtool.api.log import Log
    from idtool.data.base_sensors import sensor_options
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.inspection import show_inspection
    from idtool.robot.config import Config, read_config

    terminal = Terminal(quiet, as_json)
    settings = read_config(config) if config else Config()
    options = settings.log
    with terminal.progress() as progress:
        progress("reading", 0.0)
        record = Log(
            log,
            topic=options.topic,
            columns=options.columns,
            scale=dict(options.scale),
            sensors=sensor_options(settings) is not None,
            imu_topic=settings.base.imu.topic,
            preset=options.preset,
            fields=options.fields,
            field_joints=options.field_joints,
        )
        progress("inspecting", 0.0)
        result = inspect(record)
    show_inspection(terminal, result)
    finish(terminal, result, {})

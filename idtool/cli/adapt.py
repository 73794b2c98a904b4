"""`idtool adapt`."""

from __future__ import annotations

from pathlib import Path
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
    command,
    config_of,
    finish,
)


@app.command("adapt", epilog="Example: idtool adapt leg.urdf run1.mcap --forgetting 10")
def adapt_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    forgetting: Annotated[
        float, typer.Option(help="Time constant with which samples lose their weight, s; inf: never.")
    ] = 20.0,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Identify online, sample by sample and within the constraints, and write the parameters over time."""
    from idtool.adapt import adapt, adapt_report
    from idtool.description import robot_and_logs
    from idtool.experiment import prepare
    from idtool.identified import choose_sets
    from idtool.outputs import as_json as dump
    from idtool.outputs import write_all
    from idtool.pages import adapt_page
    from idtool.report import HEADER
    from idtool.terminal import Terminal
    from idtool.terminal.adapt import show_adaptation

    terminal = Terminal(quiet, as_json)
    folder = out or Path(f"{urdf.stem}_idtool")
    with terminal.progress() as progress:
        progress("reading", 0.0)
        robot, logs = robot_and_logs(urdf, logs)
        experiment = prepare(robot, config_of(urdf, config), logs, holdout=0.0)
        sets, remarks = choose_sets(experiment.model.bodies, experiment.config.constraints)
        result = adapt(experiment, sets, forgetting, progress=progress)
        report = {
            **HEADER,
            **adapt_report(result, experiment),
            "warnings": [*experiment.warnings, *remarks],
        }
        write_all(folder, {"adapt.json": dump(report), "adapt.html": adapt_page(report, command())})
    show_adaptation(terminal, report, folder)
    finish(terminal, report, {})

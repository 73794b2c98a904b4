"""`idtool adapt`."""

from __future__ import annotations

from typing import Annotated

import typer

from idtool.cli.app import QUESTIONS, app
from idtool.cli.options import (
    ConfigOption,
    JsonOption,
    LogsArgument,
    OutOption,
    QuietOption,
    UrdfArgument,
    command,
    finish,
    folder_for,
)


@app.command("adapt", rich_help_panel=QUESTIONS, epilog="Example: idtool adapt leg.urdf run1.mcap --forgetting 10")
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
    """Identify online, one update for each decimated row, within the constraints; write the parameters over time."""
    from idtool.api.data import experiment_of
    from idtool.api.model import Model
    from idtool.common.outputs import as_json as dump
    from idtool.common.outputs import write_all
    from idtool.estimation.command_delay import with_delay
    from idtool.estimation.identification import choose_sets
    from idtool.estimation.online.adapt import adapt, adapt_report
    from idtool.reporting.pages import adapt_page
    from idtool.reporting.report import HEADER
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.adapt import show_adaptation

    terminal = Terminal(quiet, as_json)
    folder = folder_for(urdf, out)
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        experiment = experiment_of(model, logs, holdout=0.0, progress=progress)
        experiment, delay, _ = with_delay(experiment, progress)
        sets, remarks = choose_sets(experiment.model.bodies, experiment.config.constraints)
        result = adapt(experiment, sets, forgetting, progress=progress)
        report = {
            **HEADER,
            **adapt_report(result, experiment),
            "warnings": [*experiment.warnings, *(delay.warnings if delay else ()), *remarks],
        }
        write_all(folder, {"adapt.json": dump(report), "adapt.html": adapt_page(report, command())})
    show_adaptation(terminal, report, folder)
    finish(terminal, report, {})

"""`idtool study`."""

from __future__ import annotations

from typing import Annotated

import typer

from idtool.cli.app import FURTHER_ANALYSIS, app
from idtool.cli.options import (
    ConfigOption,
    HoldoutOption,
    JobsOption,
    JsonOption,
    LogsArgument,
    OutOption,
    QuietOption,
    UrdfArgument,
    ValidateOption,
    command_line,
    finish,
    output_folder,
)


@app.command(
    "study", rich_help_panel=FURTHER_ANALYSIS, epilog="Example: idtool study leg.urdf run1.mcap --validate run2.mcap"
)
def study_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: HoldoutOption = 0.3,
    validate: ValidateOption = None,
    draws: Annotated[int, typer.Option(min=5, help="Random draws for each number of samples.")] = 40,
    jobs: JobsOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare all constraint sets, priors and estimators on the same data, and for different numbers of samples."""
    from idtool.api.model import Model
    from idtool.api.study import study
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.study import show_study

    terminal = Terminal(quiet, as_json)
    folder = output_folder(urdf, out)
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        result = study(model, logs, validate=validate or (), holdout=holdout, draws=draws, progress=progress)
        result.save(folder, command_line())
    show_study(terminal, result, folder)
    finish(terminal, result, {})

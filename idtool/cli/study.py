"""`idtool study`."""

from __future__ import annotations

from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    REDUCTIONS,
    ClusterOption,
    ConfigOption,
    HoldoutOption,
    JobsOption,
    JsonOption,
    LogsArgument,
    OutOption,
    QuietOption,
    SkipBadOption,
    UrdfArgument,
    ValidateOption,
    command_line,
    distribution_of,
    finish,
    output_folder,
)


@app.command("study", epilog="Example: idtool study leg.urdf run1.mcap --validate run2.mcap")
def study_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: HoldoutOption = 0.3,
    validate: ValidateOption = None,
    draws: Annotated[int, typer.Option(min=5, help="Random draws for each number of samples.")] = 40,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    skip_bad: SkipBadOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare all constraint sets, priors and estimators on the same data, and for different numbers of samples."""
    from idtool.api.data import load_experiment
    from idtool.api.model import Model
    from idtool.api.study import study_experiment
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.study import show_study

    terminal = Terminal(quiet, as_json)
    folder = output_folder(urdf, out)
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        with distribution_of(cluster, folder / REDUCTIONS, terminal, progress) as distribution:
            experiment = load_experiment(
                model,
                logs,
                validate or (),
                holdout,
                progress,
                takes_reductions=True,
                distribution=distribution,
                skip_bad=skip_bad,
            )
        result = study_experiment(experiment, command_line(), progress, draws)
        result.save(folder)
    show_study(terminal, result, folder)
    finish(terminal, result, {})

"""`idtool validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from idtool.cli.app import MODEL, app
from idtool.cli.options import (
    JsonOption,
    MaxRmsOption,
    NoSimulationOption,
    OutOption,
    QuietOption,
    RerunOption,
    bounds_of,
    command,
    finish,
    folder_for,
    named,
)
from idtool.common.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.reporting.terminal import Terminal


@app.command(
    "validate",
    rich_help_panel=MODEL,
    epilog="Example: idtool validate leg_idtool/identified.urdf run3.mcap --prior leg.urdf",
)
def validate_command(
    urdf: Annotated[
        Path | None, typer.Argument(metavar="URDF", help="The model's URDF.", show_default=False, callback=named)
    ] = None,
    logs: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG", help="Logs: MCAP, CSV or rosbag2 folders.", show_default=False)
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Configuration; default: <urdf stem>.yaml or model.yaml beside the URDF."),
    ] = None,
    prior: Annotated[Path | None, typer.Option(help="Another URDF for comparison.")] = None,
    out: OutOption = None,
    max_rms: MaxRmsOption = None,
    no_simulation: NoSimulationOption = False,
    rerun: RerunOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compute the torque and motion errors of a model on logs; without arguments, run the regression."""
    from idtool.api.data import experiment_of
    from idtool.api.model import Model
    from idtool.api.validate import prior_model, validate_experiment
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.validation import show_validation

    terminal = Terminal(quiet, as_json)
    if urdf is None:
        _regression(terminal, any((config, prior, out, max_rms, no_simulation, rerun)))
        return
    folder = folder_for(urdf, out)
    with terminal.progress() as progress:
        model, every = Model.with_logs(urdf, logs or (), config)
        experiment = experiment_of(model, (), every, progress=progress)
        bounds = bounds_of(max_rms or [], experiment)
        other = None if prior is None else prior_model(prior)
        result = validate_experiment(experiment, other, bounds, command(), progress, not no_simulation)
        result.save(folder)
        if rerun:
            result.rerun(rerun)
    show_validation(terminal, result, folder)
    finish(terminal, result, dict(result.ok))


def _regression(terminal: Terminal, options: bool) -> None:
    """`idtool validate` without arguments."""
    if options:
        what = "is missing; the regression test, which runs without a URDF, does not accept these options"
        raise ConfigError("urdf", what)
    from idtool.api.regression import regression
    from idtool.reporting.terminal.validation import show_regression

    with terminal.progress() as progress:
        report = regression(progress)
    show_regression(terminal, report)
    finish(terminal, report, {f"{case.case} {case.joint}": case.ok for case in report.cases})

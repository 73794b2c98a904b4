"""`idtool validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    LOG_FORMATS,
    REDUCTIONS,
    ClusterOption,
    JobsOption,
    JsonOption,
    MaxRmsOption,
    NoSimulationOption,
    OutOption,
    QuietOption,
    RerunOption,
    SkipBadOption,
    StrictOption,
    command_line,
    distribution_of,
    finish,
    finish_model,
    log_path_or_url,
    output_folder,
    parse_bounds,
    resolve_unnamed,
)
from idtool.common.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.reporting.terminal import Terminal


@app.command(
    "validate",
    epilog="Example: idtool validate leg_idtool/identified.urdf run3.mcap --prior leg.urdf",
)
def validate_command(
    urdf: Annotated[
        Path | None,
        typer.Argument(metavar="URDF", help="The model's URDF.", show_default=False, callback=resolve_unnamed),
    ] = None,
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG", help=f"Logs ({LOG_FORMATS}), or their URLs.", show_default=False, parser=log_path_or_url
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            help="Configuration; default: <urdf stem>.yaml or model.yaml beside the URDF.",
        ),
    ] = None,
    prior: Annotated[Path | None, typer.Option(help="Another URDF for comparison.")] = None,
    out: OutOption = None,
    max_rms: MaxRmsOption = None,
    strict: StrictOption = False,
    no_simulation: NoSimulationOption = False,
    rerun: RerunOption = None,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    skip_bad: SkipBadOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compute the torque and motion errors of a model on logs; without arguments, run the regression test."""
    from idtool.api.data import load_experiment
    from idtool.api.model import Model
    from idtool.api.validate import prior_model, validate_experiment
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.validation import show_validation

    terminal = Terminal(quiet, as_json)
    if urdf is None:
        has_options = any((config, prior, out, max_rms, strict, no_simulation, rerun, cluster, skip_bad))
        _run_regression(terminal, has_options)
        return
    folder = output_folder(urdf, out)
    with terminal.progress() as progress:
        model, all_logs = Model.with_logs(urdf, logs or (), config)
        with distribution_of(cluster, folder / REDUCTIONS, terminal, progress) as distribution:
            experiment = load_experiment(
                model,
                (),
                all_logs,
                progress=progress,
                takes_reductions=True,
                distribution=distribution,
                skip_bad=skip_bad,
            )
        bounds = parse_bounds(max_rms or [], experiment)
        compared_model = None if prior is None else prior_model(prior)
        result = validate_experiment(experiment, compared_model, bounds, command_line(), progress, not no_simulation)
        result.save(folder)
        if rerun:
            result.rerun(rerun)
    show_validation(terminal, result, folder)
    finish_model(terminal, result, dict(result.ok), strict)


def _run_regression(terminal: Terminal, has_options: bool) -> None:
    """Run `idtool validate` without arguments."""
    if has_options:
        what = "is missing; the regression test, which runs without a URDF, does not accept these options"
        raise ConfigError("urdf", what)
    from idtool.api.regression import regression
    from idtool.reporting.terminal.validation import show_regression

    with terminal.progress() as progress:
        report = regression(progress)
    show_regression(terminal, report)
    finish(terminal, report, {f"{case.case} {case.joint}": case.ok for case in report.cases})

"""`idtool validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    JsonOption,
    MaxRmsOption,
    NoSimulationOption,
    OutOption,
    QuietOption,
    bounds_of,
    command,
    config_of,
    finish,
)
from idtool.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.terminal import Terminal


@app.command("validate", epilog="Example: idtool validate leg_idtool/identified.urdf run3.mcap --prior leg.urdf")
def validate_command(
    urdf: Annotated[Path | None, typer.Argument(help="The model's URDF.", show_default=False)] = None,
    logs: Annotated[list[Path] | None, typer.Argument(help="Logs: MCAP or CSV.", show_default=False)] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Configuration; default: <urdf stem>.yaml or model.yaml beside the URDF."),
    ] = None,
    prior: Annotated[Path | None, typer.Option(help="A URDF to compare with.")] = None,
    out: OutOption = None,
    max_rms: MaxRmsOption = None,
    no_simulation: NoSimulationOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Tell how well a model predicts the torque and the motion of logs; without arguments, run the regression."""
    from idtool.terminal import Terminal

    terminal = Terminal(quiet, as_json)
    if urdf is None:
        if config or prior or out or max_rms or no_simulation:
            raise ConfigError("urdf", "is missing; the regression, which runs without one, takes no such options")
        _regression(terminal)
        return
    from idtool.experiment import coefficients_of, prepare
    from idtool.outputs import as_json as dump
    from idtool.outputs import write_all
    from idtool.pages import validation_page
    from idtool.replay import replay
    from idtool.report import validation_report
    from idtool.robot import read_robot
    from idtool.simulation_report import simulation_notes, simulation_report
    from idtool.terminal.validation import show_validation
    from idtool.validate import evaluate

    settings, folder = config_of(urdf, config), out or Path(f"{urdf.stem}_idtool")
    with terminal.progress() as progress:
        progress("reading", 0.0)
        experiment = prepare(read_robot(urdf), settings, [], logs or [])
        bounds = bounds_of(max_rms or [], experiment)
        models = {"model": experiment.equation.prior}
        if prior is not None:
            own = config_of(prior, None) if prior.with_suffix(".yaml").is_file() else settings.without_friction_values()
            models["prior"] = coefficients_of(read_robot(prior), own, experiment)
        evaluation = evaluate(experiment, models, held_out=True, progress=progress)
        rollouts = None if no_simulation else replay(experiment, models, held_out=True, progress=progress)
        simulation = simulation_report(rollouts, "model", experiment)
        report = validation_report(evaluation, experiment.model.units, experiment.band_hz, bounds, simulation)
        report["warnings"] = [*experiment.warnings, *simulation_notes(rollouts, "model")]
        page = validation_page(evaluation, report, command(), rollouts)
        write_all(folder, {"validation.json": dump(report), "validation.html": page})
    show_validation(terminal, report, folder)
    finish(terminal, report, report["ok"])


def _regression(terminal: Terminal) -> None:
    """`idtool validate` without arguments."""
    from idtool.regression import read_manifest, run_case
    from idtool.report import HEADER
    from idtool.terminal.validation import show_regression

    here, home = Path("sample_logs"), Path(__file__).parents[2] / "sample_logs"
    folder = here if (here / "manifest.yaml").exists() else home
    outcomes = []
    with terminal.progress() as progress:
        for case in read_manifest(folder / "manifest.yaml"):
            outcomes += run_case(case, folder, progress)
    show_regression(terminal, outcomes)
    cases = [
        {"case": o.case, "joint": o.joint, "rms": o.rms, "bound": o.bound, "prior": o.prior, "ok": o.ok}
        for o in outcomes
    ]
    finish(terminal, {**HEADER, "cases": cases}, {f"{o.case} {o.joint}": o.ok for o in outcomes})

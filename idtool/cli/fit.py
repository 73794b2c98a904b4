"""`idtool fit`."""

from __future__ import annotations

from pathlib import Path

from idtool.cli.app import app
from idtool.cli.options import (
    ConfigOption,
    HoldoutOption,
    JsonOption,
    LogsArgument,
    MaxRmsOption,
    MethodOption,
    NoSimulationOption,
    OutOption,
    QuickOption,
    QuietOption,
    UrdfArgument,
    ValidateOption,
    bounds_of,
    command,
    config_of,
    finish,
)


@app.command("fit", epilog="Example: idtool fit leg.urdf run1.mcap run2.mcap --validate run3.mcap")
def fit_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: HoldoutOption = 0.3,
    validate: ValidateOption = None,
    max_rms: MaxRmsOption = None,
    no_simulation: NoSimulationOption = False,
    method: MethodOption = "ls",
    quick: QuickOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Identify inertias, friction and rotors; write identified.urdf, model.yaml, report.json and report.html."""
    from idtool.experiment import prepare
    from idtool.fit import fit
    from idtool.outputs import as_json as dump
    from idtool.outputs import as_yaml, write_all
    from idtool.pages import fit_page
    from idtool.report import fit_report, joint_dynamics, model_config
    from idtool.robot import read_robot
    from idtool.terminal import Terminal
    from idtool.terminal.fit import show_fit
    from idtool.urdf import identified_urdf

    terminal = Terminal(quiet, as_json)
    folder = out or Path(f"{urdf.stem}_idtool")
    with terminal.progress() as progress:
        progress("reading", 0.0)
        experiment = prepare(read_robot(urdf), config_of(urdf, config), logs, validate or (), holdout)
        bounds = bounds_of(max_rms or [], experiment)
        result = fit(experiment, progress, not (no_simulation or quick), not quick, method)
        progress("writing", 0.0)
        report = fit_report(result)
        bodies = {body.name: (body, result.parameters(i)) for i, body in enumerate(experiment.model.bodies)}
        header = f"Identified by idtool from {urdf.name}; with identified.urdf it is the identified model."
        write_all(
            folder,
            {
                "identified.urdf": identified_urdf(experiment.model.robot, bodies, joint_dynamics(result)),
                "model.yaml": as_yaml(model_config(result), header),
                "report.json": dump(report),
                "report.html": fit_page(result, report, command()),
            },
        )
    show_fit(terminal, report, folder)
    rms = report["rms"]["validation"] or report["rms"]["train"]
    finish(terminal, report, {name: rms[name] <= bound for name, bound in bounds.items()})

"""`idtool simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    LOG_FORMATS,
    LOG_TO_WRITE,
    ConfigOption,
    JsonOption,
    QuietOption,
    RerunOption,
    UrdfArgument,
    finish,
    output_file,
    output_folder,
    require_log,
)

LogArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="LOG",
        help=f"A log or, with --track, a trajectory ({LOG_FORMATS}). A bag with /robot_description needs no URDF.",
        show_default=False,
        callback=require_log,
    ),
]
LogOutOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", help=f"{LOG_TO_WRITE}; default: <urdf stem>_idtool/simulated.mcap."),
]
WindowOption = Annotated[
    float | None,
    typer.Option(
        help="Time between restarts from the measured state, s; 0: no restarts. Default: the configuration's "
        "simulation.window under the logged torque, no restarts under the controller."
    ),
]
ClosedLoopOption = Annotated[
    bool,
    typer.Option(
        "--closed-loop",
        help="Drive the joints with the configuration's controller and the logged command, not with the logged torque.",
    ),
]
TrackOption = Annotated[
    bool,
    typer.Option(
        "--track",
        help="Let the controller track the log's qcmd and vcmd (or q and v) from their first state.",
    ),
]


@app.command("simulate", epilog="Example: idtool simulate leg_idtool/identified.urdf run3.mcap")
def simulate_command(
    urdf: UrdfArgument,
    log: LogArgument = None,
    config: ConfigOption = None,
    out: LogOutOption = None,
    window: WindowOption = None,
    closed_loop: ClosedLoopOption = False,
    track: TrackOption = False,
    rerun: RerunOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Simulate a model under a log's torque or under its controller, and write the motion as a log."""
    from idtool.api.model import Model
    from idtool.api.simulate import LOG_NAME, simulate
    from idtool.data.logs import check_log_file
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.simulation import show_simulated_log

    terminal = Terminal(quiet, as_json)
    file = output_file(out, LOG_NAME) if out else output_folder(urdf, None) / LOG_NAME
    check_log_file(file, [path for path in (urdf, log, config) if path])
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, [log] if log else [], config)
        result = simulate(model, logs[-1], window=window, closed_loop=closed_loop, track=track, progress=progress)
        progress("writing", 0.0)
        result.save(file)
        if rerun:
            result.rerun(rerun)
    report = result.report.model_copy(update={"file": str(file)})
    show_simulated_log(terminal, report, track)
    finish(terminal, report, {})

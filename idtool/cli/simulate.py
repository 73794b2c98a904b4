"""`idtool simulate`."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from idtool.cli.app import app
from idtool.cli.options import ConfigOption, JsonOption, QuietOption, UrdfArgument, config_of, finish
from idtool.exceptions import ConfigError, LogError

if TYPE_CHECKING:
    from idtool.config import Config
    from idtool.experiment import Experiment
    from idtool.simulated_log import SimulatedLog
    from idtool.terminal import Terminal


@app.command("simulate", epilog="Example: idtool simulate leg_idtool/identified.urdf run3.mcap")
def simulate_command(
    urdf: UrdfArgument,
    log: Annotated[Path, typer.Argument(help="A log or, with --track, a trajectory: MCAP or CSV.", show_default=False)],
    config: ConfigOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Log to write, MCAP or CSV by its ending; default: <urdf stem>_idtool/simulated.mcap."),
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(
            help="Start again from the measured state this often, s; 0: never. Default: the configuration's "
            "simulation.window under the logged torque, never under the controller."
        ),
    ] = None,
    closed_loop: Annotated[
        bool,
        typer.Option(
            "--closed-loop",
            help="Let the configuration's controller drive the joints on the logged command, not the logged torque.",
        ),
    ] = False,
    track: Annotated[
        bool,
        typer.Option(
            "--track",
            help="Let the controller track the log's qcmd and vcmd, else its q and v, from their first state on.",
        ),
    ] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run a model forwards along a log, or along a trajectory under its controller, and write the motion as a log."""
    from idtool.experiment import prepare
    from idtool.logs import write_log
    from idtool.robot import read_robot
    from idtool.simulated_log import as_command, as_logged, simulated_log, under_controller
    from idtool.terminal import Terminal

    terminal = Terminal(quiet, as_json)
    file, settings = out or Path(f"{urdf.stem}_idtool", "simulated.mcap"), config_of(urdf, config)
    _check_file(file, log)
    _check_options(settings, window, closed_loop, track)
    seen_as = as_command if track else under_controller if closed_loop else as_logged
    started = time.monotonic()
    with terminal.progress() as progress:
        progress("reading", 0.0)
        experiment = prepare(read_robot(urdf), settings, [], [log], seen_as=seen_as)
        every = _window(experiment, window)
        done = simulated_log(experiment, experiment.equation.prior, every, file, progress)
        progress("writing", 0.0)
        _make_folder(file.parent)
        write_log(file, done.log)
    report = _report(experiment, done, time.monotonic() - started)
    _show(terminal, report, "trajectory" if track else "measured positions")
    finish(terminal, report, {})


def _check_file(file: Path, log: Path) -> None:
    """Before anything is simulated: whether the result can be written, and not over what is read."""
    if file.suffix.lower() not in (".mcap", ".csv"):
        raise LogError(file, "has an ending that no log is written under; use .mcap or .csv")
    if file.resolve() == log.resolve():
        raise LogError(file, "is the log that is read; give another --out")


def _check_options(settings: Config, window: float | None, closed_loop: bool, track: bool) -> None:
    if closed_loop and track:
        raise ConfigError("--track", "goes without --closed-loop; give one of them")
    if (closed_loop or track) and settings.controller is None:
        option = "--track" if track else "--closed-loop"
        raise ConfigError("controller", f"is missing in the configuration; give kp and kd there, {option} needs them")
    if window is not None and not 0 <= window < math.inf:
        raise ConfigError("--window", f"{window:g} is no time; give seconds, or 0 for never")


def _window(experiment: Experiment, given: float | None) -> float | None:
    """How often to start again [s]; None: never."""
    if given is not None:
        return given or None
    closed = experiment.runs[0].signals.command.joints.any()
    return None if closed else experiment.config.simulation.window


def _make_folder(folder: Path) -> None:
    from idtool.outputs import OutputError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(folder, f"cannot be written to ({error.strerror}); give another --out") from None


def _report(experiment: Experiment, done: SimulatedLog, wall: float) -> dict[str, Any]:
    from idtool.report import HEADER
    from idtool.simulation_report import POSITION_UNITS

    lost = [f"{done.lost} of {done.rollouts} rollouts ran away; they end where they did"] if done.lost else []
    return {
        **HEADER,
        "file": str(done.log.path),
        "joints": list(done.log.joints),
        "units": {joint: POSITION_UNITS[unit] for joint, unit in experiment.model.units.items()},
        "kind": done.kind,
        "window": done.window,
        "rollouts": done.rollouts,
        "lost": done.lost,
        "samples": len(done.log),
        "seconds": done.seconds,
        "wall_seconds": wall,
        "rmse": {"position": done.position or None, "velocity": done.velocity or None},
        "urdf": str(experiment.model.robot.path),
        "log": str(experiment.runs[0].signals.log.path),
        "warnings": [*experiment.warnings, *lost],
    }


def _show(terminal: Terminal, report: dict[str, Any], measured: str) -> None:
    """What was run, how far it is from what was measured, and where it is."""
    how = "closed loop under the controller" if report["kind"] == "closed_loop" else "open loop under the logged torque"
    often = "never restarted" if report["window"] is None else f"{report['window']:g} s at a time"
    terminal.say(f"{how}, {often}: {report['seconds']:.4g} s simulated in {report['wall_seconds']:.1f} s")
    if position := report["rmse"]["position"]:
        units = " or ".join(dict.fromkeys(report["units"].values()))
        joints = ", ".join(f"{name} {position[name]:.4g}" for name in report["joints"])
        terminal.say(f"{position['overall']:.4g} {units} RMS from the {measured}: {joints}")
    terminal.warn(report["warnings"])
    terminal.say(f"written: {report['file']}")

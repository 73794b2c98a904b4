"""`idtool init`."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from idtool.cli.app import FIRST, app
from idtool.cli.options import JsonOption, LogsArgument, QuietOption, UrdfArgument, finish

if TYPE_CHECKING:
    from collections.abc import Sequence

    from idtool.setup import Start


@app.command("init", rich_help_panel=FIRST, epilog="Example: idtool init leg.urdf run1.mcap run2.mcap")
def init_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", help="What is known already, such as controller gains: its keys are kept as they are."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: <urdf stem>.yaml beside the URDF.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a commented configuration with all that URDF and logs tell; what they do not is left to fill in."""
    from idtool.common.names import stem
    from idtool.common.outputs import write_all
    from idtool.common.safe_yaml import read_yaml
    from idtool.data.description import robot_and_logs
    from idtool.reporting.report import HEADER
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.init import show_start
    from idtool.setup import start

    terminal = Terminal(quiet, as_json)
    beside = urdf.with_name(f"{stem(urdf)}.yaml")  # where the other commands look for it
    file = out or beside
    _check(file, [urdf, *logs], force)
    with terminal.progress() as progress:
        progress("reading", 0.0)
        robot, every = robot_and_logs(urdf, logs)
        given = read_yaml(config) if config else None
        found = start(robot, every, given or {}, config, progress)
        write_all(file.parent, {file.name: found.text})
    report = {**HEADER, "file": str(file), "urdf": str(urdf), "logs": [str(path) for path in logs], **_report(found)}
    report["next"] = _next(found, file, [urdf, *logs], file.resolve() == beside.resolve())
    show_start(terminal, report)
    finish(terminal, report, {})


def _check(file: Path, inputs: Sequence[Path], force: bool) -> None:
    """Before anything is read: whether the file may and can be written."""
    from idtool.common.outputs import OutputError

    if any(file.resolve() == path.resolve() for path in inputs):
        raise OutputError(file, "is a file that is read; give another --out")
    if file.is_dir():
        raise OutputError(file, "is a folder; give a file as --out")
    if file.exists() and not force:
        raise OutputError(file, "is there already; give --force to overwrite it, or another --out")
    folder = next(folder for folder in file.absolute().parents if folder.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(folder, "cannot be written to; give another --out")


def _report(found: Start) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "band_hz": found.band_hz,
        "config": found.data,
        "rms": found.rms,
        "trials": [asdict(trial) for trial in found.trials],
        "found": list(found.found),
        "left": [asdict(left) for left in found.left],
        "needed": [left.key for left in found.needed],
        "warnings": list(found.warnings),
    }


def _next(found: Start, file: Path, given: Sequence[Path], beside: bool) -> str:
    """The next command: the fit, or the same again with what it cannot do without filled in."""
    arguments = list(map(str, given))
    if found.needed:
        out = [] if beside else ["--out", str(file)]
        return shlex.join(["idtool", "init", *arguments, "--config", str(file), *out, "--force"])
    return shlex.join(["idtool", "fit", *arguments, *([] if beside else ["--config", str(file)])])

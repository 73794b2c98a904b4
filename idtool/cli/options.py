"""What commands share: arguments and options, the configuration, bounds, and how they end."""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import stem

if TYPE_CHECKING:
    from idtool.estimation.dataset.experiment import Experiment
    from idtool.reporting.results.base import Result
    from idtool.reporting.terminal import Terminal


def named(path: Path | None) -> Path | None:
    """The path with a name, which what is written is called after: the folder one is in has none."""
    return path.resolve() if path and path.name in ("", "..") else path


def some_log(context: typer.Context, given: Any) -> Any:
    """The log or logs as given: none is enough where what stands in the URDF's place is a bag."""
    from idtool.data.logs import is_bag

    urdf = context.params.get("urdf")
    if not (given or context.resilient_parsing or (urdf and is_bag(urdf))):
        if urdf and not os.path.exists(urdf):  # of any name, however long
            raise ModelError(urdf, "there is no such file")
        raise ConfigError("command", f"missing argument 'LOG'; try {context.command_path} --help")
    return given


def _recordable(file: Path | None) -> Path | None:
    """The file, where it can be made: asked before the work is done."""
    if file is not None:
        from idtool.reporting.rerun_recording import library

        library()
    return file


UrdfArgument = Annotated[
    Path, typer.Argument(metavar="URDF", help="The robot's URDF.", show_default=False, callback=named)
]
LogsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help="Logs: MCAP, CSV or rosbag2 folders. If the first one is a bag with /robot_description, the URDF may "
        "be omitted.",
        show_default=False,
        default_factory=list,
        callback=some_log,
    ),
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="Configuration (YAML); default: <urdf stem>.yaml beside the URDF.")
]
OutOption = Annotated[Path | None, typer.Option("--out", help="Folder to write to; default: <urdf stem>_idtool/.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
HoldoutOption = Annotated[float, typer.Option(help="Fraction at the end of every log that is kept for validation.")]
ValidateOption = Annotated[
    list[Path] | None, typer.Option(help="A whole log for validation, instead of the holdout; repeatable.")
]
NoSimulationOption = Annotated[bool, typer.Option("--no-simulation", help="Skip the forward simulation (faster).")]
QuickOption = Annotated[
    bool,
    typer.Option("--quick", help="Only the fit: skip the simulation and the uncertainty analysis."),
]
MethodOption = Annotated[
    Literal["ls", "iv"],
    typer.Option(
        "--method",
        help="ls: least squares; iv: instrumental variables, which are not biased by noise in q and v but slower.",
    ),
]
RerunOption = Annotated[
    Path | None,
    typer.Option(
        "--rerun",
        metavar="FILE.rrd",
        help="Also write a recording for the rerun viewer; needs the extra 'rerun' of idtool.",
        callback=_recordable,
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print only errors.")]
MaxRmsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--max-rms",
        help="Largest accepted RMS torque error in the filter's band, for all joints together (0.5) or one (hip=0.5); "
        "exit code 1 if it is exceeded; repeatable.",
    ),
]
InertiaOption = Annotated[
    Literal["refit", "fixed"],
    typer.Option(
        help="Identify the inertia again at every step, or keep that of the URDF fixed, so that payloads, torque gains "
        "and tilted bases can be found."
    ),
]
EffectsOption = Annotated[str | None, typer.Option(help="Effects to search for, separated by commas; default: all.")]
MaxEffectsOption = Annotated[int, typer.Option(min=1, help="Largest number of effects to add.")]
AssumeOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="EFFECT:JOINT",
        help="Start with this effect, on a joint or link if it has one; repeatable.",
    ),
]
ReportOnlyOption = Annotated[
    bool, typer.Option("--report-only", help="Write diagnosis.json and diagnosis.html, but no model.")
]
ExplainOption = Annotated[bool, typer.Option("--explain", help="Show why each candidate was rejected.")]


def folder_for(urdf: Path, given: Path | None) -> Path:
    """The folder to write to: the one given, or one in the working directory that is called after the URDF.

    Raises
    ------
    OutputError
        If it cannot be written to; found out before the work is done.
    """
    from idtool.common.outputs import check_folder

    folder = given or Path(f"{stem(urdf)}_idtool")
    check_folder(folder)
    return folder


def bounds_of(given: list[str], experiment: Experiment) -> dict[str, float]:
    """Bounds by joint or ``overall`` from the options."""
    from idtool.common.names import suggestion

    bounds = {}
    for text in given:
        name, _, number = text.rpartition("=")
        name = name or "overall"
        known = (*experiment.equation.joints, "overall")
        if name not in known:
            raise ConfigError("--max-rms", f"{name} is not a joint; {suggestion(name, known)}")
        try:
            bounds[name] = float(number)
        except ValueError:
            bounds[name] = math.nan
        if not 0 < bounds[name] < math.inf:
            raise ConfigError("--max-rms", f"{text or 'nothing'} is not NUMBER or JOINT=NUMBER, with a number above 0")
    return bounds


def command() -> str:
    """The command line, as a person would type it."""
    return shlex.join(["idtool", *sys.argv[1:]])


def finish(terminal: Terminal, result: Result, met: Mapping[str, bool], missing: str = "bound not met") -> None:
    """Print the result where asked for; exit with 1 where a bound was not met."""
    terminal.result(result.to_json())
    missed = [name for name, ok in met.items() if not ok]
    if missed:
        terminal.say(f"{missing}: {', '.join(missed)}")
        raise typer.Exit(1)

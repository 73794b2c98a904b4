"""Arguments and options that commands share, and the end of a command."""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.input_files import missing_file_advice
from idtool.common.names import stem, without_secrets

if TYPE_CHECKING:
    from idtool.api.distribution import Distribution
    from idtool.estimation.dataset.experiment import Experiment
    from idtool.reporting.results.base import Result
    from idtool.reporting.results.fit import FitReport
    from idtool.reporting.results.validation import ValidationReport
    from idtool.reporting.terminal import Terminal


LOG_FORMATS = "MCAP, CSV or a rosbag2 folder"  # that help texts name
REDUCTIONS = "reductions"  # folder of those that a cluster made, in that of the results
LOG_TO_WRITE = "Folder, or log to write, MCAP or CSV according to its extension"


def resolve_unnamed(path: Path | None) -> Path | None:
    """The path with a name, after which output is named: ``.`` and ``..`` have none and are resolved."""
    if path and path.name in ("", ".."):
        return path.resolve()
    return path


def require_log(context: typer.Context, logs: Any) -> Any:
    """The log or logs as given; none is needed if the URDF argument is a bag.

    Raises
    ------
    ConfigError
        If there is no log.
    """
    from idtool.data.logs import is_bag

    urdf = context.params.get("urdf")
    if logs or context.resilient_parsing or (urdf and is_bag(urdf)):
        return logs
    if urdf and not os.path.exists(urdf):  # of any name, however long
        raise ModelError(urdf, f"there is no such file; {missing_file_advice(urdf)}")
    raise ConfigError("command", f"missing argument 'LOG'; try {context.command_path} --help")


def _limit_processes(count: int | None) -> int | None:
    """The number of processes as given, which is set."""
    from idtool.common.processes import limit_processes

    limit_processes(count)
    return count


def log_path_or_url(text: str) -> Path:
    """The path of a log, or its URL as an object with a path's methods."""
    from idtool.common.urls import log_path

    return log_path(text)


def _check_rerun(file: Path | None) -> Path | None:
    """The file as given; an error, before any work is done, if rerun is missing or the file cannot be written."""
    if file is not None:
        from idtool.common.outputs import check_file
        from idtool.reporting.rerun_recording import rerun_package

        rerun_package()
        check_file(file, [], "--rerun")
    return file


def _complete_effects(incomplete: str) -> list[str]:
    """Lists of effects that begin with what was typed: those that are complete, and one more."""
    from idtool.dynamics.effects import effect_types

    complete, comma, _ = incomplete.rpartition(",")
    return [f"{complete}{comma}{effect}" for effect in effect_types()]


UrdfArgument = Annotated[
    Path, typer.Argument(metavar="URDF", help="The robot's URDF.", show_default=False, callback=resolve_unnamed)
]
LogsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help=f"Logs ({LOG_FORMATS}), or their URLs. If the first one is a bag with /robot_description, the URDF may be "
        "omitted.",
        show_default=False,
        default_factory=list,
        parser=log_path_or_url,
        callback=require_log,
    ),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", "-c", help="Configuration (YAML); default: <urdf stem>.yaml beside the URDF."),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", "-o", help="Folder to write to; default: <urdf stem>_idtool/.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
HoldoutOption = Annotated[float, typer.Option(help="Fraction at the end of every log that is kept for validation.")]
ValidateOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="LOG",
        parser=log_path_or_url,
        help="A whole log for validation, instead of the holdout; repeatable.",
    ),
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
        callback=_check_rerun,
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        min=1,
        help="Largest number of processes; default: one for each processor core.",
        show_default=False,
        callback=_limit_processes,
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS|local:N",
        help="Dask cluster that reads the logs: address or JSON file of its scheduler, or local:N for N processes on "
        "this machine. With a cluster, fit skips the simulation and the search for data faults, and diagnose searches "
        "only part of each log. Needs the extra 'cluster' of idtool.",
    ),
]
SkipBadOption = Annotated[
    bool, typer.Option("--skip-bad", help="Leave out logs that cannot be used; a warning names each.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors.")]
MaxRmsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--max-rms",
        help="Largest accepted RMS torque error in the filter's band, for all joints together (0.5) or one (hip=0.5); "
        "exit code 1 if it is exceeded; repeatable.",
    ),
]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="Exit code 1 if the verdict is that the model must not be used.")
]
InertiaOption = Annotated[
    Literal["refit", "fixed"] | None,
    typer.Option(
        help="refit: identify the inertia again at every step; fixed: keep that of the URDF, so that payloads, "
        "torque-scale errors and a tilted base can be found. Default: refit; with --against fixed.",
        show_default=False,
    ),
]
EffectsOption = Annotated[
    str | None,
    typer.Option(
        help="Effects to search for, separated by commas; default: all.",
        autocompletion=_complete_effects,
    ),
]
MaxEffectsOption = Annotated[int, typer.Option(min=1, help="Largest number of effects to add.")]
BudgetOption = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="Time limit for the search, s. The effects found by then are reported, as they are after Ctrl-C.",
        show_default="none",
    ),
]
AssumeOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="EFFECT:JOINT",
        autocompletion=_complete_effects,
        help="Start with this effect, on this joint or link if it acts on one; repeatable.",
    ),
]
AgainstOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="LOG",
        help="The simulator's log, recorded with the same commands as LOG; or a folder with one simulator log for each "
        "LOG, of the same name. Lists what to change in the simulator. Repeatable: one for each LOG, in the same "
        "order.",
    ),
]
ReportOnlyOption = Annotated[
    bool, typer.Option("--report-only", help="Write diagnosis.json and diagnosis.html, but no model.")
]
ExplainOption = Annotated[bool, typer.Option("--explain", help="Show why each candidate was rejected.")]


@contextmanager
def distribution_of(
    address: str | None, folder: Path, terminal: Terminal, progress: Callable[[str, float], None]
) -> Iterator[Distribution | None]:
    """The cluster that reads the logs, None without an address; reductions are kept in the folder."""
    from idtool.api.distribution import open_distribution

    with open_distribution(address, folder, progress) as distribution:
        if distribution is not None and distribution.cluster.dashboard:
            terminal.say(f"dashboard of the cluster: {distribution.cluster.dashboard}")
        yield distribution


def output_folder(urdf: Path, out: Path | None) -> Path:
    """The folder to write to: the one given, or one in the working directory that is named after the URDF.

    Raises
    ------
    OutputError
        If it cannot be written to.
    """
    from idtool.common.outputs import check_folder

    folder = out or Path(f"{stem(urdf)}_idtool")
    check_folder(folder)
    return folder


def output_file(out: Path, name: str) -> Path:
    """The one file that a command writes: the path itself or, if it is a folder or has no extension, a file in it.

    Parameters
    ----------
    out
        Path that was given.
    name
        Name of the file in a folder.
    """
    is_folder = out.is_dir() or not out.suffix
    return out / name if is_folder else out


def parse_bounds(texts: list[str], experiment: Experiment) -> dict[str, float]:
    """Bounds by joint or ``overall`` from the options."""
    from idtool.common.names import suggestion

    names = (*experiment.equation.joints, "overall")
    bounds = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        name = name or "overall"
        if name not in names:
            raise ConfigError("--max-rms", f"{name} is not a joint; {suggestion(name, names)}")
        try:
            bound = float(number)
        except ValueError:
            bound = math.nan
        if not 0 < bound < math.inf:
            raise ConfigError(
                "--max-rms", f"{text or 'an empty value'} is not NUMBER or JOINT=NUMBER, with a number above 0"
            )
        bounds[name] = bound
    return bounds


def command_line() -> str:
    """The command line, as a person would type it."""
    return shlex.join(["idtool", *map(without_secrets, sys.argv[1:])])


def finish_model(
    terminal: Terminal, result: FitReport | ValidationReport, bounds: Mapping[str, bool], strict: bool
) -> None:
    """Finish as `finish` does; with ``strict``, exit with 1 also if the verdict is not to use the model."""
    is_refused = strict and result.verdict == "do_not_use"
    if is_refused:
        terminal.say("--strict: the verdict is that the model must not be used")
    finish(terminal, result, bounds)
    if is_refused:
        raise typer.Exit(1)


def finish(terminal: Terminal, result: Result, checks: Mapping[str, bool], failure: str = "bound not met") -> None:
    """Print the result as JSON if asked for; exit with 1 if a check failed.

    Parameters
    ----------
    terminal, result
        The terminal and the result.
    checks
        Outcome of each check, by name.
    failure
        Message for the checks that failed, before their names.
    """
    terminal.result(result.to_json())
    failed = [name for name, ok in checks.items() if not ok]
    if failed:
        terminal.say(f"{failure}: {', '.join(failed)}")
        raise typer.Exit(1)

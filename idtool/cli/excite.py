"""`idtool excite`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from idtool.cli.app import FIRST, app
from idtool.cli.options import ConfigOption, JsonOption, QuietOption, UrdfArgument, command, finish, folder_for
from idtool.common.exceptions import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from idtool.api.model import Model
    from idtool.estimation.dataset.experiment import Experiment
    from idtool.excitation.design import Logged
    from idtool.excitation.task import Task

_CRITERIA = ("d", "a", "e", "condition")
_ALL = ""  # an option's value for all joints


@app.command(
    "excite",
    rich_help_panel=FIRST,
    epilog="Example: idtool excite leg.urdf --duration 30 --noise 0.1 --favour shank_link",
)
def excite_command(
    urdf: UrdfArgument,
    config: ConfigOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Log to write, MCAP or CSV by its ending; default: <urdf stem>_idtool/excitation.mcap."),
    ] = None,
    log: Annotated[
        list[Path] | None, typer.Option(help="A log that there is already: designs what to do next; repeatable.")
    ] = None,
    pattern: Annotated[str, typer.Option(help="fourier, bspline, or shell, the paper's motion.")] = "fourier",
    criterion: Annotated[
        str, typer.Option(help="d: all parameters; a: the mean error; e: the worst combination; or condition.")
    ] = "d",
    favour: Annotated[
        list[str] | None,
        typer.Option(help="What the criterion is for: a body, a joint's friction, or a parameter (hip.coulomb)."),
    ] = None,
    duration: Annotated[float, typer.Option(help="Of the trajectory, s.")] = 20.0,
    slow: Annotated[float, typer.Option(help="Share of it for slow sweeps and standstill, for friction.")] = 0.2,
    rate: Annotated[float, typer.Option(help="Samples a second, Hz.")] = 1000.0,
    highest: Annotated[
        float | None, typer.Option("--max-frequency", help="Highest frequency, Hz; default: by the limits.")
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(help="Torque noise in the filter's band, N·m rms: 0.1, or hip=0.1. Default: from --log, or 1 %."),
    ] = None,
    margin: Annotated[float, typer.Option(help="Share of each limit left unused; of the effort, twice that.")] = 0.1,
    clearance: Annotated[float, typer.Option(help="How near links may come to each other, m.")] = 0.01,
    start: Annotated[list[str] | None, typer.Option(help="Pose at start and end: hip=0.5; repeatable.")] = None,
    tip: Annotated[str | None, typer.Option(help="Link that follows the shell; default: every limb's last.")] = None,
    iterations: Annotated[int, typer.Option(min=1, help="Of the search.")] = 200,
    seed: Annotated[int | None, typer.Option(help="Of what is drawn; default: the configuration's.")] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Design a trajectory that makes the parameters visible, and print the standard errors to expect."""
    from idtool.api.model import Model
    from idtool.common.outputs import check_log
    from idtool.common.provenance import provenance
    from idtool.estimation.dataset.experiment import sources_of
    from idtool.excitation.design import Wishes, design
    from idtool.reporting.excite_report import excite_report
    from idtool.reporting.report import HEADER
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.excite import show_excitation

    terminal = Terminal(quiet, as_json)
    file = out or folder_for(urdf, None) / "excitation.mcap"
    check_log(file, [urdf, *(log or []), *([config] if config else [])])
    _check(criterion, duration, rate, margin, clearance, highest)
    model = Model(urdf, config)
    wishes = Wishes(
        pattern=pattern,
        seconds=duration,
        slow=slow,
        highest=highest,
        iterations=iterations,
        seed=model.settings.seed if seed is None else seed,
        start=_numbers("--start", start or [], for_all=False),
        tip=tip,
    )
    noises = _numbers("--noise", noise or [], for_all=True)
    asked = {"rate": rate, "margin": margin, "clearance": clearance, "criterion": criterion, "favour": favour or []}
    with terminal.progress() as progress:
        progress("reading", 0.0)
        task, logged, experiment = _task(model, log or [], noises, asked, progress)
        found = design(task, experiment.config if experiment else model.settings, wishes, logged, progress)
        progress("writing", 0.0)
        report = {
            **HEADER,
            **provenance(experiment.sources if experiment else sources_of(model.robot, model.settings)),
            "file": str(file),
            "urdf": str(urdf),
            "logs": [str(path) for path in log or []],
            "seed": wishes.seed,
            "samples": math.floor(found.trajectory.seconds * rate + 1e-9) + 1,
            **excite_report(found),
        }
        report["warnings"] = list(dict.fromkeys([*(experiment.warnings if experiment else ()), *report["warnings"]]))
        _write(file, found.log(file), report)
    show_excitation(terminal, report)
    finish(terminal, report, {})


def _check(
    criterion: str,
    duration: float,
    rate: float,
    margin: float,
    clearance: float,
    highest: float | None,
) -> None:
    """Before anything is read: whether the options can be meant."""
    from idtool.common.names import nearest

    if criterion not in _CRITERIA:
        raise ConfigError("--criterion", f"{criterion} is none; {nearest(criterion, _CRITERIA)}")
    for option, value, least, most in (
        ("--duration", duration, 3.0, 3600.0),
        ("--rate", rate, 20.0, 20_000.0),
        ("--margin", margin, 0.0, 0.45),
        ("--clearance", clearance, 0.0, 1.0),
        ("--max-frequency", 1.0 if highest is None else highest, 0.01, 1000.0),
    ):
        if not least <= value <= most:
            raise ConfigError(option, f"{value:g} is not from {least:g} to {most:g}")


def _numbers(option: str, given: Sequence[str], for_all: bool) -> dict[str, float]:
    """JOINT=NUMBER by joint; a number without a joint is for all."""
    found = {}
    for text in given:
        name, separator, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or not (separator or for_all) or (for_all and value <= 0):
            form = "NUMBER or JOINT=NUMBER, above 0" if for_all else "JOINT=NUMBER"
            raise ConfigError(option, f"{text or 'nothing'} is not {form}")
        found[name if separator else _ALL] = value
    return found


def _task(
    given: Model,
    logs: Sequence[Path],
    noises: Mapping[str, float],
    asked: Mapping[str, Any],
    progress: Callable[[str, float], None],
) -> tuple[Task, Logged | None, Experiment | None]:
    """The robot and what is to be told, of the joints that are logged already, where some are; and these logs."""
    from idtool.dynamics.effects import build_effects
    from idtool.dynamics.regressor import LinearModel
    from idtool.estimation.command_delay import with_delay
    from idtool.estimation.dataset.equality_constraints import equality_constraints
    from idtool.estimation.dataset.experiment import prepare
    from idtool.estimation.dataset.weights import free_noise
    from idtool.excitation.design import Logged
    from idtool.excitation.task import make_task
    from idtool.robot.model import build_model

    robot, settings, measured = given.robot, given.settings, dict[str, float]()
    logged = experiment = None
    if logs:
        experiment, _, _ = with_delay(prepare(robot, settings, logs, holdout=0.0), progress)
        model, equation, settings = experiment.model, experiment.equation, experiment.config
        equalities = experiment.equalities
        reduction = experiment.reduce(progress)
        logged = Logged(reduction, free_noise(equation, reduction, equalities))
        measured = dict(zip(model.names, logged.noise.tolist(), strict=True))
    else:
        model = build_model(
            robot, settings, [j.name for j in robot.joints.values() if j.kind != "fixed" and not j.mimic]
        )
        equation = LinearModel(model.names, build_effects(model, settings))
        equalities = equality_constraints(settings, model, equation)
    alike = dict.fromkeys(model.names, noises[_ALL]) if _ALL in noises else {}
    noise = {**measured, **alike, **{name: x for name, x in noises.items() if name != _ALL}}
    return make_task(model, equation, equalities, settings, noise=noise, **asked), logged, experiment


def _write(file: Path, log: Any, report: dict[str, Any]) -> None:
    from idtool.common.interrupt import held_back
    from idtool.common.outputs import write_all
    from idtool.data.logs import write_log
    from idtool.reporting.pages.excite import excite_page

    page = excite_page(report, command())
    with held_back():
        write_all(file.parent, {f"{file.stem}.html": page})
        write_log(file, log)

"""`excite`: design an exciting trajectory."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from idtool.api.data import as_list
from idtool.api.explanations import find_explanations, parse_alternatives
from idtool.api.log import Log
from idtool.api.model import Model, Source, as_model
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, ignore_progress, notice_lines, table_lines
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.interrupt import delay_interrupt
from idtool.common.names import join_names, suggestion
from idtool.common.notice import Notice
from idtool.common.number_text import number
from idtool.common.outputs import write_all
from idtool.common.threads import with_single_threaded_blas
from idtool.data.controller import with_unknown_torque
from idtool.data.logs import JointLog, check_log_file, write_log
from idtool.dynamics.armature import with_armature
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.command_delay import with_delay
from idtool.estimation.controller_gains import with_gains
from idtool.estimation.dataset.cutoff import with_cutoff_for_period
from idtool.estimation.dataset.equality_constraints import equality_constraints
from idtool.estimation.dataset.experiment import Experiment, prepare, sources_of
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.row_noise import with_row_noise
from idtool.excitation.criteria import Criterion
from idtool.excitation.deciding import decide as decide_between
from idtool.excitation.design import Design, DesignOptions, design
from idtool.excitation.logged_data import LoggedData
from idtool.excitation.standing.design import design_standing
from idtool.excitation.standing.task import StandingOptions, StandingTask, make_standing_task
from idtool.excitation.task import DesignTask, make_design_task
from idtool.reporting.excitation_report import excitation_report
from idtool.reporting.results.excitation import ExcitationReport
from idtool.robot.config import Base, Config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output

LOG_NAME = "excitation.mcap"  # what the log is called in a folder
CRITERIA = ("d", "a", "e", "condition")
ALL_JOINTS = ""  # in place of a joint: all joints

_ITERATIONS, _STANDING_ITERATIONS = 200, 60
_FRICTION_COEFFICIENT = 0.5
_MIN_FRICTION, _MAX_FRICTION = 0.05, 2.0
_MAX_SOLE = 2.0  # m


class ExcitationResult(ExcitationReport, Displayable):
    """A designed trajectory and the expected standard errors of a fit to it."""

    _design: Design

    @property
    def log(self) -> Log:
        """The trajectory as a log of commands; q and v are those that a perfect controller would give."""
        return Log.from_record(self._design.log(Path(LOG_NAME)))

    def save(self, file: str | os.PathLike[str], made_by: str = "idtool.excite(…)") -> tuple[Path, Path]:
        """Write the trajectory as a log, and a page beside it.

        Parameters
        ----------
        file
            The log; its extension decides the format.
        made_by
            Command that the HTML report shows.

        Returns
        -------
        The log and the page.

        Raises
        ------
        OutputError
            If they cannot be written.
        """
        from idtool.reporting.pages.excite import excite_page

        path = Path(file)
        check_log_file(path, [])
        report = self.model_copy(update={"file": str(path)})
        page = excite_page(report, made_by)
        with delay_interrupt():
            write_all(path.parent, {f"{path.stem}.html": page})
            write_log(path, self._design.log(path))
        return path, path.with_suffix(".html")

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.excite import show_excitation

        show_excitation(output, self)

    def __repr__(self) -> str:
        title = f"ExcitationResult: {self.duration:g} s at {self.rate_hz:g} Hz"
        rows = []
        for p in self.base_parameters:
            rows.append([p.name, number(p.prior), number(p.standard_error), p.unit])
        lines = [title]
        lines += table_lines(["base parameter", "prior", "± se", "unit"], rows)
        lines += notice_lines(self.notices)
        return "\n".join(lines)


@shows_progress
@with_single_threaded_blas
def excite(
    model: Model | Source,
    *,
    logs: Source | Sequence[Source] = (),
    pattern: str = "fourier",
    criterion: str = "d",
    favour: Sequence[str] = (),
    duration: float = 20.0,
    slow: float = 0.2,
    rate: float = 1000.0,
    max_frequency: float | None = None,
    noise: float | Mapping[str, float] | None = None,
    margin: float = 0.1,
    clearance: float = 0.01,
    start: Mapping[str, float] | None = None,
    tip: str | None = None,
    iterations: int | None = None,
    seed: int | None = None,
    stand: bool = False,
    feet: Sequence[str] = (),
    friction_coefficient: float | None = None,
    sole_size: tuple[float, float] | None = None,
    decide: tuple[str, str] | None = None,
    progress: Progress | None = None,
) -> ExcitationResult:
    """Design an exciting trajectory, like `idtool excite`.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Existing logs. The trajectory is designed to complement them.
    pattern
        ``fourier``, ``bspline``, or ``shell``, on which limb tips move (Wensing et al. 2018).
    criterion
        ``d``: all parameters; ``a``: the mean error; ``e``: the worst combination; or ``condition``.
    favour
        Bodies, joints (for their friction) or parameters (``hip.coulomb``) for which to optimize.
    duration
        Duration of the trajectory [s].
    slow
        Fraction of the duration for slow sweeps and standstill, which determine friction.
    rate
        Samples per second [Hz].
    max_frequency
        Highest frequency [Hz]; None: by the limits.
    noise
        RMS torque noise in the filter's band [N·m or N], of all joints or by joint; None: from the logs, or 1 % of the
        largest torque.
    margin
        Unused fraction of each limit; twice this fraction for the effort.
    clearance
        Minimum distance between links [m].
    start
        Pose at start and end, by joint [rad or m]; a name may contain wildcards, as in ``*_knee_joint``.
    tip
        Link that follows the shell; None: the last link of every limb.
    iterations
        Number of iterations of the search; None: 200, or 60 with ``stand``.
    seed
        Random seed; None: the seed of the configuration.
    stand
        If true, the feet of a robot with a floating base stay on the ground, and its base moves. If false, the base is
        held, and the feet are in the air.
    feet
        With ``stand``, the contacts that stay on the ground; none: those at the ends of limbs.
    friction_coefficient
        With ``stand``, the friction coefficient of the feet on the ground; None: 0.5.
    sole_size
        With ``stand``, length and width of the feet that are surfaces [m]; None: from the geometry of their links.
    decide
        Two explanations of what a model lacks, between which a log of the trajectory will decide: each an effect on a
        joint or link (``"stribeck_friction:hip"``), or a configuration file with effects. The parameters are those of
        the configuration; else they are fitted to the logs; without logs, the effect has a typical size.
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If the model, the configuration or a log cannot be used. Messages contain the option names of the command line.
    """
    report_progress = progress or ignore_progress
    _check_options(criterion, duration, rate, margin, clearance, max_frequency, seed)
    _check_standing(stand, feet, friction_coefficient, sole_size, tip, decide)
    model = as_model(model)
    if stand:
        given, held_notices = _standing(model.settings)
    else:
        given, held_notices = _held_at_base(model.settings, with_logs=bool(as_list(logs)))
    alternatives = None if decide is None else parse_alternatives(decide)
    default_iterations = _STANDING_ITERATIONS if stand else _ITERATIONS
    options = DesignOptions(
        pattern=pattern,
        duration=duration,
        friction_share=slow,
        max_frequency=max_frequency,
        iterations=default_iterations if iterations is None else iterations,
        seed=given.seed if seed is None else seed,
        start=_start_by_joint(start or {}, model.robot, given),
        tip=tip,
    )
    paths = [Path(str(path)) for path in as_list(logs)]
    check = partial(_check_torque, model.robot, model.settings)
    experiment = _load_experiment(model.robot, given, paths, check, report_progress)
    if experiment is None:
        given = with_cutoff_for_period(given, 1 / rate)
    standing = None
    if stand:
        friction = _FRICTION_COEFFICIENT if friction_coefficient is None else friction_coefficient
        standing = StandingOptions(tuple(feet), friction, sole_size, options.start)
    task, logged = _make_task(
        model.robot, given, experiment, standing, noise, rate, margin, clearance, criterion, favour, report_progress
    )
    if experiment is None:
        settings = given
        sources = sources_of(model.robot, settings)
        notices: Sequence[Notice] = held_notices
    else:
        settings = experiment.config
        sources = experiment.sources
        notices = [*held_notices, *experiment.notices]
    explanations = None
    if alternatives is not None:
        explanations = find_explanations(alternatives, task, settings, experiment, report_progress)
    if isinstance(task, StandingTask):
        chosen_design: Design = design_standing(task, settings, options, logged, report_progress)
    else:
        chosen_design = design(task, settings, options, logged, report_progress)
    decision = None
    if explanations is not None:
        chosen_design, decision = decide_between(
            chosen_design, settings, options, logged, experiment, explanations, report_progress
        )
    report = excitation_report(
        chosen_design,
        decision,
        sources,
        urdf=str(model.robot.path),
        logs=[str(path) for path in paths],
        seed=options.seed,
        notices=notices,
    )
    result = ExcitationResult.from_result(report)
    result._design = chosen_design
    return result


def _check_options(
    criterion: str,
    duration: float,
    rate: float,
    margin: float,
    clearance: float,
    max_frequency: float | None,
    seed: int | None,
) -> None:
    """Check the options before anything is read; ConfigError if one is out of its range."""
    if seed is not None and seed < 0:
        raise ConfigError("--seed", f"{seed} is negative; give 0 or more")
    if criterion not in CRITERIA:
        raise ConfigError("--criterion", f"{criterion} is not a criterion; {suggestion(criterion, CRITERIA)}")
    for option, value, least, most in (
        ("--duration", duration, 3.0, 3600.0),
        ("--rate", rate, 20.0, 20_000.0),
        ("--margin", margin, 0.0, 0.45),
        ("--clearance", clearance, 0.0, 1.0),
        ("--max-frequency", 1.0 if max_frequency is None else max_frequency, 0.01, 1000.0),
    ):
        if not least <= value <= most:
            raise ConfigError(option, f"{value:g} is not between {least:g} and {most:g}")


def _held_at_base(settings: Config, with_logs: bool) -> tuple[Config, tuple[Notice, ...]]:
    """Settings of a robot whose base is held, in place of one that floats, and a notice that says so.

    What a wrench sensor measures is left out: without it, a trajectory is expected to tell less than it does.
    """
    if with_logs:
        settings.require_only_joints("idtool excite with logs")
    held = settings.model_copy(update={"base": Base(), "contacts": (), "wrench_sensors": ()})
    if settings.base.kind == "fixed":
        return held, ()
    message = "the trajectory is for a robot whose base is held upright, with all feet in the air"
    advice = "hang it on a rope or a stand, and fit this log together with logs of the robot on the ground"
    return held, (Notice("base_is_held", "warning", None, message, advice),)


def _check_standing(
    stand: bool,
    feet: Sequence[str],
    friction_coefficient: float | None,
    sole_size: tuple[float, float] | None,
    tip: str | None,
    decide: tuple[str, str] | None,
) -> None:
    """Refuse options that do not go together with ``stand``, or need it, or are out of their range; ConfigError."""
    only_standing = {
        "--feet": bool(feet),
        "--ground-friction": friction_coefficient is not None,
        "--sole-size": sole_size is not None,
    }
    for option, is_given in only_standing.items():
        if is_given and not stand:
            raise ConfigError(option, "is for a robot that stands; add --stand")
    never_standing = {"--tip": tip is not None, "--decide": decide is not None}
    for option, is_given in never_standing.items():
        if is_given and stand:
            raise ConfigError(option, "is not for a robot that stands; leave out --stand")
    if friction_coefficient is not None and not _MIN_FRICTION <= friction_coefficient <= _MAX_FRICTION:
        between = f"between {_MIN_FRICTION:g} and {_MAX_FRICTION:g}"
        raise ConfigError("--ground-friction", f"{friction_coefficient:g} is not {between}")
    for size in sole_size or ():
        if not 0 < size <= _MAX_SOLE:
            raise ConfigError("--sole-size", f"{size:g} is not between 0 and {_MAX_SOLE:g} m")


def _standing(settings: Config) -> tuple[Config, tuple[Notice, ...]]:
    """Settings of a robot that stands, and a notice on what its trajectory depends on.

    Wrench sensors are left out, so that the expected standard errors are too large with them. Feet are rigid: how far
    they give way depends on a torque that is not measured yet.
    """
    if settings.base.kind == "fixed":
        raise ConfigError("--stand", "needs a floating base and contacts; set base: {kind: floating} and contacts")
    message = (
        "the feet stay on the ground only if the URDF's masses are accurate and the joints track the trajectory; "
        "standing alone does not determine the mass"
    )
    advice = "try the trajectory at a fraction of its speed, and log a motion of the hanging robot too"
    notice = Notice("robot_must_stand", "note", None, message, advice)
    rigid = tuple(contact.model_copy(update={"compliance": "none"}) for contact in settings.contacts)
    return settings.model_copy(update={"wrench_sensors": (), "contacts": rigid}), (notice,)


def _start_by_joint(start: Mapping[str, float], robot: Robot, settings: Config) -> dict[str, float]:
    """Positions by joint, from those by joint or pattern of names; an exact name counts more than a pattern."""
    moving = [joint.name for joint in robot.joints.values() if joint.kind != "fixed" and joint.mimic is None]
    joints = [name for name in moving if name not in settings.locked_joints]
    by_pattern: dict[str, float] = {}
    by_name: dict[str, float] = {}
    for name, value in start.items():
        is_pattern = name not in joints and any(character in name for character in "*?")
        if not is_pattern:
            by_name[name] = value
            continue
        matches = fnmatch.filter(joints, name)
        if not matches:
            raise ConfigError("--start", f"{name} matches no moving joint; {suggestion(name, joints)}")
        by_pattern |= dict.fromkeys(matches, value)
    return by_pattern | by_name


def _check_torque(robot: Robot, settings: Config, log: JointLog) -> JointLog:
    """The log; LogError if wrench sensors, which a design leaves out, replace the torque of a joint."""
    if not settings.wrench_sensors:
        return log
    joints = robot.joints if settings.joints is None else settings.joints
    used = [name for name in joints if name not in settings.locked_joints]
    unknown = with_unknown_torque(log, settings.controller).unknown_torque
    lacking = [name for name in unknown if name in used]
    if lacking:
        what = f"no torque was logged of {join_names(lacking)}, and excite --stand leaves out the wrench sensors"
        raise LogError(log.path, f"{what} that replace it; leave out this log")
    return log


def _load_experiment(
    robot: Robot,
    settings: Config,
    logs: Sequence[Path],
    check: Callable[[JointLog], JointLog],
    progress: Progress,
) -> Experiment | None:
    """The experiment of the existing logs, each of which passes a check; None without any."""
    if not logs:
        return None
    experiment, _ = with_gains(prepare(robot, settings, logs, holdout=0.0, transform=check), progress)
    experiment, _, _ = with_delay(experiment, progress)
    return with_row_noise(experiment, progress)


def _make_task(
    robot: Robot,
    settings: Config,
    experiment: Experiment | None,
    standing: StandingOptions | None,
    noise: float | Mapping[str, float] | None,
    rate: float,
    margin: float,
    clearance: float,
    criterion: str,
    favour: Sequence[str],
    progress: Progress,
) -> tuple[DesignTask, LoggedData | None]:
    """The design task, and the information of the existing logs; with logs, only the logged joints take part."""
    measured_noise: dict[str, float] = {}
    logged = None
    if experiment is not None:
        tree, equation, settings = experiment.model, experiment.equation, experiment.config
        equalities = experiment.equalities
        reduction = experiment.reduce(progress)
        contacts = equation.contacts
        sigma = free_noise(equation, reduction, equalities) if contacts is None else contacts.noise
        logged = LoggedData(reduction, sigma)
        measured_noise = dict(zip(tree.names, logged.noise.tolist(), strict=True))
    else:
        moving = [joint.name for joint in robot.joints.values() if joint.kind != "fixed" and not joint.mimic]
        tree = build_model(robot, settings, moving)
        settings = with_armature(settings, tree)
        contacts = None
        if standing is not None:
            contacts = ContactModel(tree, settings.contacts, np.ones(len(tree.names)))
            measured_noise = dict(settings.base.noise)
        equation = LinearModel(tree.names, build_effects(tree, settings), contacts=contacts)
        equalities = equality_constraints(settings, tree, equation)
    given_noise = {**measured_noise, **_given_noise(noise, tree.joint_names)}
    if standing is not None:
        return make_standing_task(
            tree,
            equation,
            equalities,
            settings,
            standing,
            logged,
            noise=given_noise,
            rate=rate,
            margin=margin,
            clearance=clearance,
            criterion=cast(Criterion, criterion),
            favour=favour,
        ), logged
    task = make_design_task(
        tree,
        equation,
        equalities,
        settings,
        noise=given_noise,
        rate=rate,
        margin=margin,
        clearance=clearance,
        criterion=cast(Criterion, criterion),
        favour=favour,
    )
    return task, logged


def _given_noise(noise: float | Mapping[str, float] | None, joints: Sequence[str]) -> dict[str, float]:
    """Noise by joint, as the user gave it; that of a single joint counts more than that of all joints."""
    if noise is None:
        return {}
    if not isinstance(noise, Mapping):
        return dict.fromkeys(joints, noise)
    by_joint = dict(noise)
    if ALL_JOINTS not in by_joint:
        return by_joint
    common = by_joint.pop(ALL_JOINTS)
    return {**dict.fromkeys(joints, common), **by_joint}

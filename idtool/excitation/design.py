"""`design`: an exciting trajectory, and the standard errors to expect from it.

The search uses a coarse grid and penalties. Its result is then scaled to the limits on a fine grid, and the standard
errors are predicted by what `fit` will do with the log: the same filter, the same rows left out.

Shapes: nv joints, N samples, r base parameters, p coefficients. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.optimize import minimize

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.names import suggestion
from idtool.common.number_text import short_number
from idtool.data.logs import JointLog, make_log
from idtool.data.signals import Signals, default_cutoff
from idtool.estimation.dataset.experiment import Progress
from idtool.estimation.dataset.reduction import Reduction, empty, reduce_blocks
from idtool.excitation.criteria import CRITERIA, StandardErrors, expected_standard_errors
from idtool.excitation.feasibility import home_pose, limit_utilization, nearest_links, scale_to_limits
from idtool.excitation.limits import Limits
from idtool.excitation.logged_data import LoggedData
from idtool.excitation.objective import Objective
from idtool.excitation.patterns import (
    PATTERNS,
    MotionSamples,
    Pattern,
    PatternSpec,
    SlowSweeps,
    Standstill,
    Trajectory,
    TrajectorySegment,
)
from idtool.excitation.task import DesignTask
from idtool.robot.config import Config

MAX_DURATION = 40.0  # s of a motion that is searched for; longer ones are repeated
_MIN_DURATION = 2.0  # s
_STANDSTILL_SHARE = 0.25  # of the time for friction
_MIN_FRICTION_DURATION = 1.0  # s of slow sweeps or standstill; shorter ones are left out
_SAMPLES_PER_PERIOD = 16.0  # of the highest frequency, on the coarse grid
_MIN_COARSE_RATE = 20.0  # Hz
_FINE_RATE = 100.0  # Hz, for the segments that are not searched for
_BELOW_BAND = 0.25  # of the filter's cut-off: highest frequency of a motion
_ABOVE_CORNER = 2.0  # times the frequency at which a joint that uses its range reaches another limit
_STAGES = ((1e2, 0.3), (1e3, 0.3), (1e4, 0.4))  # weight of the penalties, and share of the iterations at it
_TRIAL = 0.1  # of the iterations, for each of the motions drawn at random, and each repair
_REPAIRS = 4  # of collisions between coarse samples
_REPAIR_INSTANTS = 300  # at which each repair adds the clearance to the objective


@dataclass(frozen=True)
class DesignOptions:
    """Options of a trajectory.

    Attributes
    ----------
    pattern
        Name of the pattern.
    duration
        Duration of the whole trajectory [s].
    friction_share
        Share of it for friction: slow sweeps and standstill.
    max_frequency
        Highest frequency [Hz]; None: from the limits.
    iterations
        Of the search.
    seed
        Of the random numbers.
    start
        Positions at the start, by joint [rad or m].
    tip
        Link that follows a shell; None: the last.
    """

    pattern: str = "fourier"
    duration: float = 20.0
    friction_share: float = 0.2
    max_frequency: float | None = None
    iterations: int = 150
    seed: int = 0
    start: Mapping[str, float] = field(default_factory=dict)
    tip: str | None = None


@dataclass(frozen=True)
class Design:
    """A trajectory and the standard errors to expect from it.

    Attributes
    ----------
    task, trajectory
        The task and the trajectory that solves it.
    errors, logged_errors
        Standard errors to expect from all data together, and from the logged data alone, None without any; SI.
    criteria
        Values by criterion: of a random motion of the same pattern, of the design, and of the logged data.
    utilization
        Largest share of each of the robot's limits that is used, shape (4, nv).
    nearest
        The links that come nearest to each other, their distance [m], and the time [s]; None without geometry.
    max_frequency
        Highest frequency of the pattern [Hz].
    evaluations
        Number of motions evaluated.
    interrupted
        True if the search was interrupted.
    """

    task: DesignTask
    trajectory: Trajectory
    errors: StandardErrors
    logged_errors: StandardErrors | None
    criteria: dict[str, dict[str, float]]
    utilization: Array
    nearest: tuple[tuple[str, str], float, float] | None
    max_frequency: float
    evaluations: int
    interrupted: bool

    def log(self, path: Path) -> JointLog:
        """The trajectory as a log of commands; q and v are those of perfect tracking."""
        t, (q, v, _) = self.trajectory.sampled(self.task.rate)
        signals = {"q": q.T, "v": v.T, "qcmd": q.T, "vcmd": v.T}
        return make_log(path, t, self.task.model.joint_names, {name: x.copy() for name, x in signals.items()})

    def curves(self, t: Array) -> tuple[MotionSamples, Array]:
        """Motion of the joints and their predicted torque at ascending times, shape (n, N) each."""
        samples = self.trajectory.motion(t)
        return samples, self.task.torque(samples, t)


def design(
    task: DesignTask, config: Config, options: DesignOptions, logged: LoggedData | None, progress: Progress
) -> Design:
    """Find a trajectory.

    Parameters
    ----------
    task
        Robot, limits and criterion.
    config
        For the filter that the log will go through.
    options
        Pattern, duration and the like.
    logged
        Data that was logged before, if any.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    IdtoolError
        If there is no such motion.
    """
    if options.pattern not in PATTERNS:
        raise ConfigError(
            "--pattern", f"{options.pattern} is not a pattern; {suggestion(options.pattern, list(PATTERNS))}"
        )
    rng = np.random.default_rng(options.seed)
    frequency = options.max_frequency or max_frequency(task.limits, task.rate, config)
    home = home_pose(task, options.start, rng)

    def spec_of(duration: float) -> PatternSpec:
        return PatternSpec(task.model, task.limits, home, duration)

    def scale(segment: TrajectorySegment) -> TrajectorySegment:
        return scale_to_limits(task, segment)

    segments, remaining = friction_segments(options, spec_of, scale, rng)

    logged_rows = logged_rows_of(task, logged)
    logged_information = logged_rows.T @ logged_rows

    repeats = int(np.ceil(remaining / MAX_DURATION))
    spec = replace(spec_of(remaining / repeats), max_frequency=max(frequency, 2 * repeats / remaining), tip=options.tip)
    pattern = PATTERNS[options.pattern](spec)
    information = logged_information + _information(task, segments)
    rate = max(_SAMPLES_PER_PERIOD * spec.max_frequency, _MIN_COARSE_RATE)
    objective = Objective(task, pattern, information, repeats, rate)
    first, interrupted = search(objective, options.iterations, rng, progress)

    progress("checking the limits", 0.0)
    random_segment, segment = scaled_segments(task, objective, first, scale)
    trajectory = Trajectory((segment,) * repeats + segments)

    progress("predicting the standard errors", 0.0)
    logged_errors = None
    if logged is not None:
        logged_errors = expected_standard_errors(logged_rows / task.scales, task.base)
    all_rows = _all_rows(task, config, trajectory, logged_rows)
    information_of = {"random": objective.information(random_segment.x), "design": all_rows.T @ all_rows}
    if logged is not None:
        information_of["logged"] = logged_information
    return Design(
        task=task,
        trajectory=trajectory,
        errors=expected_standard_errors(all_rows / task.scales, task.base),
        logged_errors=logged_errors,
        criteria={name: criteria_of(task, M) for name, M in information_of.items()},
        utilization=limit_utilization(task, trajectory),
        nearest=nearest_links(task, trajectory),
        max_frequency=spec.max_frequency,
        evaluations=objective.evaluations,
        interrupted=interrupted,
    )


def with_trajectory(design: Design, config: Config, trajectory: Trajectory, logged: LoggedData | None) -> Design:
    """A design with another trajectory for the same task.

    Parameters
    ----------
    design
        The design.
    config, logged
        As for `design`.
    trajectory
        The trajectory, within all limits.
    """
    task = design.task
    rows = _all_rows(task, config, trajectory, logged_rows_of(task, logged))
    return replace(
        design,
        trajectory=trajectory,
        errors=expected_standard_errors(rows / task.scales, task.base),
        criteria={**design.criteria, "design": criteria_of(task, rows.T @ rows)},
        utilization=limit_utilization(task, trajectory),
        nearest=nearest_links(task, trajectory),
    )


def logged_rows_of(task: DesignTask, logged: LoggedData | None) -> Array:
    """Rows of the data that was logged before, by base parameters in units of their scales; shape (rows, r)."""
    if logged is None:
        return np.zeros((0, len(task.scales)))
    return task.columns.rows(logged.reduction, logged.noise) * task.scales


def _all_rows(task: DesignTask, config: Config, trajectory: Trajectory, logged_rows: Array) -> Array:
    """The logged rows and those to expect from a trajectory, shape (rows, r)."""
    reduction = _predicted_reduction(task, config, trajectory)
    return np.concatenate([logged_rows, task.columns.rows(reduction, task.noise) * task.scales])


def criteria_of(task: DesignTask, M: Array) -> dict[str, float]:
    """All criteria of an information matrix (r, r)."""
    return {kind: task.criterion.value(M, kind) for kind in CRITERIA}


def _information(task: DesignTask, segments: Sequence[TrajectorySegment]) -> Array:
    """Information of segments that are not searched for, shape (r, r)."""
    M = np.zeros((len(task.scales), len(task.scales)))
    for segment in segments:
        duration = segment.pattern.duration
        t = np.linspace(0, duration, int(_FINE_RATE * duration) + 2)
        M += task.information(segment.motion(t), t)
    return M


def max_frequency(limits: Limits, rate: float, config: Config) -> float:
    """Highest useful frequency of a motion [Hz].

    A joint that moves over its whole range and at its velocity limit meets its acceleration limit at some frequency;
    far above that, it hardly moves. And the filter must let it through.
    """
    by_velocity = limits.acceleration / limits.velocity
    by_range = np.sqrt(limits.acceleration / limits.half_range)
    corner = np.maximum(by_velocity, by_range) / (2 * np.pi)
    band = config.filter.cutoff_hz or default_cutoff(1 / rate)
    return float(min(_ABOVE_CORNER * corner.max(), _BELOW_BAND * band))


def friction_segments(
    options: DesignOptions,
    spec_of: Callable[[float], PatternSpec],
    scale: Callable[[TrajectorySegment], TrajectorySegment],
    rng: np.random.Generator,
) -> tuple[tuple[TrajectorySegment, ...], float]:
    """Slow sweeps and standstill, and the duration that remains [s].

    Parameters
    ----------
    options
        Duration, and the share of it for friction.
    spec_of
        Robot, limits and home of a motion of a duration [s].
    scale
        Scales a segment to the limits.
    rng
        For the speeds and poses.
    """
    if not 0 <= options.friction_share < 1:
        raise ConfigError("--slow", f"{options.friction_share:g} is not a fraction; give a number from 0 to below 1")
    friction_duration = options.friction_share * options.duration
    standstill_duration = _STANDSTILL_SHARE * friction_duration
    if standstill_duration < _MIN_FRICTION_DURATION:
        standstill_duration = 0.0

    segments = []
    durations = ((SlowSweeps, friction_duration - standstill_duration), (Standstill, standstill_duration))
    for kind, duration in durations:
        if duration >= _MIN_FRICTION_DURATION:
            pattern = kind(spec_of(duration))
            segments.append(scale(TrajectorySegment(pattern, pattern.draw(rng))))
    remaining = options.duration - sum(segment.pattern.duration for segment in segments)
    if remaining < _MIN_DURATION:
        raise ConfigError(
            "--duration", f"leaves {short_number(remaining)} s for the motion; give at least {_MIN_DURATION:g} s more"
        )
    return tuple(segments), remaining


def scaled_segments(
    task: DesignTask,
    objective: SearchObjective,
    first: Array,
    scale: Callable[[TrajectorySegment], TrajectorySegment],
) -> tuple[TrajectorySegment, TrajectorySegment]:
    """The first motion that was drawn, and the better one of it and the best one found, both scaled to the limits.

    Parameters
    ----------
    task
        The criterion by which motions are compared.
    objective
        The objective after the search.
    first
        Parameters of the first motion.
    scale
        Scales a segment to the limits.
    """
    best = first if objective.best is None else objective.best
    random_segment = scale(TrajectorySegment(objective.pattern, first))
    best_segment = scale(TrajectorySegment(objective.pattern, best))

    def criterion(segment: TrajectorySegment) -> float:
        return task.criterion.value(objective.information(segment.x))

    return random_segment, min(random_segment, best_segment, key=criterion)


class SearchObjective(Protocol):
    """Function that a search minimizes; see `Objective`."""

    pattern: Pattern
    best: Array | None
    penalty_weight: float

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Value, and gradient with respect to x."""
        ...

    def information(self, x: Array) -> Array:
        """Information of a motion on the base parameters in units of their scales, shape (r, r)."""
        ...

    def collision_times(self, x: Array) -> Array:
        """Times at which links are too near to each other, between the samples of the search [s]."""
        ...

    def add_clearance_times(self, t: Array) -> None:
        """Evaluate the clearance at these times [s] too."""
        ...


def search(
    objective: SearchObjective, iterations: int, rng: np.random.Generator, progress: Progress
) -> tuple[Array, bool]:
    """Search for the best motion; returns the first one drawn, and True if the search was interrupted."""
    pattern = objective.pattern
    draws = [pattern.draw(rng) for _ in range(pattern.draws)]
    trial_iterations = max(round(_TRIAL * iterations), 1)
    total = max(round(iterations * (1 + _TRIAL * len(draws))), 1)
    done = 0

    def count_iteration(_: Array) -> None:
        nonlocal done
        done += 1
        progress("designing", min(done / total, 1.0))

    def improve(x: Array, max_iterations: int) -> tuple[float, Array]:
        result = minimize(  # type: ignore[call-overload]
            objective,
            x,
            jac=True,
            method="L-BFGS-B",
            callback=count_iteration,
            options={"maxiter": max_iterations, "maxcor": 20},
        )
        return float(result.fun), result.x

    try:
        progress("designing", 0.0)
        objective.penalty_weight = _STAGES[0][0]
        trials = [improve(x, trial_iterations) for x in draws]
        _, x = min(trials, key=lambda trial: trial[0])
        for penalty_weight, share in _STAGES:
            objective.penalty_weight = penalty_weight
            _, x = improve(x, max(round(share * iterations), 1))
        for _ in range(_REPAIRS):
            best = x if objective.best is None else objective.best
            times = objective.collision_times(best)
            if not len(times):
                break
            stride = max(len(times) // _REPAIR_INSTANTS, 1)
            objective.add_clearance_times(times[::stride])
            _, x = improve(best, trial_iterations)
    except KeyboardInterrupt:
        return draws[0], True
    return draws[0], False


def _predicted_reduction(task: DesignTask, config: Config, trajectory: Trajectory) -> Reduction:
    """The trajectory's log as `fit` would reduce it, with the predicted torque."""
    signals = predicted_signals(task, config, trajectory, task.rate)
    blocks = map(task.equation.block, signals.batches())
    return reduce_blocks(blocks, empty(task.equation.active()), signals.low_pass.redundancy)


def predicted_signals(task: DesignTask, config: Config, trajectory: Trajectory, rate: float) -> Signals:
    """The log of a trajectory at a sampling rate [Hz], with the predicted torque."""
    t, samples = trajectory.sampled(rate)
    names = task.model.names
    channels = {"q": samples.q.T, "v": samples.v.T, "tau": task.torque(samples, t).T}
    return Signals(make_log(Path("design"), t, names, channels), names, config)

"""Every constraint set and every estimator side by side on the same data.

The paper's sets with solve times and violations of realizability, its Fig. 5 and Remark 5. The logs are read once; all
else are small problems on R-factors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, SolverError
from idtool.common.notice import Notice
from idtool.common.processes import shared_among_processes
from idtool.estimation.command_delay import CommandDelay, with_delay
from idtool.estimation.controller_gains import ControllerGains, with_gains
from idtool.estimation.dataset.experiment import NOT_SIMULATED, Experiment, Progress
from idtool.estimation.dataset.reduced_logs import ReducedLog, is_reducible, reduce_logs
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise, weighted_rows
from idtool.estimation.evaluation.reduced_errors import TorqueEvaluator
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.estimation.online.adapt import adapt, convergence, time_to
from idtool.estimation.problem.certificate import Certificate
from idtool.estimation.problem.estimate import solve, solve_locally
from idtool.estimation.problem.local import LOCAL
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.reduced_experiment import ReducedExperiment
from idtool.estimation.row_noise import with_row_noise
from idtool.estimation.study.learning import Curve, learn, read_data, reduced_data
from idtool.robot.config import WEAK_PRIOR
from idtool.robot.inertia import PI_SIZE, smallest_eigenvalue
from idtool.robot.sets import ConstraintSet, choose_set, constraint_sets

CURVES = ("none", "semi", "full", "ellipsoid")  # of the paper's Fig. 5
PRIORS = ("euclidean", "pullback", "entropic")
DRAWS = 40
_FORGETTING = np.inf  # the parameters of a log do not change
_REPEATS = 3  # of a solution, for its time
_MOST_SECONDS = 1.0  # for all of them


@dataclass(frozen=True)
class StudyEntry:
    """Result of one constraint set or estimator.

    Attributes
    ----------
    sets
        The constraint set of each body.
    theta
        The coefficients, SI, shape (p,).
    certificate
        The check of the solution.
    seconds
        Median wall time of the solution.
    least
        Least eigenvalue of each body's pseudo-inertia, in units of its typical mass and size, shape (bodies,).
    """

    sets: tuple[ConstraintSet, ...]
    theta: Array
    certificate: Certificate
    seconds: float
    least: Array


@dataclass(frozen=True)
class Online:
    """The adaptive estimator's parameter error over time, relative to that of the prior.

    Attributes
    ----------
    t
        Seconds of log, shape (T,).
    error
        By set, shape (T,) each.
    settled
        By set, time after which the error stays below a tenth [s]; None: never.
    """

    t: Array
    error: dict[str, Array]
    settled: dict[str, float | None]


@dataclass(frozen=True)
class Study:
    """Every constraint set and every estimator on the same data.

    Attributes
    ----------
    experiment
        Model and data.
    sets, estimators
        Entries by name: constraint sets with the configuration's prior; priors and local solvers.
    train, validation
        Errors of all these models under their names; the first one's curves are for drawing.
    counts, curves, draws
        The validation error against numbers of samples.
    online
        Remark 5; empty from reductions.
    notices
        Plain sentences for the user.
    seconds
        Wall time of everything.
    """

    experiment: Experiment
    sets: dict[str, StudyEntry]
    estimators: dict[str, StudyEntry]
    train: Evaluation
    validation: Evaluation
    counts: list[int]
    curves: dict[str, Curve]
    draws: int
    online: Online
    notices: tuple[Notice, ...]
    seconds: float


def study(experiment: Experiment, progress: Progress, draws: int = DRAWS) -> Study:
    """Estimate with every constraint set and every estimator.

    Parameters
    ----------
    experiment
        Model and data, some of it held out.
    progress
        Callback for the stage and its progress, from 0 to 1.
    draws
        Random draws of samples for each count; four times as many where there are fewer samples than parameters.

    Raises
    ------
    ConfigError
        If nothing is held out.
    LogError
        If nothing is left to fit a joint to.
    """
    started = time.perf_counter()
    if not experiment.samples(held_out=True):
        raise ConfigError("--holdout", "a study compares errors on held-out data; use a larger --holdout or --validate")
    experiment = _weakly_regularized(experiment)
    delay: CommandDelay | None = None
    gains: ControllerGains | None = None
    logs: Sequence[ReducedLog] | None = None
    if isinstance(experiment, ReducedExperiment):
        logs = experiment.logs
    else:
        experiment, gains = with_gains(experiment, progress)
        experiment, delay, _ = with_delay(experiment, progress)
        experiment = with_row_noise(experiment, progress)
        if is_reducible(experiment):
            logs = reduce_logs(experiment, progress, draws_rows=True)
    data = read_data(experiment, progress) if logs is None else reduced_data(experiment, logs)
    if not any(factor.rows for factor in data.validation):
        what = "in the held-out data, unknown contact forces can explain all torques"
        raise ConfigError("--holdout", f"{what}; give logs with other motions with --validate")
    rng = np.random.default_rng(experiment.config.seed)
    equation = experiment.equation
    total = data.total
    noise = free_noise(equation, total, experiment.equalities)
    notices = [notice for notice in experiment.notices if notice.code not in NOT_SIMULATED]
    notices += [notice for part in (gains, delay) if part for notice in part.notices]
    names = [name for name, s in constraint_sets().items() if any(map(s.applies_to, experiment.model.bodies))]
    problem_of = {name: _problem_builder(experiment, name, noise) for name in names}
    candidates = {}
    for name in names:
        problem = problem_of[name](total)
        candidates[name] = partial(_entry, experiment, name, problem, partial(solve, problem))
    sets = _solved_entries(candidates, notices, progress)
    estimators = _solved_entries(_estimators(experiment, total, noise), notices, progress)

    automatic = [name for name in sets if constraint_sets()[name].automatic]  # at least `none`, plain least squares
    tightest = automatic[-1]
    models = {"identified": sets[tightest].theta, "prior": equation.prior}
    models |= {f"set {name}": entry.theta for name, entry in sets.items()}
    models |= {name: entry.theta for name, entry in estimators.items()}
    evaluator = TorqueEvaluator(experiment, progress, logs)
    train_errors = evaluator.evaluate(models, held_out=False)
    validation_errors = evaluator.evaluate(models, held_out=True)

    drawn = {name: problem_of[name] for name in CURVES if name in problem_of}
    counts, curves = learn(data, equation.active(), drawn, draws, rng, progress)
    unsolved = [f"{name} {curve.unsolved}" for name, curve in curves.items() if curve.unsolved]
    if unsolved:
        message = f"some random draws could not be solved: {', '.join(unsolved)}"
        notices.append(Notice("draws_not_solved", "warning", None, message))
    if isinstance(experiment, ReducedExperiment):
        online = Online(np.zeros(0), {}, {})
        message = "the convergence of the online estimate is left out: a reduction does not hold all samples"
        notices.append(Notice("online_left_out", "note", None, message, "give the logs, or use idtool adapt"))
    else:
        rows = weighted_rows(equation, total, noise)[:, :-1]
        online = _online(experiment, list(drawn), sets[tightest].theta, rows, progress)
    return Study(
        experiment=experiment,
        sets=sets,
        estimators=estimators,
        train=train_errors,
        validation=validation_errors,
        counts=counts,
        curves=curves,
        draws=draws,
        online=online,
        notices=tuple(notices),
        seconds=time.perf_counter() - started,
    )


def _weakly_regularized(experiment: Experiment) -> Experiment:
    """The experiment with a number for the prior's weight: an automatic one would hide the effect of a set."""
    regularization = experiment.config.regularization.fixed_or_weak()
    return replace(experiment, config=experiment.config.model_copy(update={"regularization": regularization}))


def _problem_builder(experiment: Experiment, name: str, noise: Array) -> Callable[[Reduction], Problem]:
    """Function that builds the problem of a constraint set from a reduction."""
    equation, bodies, config = experiment.equation, experiment.model.bodies, experiment.config
    sets = [choose_set(body, name) for body in bodies]

    def build(data: Reduction) -> Problem:
        return build_problem(equation, bodies, data, sets, config.regularization, noise, experiment.equalities)

    return build


def _entry(
    experiment: Experiment, name: str, problem: Problem, attempt: Callable[[], tuple[Array, Certificate]]
) -> StudyEntry:
    """The result of a problem, solved several times to measure the time."""
    seconds: list[float] = []
    while len(seconds) < _REPEATS and sum(seconds) < _MOST_SECONDS:
        started = time.perf_counter()
        x, certificate = attempt()
        seconds.append(time.perf_counter() - started)
    theta = problem.theta(problem.S @ x)
    sets = tuple(choose_set(body, name) for body in experiment.model.bodies)
    units = np.array([c.scale for c in experiment.equation.coefficients[: PI_SIZE * len(sets)]])
    least = smallest_eigenvalue((theta[: len(units)] / units).reshape(-1, PI_SIZE))
    return StudyEntry(sets, theta, certificate, float(np.median(seconds)), least)


def _solved_entries(
    candidates: Mapping[str, Callable[[], StudyEntry]], notices: list[Notice], progress: Progress
) -> dict[str, StudyEntry]:
    """Entries of all candidates that can be solved, and a notice about each of the others."""
    entries = {}
    for done, (name, solve_candidate) in enumerate(candidates.items()):
        progress(f"solving {name}", done / len(candidates))
        try:
            entries[name] = solve_candidate()
        except SolverError as error:
            notices.append(Notice("estimator_failed", "warning", name, str(error)))
    return entries


def _estimators(experiment: Experiment, total: Reduction, noise: Array) -> dict[str, Callable[[], StudyEntry]]:
    """Every prior on the ellipsoids, and the local solvers on the set that they know."""
    equation, bodies, given = experiment.equation, experiment.model.bodies, experiment.config.regularization
    weighted = given.model_copy(
        update={"weight": given.numeric_weight or WEAK_PRIOR.numeric_weight, "units": "relative"}
    )
    candidates: dict[str, Callable[[], StudyEntry]] = {}
    for name in (*PRIORS, *LOCAL):
        kind = given if name in LOCAL else weighted.model_copy(update={"kind": name})
        chosen = "full" if name in LOCAL else "ellipsoid"
        sets = [choose_set(body, chosen) for body in bodies]
        problem = build_problem(equation, bodies, total, sets, kind, noise, experiment.equalities)
        start = equation.prior[experiment.equalities.free] / problem.scale
        attempt = partial(solve_locally, problem, name, start) if name in LOCAL else partial(solve, problem)
        candidates[name] = partial(_entry, experiment, chosen, problem, attempt)
    return candidates


def _online(experiment: Experiment, names: list[str], target: Array, rows: Array, progress: Progress) -> Online:
    """Convergence of the adaptive estimator to the estimate from all data (Remark 5)."""

    def errors(name: str, progress: Progress) -> tuple[Array, Array]:
        """Times and relative errors with a set."""
        sets = [choose_set(body, name) for body in experiment.model.bodies]
        adaptation = adapt(experiment, sets, _FORGETTING, progress=progress)
        return adaptation.t, convergence(adaptation, target, rows)

    by_set = shared_among_processes(errors, names, progress)
    t = by_set[0][0]
    error = {name: of_set for name, (_, of_set) in zip(names, by_set, strict=True)}
    return Online(t, error, {name: time_to(t, e) for name, e in error.items()})

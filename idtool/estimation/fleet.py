"""`fit_fleet`: one model of the bodies of several robots of one type, with friction of each robot's own.

Letters: theta (p,) coefficients of one robot; M_r (p, P) selects those of robot r from the P of all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError, SolverError
from idtool.common.names import join_names, printable
from idtool.common.notice import Notice
from idtool.common.number_text import number
from idtool.dynamics.effects import effect_name
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.pooled_model import PooledModel, pooled_model
from idtool.estimation.dataset.reduced_logs import ReducedLog, training_blocks
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.evaluation.reduced_errors import evaluate_reduced
from idtool.estimation.evaluation.torque_errors import Errors, Evaluation
from idtool.estimation.fit import Fit
from idtool.estimation.fit_notices import fit_notices
from idtool.estimation.problem.estimate import Estimate, estimate
from idtool.estimation.problem.regularization_path import regularization_path
from idtool.estimation.reduced_experiment import ReducedExperiment
from idtool.estimation.uncertainty.analysis import cluster_notices
from idtool.estimation.uncertainty.cluster_robust import ClusterRobustEstimate, cluster_robust_estimate
from idtool.robot.config.pool import Pool

_MIN_RATIO = 4.0  # of a difference to its standard error, above which a robot stands out
_MIN_DIFFERENCE = 0.3  # of the others' value
_MIN_GAIN = 0.15  # of its error, that a robot's own bodies would take away
_MAD_TO_SIGMA = 1.4826  # of a normal distribution


@dataclass(frozen=True)
class FleetRobot:
    """One robot of a fleet.

    Attributes
    ----------
    name
        Its name.
    fit
        The fleet's model with its own friction, as a fit: estimate, uncertainty and errors on its logs.
    alone
        Errors, on the same data as `Fit.evaluation`, of a model that was fitted to its logs alone.
    outliers
        How it differs from the others.
    """

    name: str
    fit: Fit
    alone: Errors
    outliers: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """RMS error of the fleet's model on the robot's logs [N·m or N]."""
        joints = self.fit.experiment.equation.joints
        return self.fit.evaluation.errors["identified"].rms(joints)["overall"]

    @property
    def error_alone(self) -> float:
        """RMS error of a model that was fitted to its logs alone [N·m or N]."""
        return self.alone.rms(self.fit.experiment.equation.joints)["overall"]


@dataclass(frozen=True)
class Fleet:
    """A fit to logs of several robots of one type.

    Attributes
    ----------
    fit
        The bodies, with the mean of the robots' friction; its errors are those of each robot's own model.
    pool
        What the robots share.
    robots
        The robots.
    """

    fit: Fit
    pool: Pool
    robots: tuple[FleetRobot, ...]


def fit_fleet(fit: Fit, progress: Progress) -> Fleet:
    """Fit a model to a fleet.

    Parameters
    ----------
    fit
        The fit of one model to all of its logs, which have been reduced; its prior and weight are those of the fleet.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    ConfigError
        If the logs are not those of several robots.
    SolverError
        If the problem could not be solved.
    """
    progress("fitting the fleet", 0.0)
    experiment = fit.experiment
    pool = experiment.config.pool
    if not isinstance(experiment, ReducedExperiment) or pool is None:
        raise TypeError("a fleet is fitted to reduced logs")
    logs_by_robot = logs_of_robots(pool, experiment.logs)
    model = pooled_model(experiment.equation, list(logs_by_robot), pool.own)
    solver = _FleetSolver(fit, experiment, model, logs_by_robot)
    fit = solver.fit  # with the weight of the prior for the fleet
    estimated = solver.estimate()
    robust = solver.uncertainty(estimated)
    robots = []
    for r, (name, logs) in enumerate(logs_by_robot.items()):
        progress("fitting the fleet", (r + 1) / (len(logs_by_robot) + 1))
        own_fit = solver.view(estimated, robust, model.selection(r), replace(experiment, logs=tuple(logs)))
        robots.append(FleetRobot(name, solver.evaluated(own_fit, logs), solver.errors_alone(own_fit, logs)))
    mean = solver.view(estimated, robust, model.mean, experiment)
    mean = replace(
        mean,
        train=_merged(fit.train, [robot.fit.train for robot in robots]),
        validation=_merged(fit.validation, [robot.fit.validation for robot in robots]),
    )
    robots = [replace(robot, outliers=tuple(_outliers(robot, robots, model))) for robot in robots]
    notices = (*_lasting_notices(fit, experiment), *_general_notices(mean), *cluster_notices(robust, solver.data))
    return Fleet(replace(mean, notices=(*notices, *_outlier_notices(robots))), pool, tuple(robots))


def check_fleet(pool: Pool, experiment: Experiment) -> None:
    """Check that a fleet can be fitted, before the work is done.

    Raises
    ------
    ConfigError
        If the logs are not those of several robots, or these have nothing of their own.
    """
    if isinstance(experiment, ReducedExperiment):
        logs_of_robots(pool, experiment.logs)
        _check_own(pool, experiment)


def logs_of_robots(pool: Pool, logs: Sequence[ReducedLog]) -> dict[str, list[ReducedLog]]:
    """Logs by robot: as the configuration says, else by the folder that a log is in.

    Raises
    ------
    ConfigError
        If a log is of no robot or of several, or all are of one.
    """
    by_robot: dict[str, list[ReducedLog]] = {name: [] for name in pool.robots}
    for log in logs:
        by_robot.setdefault(_robot_of(pool, log.path), []).append(log)
    for name in by_robot:
        if name in ("", ".", "..") or "/" in name or "\\" in name or not name.isprintable():
            raise ConfigError(f"pool.robots: {printable(name)}", "cannot be the name of a folder; give another name")
    unused = [name for name, own in by_robot.items() if not own]
    if unused:
        raise ConfigError(f"pool.robots: {unused[0]}", "no log is of this robot; remove it, or correct its patterns")
    if len(by_robot) < 2:
        (name,) = by_robot
        what = f"all logs are of one robot, {printable(name)}"
        raise ConfigError("pool", f"{what}; put those of each robot into a folder, or list them under pool.robots")
    unfitted = [name for name, own in by_robot.items() if not any(log.train for log in own)]
    if unfitted:
        what = f"no log of {printable(unfitted[0])} is for the fit"
        raise ConfigError("pool", f"{what}; give one, or leave out its logs for validation")
    return by_robot


def _robot_of(pool: Pool, path: Path) -> str:
    if not pool.robots:
        return path.absolute().parent.name
    robots = []
    for name, patterns in pool.robots.items():
        if any(fnmatch(path.name, pattern) or fnmatch(str(path), pattern) for pattern in patterns):
            robots.append(name)
    if len(robots) != 1:
        what = f"the log {path.name} is of {join_names(robots) if robots else 'none of the robots'}"
        raise ConfigError("pool.robots", f"{what}; give patterns by which each log is of one robot")
    return robots[0]


def _check_own(pool: Pool, experiment: ReducedExperiment) -> None:
    """Refuse what no coefficient belongs to."""
    effects = {c.effect for c in experiment.equation.coefficients}
    for name in pool.own:
        has_any = pooled_model(experiment.equation, ["robot"], [name]).is_own.any()
        if not has_any:
            known = join_names(sorted(effects - {"rigid_body"}))
            raise ConfigError(f"pool.own: {name}", f"has no parameters in this model; it has friction, and {known}")


class _FleetSolver:
    """Estimates of a fleet.

    Parameters
    ----------
    fit
        The fit of one model to all logs.
    experiment
        Model and reduced logs.
    model
        The equation of all robots.
    logs_by_robot
        Logs of each robot.

    Attributes
    ----------
    data
        All logs in blocks, with rows of each robot.
    fit
        The fit, with the weight of the prior that the fleet's data accept.
    """

    def __init__(
        self,
        fit: Fit,
        experiment: ReducedExperiment,
        model: PooledModel,
        logs_by_robot: Mapping[str, Sequence[ReducedLog]],
    ) -> None:
        self._experiment = experiment
        self._model = model
        self._equalities = model.equalities(experiment.equalities)
        self.data: list[Blocks] = []
        for r, logs in enumerate(logs_by_robot.values()):
            self.data += [model.blocks(log, r) for log in training_blocks(experiment, logs)]
        self._total = merge_reductions([log.total for log in self.data])
        self.fit = self._with_weight(fit)

    def _with_weight(self, fit: Fit) -> Fit:
        """The fit with the weight of the prior that the fleet's data accept, if it is to be chosen."""
        if fit.path is None:
            return fit
        prior = self._experiment.config.regularization.model_copy(
            update={"mass_precision": fit.regularization.mass_precision}
        )
        noise = free_noise(self._model, self._total, self._equalities)
        with suppress(SolverError):  # if it is infeasible, the estimate says so
            path = regularization_path(self._model, fit.prior, self.data, fit.sets, prior, self._equalities, noise)
            return replace(fit, path=path, regularization=prior.with_weight(path.weight))
        return fit

    def estimate(self) -> Estimate:
        """The coefficients of all robots."""
        config = self._experiment.config
        return estimate(
            self._model,
            self.fit.prior,
            self._total,
            self.fit.sets,
            self.fit.regularization,
            self._equalities,
            config.solver.name,
            backend=config.solver.backend,
        )

    def uncertainty(self, estimated: Estimate) -> ClusterRobustEstimate:
        """Standard errors of the coefficients of all robots."""
        rng = np.random.default_rng(self._experiment.config.seed)
        return cluster_robust_estimate(self._model, self.data, estimated.noise, estimated.theta, self._equalities, rng)

    def view(self, estimated: Estimate, robust: ClusterRobustEstimate, M: Array, experiment: ReducedExperiment) -> Fit:
        """The fit with coefficients M theta, M (p, P), and their uncertainty; its errors are still to be evaluated."""
        fit = self.fit
        theta = M @ estimated.theta
        uncertainty = robust.uncertainty.of_combinations(M)
        analysis = replace(
            fit.uncertainty_analysis,
            theta=theta,
            uncertainty=uncertainty,
            cluster_robust=replace(
                robust, theta=M @ robust.theta, uncertainty=uncertainty, influence=robust.influence @ M.T
            ),
        )
        by_joint = estimated.noise.reshape(len(self._model.robots), -1)
        noise = np.sqrt(np.square(by_joint).mean(axis=0))
        own_estimate = replace(estimated, theta=theta, noise=noise)
        return replace(fit, experiment=experiment, estimate=own_estimate, uncertainty_analysis=analysis)

    def evaluated(self, own_fit: Fit, logs: Sequence[ReducedLog]) -> Fit:
        """A robot's fit with its errors on the robot's logs."""
        equation = self._experiment.equation
        models = {"identified": own_fit.estimate.theta, "prior": equation.prior}
        train = evaluate_reduced(equation, logs, models, held_out=False)
        validation = evaluate_reduced(equation, logs, models, held_out=True)
        return replace(own_fit, train=train, validation=validation)

    def errors_alone(self, own_fit: Fit, logs: Sequence[ReducedLog]) -> Errors:
        """Errors of a model that is fitted to a robot's logs alone."""
        experiment = self._experiment
        config = experiment.config
        data = training_blocks(experiment, logs)
        alone = estimate(
            experiment.equation,
            self.fit.prior,
            merge_reductions([log.total for log in data]),
            self.fit.sets,
            self.fit.regularization,
            experiment.equalities,
            config.solver.name,
            backend=config.solver.backend,
        )
        has_held_out = any(log.held_out for log in logs)
        evaluation = evaluate_reduced(experiment.equation, logs, {"alone": alone.theta}, has_held_out)
        return evaluation.errors["alone"]


def _merged(of_all: Evaluation, of_robots: Sequence[Evaluation]) -> Evaluation:
    """The errors of all logs, each by the model of its robot; the measured torque is what it was."""
    errors = {}
    for model, first in of_robots[0].errors.items():
        total = Errors.none(len(first.known_samples), 0)
        for evaluation in of_robots:
            own = evaluation.errors[model]
            total.samples += own.samples
            total.known_samples += own.known_samples
            total.sum_squares_in_band += own.sum_squares_in_band
            total.sum_squares_as_logged += own.sum_squares_as_logged
        errors[model] = total
    traces = tuple(trace for evaluation in of_robots for trace in evaluation.traces)
    return replace(of_all, errors=errors, traces=traces)


def _outliers(robot: FleetRobot, robots: Sequence[FleetRobot], model: PooledModel) -> Iterator[str]:
    """How a robot differs from the others, in words."""
    others = [other for other in robots if other is not robot]
    coefficients = model.of_one.coefficients
    for i in np.flatnonzero(model.is_own).tolist():
        value, error = _coefficient(robot, i)
        values, errors = np.array([_coefficient(other, i) for other in others]).T
        middle = float(np.median(values))
        spread = _MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))
        scatter = np.sqrt(error**2 + float(np.median(errors)) ** 2 + spread**2)
        difference = abs(value - middle)
        if difference > _MIN_RATIO * scatter and difference > _MIN_DIFFERENCE * abs(middle):
            c = coefficients[i]
            yield (
                f"{effect_name(c.effect)} of {c.owner} is {number(value)} {c.unit}, of the others "
                f"{_range_text(values)} (standard error {number(float(error))})"
            )
    gain = 1 - robot.error_alone / max(robot.error, np.finfo(float).tiny)
    if gain > _MIN_GAIN:
        yield f"a model fitted to its logs alone has {100 * gain:.0f} % less error: its bodies differ from the fleet's"


def _coefficient(robot: FleetRobot, index: int) -> tuple[float, float]:
    """Value and standard error of a robot's coefficient."""
    fit = robot.fit
    return float(fit.estimate.theta[index]), float(fit.uncertainty.standard_error[index])


def _range_text(values: Array) -> str:
    low, high = number(float(values.min())), number(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _lasting_notices(fit: Fit, experiment: ReducedExperiment) -> list[Notice]:
    """Notices of the fit of one model to all logs but for those about its errors and standard errors."""
    data = training_blocks(experiment, experiment.logs)
    of_errors = {*_general_notices(fit), *cluster_notices(fit.uncertainty_analysis.cluster_robust, data)}
    return [notice for notice in fit.notices if notice not in of_errors]


def _general_notices(fit: Fit) -> list[Notice]:
    """Notices about a model's bodies and errors."""
    evaluation = fit.validation if fit.has_held_out else fit.train
    return fit_notices(fit.experiment, fit, evaluation, fit.has_held_out)


def _outlier_notices(robots: Sequence[FleetRobot]) -> Iterator[Notice]:
    for robot in robots:
        advice = f"idtool diagnose robots/{robot.name}/identified.urdf LOG… --inertia fixed finds what it has or lacks"
        for outlier in robot.outliers:
            yield Notice("robot_stands_out", "warning", robot.name, outlier, advice)

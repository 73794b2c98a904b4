"""`fit_fleet`: one model of the bodies of several robots of one type, with friction of each robot's own.

Letters: theta (P,) coefficients of all robots, theta_r = M_r theta (p,) those of robot r.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, SolverError
from idtool.common.names import printable, suggestion
from idtool.common.notice import Notice
from idtool.common.number_text import number, with_error
from idtool.dynamics.effects import effect_name
from idtool.dynamics.effects.rigid_body import RIGID_BODY
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.experiment import Progress
from idtool.estimation.dataset.pooled_model import PooledModel, pooled_model
from idtool.estimation.dataset.reduced_logs import ReducedLog, training_blocks
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.robots_of_logs import robots_of_logs
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
from idtool.robot.config.pool import FRICTION, Pool

_OUTLIER_Z_SCORE = 4.0  # difference over its deviation: standard errors, and scatter of the others
_OUTLIER_DIFFERENCE = 0.3  # relative to the largest absolute value of all robots
_OUTLIER_ERROR_REDUCTION = 0.15  # relative, by a model fitted to the robot's logs alone
_DIAGNOSE = (
    "idtool diagnose with its model in robots/{robot}, its logs and --inertia fixed finds what it carries or lacks"
)
_MAD_TO_SIGMA = 1.4826  # of a normal distribution


@dataclass(frozen=True)
class Outlier:
    """A difference of a robot from the others.

    Attributes
    ----------
    text
        The difference in words.
    advice
        What to do about it; empty if the text is enough.
    """

    text: str
    advice: str = ""


@dataclass(frozen=True)
class FleetRobot:
    """One robot of a fleet.

    Attributes
    ----------
    name
        Its name.
    fit
        The fleet's model with its own friction, as a fit: estimate, uncertainty and errors on its logs.
    rms_error
        RMS torque error of this model, on held-out data if all robots have some, else on training data [N·m or N].
    rms_error_alone
        The same of a model that was fitted to its logs alone.
    outliers
        How it differs from the others.
    """

    name: str
    fit: Fit
    rms_error: float
    rms_error_alone: float
    outliers: tuple[Outlier, ...] = ()


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
        The fit of one model to all logs, which have been reduced. Its prior is that of the fleet; the prior's weight is
        chosen again if it was chosen from the data.
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
    all_have_held_out = all(any(log.held_out for log in logs) for logs in logs_by_robot.values())
    noise = estimated.noise.reshape(len(logs_by_robot), -1)
    robots = []
    for r, (name, logs) in enumerate(logs_by_robot.items()):
        progress("fitting the fleet", (r + 1) / (len(logs_by_robot) + 1))
        of_robot = replace(experiment, logs=tuple(logs))
        own_fit = solver.with_errors(
            solver.fit_of_combination(estimated, robust, model.selection(r), noise[r], of_robot), logs
        )
        evaluation = own_fit.validation if all_have_held_out else own_fit.train
        rms_error = _overall(evaluation.errors["identified"], experiment)
        rms_error_alone = _overall(solver.errors_alone(logs, all_have_held_out), experiment)
        robots.append(FleetRobot(name, own_fit, rms_error, rms_error_alone))
    mean_noise = np.sqrt(np.square(noise).mean(axis=0))
    mean = solver.fit_of_combination(estimated, robust, model.averaging, mean_noise, experiment)
    mean = replace(
        mean,
        train=_merged(fit.train, [robot.fit.train for robot in robots]),
        validation=_merged(fit.validation, [robot.fit.validation for robot in robots]),
    )
    robots = [replace(robot, outliers=tuple(_outliers(robot, robots, model))) for robot in robots]
    notices = (*_other_notices(fit, experiment), *_model_notices(mean), *cluster_notices(robust, solver.data))
    return Fleet(replace(mean, notices=(*notices, *_outlier_notices(robots))), pool, tuple(robots))


def _overall(errors: Errors, experiment: ReducedExperiment) -> float:
    """RMS error over all joints [N·m or N]."""
    return errors.rms(experiment.equation.joints)["overall"]


def check_fleet(pool: Pool, experiment: ReducedExperiment) -> None:
    """Check that a fleet can be fitted, before the work is done.

    Raises
    ------
    ConfigError
        If the logs are not those of several robots, or these have nothing of their own.
    """
    logs_of_robots(pool, experiment.logs)
    equation = experiment.equation
    for name in pool.own:
        if name == RIGID_BODY:
            raise ConfigError(f"pool.own: {name}", "bodies are what all robots share; list friction, or effects")
        if not pooled_model(equation, ["robot"], [name]).is_own.any():
            effects = [c.effect for c in equation.coefficients if c.effect != RIGID_BODY]
            known = [FRICTION, *dict.fromkeys(effects)]
            raise ConfigError(f"pool.own: {name}", f"has no parameters in this model; {suggestion(name, known)}")


def logs_of_robots(pool: Pool, logs: Sequence[ReducedLog]) -> dict[str, list[ReducedLog]]:
    """Logs by robot.

    Raises
    ------
    ConfigError
        As `robots_of_logs`, or if no log of a robot is for the fit.
    """
    by_robot: dict[str, list[ReducedLog]] = {}
    for log, robot in zip(logs, robots_of_logs(pool, [log.path for log in logs]), strict=True):
        by_robot.setdefault(robot, []).append(log)
    unfitted = [name for name, own in by_robot.items() if not any(log.train for log in own)]
    if unfitted:
        what = f"no log of {printable(unfitted[0])} is for the fit"
        raise ConfigError("pool", f"{what}; give one, or leave out its logs for validation")
    return by_robot


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
        return self._estimate(self._model, self._total, self._equalities)

    def uncertainty(self, estimated: Estimate) -> ClusterRobustEstimate:
        """Standard errors of the coefficients of all robots."""
        rng = np.random.default_rng(self._experiment.config.seed)
        return cluster_robust_estimate(self._model, self.data, estimated.noise, estimated.theta, self._equalities, rng)

    def fit_of_combination(
        self, estimated: Estimate, robust: ClusterRobustEstimate, M: Array, noise: Array, experiment: ReducedExperiment
    ) -> Fit:
        """The fit with coefficients M theta, M (p, P), and their covariance.

        Its torque errors, ``train`` and ``validation``, are still those of `fit`: the caller replaces them.
        """
        fit = self.fit
        combined_theta = M @ estimated.theta
        uncertainty = robust.uncertainty.of_combinations(M)
        analysis = replace(
            fit.uncertainty_analysis,
            theta=combined_theta,
            uncertainty=uncertainty,
            cluster_robust=replace(
                robust, theta=M @ robust.theta, uncertainty=uncertainty, influence=robust.influence @ M.T
            ),
        )
        own_estimate = replace(estimated, theta=combined_theta, noise=noise)
        return replace(fit, experiment=experiment, estimate=own_estimate, uncertainty_analysis=analysis)

    def with_errors(self, own_fit: Fit, logs: Sequence[ReducedLog]) -> Fit:
        """A robot's fit with its errors on the robot's logs."""
        equation = self._experiment.equation
        models = {"identified": own_fit.estimate.theta, "prior": equation.prior}
        train = evaluate_reduced(equation, logs, models, held_out=False)
        validation = evaluate_reduced(equation, logs, models, held_out=True)
        return replace(own_fit, train=train, validation=validation)

    def errors_alone(self, logs: Sequence[ReducedLog], held_out: bool) -> Errors:
        """Errors on a robot's held-out data, or its training data, of a model that is fitted to its logs alone."""
        equation = self._experiment.equation
        data = training_blocks(self._experiment, logs)
        alone = self._estimate(equation, merge_reductions([log.total for log in data]), self._experiment.equalities)
        return evaluate_reduced(equation, logs, {"alone": alone.theta}, held_out).errors["alone"]

    def _estimate(self, equation: LinearModel, reduction: Reduction, equalities: EqualityConstraints) -> Estimate:
        """Coefficients of an equation, with the prior and the settings of the fleet."""
        fit = self.fit
        solver = self._experiment.config.solver
        return estimate(
            equation,
            fit.prior,
            reduction,
            fit.sets,
            fit.regularization,
            equalities,
            solver.name,
            backend=solver.backend,
        )


def _merged(of_all: Evaluation, of_robots: Sequence[Evaluation]) -> Evaluation:
    """Torque errors of all logs, each by the model of its robot; the measured torque's deviation does not change."""
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


def _outliers(robot: FleetRobot, robots: Sequence[FleetRobot], model: PooledModel) -> Iterator[Outlier]:
    """Differences of a robot from the others. Single values tell which robot is odd only among three or more."""
    others = [other for other in robots if other is not robot]
    if len(others) > 1:
        yield from _coefficient_outliers(robot, others, model)
    reduction = 1 - robot.rms_error_alone / max(robot.rms_error, np.finfo(float).tiny)
    if reduction > _OUTLIER_ERROR_REDUCTION:
        better = f"a model fitted to its logs alone has {100 * reduction:.0f} % less error"
        yield Outlier(f"{better}: its bodies probably differ, as with a load", _DIAGNOSE.format(robot=robot.name))


def _coefficient_outliers(robot: FleetRobot, others: Sequence[FleetRobot], model: PooledModel) -> Iterator[Outlier]:
    """Coefficients of a robot that differ from the median of the others by more than errors and scatter explain."""
    for i in np.flatnonzero(model.is_own).tolist():
        value, standard_error = _coefficient(robot, i)
        values, standard_errors = np.array([_coefficient(other, i) for other in others]).T
        median = float(np.median(values))
        deviation_of_others = _MAD_TO_SIGMA * float(np.median(np.abs(values - median)))
        median_error = float(np.median(standard_errors))
        deviation = np.sqrt(standard_error**2 + median_error**2 + deviation_of_others**2)
        difference = abs(value - median)
        largest = max(abs(value), float(np.abs(values).max()))
        if difference > _OUTLIER_Z_SCORE * deviation and difference > _OUTLIER_DIFFERENCE * largest:
            c = model.single_robot.coefficients[i]
            with_unit = f"{' ± '.join(with_error(value, standard_error))} {c.unit}"
            yield Outlier(f"{effect_name(c.effect)} of {c.owner} is {with_unit}; the others have {_range_text(values)}")


def _coefficient(robot: FleetRobot, index: int) -> tuple[float, float]:
    """Value and standard error of a robot's coefficient."""
    fit = robot.fit
    return float(fit.estimate.theta[index]), float(fit.uncertainty.standard_error[index])


def _range_text(values: Array) -> str:
    """Least and greatest of some values."""
    low, high = number(float(values.min())), number(float(values.max()))
    return low if low == high else f"{low} to {high}"


def _other_notices(fit: Fit, experiment: ReducedExperiment) -> list[Notice]:
    """Notices of the fit of one model to all logs but for those that are made again for the fleet's model."""
    data = training_blocks(experiment, experiment.logs)
    made_again = {*_model_notices(fit), *cluster_notices(fit.uncertainty_analysis.cluster_robust, data)}
    return [notice for notice in fit.notices if notice not in made_again]


def _model_notices(fit: Fit) -> list[Notice]:
    """Notices about a model's bodies and errors."""
    evaluation = fit.validation if fit.has_held_out else fit.train
    return fit_notices(fit.experiment, fit, evaluation, fit.has_held_out)


def _outlier_notices(robots: Sequence[FleetRobot]) -> Iterator[Notice]:
    """Notices about robots that stand out."""
    for robot in robots:
        for outlier in robot.outliers:
            yield Notice("robot_stands_out", "warning", robot.name, outlier.text, outlier.advice)

"""The fit: from an experiment to estimated coefficients, their uncertainty and their prediction errors."""

from __future__ import annotations

import time
from dataclasses import replace

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.memory import release_freed_memory
from idtool.common.notice import Notice
from idtool.dynamics.effects import ParameterValue, effect_from_entry
from idtool.estimation.command_delay import CommandDelay, command_delay, with_delay
from idtool.estimation.controller_gains import ControllerGains, with_gains
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduced_logs import ReducedLog, is_reducible, reduce_logs, training_blocks
from idtool.estimation.evaluation.reduced_errors import TorqueEvaluator
from idtool.estimation.evaluation.rollouts import RolloutEvaluation, evaluate_rollouts, simulation_notices
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.estimation.fit_notices import fit_notices
from idtool.estimation.identification import Method, estimate_from_logs
from idtool.estimation.offset_notices import held_out_offset_notices, offset_notices
from idtool.estimation.problem.estimate import Estimate
from idtool.estimation.problem.regularization_path import RegularizationPath
from idtool.estimation.reduced_experiment import ReducedExperiment
from idtool.estimation.row_correlation import with_row_correlation
from idtool.estimation.row_noise import with_row_noise
from idtool.estimation.sensor_drift import with_sensor_drift
from idtool.estimation.uncertainty import UncertaintyAnalysis, uncertainty_analysis
from idtool.estimation.uncertainty.standard_errors import Uncertainty
from idtool.robot.body import Body
from idtool.robot.config import EffectEntry, Regularization
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets import ConstraintSet

_REFITS = 2  # where columns depend on the values of the coefficients


@dataclass(frozen=True)
class Fit:
    """An identified model.

    Attributes
    ----------
    experiment
        Model and data.
    method
        Least squares, or instrumental variables.
    sets
        The constraint set of each body.
    prior
        The bodies that the fit was pulled towards; see `prior_bodies`.
    estimate
        The coefficients with their certificate.
    regularization
        The prior with its weight as a number.
    path
        The choice of that weight; None where it was given.
    uncertainty_analysis
        Standard errors, and what they rest on.
    train, validation
        Errors of the ``identified`` and the ``prior`` model; ``validation`` has no samples where nothing was held out.
    simulation
        Rollouts of both models, on what was held out, else on the training data; None: not asked for.
    notices
        Plain sentences for the user.
    seconds
        Wall time of each stage.
    delay
        From command to torque, fitted; None: no torque comes from a command, or it was not asked for.
    """

    experiment: Experiment
    method: Method
    sets: tuple[ConstraintSet, ...]
    prior: tuple[Body, ...]
    estimate: Estimate
    regularization: Regularization
    path: RegularizationPath | None
    uncertainty_analysis: UncertaintyAnalysis
    train: Evaluation
    validation: Evaluation
    simulation: RolloutEvaluation | None
    notices: tuple[Notice, ...]
    seconds: dict[str, float]
    delay: CommandDelay | None
    gains: ControllerGains | None

    @property
    def has_held_out(self) -> bool:
        """True if data were held out for validation."""
        return self.validation.errors["identified"].samples > 0

    @property
    def evaluation(self) -> Evaluation:
        """Errors on the held-out data, or on the training data if nothing was held out."""
        return self.validation if self.has_held_out else self.train

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard errors."""
        return self.uncertainty_analysis.uncertainty

    def parameters(self, index: int) -> Array:
        """The identified parameters of the model's body of that index, shape (10,)."""
        return self.estimate.theta[PI_SIZE * index : PI_SIZE * (index + 1)]

    def effect_parameters(self, entry: EffectEntry) -> dict[str, ParameterValue]:
        """Linear parameters of one of the configuration's effects with their standard errors, by name."""
        key = effect_from_entry(entry, self.experiment.model).key
        effect_and_slice = self.experiment.equation.find_named_effect(key)
        if effect_and_slice is None:
            return {}
        effect, part = effect_and_slice
        return effect.parameters(self.estimate.theta[part], self.uncertainty.covariance[part, part])


def fit(
    experiment: Experiment,
    progress: Progress,
    simulate: bool = False,
    analyze_uncertainty: bool = False,
    method: Method = "ls",
) -> Fit:
    """Identify a model.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    simulate
        If true, simulate the identified model and the prior too.
    analyze_uncertainty
        If true, find the information source of each parameter, compare logs, and look for bias by noise.
    method
        Least squares, or instrumental variables.

    Raises
    ------
    LogError
        If there are fewer samples than it takes, or a joint does not move.
    ModelError
        If there are no instruments, as the model cannot be simulated.
    SolverError
        If the problem could not be solved.
    """
    clock = _Clock()
    delay: CommandDelay | None = None
    gains: ControllerGains | None = None
    data: tuple[Blocks, ...] | None = None
    reduced: tuple[ReducedLog, ...] | None = None
    if isinstance(experiment, ReducedExperiment):
        if method == "iv":
            raise ConfigError("--method iv", "needs the logs: a reduction does not hold their samples")
        reduced = experiment.logs
    else:
        experiment, gains = with_gains(experiment, progress)
        experiment, delay, data = with_delay(experiment, progress)
        if experiment.equation.contacts is not None:
            experiment = with_row_noise(experiment, progress)
            data = None  # reduced with other noise
        experiment, data = with_sensor_drift(experiment, progress, data)
        if delay is None and analyze_uncertainty:
            delay = command_delay(experiment, progress)
        clock.stop("delay")
        if is_reducible(experiment):
            reduced = reduce_logs(experiment, progress)
            clock.stop("reduce")
    if reduced is not None and data is None:
        data = training_blocks(experiment, reduced)

    decorrelated = with_row_correlation(experiment, progress)  # for the estimate only: errors are told row by row
    if decorrelated is not experiment:
        data = None
    identification = estimate_from_logs(decorrelated, method, progress, data)
    if experiment.equation.depends_on_parameters:
        path = identification.path
        for _ in range(_REFITS):
            equation = decorrelated.equation.linearized_at(identification.estimate.theta)
            decorrelated = replace(decorrelated, equation=equation)
            config = decorrelated.config.model_copy(update={"regularization": identification.regularization})
            identification = estimate_from_logs(replace(decorrelated, config=config), method, progress)
        identification = replace(identification, path=path)
        equation = experiment.equation.linearized_at(decorrelated.equation.operating_theta)
        experiment = replace(experiment, equation=equation)
    estimate = identification.estimate
    controller_notices = [notice for part in (gains, delay) if part for notice in part.notices]
    notices = [*experiment.notices, *controller_notices, *identification.notices]
    clock.stop("identify")

    models = {"identified": estimate.theta, "prior": experiment.equation.prior}
    evaluator = TorqueEvaluator(experiment, progress, reduced)
    train = evaluator.evaluate(models, held_out=False)
    validation = evaluator.evaluate(models, held_out=True)
    held_out = validation.errors["identified"].samples > 0
    if not held_out:
        message = "no data were held out: the training error says little about prediction"
        advice = "leave --holdout above 0, or give another log with --validate"
        notices.append(Notice("nothing_held_out", "warning", None, message, advice))
    notices += fit_notices(experiment, identification, validation if held_out else train, held_out)
    clock.stop("evaluate")

    delay_error = None
    if delay and delay.error:
        delay_error = delay.slope * delay.error
    analysis = uncertainty_analysis(
        experiment, identification, train.independent_samples, progress, analyze_uncertainty, delay_error, reduced
    )
    notices += analysis.notices
    notices += offset_notices(experiment, estimate.theta, analysis.uncertainty)
    notices += held_out_offset_notices(validation)
    clock.stop("uncertainty")

    fitted = Fit(
        experiment=experiment,
        method=method,
        sets=identification.sets,
        prior=identification.prior,
        estimate=estimate,
        regularization=identification.regularization,
        path=identification.path,
        uncertainty_analysis=analysis,
        train=train,
        validation=validation,
        simulation=None,
        notices=tuple(notices),
        seconds=clock.seconds,
        delay=delay,
        gains=gains,
    )
    if simulate:
        fitted = with_simulation(fitted, simulate_fit(fitted, progress))
    clock.stop("simulate")
    return fitted


def simulate_fit(fitted: Fit, progress: Progress) -> RolloutEvaluation | None:
    """Rollouts of an identified model and of its prior, on what was held out, else on the training data.

    None if nothing can be simulated; see `evaluate_rollouts`.
    """
    models = {"identified": fitted.estimate.theta, "prior": fitted.experiment.equation.prior}
    return evaluate_rollouts(fitted.experiment, models, fitted.has_held_out, progress)


def with_simulation(fitted: Fit, simulation: RolloutEvaluation | None) -> Fit:
    """A fit with rollouts of its models, and what there is to say about them."""
    notices = simulation_notices(simulation, "identified")
    return replace(fitted, simulation=simulation, notices=(*fitted.notices, *notices))


class _Clock:
    """Wall time of consecutive stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._started = time.perf_counter()

    def stop(self, stage: str) -> None:
        """Note the time of a stage that ends now, and return the memory that it freed; the next one begins."""
        release_freed_memory()
        now = time.perf_counter()
        self.seconds[stage] = now - self._started
        self._started = now

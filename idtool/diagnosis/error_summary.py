"""Errors of a model, in torque and in rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from idtool.common.arrays import Array
from idtool.diagnosis.records import ErrorSummary
from idtool.diagnosis.screen import sum_standard_error
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.rollouts import evaluate_rollouts
from idtool.estimation.evaluation.torque_errors import Errors, evaluate
from idtool.estimation.fit import Fit

MAX_ERROR_RATIO = 1.0005  # of the errors with an effect and without it, over all joints, that is no increase
NEGLIGIBLE_SHARE = 3e-3  # of a joint's torque: a smaller error does not matter

MAX_EXCUSED_RATIO = 1.01  # of these errors, that chance or reversals may explain
_MIN_INCREASE_SIGNIFICANCE = 2.0  # ratio of an increase to its standard error, that chance does not explain
_MODEL = "model"
_IDENTIFIED = "identified"


def evaluate_errors(experiment: Experiment, theta: Array, simulate: bool, progress: Progress) -> ErrorSummary:
    """Errors of a model on training and held-out data.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Its coefficients, shape (p,).
    simulate
        True to simulate it too, on the held-out data if there are any, else on the training data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    joints = experiment.equation.joints
    models = {_MODEL: theta}
    held_out = experiment.has_held_out
    train = evaluate(experiment, models, False, progress).errors[_MODEL]
    validation = evaluate(experiment, models, True, progress).errors[_MODEL] if held_out else None
    simulation = None
    if simulate:
        rollouts = evaluate_rollouts(experiment, models, held_out, progress)
        if rollouts is not None and _MODEL not in rollouts.failed:
            simulation = rollouts.errors[_MODEL].rmse(joints, "position")
    return _summary(train, validation, simulation, joints)


def errors_of_fit(fit: Fit) -> ErrorSummary:
    """Errors of an identified model, from its fit."""
    joints = fit.experiment.equation.joints
    train = fit.train.errors[_IDENTIFIED]
    validation = fit.validation.errors[_IDENTIFIED] if fit.has_held_out else None
    simulation = None
    if fit.simulation is not None and _IDENTIFIED not in fit.simulation.failed:
        simulation = fit.simulation.errors[_IDENTIFIED].rmse(joints, "position")
    return _summary(train, validation, simulation, joints)


def _summary(
    train: Errors, validation: Errors | None, simulation: Mapping[str, float] | None, joints: Sequence[str]
) -> ErrorSummary:
    """Summary of the errors of a model; ``simulation`` are those of its rollouts."""
    deciding = train if validation is None else validation
    validation_rms = None if validation is None else validation.rms(joints)
    return ErrorSummary(train.rms(joints), validation_rms, simulation, deciding.sum_squares_by_second)


def increases_error(before: ErrorSummary, after: ErrorSummary) -> bool:
    """True if the torque error over all joints is larger, by more than chance explains.

    Chance explains an increase of less than 1 % that is below two standard errors, by the scatter of the increase over
    the seconds of the logs. The noise of the strongest joints can outweigh the whole effect of an effect on a weak one.
    """
    ratio = after.torque["overall"] / before.torque["overall"] if before.torque["overall"] > 0 else 1.0
    if not MAX_ERROR_RATIO < ratio < MAX_EXCUSED_RATIO:
        return ratio > MAX_ERROR_RATIO
    if before.torque_squares_by_second is None or after.torque_squares_by_second is None:
        return True
    increases = after.torque_squares_by_second - before.torque_squares_by_second
    with_samples = increases[before.torque_squares_by_second > 0]
    return bool(increases.sum() > _MIN_INCREASE_SIGNIFICANCE * sum_standard_error(with_samples))

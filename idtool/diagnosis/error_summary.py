"""Errors of a model, in torque and in rollouts."""

from __future__ import annotations

from idtool.common.arrays import Array
from idtool.diagnosis.records import ErrorSummary
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.rollouts import evaluate_rollouts
from idtool.estimation.evaluation.torque_errors import evaluate
from idtool.estimation.fit import Fit

MAX_ERROR_RATIO = 1.0005  # of the errors with an effect and without it, over all joints, that chance explains
NEGLIGIBLE_SHARE = 3e-3  # of a joint's torque: a smaller error does not matter

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
    train = evaluate(experiment, models, False, progress).errors[_MODEL].rms(joints)
    validation = None
    held_out = experiment.has_held_out
    if held_out:
        validation = evaluate(experiment, models, True, progress).errors[_MODEL].rms(joints)
    simulation = None
    if simulate:
        rollouts = evaluate_rollouts(experiment, models, held_out, progress)
        if _MODEL not in rollouts.failed:
            simulation = rollouts.errors[_MODEL].rmse(joints, "position")
    return ErrorSummary(train, validation, simulation)


def errors_of_fit(fit: Fit) -> ErrorSummary:
    """Errors of an identified model, from its fit."""
    joints = fit.experiment.equation.joints
    train = fit.train.errors[_IDENTIFIED].rms(joints)
    validation = fit.validation.errors[_IDENTIFIED].rms(joints) if fit.has_held_out else None
    simulation = None
    if fit.simulation is not None and _IDENTIFIED not in fit.simulation.failed:
        simulation = fit.simulation.errors[_IDENTIFIED].rmse(joints, "position")
    return ErrorSummary(train, validation, simulation)

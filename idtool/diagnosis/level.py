"""How well a model does, in torque and in rollouts."""

from __future__ import annotations

from idtool.common.arrays import Array
from idtool.diagnosis.records import Level
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.rollouts import evaluate_rollouts
from idtool.estimation.evaluation.validation import evaluate

MODEL = "model"


def level(experiment: Experiment, theta: Array, simulated: bool, progress: Progress) -> Level:
    """Errors of a model on training and held-out data.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Its coefficients, shape (p,).
    simulated
        Whether to run it forwards too, on what was held out, else on the training data.
    progress
        Told the stage and how far it has come.
    """
    joints, models = experiment.equation.joints, {MODEL: theta}
    held_out = any(run.held_out for run in experiment.runs)
    train = evaluate(experiment, models, False, progress).errors[MODEL].rms(joints)
    validation = evaluate(experiment, models, True, progress).errors[MODEL].rms(joints) if held_out else None
    run = evaluate_rollouts(experiment, models, held_out, progress) if simulated else None
    moved = None if run is None or MODEL in run.failed else run.errors[MODEL].rmse(joints, "position")
    return Level(train, validation, moved)

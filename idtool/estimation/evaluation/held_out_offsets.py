"""Offsets of wrench sensors in logs that a model was not fitted to, estimated from these logs themselves.

No model of a robot can know what a sensor will read without load after it was restarted. So for each model that is
compared, six numbers per sensor and log are taken from the log: those that leave least of its errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.dynamics.effects.effect import Effect
from idtool.dynamics.effects.wrench_sensor_offset import WrenchSensorOffset, further_offsets
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Run
from idtool.estimation.dataset.sensor_offsets import offset_rows

_RANK = 1e-10  # of the largest singular value: what lies below is not determined


@dataclass(frozen=True)
class LogModels:
    """Models with the offsets of one log.

    Attributes
    ----------
    equation
        The torque equation, with coefficients for the log's own offsets at the end.
    thetas
        Coefficients of each model by name, shape (p',).
    offsets
        By fixed joint, reading of its sensor without load at the beginning of the log by the first model, shape (6,)
        [N, N·m]; those that were estimated from the log.
    """

    equation: LinearModel
    thetas: Mapping[str, Array]
    offsets: Mapping[str, Array]


def models_in_log(experiment: Experiment, run: Run, held_out: bool, models: Mapping[str, Array]) -> LogModels:
    """Models with the offsets of wrench sensors in a log's part for validation, or for fitting.

    Offsets are estimated from what was held out if nothing of the log was fitted, or if they drift.

    Parameters
    ----------
    experiment
        Model and data.
    run
        The log.
    held_out
        True for its part for validation.
    models
        Name to coefficients, shape (p,).
    """
    equation = experiment.equation
    effects = held_out_offsets(experiment, run) if held_out else []
    if not effects:
        return LogModels(equation, models, {})
    further = LinearModel(equation.joints, tuple(effects), contacts=equation.contacts)
    changes = _offset_changes(equation, further, run, held_out, models)
    extended = with_further_effects(equation, effects)
    pairs = zip(models.items(), changes, strict=True)
    thetas = {name: np.concatenate([theta, change]) for (name, theta), change in pairs}

    first = next(iter(thetas.values()))
    readings = {}
    for i, sensor in enumerate(experiment.config.wrench_sensors):
        if sensor.has_offset_by_log and not run.train:
            (to_offset,) = offset_rows(experiment.model, extended, i, run.signals.recording, [0.0])
            readings[sensor.joint] = to_offset @ first
    return LogModels(extended, thetas, readings)


def held_out_offsets(experiment: Experiment, run: Run) -> list[WrenchSensorOffset]:
    """Effects whose coefficients are to be estimated from what was held out of a log."""
    sensors = {}
    for i, sensor in enumerate(experiment.config.wrench_sensors):
        is_new = sensor.has_offset_by_log and not run.train
        if is_new or sensor.has_drift:
            sensors[i] = sensor
    log = run.signals.log
    return further_offsets(experiment.model, sensors, run.signals.recording, float(log.t[-1] - log.t[0]))


def with_further_effects(equation: LinearModel, effects: Sequence[Effect]) -> LinearModel:
    """The equation with effects whose coefficients come after all others."""
    return replace(equation, effects=(*map(copy, equation.effects), *effects))


def _offset_changes(
    equation: LinearModel, further: LinearModel, run: Run, held_out: bool, models: Mapping[str, Array]
) -> Array:
    """Coefficients of further offsets that leave least of each model's errors, shape (models, m)."""
    thetas = np.stack(list(models.values()))
    count = len(further.coefficients)
    gram = np.zeros((count, count))
    score = np.zeros((len(thetas), count))
    noise = np.ones(len(equation.joints)) if equation.contacts is None else equation.contacts.noise
    for batch in run.signals.batches(run.parts(held_out)):
        columns = further.filtered_columns(batch, equation.row_filter(batch))
        measured, predicted, _ = equation.compared_torques(batch, thetas)
        for row, active in enumerate(further.active()):
            if not len(active):
                continue
            own = columns[row][:-1] / noise[row]
            errors = (measured[row] - predicted[:, row]) / noise[row]
            gram[np.ix_(active, active)] += own @ own.T
            score[:, active] += errors @ own.T
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    scaled = np.linalg.lstsq(gram / np.outer(size, size), (score / size).T, rcond=_RANK)[0]
    return np.asarray(scaled.T / size)

"""Drift of wrench sensors, switched on where the logs show it.

What a fit without drift leaves of a sensor's rows is averaged over blocks of time. If these means follow a drift along
one of the logs, the data are reduced with it, and the drift stays if it also predicts blocks that were not fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc

from idtool.common.arrays import Array, Indices
from idtool.dynamics.effects import build_effects
from idtool.dynamics.effects.wrench_sensor_offset import WrenchSensorOffset, drift_times
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.equality_constraints import EqualityConstraints, equality_constraints
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.weights import free_fit
from idtool.robot.config import WrenchSensor

_BLOCK_SECONDS = 2.0  # of a mean; less where logs are short
_BLOCKS = 10  # of a short log
_MAX_P_VALUE = 1e-4  # of no drift, up to which one is tried
_MAX_ERROR = 0.9  # of the squared error without drift, on blocks that were not fitted, up to which it stays


def with_sensor_drift(
    experiment: Experiment, progress: Progress, data: tuple[Blocks, ...] | None = None
) -> tuple[Experiment, tuple[Blocks, ...] | None]:
    """Find out which wrench sensors drift, of those whose configuration leaves it open.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    data
        The training data, if they have been reduced before.

    Returns
    -------
    The experiment with the drift in its equation, and the training data, if they have been reduced with it.
    """
    sensors = experiment.config.wrench_sensors
    open_sensors = [i for i, sensor in enumerate(sensors) if sensor.has_offset and sensor.drift == "auto"]
    if not open_sensors:
        return experiment, data
    if data is None:
        data = _reduced(experiment, progress)
    suspects = _suspects(experiment, data, open_sensors)
    if not suspects:
        return experiment, data

    blocks = [_regrouped(log) for log in data]
    without = _errors_on_other_half(experiment.equation, blocks, experiment.equalities)
    drifting = _with_drift(experiment, suspects)
    data_with_drift = _reduced(drifting, progress)
    blocks = [_regrouped(log) for log in data_with_drift]
    with_drift = _errors_on_other_half(drifting.equation, blocks, drifting.equalities)
    accepted = []
    for i in suspects:
        rows = experiment.model.sensor_coordinates(i)
        ratio = with_drift[rows] / np.where(without[rows] > 0, without[rows], 1.0)
        if ratio.mean() < _MAX_ERROR:
            accepted.append(i)
    if accepted == suspects:
        return drifting, data_with_drift
    if not accepted:
        return experiment, data
    drifting = _with_drift(experiment, accepted)
    return drifting, _reduced(drifting, progress)


def _reduced(experiment: Experiment, progress: Progress) -> tuple[Blocks, ...]:
    """The training data as R-factors."""
    return experiment.reduce_in_blocks(progress)


def _with_drift(experiment: Experiment, indices: Collection[int]) -> Experiment:
    """Experiment in whose equation the sensors of some indices drift."""
    sensors: list[WrenchSensor] = []
    for i, sensor in enumerate(experiment.config.wrench_sensors):
        sensors.append(sensor.model_copy(update={"drift": True}) if i in indices else sensor)
    config = experiment.config.model_copy(update={"wrench_sensors": tuple(sensors)})
    equation = replace(experiment.equation, effects=build_effects(experiment.model, config))
    equalities = equality_constraints(config, experiment.model, equation)
    return replace(experiment, config=config, equation=equation, equalities=equalities)


def _regrouped(log: Blocks) -> Blocks:
    """A log in blocks that are long enough for their errors to be independent."""
    seconds = min(_BLOCK_SECONDS, len(log) * log.seconds / _BLOCKS)
    return log.regrouped(max(round(seconds / log.seconds), 1))


def _suspects(experiment: Experiment, data: Sequence[Blocks], sensors: Sequence[int]) -> list[int]:
    """Sensors, by index, whose errors without drift follow one along a log."""
    equation, model = experiment.equation, experiment.model
    total = merge_reductions([log.total for log in data])
    theta = free_fit(equation, total, experiment.equalities).theta
    logs = [_regrouped(log) for log in data]
    active = equation.active()
    suspects = []
    for i in sensors:
        rows = range(*model.sensor_coordinates(i).indices(len(model.joints)))
        for effect, part in equation.effect_slices():
            if not isinstance(effect, WrenchSensorOffset) or effect.row not in rows:
                continue
            own = active[effect.row]
            columns = np.flatnonzero((own >= part.start) & (own < part.stop))
            means = [_mean_errors(log, effect.row, columns, theta[own]) for log in logs]
            p_values = [_p_value(errors, log.seconds) for errors, log in zip(means, logs, strict=True)]
            if i not in suspects and min(p_values) < _MAX_P_VALUE:
                suspects.append(i)
    return suspects


def _mean_errors(log: Blocks, row: int, columns: Indices, theta: Array) -> Array:
    """Mean error of a sensor's coordinate in each block of a log [N or N·m].

    Parameters
    ----------
    log
        The log.
    row
        Index of the coordinate.
    columns
        Columns of its offsets among those of the row, of which a log has one: a column of ones.
    theta
        Coefficients of the row, shape (m_j,).
    """
    means = []
    for block in log.parts:
        R = block[row].R
        if not len(R):
            continue
        sizes = np.square(R[:, columns]).sum(axis=0)
        ones = R[:, columns[np.argmax(sizes)]]
        if sizes.max() > 0:
            means.append(-float(ones @ (R @ np.append(theta, -1.0)) / sizes.max()))
    return np.array(means)


def _p_value(means: Array, seconds: float) -> float:
    """Probability that mean errors of blocks of a length [s] follow a drift as well by chance, by an F-test."""
    t = seconds * np.arange(len(means))
    times = drift_times(seconds * len(means))
    drift = np.column_stack([np.ones_like(t), *(np.maximum(t - time, 0.0) for time in times)])
    freedom = len(means) - drift.shape[1]
    if freedom < 1:
        return 1.0
    errors = means - drift @ np.linalg.lstsq(drift, means, rcond=None)[0]
    unexplained = float(errors @ errors) / freedom
    explained = (float(np.square(means - means.mean()).sum()) - float(errors @ errors)) / len(times)
    return float(fdtrc(len(times), freedom, explained / unexplained)) if unexplained > 0 else 1.0


def _errors_on_other_half(equation: LinearModel, data: Sequence[Blocks], equalities: EqualityConstraints) -> Array:
    """Sum of squared errors of each row on every other block under a fit to the rest, and vice versa, shape (nv,)."""
    halves = []
    for first in (0, 1):
        halves.append(merge_reductions([part for log in data for part in log.parts[first::2]]))
    errors = np.zeros(len(equation.joints))
    for fitted, other in (halves, halves[::-1]):
        theta = free_fit(equation, fitted, equalities).theta
        for row, (factor, active) in enumerate(zip(other, equation.active(), strict=True)):
            errors[row] += factor.squared_error(theta[active])
    return errors

"""Readings of the wrench sensors without load as functions of the coefficients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.effects.wrench_sensor_offset import WrenchSensorOffset
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows
from idtool.robot.model import WRENCH_SIZE, RobotModel


def offset_rows(model: RobotModel, equation: LinearModel, index: int, recording: str, times: Sequence[float]) -> Array:
    """Reading of a sensor without load per coefficient at times of a log, shape (times, 6, p).

    Parameters
    ----------
    model, equation
        The robot.
    index
        Index of the sensor among the wrench sensors of the model.
    recording
        The log, as `Motion.recording`.
    times
        Times since the log's first sample [s].
    """
    to_body = list(model.wrench_sensors.values())[index]
    first = model.sensor_coordinates(index).start
    on_body = np.zeros((len(times), WRENCH_SIZE, len(equation.coefficients)))
    for effect, part in equation.effect_slices():
        if isinstance(effect, WrenchSensorOffset) and first <= effect.row < first + WRENCH_SIZE:
            on_body[:, effect.row - first, part] = effect.shares(recording, np.asarray(times)).T
    return np.asarray(np.linalg.inv(to_body) @ on_body)


def has_offset(model: RobotModel, equation: LinearModel, index: int) -> bool:
    """True if the offset of a sensor, by its index, is a coefficient."""
    coordinates = range(*model.sensor_coordinates(index).indices(len(model.joints)))
    return any(isinstance(effect, WrenchSensorOffset) and effect.row in coordinates for effect in equation.effects)


def with_offsets_of(equation: LinearModel, data: Reduction, noise: Array, theta: Array) -> Array:
    """Coefficients with the offsets of wrench sensors that leave least of the errors on some data, shape (..., p).

    Offsets that the data do not contain, such as those of other logs, remain.

    Parameters
    ----------
    equation
        The torque equation.
    data
        The data.
    noise
        Residual noise of every row, shape (nv,).
    theta
        Coefficients, shape (..., p).
    """
    indices = [
        i
        for effect, part in equation.effect_slices()
        if isinstance(effect, WrenchSensorOffset) and effect.recordings != ("",)
        for i in range(part.start, part.stop)
    ]
    if not indices:
        return theta
    rows = weighted_rows(equation, data, noise)
    errors = theta @ rows[:, :-1].T - rows[:, -1]
    changed = theta.copy()
    changed[..., indices] -= np.linalg.lstsq(rows[:, indices], errors.T, rcond=None)[0].T
    return changed

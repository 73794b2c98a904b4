"""Notices about the offsets of wrench sensors: that they differ between logs, drift, or follow from a log itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.estimation.dataset.experiment import Experiment, Run
from idtool.estimation.dataset.sensor_offsets import has_offset, offset_rows
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.estimation.uncertainty.standard_errors import Uncertainty

_MIN_RATIO = 5.0  # of a difference to its standard error, from which it is no noise
_MOST_LOGS = 50  # that are compared


def offset_notices(experiment: Experiment, theta: Array, uncertainty: Uncertainty) -> Iterator[Notice]:
    """Notices about the identified offsets of wrench sensors.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    uncertainty
        Their uncertainty.
    """
    runs = [run for run in experiment.runs if run.train]
    for i, sensor in enumerate(experiment.config.wrench_sensors):
        if not has_offset(experiment.model, experiment.equation, i):
            continue
        if sensor.has_offset_by_log and len(runs) > 1:
            offsets = [_rows(experiment, i, run, [_middle(run)])[0] for run in runs[:_MOST_LOGS]]
            differences = [b - a for a, b in combinations(offsets, 2)]
            if size := _largest_text(differences, theta, uncertainty):
                message = f"its offset differs between logs by {size}; each log has its own"
                yield Notice("wrench_sensor_offset_differs", "note", sensor.joint, message)
        if sensor.has_drift:
            drifts = []
            for run in runs:
                first, last = _rows(experiment, i, run, run.fitted_times)
                drifts.append(last - first)
            if size := _largest_text(drifts, theta, uncertainty):
                largest = int(np.argmax([_force(rows, theta) for rows in drifts]))
                start, stop = runs[largest].fitted_times
                where = f"in {stop - start:.0f} s of {runs[largest].signals.recording}"
                message = f"its offset drifts by {size} {where}; the drift is identified along with the robot"
                advice = "let the sensor warm up before you log, or log for a shorter time"
                yield Notice("wrench_sensor_drift", "warning", sensor.joint, message, advice)


def held_out_offset_notices(evaluation: Evaluation) -> Iterator[Notice]:
    """Notice about offsets that were estimated from the logs that they are used for."""
    names = list(evaluation.sensor_offsets)
    if names:
        joints = list(dict.fromkeys(joint for own in evaluation.sensor_offsets.values() for joint in own))
        message = f"the offset of {join_names(joints)} in {join_names(names)} was estimated from the log itself"
        advice = "to use the offset of the model, set common_offset: true"
        yield Notice("wrench_sensor_offset_reestimated", "note", "wrench_sensors", message, advice)


def _rows(experiment: Experiment, sensor: int, run: Run, times: Sequence[float]) -> Array:
    """`offset_rows` in a log."""
    return offset_rows(experiment.model, experiment.equation, sensor, run.signals.recording, times)


def _middle(run: Run) -> float:
    """Time in the middle of what is fitted of a log, since its first sample [s]."""
    return float(np.mean(run.fitted_times))


def _force(rows: Array, theta: Array) -> float:
    """Length of the force of a wrench per coefficient, shape (6, p) [N]."""
    return float(np.linalg.norm(rows[:3] @ theta))


def _largest_text(changes: list[Array], theta: Array, uncertainty: Uncertainty) -> str:
    """Largest force and moment of changes per coefficient, shape (6, p) each; empty if all may be noise."""
    errors = [uncertainty.of(rows) for rows in changes]
    is_significant = [
        bool((np.abs(rows @ theta) > _MIN_RATIO * error).any()) for rows, error in zip(changes, errors, strict=True)
    ]
    if not any(is_significant):
        return ""
    force = max(_force(rows, theta) for rows in changes)
    moment = max(float(np.linalg.norm(rows[3:] @ theta)) for rows in changes)
    return f"{short_number(force, 2)} N and {short_number(moment, 2)} N·m"

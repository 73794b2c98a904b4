"""Location of a residual: on which joints, when, and in which region of state, before it has a name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array, Mask, mask_runs
from idtool.diagnosis.records import ResidualLocation
from idtool.diagnosis.regions import JointResidual, describe_region
from idtool.diagnosis.residual_series import ResidualSeries, residual_series
from idtool.estimation.dataset.experiment import Experiment, Progress

_MIN_RELATIVE_GAIN = 0.1  # of the largest relative gain of a joint: others do not disagree
_MIN_SIGNIFICANCE = 3.0  # times what chance loses
_ABOVE_FLOOR = 1.1  # times the noise floor, that a residual must exceed
_BLOCKS = 36  # of time, to estimate what chance does
_MAX_ENERGY = 0.8  # of the energy, that windows are to hold
_MAX_TIME = 0.45  # of the time, that windows may take
_CELL = 0.1  # s, of which windows are made
_MAX_CELLS = 600
_MIN_GAP = 0.5  # s between windows
_MAX_WINDOWS = 12
_MIN_WINDOW_ENERGY = 0.02  # of the energy


def localize_residual(
    before: Experiment, theta_before: Array, after: Experiment, theta_after: Array, progress: Progress
) -> ResidualLocation:
    """Location of the residual that a diagnosis step explains.

    Parameters
    ----------
    before, after
        Model and data without and with the effect; the logs are the same.
    theta_before, theta_after
        Coefficients, shape (p,) each.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    models = [(before.equation, theta_before), (after.equation, theta_after)]
    series = residual_series(before, models, progress, "locating the explained residual")
    squares_before, squares_after = np.square(series.residuals)
    explained = series.residuals[0] - series.residuals[1]
    gain = squares_before - squares_after
    return _locate(before, series, gain, squares_before, explained, at_least_one=True)


def localize_unexplained(
    experiment: Experiment, theta: Array, floor: Mapping[str, float], progress: Progress
) -> dict[str, ResidualLocation]:
    """Location of the remaining residual, for each joint that still disagrees.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    floor
        Noise floor, rms by joint [N·m or N].
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    series = residual_series(experiment, [(experiment.equation, theta)], progress, "locating the remaining residual")
    joints = experiment.equation.joints
    noise = np.array([floor[name] for name in joints])[:, None]
    squares = np.square(series.residuals[0])
    above_floor = squares - np.square(_ABOVE_FLOOR * noise)
    locations = {}
    for j, name in enumerate(joints):
        gain = np.zeros_like(squares)
        gain[j] = above_floor[j]
        location = _locate(experiment, series, gain, squares, series.residuals[0])
        if location.joints:
            locations[name] = location
    return locations


def _locate(
    experiment: Experiment,
    series: ResidualSeries,
    gain: Array,
    squares: Array,
    torque: Array,
    at_least_one: bool = False,
) -> ResidualLocation:
    """Location of a gain.

    Parameters
    ----------
    experiment, series
        The logs.
    gain, squares
        Reduction of the squared residual, and the squared residual, shape (nv, n).
    torque
        The torque explained, shape (nv, n).
    at_least_one
        True if the joint with the largest gain disagrees in any case, even by chance.
    """
    time = series.dt * series.valid
    energy = gain * time
    total = np.maximum((squares * time).sum(axis=1), 1e-300)
    relative_gain = energy.sum(axis=1) / total
    is_significant = energy.sum(axis=1) > _MIN_SIGNIFICANCE * _chance(energy)
    disagrees = is_significant & (relative_gain > _MIN_RELATIVE_GAIN * max(relative_gain.max(), 0.0))
    if at_least_one and not disagrees.any():
        disagrees = (relative_gain > 0) & (relative_gain == relative_gain.max())
    if not disagrees.any():
        return ResidualLocation((), (), "")

    joints = experiment.equation.joints
    relative_energy = (energy / total[:, None])[disagrees].sum(axis=0)
    windows = energy_windows(series, relative_energy, series.valid[disagrees].any(axis=0))
    j = int(np.argmax(np.where(disagrees, relative_gain, -np.inf)))
    residual = JointResidual(
        series=series,
        joint=j,
        names=joints,
        is_prismatic=tuple(experiment.model.units[name] == "N" for name in joints),
        band=experiment.band_hz,
        energy=energy[j],
        torque=torque[j],
        name_joint=int(disagrees.sum()) > 1,
        is_one_log=len(experiment.runs) == 1,
    )
    names = tuple(name for name, own in zip(joints, disagrees, strict=True) if own)
    return ResidualLocation(names, windows, describe_region(residual, windows))


def _chance(energy: Array) -> Array:
    """Gain that chance may make, estimated from what it loses in blocks of time, shape (nv,)."""
    starts = np.linspace(0, energy.shape[1], _BLOCKS, endpoint=False).astype(int)
    losses = np.minimum(np.add.reduceat(energy, starts, axis=1), 0.0)
    return np.asarray(np.sqrt(2 * np.square(losses).sum(axis=1)))


def energy_windows(series: ResidualSeries, energy: Array, valid: Mask) -> tuple[tuple[float, float], ...]:
    """Time intervals that contain most of an energy in little of the time [s]; none if there are no such.

    Parameters
    ----------
    series
        Times.
    energy
        Energy of each sample, shape (n,).
    valid
        Mask of the samples that count, shape (n,).
    """
    first = float(series.t[0])
    last = float(series.t[-1])
    cell = max(_CELL, (last - first) / _MAX_CELLS)
    index = ((series.t - first) / cell).astype(int)
    cell_energy = np.bincount(index, energy)
    cell_time = np.bincount(index, series.dt * valid)
    total = cell_energy.sum()
    density = cell_energy / np.maximum(cell_time, cell / 2)
    order = np.argsort(-density)
    most = int(np.searchsorted(np.cumsum(cell_energy[order]), _MAX_ENERGY * total)) + 1
    dense = int(np.count_nonzero(density > total / cell_time.sum()))
    chosen = np.zeros(len(cell_energy), dtype=bool)
    chosen[order[: max(most, dense)]] = True
    chosen = _with_gaps_filled(chosen, max(round(_MIN_GAP / cell), 1))
    if cell_time[chosen].sum() > _MAX_TIME * cell_time.sum():
        return ()

    windows = []
    for i, j in mask_runs(chosen).tolist():
        if cell_energy[i:j].sum() > _MIN_WINDOW_ENERGY * total:
            windows.append((round(first + i * cell, 3), round(min(first + j * cell, last), 3)))
    return tuple(windows)


def _with_gaps_filled(chosen: Mask, min_gap: int) -> Mask:
    """Mask with its smallest gaps filled, until there are few runs, more than ``min_gap`` cells apart."""
    chosen = chosen.copy()
    while True:
        runs = mask_runs(chosen)
        gaps = runs[1:, 0] - runs[:-1, 1]
        if not len(gaps) or (len(runs) <= _MAX_WINDOWS and gaps.min() > min_gap):
            return chosen
        k = int(np.argmin(gaps))
        chosen[runs[k, 1] : runs[k + 1, 0]] = True

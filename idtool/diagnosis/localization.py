"""Where a disagreement lives: on which joints, when, and in which region of state, before it has a name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.diagnosis.bursts import bursts
from idtool.diagnosis.maps import residual_maps
from idtool.diagnosis.records import Where
from idtool.diagnosis.regions import Scene, in_words
from idtool.diagnosis.residual_series import ResidualSeries, series
from idtool.estimation.dataset.experiment import Experiment, Progress

__all__ = ["bursts", "localize_residual", "residual_maps", "unexplained"]


_SHARE = 0.1  # of the largest relative gain: with less, a joint is not concerned
_SURE = 3.0  # times what chance loses, that a gain must be
_FLOOR = 1.1  # times the noise floor: with less, nothing is left
_BLOCKS = 36  # of time, by which chance is told
_MOST = 0.8  # of the energy that windows hold
_LITTLE = 0.45  # of the time, at the most
_CELL = 0.1  # s, of which windows are made
_CELLS = 600  # at the most
_APART = 0.5  # s between windows, at least
_WINDOWS = 12  # at the most
_WORTH = 0.02  # of the energy, that a window holds at least


def localize_residual(
    before: Experiment, theta_before: Array, after: Experiment, theta_after: Array, progress: Progress
) -> Where:
    """Where the disagreement was that a step explains.

    Parameters
    ----------
    before, after
        Model and data without and with the effect; the logs are the same.
    theta_before, theta_after
        Coefficients, shape (p,) each.
    progress
        Told how far it has come.
    """
    models = [(before.equation, theta_before), (after.equation, theta_after)]
    found = series(before, models, progress, "locating what was explained")
    first, last = np.square(found.left)
    return _where(before, found, first - last, first, found.left[0] - found.left[1], at_least_one=True)


def unexplained(
    experiment: Experiment, theta: Array, floor: Mapping[str, float], progress: Progress
) -> dict[str, Where]:
    """Where the disagreement is that is left, for each joint that still disagrees.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    floor
        What no model could come below, rms by joint [N·m or N].
    progress
        Told how far it has come.
    """
    found = series(experiment, [(experiment.equation, theta)], progress, "locating what is left")
    noise = np.array([floor[name] for name in experiment.equation.joints])[:, None]
    square = np.square(found.left[0])
    left, where = square - np.square(_FLOOR * noise), {}
    for j, name in enumerate(experiment.equation.joints):
        own = np.zeros_like(left)
        own[j] = left[j]
        there = _where(experiment, found, own, square, found.left[0])
        if there.joints:
            where[name] = there
    return where


def _where(
    experiment: Experiment,
    found: ResidualSeries,
    saved: Array,
    square: Array,
    torque: Array,
    at_least_one: bool = False,
) -> Where:
    """By squares saved of those that there were, and the torque that made the difference; shape (nv, n) each."""
    time = found.step * found.kept
    saved, all_of_it = saved * time, np.maximum((square * time).sum(axis=1), 1e-300)
    relative = saved.sum(axis=1) / all_of_it
    sure = saved.sum(axis=1) > _SURE * _chance(saved)
    concerned = sure & (relative > _SHARE * max(relative.max(), 0.0))
    if at_least_one and not concerned.any():
        concerned = (relative > 0) & (relative == relative.max())
    if not concerned.any():
        return Where((), (), "")
    joints = experiment.equation.joints
    windows = windows_of(found, (saved / all_of_it[:, None])[concerned].sum(axis=0), found.kept[concerned].any(axis=0))
    j = int(np.argmax(np.where(concerned, relative, -np.inf)))
    still = np.stack([run.signals.velocity_deadband for run in experiment.runs]).max(axis=0)
    forces = tuple(experiment.model.units[name] == "N" for name in joints)
    several, one_log = int(concerned.sum()) > 1, len(experiment.runs) == 1
    scene = Scene(found, j, joints, forces, still, experiment.band_hz, saved[j], torque[j], several, one_log)
    return Where(tuple(n for n, c in zip(joints, concerned, strict=True) if c), windows, in_words(scene, windows))


def _chance(saved: Array) -> Array:
    """What chance may save, by what it loses in blocks of time, shape (nv,)."""
    blocks = np.add.reduceat(saved, np.linspace(0, saved.shape[1], _BLOCKS, endpoint=False).astype(int), axis=1)
    return np.asarray(np.sqrt(2 * np.square(np.minimum(blocks, 0.0)).sum(axis=1)))


def windows_of(found: ResidualSeries, energy: Array, kept: Mask) -> tuple[tuple[float, float], ...]:
    """Stretches of time that hold most of an energy in little of the time, [s]; none where there are no such.

    Parameters
    ----------
    found
        Times.
    energy
        Of each sample, shape (n,).
    kept
        Which samples say something, shape (n,).
    """
    first, last = float(found.t[0]), float(found.t[-1])
    cell = max(_CELL, (last - first) / _CELLS)
    index = ((found.t - first) / cell).astype(int)
    held, spent = np.bincount(index, energy), np.bincount(index, found.step * kept)
    density = held / np.maximum(spent, cell / 2)
    order = np.argsort(-density)
    most = int(np.searchsorted(np.cumsum(held[order]), _MOST * held.sum())) + 1
    dense = int(np.count_nonzero(density > held.sum() / spent.sum()))
    chosen = np.zeros(len(held), dtype=bool)
    chosen[order[: max(most, dense)]] = True
    chosen = _merged(chosen, max(round(_APART / cell), 1))
    if spent[chosen].sum() > _LITTLE * spent.sum():
        return ()
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False)).reshape(-1, 2).tolist()
    worth = [(i, j) for i, j in edges if held[i:j].sum() > _WORTH * held.sum()]
    return tuple((round(first + i * cell, 3), round(min(first + j * cell, last), 3)) for i, j in worth)


def _merged(chosen: Mask, apart: int) -> Mask:
    """The same with the smallest gaps filled, until there are few runs, a few cells apart."""
    while True:
        edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False)).reshape(-1, 2)
        gaps = edges[1:, 0] - edges[:-1, 1]
        if not len(gaps) or (len(edges) <= _WINDOWS and gaps.min() > apart):
            return chosen
        k = int(np.argmin(gaps))
        chosen = chosen.copy()
        chosen[edges[k, 1] : edges[k + 1, 0]] = True

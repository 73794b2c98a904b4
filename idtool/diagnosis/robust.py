"""A fit that does not heed stretches of time of which the model makes nothing.

Blocks of time are weighted by Tukey's biweight of their residuals, by which one that is far out does not count at all
(Beaton & Tukey 1974), again and again; up to half of the time may be out of the ordinary. Constraints are not heeded:
it is for finding such stretches, not for a model.

Letters: F blocks; nv joints; p coefficients; m_j of joint j's equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.estimation.dataset.blocks import block_rows, cut_into_blocks, most_blocks
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked

_ROUNDS = 15
_OUT = 3.0  # times the median: where a block does not count
_RIDGE = 1e-6  # of a column's squares: what the data do not say stays as it was


@dataclass(frozen=True)
class _Sums:
    """One joint: of each block, with residuals e under the coefficients that are started from.

    Attributes
    ----------
    active
        Indices of its coefficients, shape (m_j,).
    B, g, s
        Gram matrix of the columns, shape (F, m_j, m_j), their product with e, (F, m_j), and e's squares, (F,).
    rows
        How many there are, shape (F,).
    """

    active: Indices
    B: Array
    g: Array
    s: Array
    rows: Array

    def squares(self, change: Array) -> Array:
        """Mean squares of each block with other coefficients, shape (F,)."""
        d = change[self.active]
        return np.asarray(np.maximum(self.s - 2 * self.g @ d + self.B @ d @ d, 0.0) / np.maximum(self.rows, 1.0))


def robust(experiment: Experiment, theta: Array, progress: Progress) -> Array:
    """Coefficients that do not heed stretches of time that are out of the ordinary, shape (p,).

    Parameters
    ----------
    experiment
        Model and data; of training and held-out parts.
    theta
        Where to begin, shape (p,).
    progress
        Told how far it has come.
    """
    sums = _summed(experiment, theta, progress)
    change = np.zeros(len(theta))
    squares = np.array([one.squares(change) for one in sums])
    known = np.array([one.rows > 0 for one in sums])
    for _ in range(_ROUNDS):
        size = np.array(
            [max(float(np.median(s[k])), 1e-300) if k.any() else 1.0 for s, k in zip(squares, known, strict=True)]
        )
        level = np.sqrt((squares / size[:, None]).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
        out = _OUT * max(float(np.median(level)), 1e-12)
        weight = np.square(np.maximum(1 - np.square(level / out), 0.0))
        change = _solved(sums, weight, size, len(theta))
        squares = np.array([one.squares(change) for one in sums])
    return np.asarray(theta + change)


def _solved(sums: list[_Sums], weight: Array, size: Array, p: int) -> Array:
    """The change of theta that weighted least squares asks for."""
    A, b = np.zeros((p, p)), np.zeros(p)
    for one, square in zip(sums, size, strict=True):
        A[np.ix_(one.active, one.active)] += np.tensordot(weight / square, one.B, 1)
        b[one.active] += weight / square @ one.g
    scale = np.sqrt(np.maximum(A.diagonal(), 1e-300))
    return np.asarray(np.linalg.solve(A / scale[:, None] / scale + _RIDGE * np.eye(p), b / scale) / scale)


def _summed(experiment: Experiment, theta: Array, progress: Progress) -> list[_Sums]:
    active = experiment.equation.active()
    first = experiment.runs[0].signals
    step = first.low_pass.stride * first.log.dt
    rows = sum(part.stop - part.start for run in experiment.runs for part in run.signals.ranges)
    length = block_rows(rows // first.low_pass.stride, step, first.band_hz, most_blocks(active))
    found: list[list[tuple[Array, Array, float, int]]] = [[] for _ in active]
    for run in experiment.runs:
        signals = run.signals
        batches = tracked(signals.batches(), signals.ranges, progress, "looking for contacts")
        samples = map(experiment.equation.filtered_rows, batches)
        for part in cut_into_blocks(samples, length, signals.low_pass.redundancy):
            for own, columns, factor in zip(found, active, part, strict=True):
                Y = factor.R[:, :-1]
                e = factor.R[:, -1] - Y @ theta[columns]
                own.append((Y.T @ Y, Y.T @ e, float(e @ e), factor.rows))
    return [
        _Sums(columns, *(np.array(x, dtype=float) for x in zip(*own, strict=True)))
        for columns, own in zip(active, found, strict=True)
    ]

"""Robust fit, which ignores time intervals that the model can't explain at all.

Blocks of time are weighted by Tukey's biweight of their residuals, which ignores outliers altogether (Beaton & Tukey
1974), in iterations; up to half of the time may be unusual. Constraints are ignored too: the fit serves to find such
intervals, not as a model.

Letters: F blocks; nv joints; p coefficients; m_j of joint j's equation.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.estimation.dataset.blocks import cut_into_blocks
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked

_ITERATIONS = 15
_CUTOFF = 3.0  # times the median residual: a block beyond has no weight
_RIDGE = 1e-6  # of a column's squares: what the data do not determine stays as it was


@dataclass(frozen=True)
class _JointSums:
    """Sums of one joint by block, with residuals e at the initial coefficients.

    Attributes
    ----------
    active
        Indices of its coefficients, shape (m_j,).
    gram
        Gram matrices of the columns, shape (F, m_j, m_j).
    score
        Products of the columns with e, shape (F, m_j).
    sse
        Squares of e, shape (F,).
    rows
        Number of rows, shape (F,).
    """

    active: Indices
    gram: Array
    score: Array
    sse: Array
    rows: Array

    def mean_squares(self, change: Array) -> Array:
        """Mean squared residual of each block after a change of the coefficients, shape (F,)."""
        d = change[self.active]
        squares = np.maximum(self.sse - 2 * self.score @ d + self.gram @ d @ d, 0.0)
        return np.asarray(squares / np.maximum(self.rows, 1.0))


def robust_coefficients(experiment: Experiment, theta: Array, progress: Progress) -> Array:
    """Coefficients fitted without regard to unusual time intervals, shape (p,).

    Parameters
    ----------
    experiment
        Model and data; training and held-out parts are used.
    theta
        Initial coefficients, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    sums = _accumulate(experiment, theta, progress)
    has_rows = np.array([joint.rows > 0 for joint in sums])
    change = np.zeros(len(theta))
    squares = np.array([joint.mean_squares(change) for joint in sums])
    for _ in range(_ITERATIONS):
        scale = np.ones(len(sums))
        for j, mask in enumerate(has_rows):
            if mask.any():
                scale[j] = max(float(np.median(squares[j][mask])), 1e-300)
        level = np.sqrt((squares / scale[:, None]).sum(axis=0) / np.maximum(has_rows.sum(axis=0), 1))
        cutoff = _CUTOFF * max(float(np.median(level)), 1e-12)
        weight = np.square(np.maximum(1 - np.square(level / cutoff), 0.0))
        change = _weighted_least_squares(sums, weight, scale, len(theta))
        squares = np.array([joint.mean_squares(change) for joint in sums])
    return np.asarray(theta + change)


def _weighted_least_squares(sums: list[_JointSums], weight: Array, scale: Array, p: int) -> Array:
    """Change of theta, shape (p,), with weights of the blocks, (F,), and squared scales of the joints, (nv,)."""
    A = np.zeros((p, p))
    b = np.zeros(p)
    for joint, square in zip(sums, scale, strict=True):
        A[np.ix_(joint.active, joint.active)] += np.tensordot(weight / square, joint.gram, 1)
        b[joint.active] += weight / square @ joint.score
    size = np.sqrt(np.maximum(A.diagonal(), 1e-300))
    return np.asarray(np.linalg.solve(A / size[:, None] / size + _RIDGE * np.eye(p), b / size) / size)


def _accumulate(experiment: Experiment, theta: Array, progress: Progress) -> list[_JointSums]:
    active = experiment.equation.active()
    rows = [run.signals.batches().rows for run in experiment.runs]
    lengths = experiment.block_rows(experiment.runs, rows, experiment.columns_of_coefficients)

    by_joint: list[list[tuple[Array, Array, float, float]]] = [[] for _ in active]
    for run, length in zip(experiment.runs, lengths, strict=True):
        signals = run.signals
        batches = tracked(signals.batches(), signals.ranges, progress, "looking for contacts")
        samples = map(experiment.equation.counted_rows, batches)
        for _, block in cut_into_blocks(samples, length, signals.low_pass.redundancy):
            for blocks, columns, factor in zip(by_joint, active, block, strict=True):
                Y = factor.R[:, :-1]
                e = factor.R[:, -1] - Y @ theta[columns]
                blocks.append((Y.T @ Y, Y.T @ e, float(e @ e), factor.rows))

    sums = []
    for columns, blocks in zip(active, by_joint, strict=True):
        gram, score, sse, counts = (np.array(x, dtype=float) for x in zip(*blocks, strict=True))
        sums.append(_JointSums(columns, gram, score, sse, counts))
    return sums

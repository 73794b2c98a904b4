"""Comparison of two models on the held-out data, block of time by block, so that chance can be told from a change.

Letters: nv joints; B blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.dynamics.regressor import LinearModel

_BLOCK_SECONDS = 0.5
_MIN_SIGNIFICANCE = 2.5  # standard errors, by which an increase is no chance
_MIN_INCREASE = 0.05  # of a joint's squared error, below which an increase does not matter


@dataclass(frozen=True)
class HeldOutErrors:
    """Squared errors on the held-out data.

    Attributes
    ----------
    squares
        Sum of the squared residuals of each block, by joint, shape (B, nv) [(N·m)² or N²].
    counts
        Rows of each block, by joint, shape (B, nv).
    """

    squares: Array
    counts: Array

    @property
    def mean_squares(self) -> Array:
        """Mean squared residual by joint, shape (nv,) [(N·m)² or N²]; NaN without held-out rows."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.squares.sum(axis=0) / self.counts.sum(axis=0))

    def increased_joints(self, before: HeldOutErrors) -> list[int]:
        """Joints whose error is larger than before, beyond chance."""
        change = self.squares - before.squares
        total = change.sum(axis=0)
        chance = _MIN_SIGNIFICANCE * np.sqrt(len(change)) * change.std(axis=0)
        is_larger = (total > chance) & (total > _MIN_INCREASE * before.squares.sum(axis=0))
        return np.flatnonzero(is_larger).tolist()

    def is_improved(self, before: HeldOutErrors, noise: Array) -> bool:
        """True if the error is smaller than before in units of the noise, and that of no joint is larger beyond chance.

        Parameters
        ----------
        before
            Errors of the other model.
        noise
            Unit of each joint's rows, shape (nv,) [N·m or N].
        """
        if not self.counts.any():
            return True
        total = np.nansum(self.mean_squares / np.square(noise))
        total_before = np.nansum(before.mean_squares / np.square(noise))
        return bool(total < total_before) and not self.increased_joints(before)


def held_out_errors(linearized: LinearizedFit, row_equation: LinearModel) -> HeldOutErrors:
    """Squared errors of a model on the held-out data.

    Parameters
    ----------
    linearized
        The model.
    row_equation
        Equation at whose defined columns the rows count; with the fit's reversal margin, if it has one.
    """
    equation = linearized.experiment.equation
    theta = linearized.estimate.theta
    squares = []
    counts = []
    for run in linearized.experiment.runs:
        block_length = _BLOCK_SECONDS / (run.signals.low_pass.stride * run.signals.log.dt)
        for batch in linearized.experiment.batches(run, held_out=True):
            if linearized.reversal_margin:
                masks = row_equation.clean_samples(batch, linearized.reversal_margin)
            else:
                masks = row_equation.valid_samples(batch)
            block_index = (np.arange(len(batch.t)) / block_length).astype(int)
            block_count = int(block_index[-1]) + 1
            batch_squares = np.zeros((block_count, len(masks)))
            batch_counts = np.zeros((block_count, len(masks)))
            blocks = zip(equation.active(), equation.filtered_columns(batch), masks, strict=True)
            for j, (active, columns, mask) in enumerate(blocks):
                residual = columns[-1] - theta[active] @ columns[:-1]
                batch_squares[:, j] = np.bincount(block_index, np.square(residual) * mask, block_count)
                batch_counts[:, j] = np.bincount(block_index, mask, block_count)
            squares.append(batch_squares)
            counts.append(batch_counts)
    none = np.zeros((0, linearized.joint_count))
    return HeldOutErrors(np.concatenate([none, *squares]), np.concatenate([none, *counts]))

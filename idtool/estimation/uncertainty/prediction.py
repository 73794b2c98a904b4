"""Standard errors of the predicted torque along a motion, from the parameters' errors alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
from idtool.estimation.dataset.extreme_rows import BY_MEASURED_TORQUE
from idtool.estimation.dataset.reduced_logs import ReducedLog
from idtool.estimation.uncertainty.standard_errors import Uncertainty

_UNKNOWN = 1e-3  # share of a row's size in unobservable directions, above which its error is not known


@dataclass(frozen=True)
class Prediction:
    """Standard errors of the torque in the band.

    Attributes
    ----------
    rms, largest
        Over the samples whose error is known, shape (nv,) [N·m or N].
    unknown
        Share of the samples that lie in directions that the fitted data do not determine, shape (nv,).
    """

    rms: Array
    largest: Array
    unknown: Array


class _Errors:
    """Errors of the torque in the band, by joint.

    Parameters
    ----------
    uncertainty
        Of the coefficients.
    """

    def __init__(self, uncertainty: Uncertainty) -> None:
        directions = uncertainty.directions
        values, vectors = np.linalg.eigh(uncertainty.covariance_y)
        # (p, r), whose square is the covariance:
        self._root = directions.observable @ (vectors * np.sqrt(np.maximum(values, 0)))
        self._observable = directions.observable * directions.singular_values
        self._unobservable = directions.unobservable

    def variances(self, Y: Array, columns: Indices) -> tuple[Array, Mask]:
        """Variance of a joint's torque in rows, shape (n, m_j), and mask of those in which it is known; (n,) each."""
        seen = np.square(Y @ self._observable[columns]).sum(axis=1)
        unseen = np.square(Y @ self._unobservable[columns]).sum(axis=1)
        is_known = unseen <= _UNKNOWN**2 * (seen + unseen)
        return np.square(Y @ self._root[columns]).sum(axis=1), is_known


def reduced_prediction(
    equation: LinearModel, logs: Sequence[ReducedLog], uncertainty: Uncertainty, held_out: bool
) -> Prediction:
    """Compute the predicted torque's standard error from reduced logs.

    The root mean square is that of all rows, unless it is unknown at some of them; the rest is that of the rows with
    the least and greatest measured torque, whatever the prior was when the logs were reduced.

    Parameters
    ----------
    equation
        The torque equation.
    logs
        The logs.
    uncertainty
        Of the coefficients.
    held_out
        If true on the held-out parts, else on the training parts.
    """
    errors = _Errors(uncertainty)
    squares, largest, count, unknown = np.zeros((4, len(equation.joints)))
    for part in (part for log in logs for part in log.parts(held_out)):
        for j, (factor, drawn, columns) in enumerate(
            zip(part.comparison, part.extremes.rows, equation.active(), strict=True)
        ):
            chosen = drawn[:, BY_MEASURED_TORQUE, :-2]
            rows = chosen.reshape(chosen.shape[0] * chosen.shape[1], len(columns))
            rows = rows[np.isfinite(rows).all(axis=1)]
            variance, is_known = errors.variances(rows, columns)
            share_known = np.count_nonzero(is_known) / max(len(rows), 1)
            if is_known.all():
                of_all, _ = errors.variances(factor.R[:, :-2], columns)
                squares[j] += of_all.sum()
            else:
                squares[j] += factor.rows / len(rows) * variance[is_known].sum()
            largest[j] = max(largest[j], float(np.max(variance[is_known], initial=0.0)))
            count[j] += factor.rows
            unknown[j] += factor.rows * (1 - share_known) if len(rows) else 0.0
    known_count = np.maximum(count - unknown, 1)
    rms = np.sqrt(squares / known_count)
    return Prediction(rms, np.maximum(np.sqrt(largest), rms), unknown / np.maximum(count, 1))


def prediction(experiment: Experiment, uncertainty: Uncertainty, held_out: bool, progress: Progress) -> Prediction:
    """Compute the predicted torque's standard error.

    Parameters
    ----------
    experiment
        Model and data.
    uncertainty
        Of the coefficients.
    held_out
        If true on the held-out parts, else on the training parts.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    equation = experiment.equation
    errors = _Errors(uncertainty)
    squares, largest, count, unknown = np.zeros((4, len(equation.joints)))
    for run in experiment.runs:
        parts = run.parts(held_out)
        stage = f"errors on {run.signals.log.path.name}"
        for batch in tracked(run.signals.batches(parts), parts, progress, stage):
            for j, (block, columns) in enumerate(zip(equation.block(batch), equation.active(), strict=True)):
                variance, is_known = errors.variances(block[:-1].T, columns)
                squares[j] += variance[is_known].sum()
                largest[j] = max(largest[j], float(np.max(variance[is_known], initial=0.0)))
                count[j] += len(variance)
                unknown[j] += np.count_nonzero(~is_known)
    known_count = np.maximum(count - unknown, 1)
    return Prediction(np.sqrt(squares / known_count), np.sqrt(largest), unknown / np.maximum(count, 1))

"""Standard errors of the predicted torque along a motion, from the parameters' errors alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
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
    equation, directions = experiment.equation, uncertainty.directions
    values, vectors = np.linalg.eigh(uncertainty.covariance_y)
    root = directions.observable @ (vectors * np.sqrt(np.maximum(values, 0)))  # (p, r), whose square is the covariance
    observable = directions.observable * directions.singular_values
    unobservable = directions.unobservable
    squares, largest, count, unknown = np.zeros((4, len(equation.joints)))
    for run in experiment.runs:
        parts = run.parts(held_out)
        stage = f"errors on {run.signals.log.path.name}"
        for batch in tracked(run.signals.batches(parts), parts, progress, stage):
            for j, (block, columns) in enumerate(zip(equation.block(batch), equation.active(), strict=True)):
                Y = block[:-1].T
                seen = np.square(Y @ observable[columns]).sum(axis=1)
                unseen = np.square(Y @ unobservable[columns]).sum(axis=1)
                is_known = unseen <= _UNKNOWN**2 * (seen + unseen)
                variance = np.square(Y[is_known] @ root[columns]).sum(axis=1)
                squares[j] += variance.sum()
                largest[j] = max(largest[j], float(np.max(variance, initial=0.0)))
                count[j] += len(Y)
                unknown[j] += len(Y) - len(variance)
    known_count = np.maximum(count - unknown, 1)
    return Prediction(np.sqrt(squares / known_count), np.sqrt(largest), unknown / np.maximum(count, 1))

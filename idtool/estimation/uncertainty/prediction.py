"""How far off the predicted torque may be for the parameters' errors alone, along a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
from idtool.estimation.uncertainty.uncertainty import Uncertainty

_UNKNOWN = 1e-3  # of a row's size in directions that the data did not see, above which its error is not known


@dataclass(frozen=True)
class Prediction:
    """Standard errors of the torque in the band.

    Attributes
    ----------
    rms, largest
        Over the samples whose error is known, shape (nv,) [N·m or N].
    unknown
        Share of the samples that lie in directions that the fitted data do not see, shape (nv,).
    """

    rms: Array
    largest: Array
    unknown: Array


def prediction(experiment: Experiment, found: Uncertainty, held_out: bool, progress: Progress) -> Prediction:
    """Ask for the predicted torque's standard error.

    Parameters
    ----------
    experiment
        Model and data.
    found
        Of the coefficients.
    held_out
        Which parts.
    progress
        Told how far it has come.
    """
    seen, equation = found.directions, experiment.equation
    values, vectors = np.linalg.eigh(found.spread)
    root = seen.visible @ (vectors * np.sqrt(np.maximum(values, 0)))
    hidden, visible = seen.hidden, seen.visible * seen.gain
    squares, largest, count, unknown = np.zeros((4, len(equation.joints)))
    for run in experiment.runs:
        parts = run.held_out if held_out else run.train
        stage = f"errors on {run.signals.log.path.name}"
        for batch in tracked(run.signals.batches(parts), parts, progress, stage):
            for j, (rows, own) in enumerate(zip(equation.block(batch), equation.active(), strict=True)):
                Y = rows[:-1].T
                off, on = (np.square(Y @ ways[own]).sum(axis=1) for ways in (hidden, visible))
                known = off <= _UNKNOWN**2 * (on + off)
                variance = np.square(Y[known] @ root[own]).sum(axis=1)
                squares[j] += variance.sum()
                largest[j] = max(largest[j], float(np.max(variance, initial=0.0)))
                count[j] += len(Y)
                unknown[j] += len(Y) - len(variance)
    known_count = np.maximum(count - unknown, 1)
    return Prediction(np.sqrt(squares / known_count), np.sqrt(largest), unknown / np.maximum(count, 1))

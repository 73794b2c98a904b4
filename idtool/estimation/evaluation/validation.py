"""Torque errors of a model: RMS per joint, in the filter's band and against the torque as logged.

A figure without its band means nothing, so prediction and measurement go through the same zero-phase filter; the raw
figure leaves the measurement as it was logged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Batch
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
from idtool.estimation.evaluation.envelope import Envelope, Trace
from idtool.estimation.evaluation.spectrum import Correlations


@dataclass
class Errors:
    """Sums over samples, per joint, for one model.

    Attributes
    ----------
    samples
        Number of samples.
    band, raw
        Squared errors in the band, and against the torque as logged; shape (nv,) [(N·m)² or N²].
    """

    samples: int
    band: Array
    raw: Array

    def rms(self, joints: Sequence[str], raw: bool = False) -> dict[str, float]:
        """Root mean square by joint, and ``overall`` joints and samples [N·m or N]."""
        squares = (self.raw if raw else self.band) / max(self.samples, 1)
        return {
            **{name: float(value) for name, value in zip(joints, np.sqrt(squares), strict=True)},
            "overall": float(np.sqrt(squares.mean())),
        }


@dataclass(frozen=True)
class Evaluation:
    """Models against data.

    Attributes
    ----------
    errors
        By model.
    spread
        Standard deviation of the measured torque in the band, by joint; what the normalized rms is measured in.
    traces
        One per log.
    independent
        Number of independent samples in the first model's residual, by joint.
    """

    errors: Mapping[str, Errors]
    spread: Mapping[str, float]
    traces: tuple[Trace, ...]
    independent: Mapping[str, float]


def evaluate(
    experiment: Experiment, models: Mapping[str, Array], held_out: bool, progress: Progress, angles: bool = False
) -> Evaluation:
    """Predict the torque of the training or the held-out parts with one or more models.

    Parameters
    ----------
    experiment
        Model and data.
    models
        Name to coefficients, shape (p,).
    held_out
        If true the held-out parts, else the training parts.
    progress
        Callback for the stage and its progress, from 0 to 1.
    angles
        If true the traces hold the joints' positions too, as ``q``.
    """
    joints = experiment.equation.joints
    errors = {name: Errors(0, np.zeros(len(joints)), np.zeros(len(joints))) for name in models}
    moments = np.zeros((2, len(joints)))
    samples, stride = 0, 1
    traces, correlations = [], Correlations()
    for run in experiment.runs:
        parts = run.parts(held_out)
        if not parts:
            continue
        log, stride = run.signals.log, run.signals.low_pass.stride
        envelope = Envelope(parts, log.t)
        batches = run.signals.batches(parts, every_sample=True)
        for batch in tracked(batches, parts, progress, f"predicting {log.path.name}"):
            measured, predicted = _predict(experiment, batch, models)
            inner = slice(batch.before, len(batch.motion.t) - batch.after)
            for name, torque in predicted.items():
                errors[name].samples += torque.shape[1]
                errors[name].band += np.square(torque - measured).sum(axis=1)
                errors[name].raw += np.square(torque - batch.motion.logged_tau[:, inner]).sum(axis=1)
            moments += measured.sum(axis=1), np.square(measured).sum(axis=1)
            samples += measured.shape[1]
            residual = measured - next(iter(predicted.values()))
            correlations.add(residual, measured, stride, log.dt)
            curves = {"measured": measured, "residual": residual, **predicted}
            t = batch.motion.t[inner] + log.t[0]
            envelope.add(t, {**curves, "q": batch.motion.q[:, inner]} if angles else curves)
        traces.append(envelope.trace(log.path.name))
    mean, square = moments / max(samples, 1)
    spread = np.sqrt(np.maximum(square - mean**2, 0))
    independent = correlations.independent(stride)
    return Evaluation(
        errors,
        dict(zip(joints, spread.tolist(), strict=True)),
        tuple(traces),
        dict(zip(joints, independent.tolist(), strict=False)),
    )


def _predict(experiment: Experiment, batch: Batch, models: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Measured torque and each model's, in the band, at every sample."""
    torque = experiment.equation.torque(batch.motion, np.stack(list(models.values())))
    filtered = batch.filter(torque)
    return batch.filter(batch.motion.tau), dict(zip(models, filtered, strict=True))

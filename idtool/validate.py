"""How well a model predicts torque: RMS per joint, in the filter's band and against the torque as logged.

A figure without its band means nothing, so prediction and measurement go through the same zero-phase filter; the raw
figure leaves the measurement as it was logged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from idtool.experiment import Experiment, Progress, tracked
from idtool.signals import Batch

Array = NDArray[np.float64]

_TRACE_POINTS = 2000  # a curve is drawn as the least and greatest value in this many stretches of time


@dataclass
class Errors:
    """Sums over samples, per joint, for one model.

    Attributes
    ----------
    samples
        How many.
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


@dataclass
class Trace:
    """Curves for drawing, of bounded size: (t, least, greatest) in stretches of time.

    Attributes
    ----------
    name
        The log's.
    t
        Times [s], shape (points,).
    curves
        Name to values, shape (nv, points): ``measured``, ``residual`` (measured less the first model's) or a model's.
    """

    name: str
    t: Array
    curves: dict[str, Array] = field(default_factory=dict)


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
        One a log.
    """

    errors: Mapping[str, Errors]
    spread: Mapping[str, float]
    traces: tuple[Trace, ...]


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
        Which parts.
    progress
        Told how far it has come.
    angles
        Whether the traces hold the joints' positions too, as ``q``.
    """
    joints = experiment.equation.joints
    errors = {name: Errors(0, np.zeros(len(joints)), np.zeros(len(joints))) for name in models}
    moments = np.zeros((2, len(joints)))
    samples = 0
    traces = []
    for run in experiment.runs:
        parts = run.held_out if held_out else run.train
        if not parts:
            continue
        log = run.signals.log
        envelope = _Envelope(parts, log.t)
        batches = run.signals.batches(parts, every_sample=True)
        for batch in tracked(batches, parts, progress, f"predicting {log.path.name}"):
            measured, predicted = _predict(experiment, batch, models)
            inner = slice(batch.before, len(batch.motion.t) - batch.after)
            for name, torque in predicted.items():
                errors[name].samples += torque.shape[1]
                errors[name].band += np.square(torque - measured).sum(axis=1)
                errors[name].raw += np.square(torque - batch.motion.logged[:, inner]).sum(axis=1)
            moments += measured.sum(axis=1), np.square(measured).sum(axis=1)
            samples += measured.shape[1]
            residual = measured - next(iter(predicted.values()))
            curves = {"measured": measured, "residual": residual, **predicted}
            envelope.add(batch.motion.t[inner], {**curves, "q": batch.motion.q[:, inner]} if angles else curves)
        traces.append(envelope.trace(log.path.name))
    mean, square = moments / max(samples, 1)
    spread = np.sqrt(np.maximum(square - mean**2, 0))
    return Evaluation(errors, dict(zip(joints, spread.tolist(), strict=True)), tuple(traces))


def _predict(experiment: Experiment, batch: Batch, models: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Measured torque and each model's, in the band, at every sample."""
    torque = experiment.equation.torque(batch.motion, np.stack(list(models.values())))
    filtered = batch.filter(torque)
    return batch.filter(batch.motion.tau), dict(zip(models, filtered, strict=True))


class _Envelope:
    """Collects the least and greatest value of every curve in stretches of time, so that no spike is lost."""

    def __init__(self, parts: Sequence[slice], t: Array) -> None:
        self.start, self.stop = float(t[parts[0].start]), float(t[parts[-1].stop - 1])
        samples = sum(part.stop - part.start for part in parts)
        self.bins = min(_TRACE_POINTS, max(samples, 1))
        self.low: dict[str, Array] = {}
        self.high: dict[str, Array] = {}

    def add(self, t: Array, curves: Mapping[str, Array]) -> None:
        if not len(t):
            return
        share = (t - self.start) / max(self.stop - self.start, np.finfo(float).tiny)
        index = np.clip((share * self.bins).astype(int), 0, self.bins - 1)
        first = np.flatnonzero(np.diff(index, prepend=-1))
        for name, x in curves.items():
            low = self.low.setdefault(name, np.full((len(x), self.bins), np.inf))
            high = self.high.setdefault(name, np.full((len(x), self.bins), -np.inf))
            at = index[first]
            low[:, at] = np.minimum(low[:, at], np.minimum.reduceat(x, first, axis=1))
            high[:, at] = np.maximum(high[:, at], np.maximum.reduceat(x, first, axis=1))

    def trace(self, name: str) -> Trace:
        """Two points a stretch; NaN, a break in the line, where nothing was measured."""
        centres = self.start + (self.stop - self.start) * (np.arange(self.bins) + 0.5) / self.bins
        curves = {}
        for curve, low in self.low.items():
            pairs = np.stack([low, self.high[curve]], axis=-1).reshape(len(low), -1)
            curves[curve] = np.where(np.isfinite(pairs), pairs, np.nan)
        return Trace(name, np.repeat(centres, 2), curves)

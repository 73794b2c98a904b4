"""`ResidualSeries`: what models leave of the torque all along the logs, with the motion that it went with.

Training and held-out parts alike, in the band, at the band's own rate. Of logs too long to be held, every few batches
are left out.

Letters: nv joints, n samples, m models.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.signals import Batch
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked

Models = Sequence[tuple[LinearModel, Array]]

_MOST = 2e7  # numbers that are held


@dataclass(frozen=True)
class ResidualSeries:
    """Samples one after the other, log after log.

    Attributes
    ----------
    t
        Time since the first log's first sample, as if each log began where the last one ended [s], shape (n,).
    step
        How long each stands for [s], shape (n,).
    q, v, a
        Position, velocity, acceleration, shape (nv, n).
    tau
        Torque of the last model [N·m or N], shape (nv, n).
    left
        Measured torque less each model's, shape (m, nv, n).
    kept
        Whether it says something: not where the friction's sign is not known; shape (nv, n).
    starts
        Indices at which a stretch without a gap begins.
    """

    t: Array
    step: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    left: Array
    kept: Mask
    starts: tuple[int, ...]

    @property
    def stretches(self) -> tuple[slice, ...]:
        """Those without a gap."""
        return tuple(slice(*ends) for ends in zip(self.starts, (*self.starts[1:], len(self.t)), strict=True))


def series(experiment: Experiment, models: Models, progress: Progress, stage: str) -> ResidualSeries:
    """Follow models along all logs.

    Parameters
    ----------
    experiment
        Its logs.
    models
        Torque equations of the same joints, with their coefficients, shape (p,) each.
    progress
        Told how far it has come.
    stage
        What to call it.
    """
    signals = experiment.runs[0].signals
    samples = (experiment.samples(False) + experiment.samples(True)) / signals.low_pass.stride
    numbers = samples * len(signals.joints) * (4 + len(models))
    found = list(pieces(experiment, models, progress, stage, every=int(np.ceil(max(numbers / _MOST, 1)))))
    starts: list[int] = []
    count = 0
    for piece in found:
        starts += [count] * len(piece.starts)
        count += len(piece.t)
    names = ("t", "step", "q", "v", "a", "tau", "left", "kept")
    joined = {name: np.concatenate([getattr(piece, name) for piece in found], axis=-1) for name in names}
    return ResidualSeries(**joined, starts=tuple(starts))


def pieces(
    experiment: Experiment, models: Models, progress: Progress, stage: str, every: int = 1
) -> Iterator[ResidualSeries]:
    """The same in pieces of bounded size, one of ``every``; ``starts`` is empty in a piece that goes on."""
    first = 0.0
    for run in experiment.runs:
        signals = run.signals
        step = signals.low_pass.stride * signals.log.dt
        for i, batch in enumerate(tracked(signals.batches(), signals.ranges, progress, stage)):
            if i % every == 0:
                begins = every > 1 or batch.before < batch.low_pass.reach
                yield _piece(models, batch, first, step, begins)
        first += float(signals.log.t[-1] - signals.log.t[0]) + signals.log.dt


def _piece(models: Models, batch: Batch, first: float, step: float, begins: bool) -> ResidualSeries:
    motion, stride = batch.motion, batch.low_pass.stride
    inner = slice(batch.before, len(motion.t) - batch.after)
    torque = [motion.tau, *(equation.torque(motion, theta) for equation, theta in models)]
    measured, *predicted = batch.filter(np.stack(torque))
    kept = np.logical_and.reduce([np.stack(equation.valid_samples(batch)) for equation, _ in models])
    q, v, a = (x[:, inner][:, ::stride] for x in (motion.q, motion.v, motion.a))
    left = measured - np.stack(predicted)
    t = batch.t + first
    return ResidualSeries(t, np.full(len(t), step), q, v, a, predicted[-1], left, kept, (0,) if begins else ())

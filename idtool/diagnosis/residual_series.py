"""`ResidualSeries`: residual torque of models along the logs, with the motion.

Training and held-out parts alike, in the band, at the band's own rate. Of logs too long for memory, only every few
batches are used.

Letters: nv joints, n samples, m models.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.data.signals import Batch
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress

Models = Sequence[tuple[LinearModel, Array]]

MIN_SHARE = 0.05  # of a row, that tells its noise where contact forces leave no more of it

MAX_NUMBERS = 2e7  # in memory


@dataclass(frozen=True)
class ResidualSeries:
    """Samples of all logs, one log after the other.

    Attributes
    ----------
    t
        Time since the first log's first sample, as if each log began where the last one ended [s], shape (n,).
    dt
        Time that each sample represents [s], shape (n,).
    q, v, a
        Position, velocity, acceleration, shape (nv, n).
    tau
        Torque that the last model predicts [N·m or N], shape (nv, n).
    residuals
        Measured torque less each model's, as they are compared, shape (m, nv, n).
    valid
        False where the sign of the joint's friction is not known, shape (nv, n).
    velocity_deadband
        Speed below which the sign of a velocity is lost in its noise, shape (nv,) [rad/s or m/s].
    segment_starts
        Indices at which a segment without a gap begins.
    """

    t: Array
    dt: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    residuals: Array
    valid: Mask
    velocity_deadband: Array
    segment_starts: tuple[int, ...]

    @property
    def segments(self) -> tuple[slice, ...]:
        """Parts without a gap."""
        return segments_between(self.segment_starts, len(self.t))


def segments_between(starts: Sequence[int], count: int) -> tuple[slice, ...]:
    """Slices of ``count`` samples that begin at the starts, each up to the next."""
    ends = (*starts[1:], count)
    return tuple(slice(start, end) for start, end in zip(starts, ends, strict=True))


def residual_series(
    experiment: Experiment, models: Models, progress: Progress, stage: str, most_numbers: float = MAX_NUMBERS
) -> ResidualSeries:
    """Residuals of models along all logs.

    Parameters
    ----------
    experiment
        The logs.
    models
        Torque equations of the same joints, with their coefficients, shape (p,) each.
    progress
        Callback for the stage and its progress, from 0 to 1.
    stage
        Name of this stage.
    most_numbers
        About how many numbers may be in memory; of longer logs, every second batch, or every third and so on, is used.
    """
    signals = experiment.runs[0].signals
    samples = (experiment.samples(held_out=False) + experiment.samples(held_out=True)) / signals.low_pass.stride
    numbers = samples * len(signals.joints) * (4 + len(models))
    every = int(np.ceil(max(numbers / most_numbers, 1)))
    names = ("t", "dt", "q", "v", "a", "tau", "residuals", "valid")
    pieces: dict[str, list[Any]] = {name: [] for name in names}
    deadbands = []
    starts: list[int] = []
    count = 0
    for chunk in residual_chunks(experiment, models, progress, stage, every):
        if chunk.segment_starts:
            starts.append(count)
        count += len(chunk.t)
        deadbands.append(chunk.velocity_deadband)
        for name in names:
            pieces[name].append(getattr(chunk, name))
    # one of them is in memory twice at a time
    joined: dict[str, Any] = {name: np.concatenate(pieces.pop(name), axis=-1) for name in names}
    deadband = np.max(deadbands, axis=0)
    return ResidualSeries(**joined, velocity_deadband=deadband, segment_starts=tuple(starts))


def residual_chunks(
    experiment: Experiment, models: Models, progress: Progress, stage: str, every: int = 1
) -> Iterator[ResidualSeries]:
    """`residual_series` in chunks of bounded size, one of ``every``.

    ``segment_starts`` is empty in a chunk that continues the one before.
    """
    log_start = 0.0
    for run in experiment.runs:
        signals = run.signals
        dt = signals.row_step
        batches = signals.batches()[::every]
        for i, batch in enumerate(batches):
            progress(stage, i / len(batches))
            starts_segment = every > 1 or batch.before < batch.low_pass.reach
            yield _chunk(models, batch, log_start, dt, starts_segment)
        log_start += signals.log.duration + signals.log.dt


def _chunk(models: Models, batch: Batch, log_start: float, dt: float, starts_segment: bool) -> ResidualSeries:
    motion = batch.motion
    stride = batch.low_pass.stride
    inner = slice(batch.before, len(motion.t) - batch.after)
    predicted = []
    residuals = []
    valid = []
    for equation, theta in models:
        row_filter = equation.row_filter(batch)
        measured_torque, predicted_torque, _ = equation.compared_torques(batch, theta, row_filter)
        predicted.append(predicted_torque)
        residuals.append(measured_torque - predicted_torque)
        shares = np.array(row_filter.shares, dtype=float)
        valid.append(shares > MIN_SHARE)
    return ResidualSeries(
        t=batch.t + log_start,
        dt=np.full(len(batch.t), dt),
        q=motion.q[:, inner][:, ::stride].copy(),  # or every sample of the motion would stay in memory
        v=motion.v[:, inner][:, ::stride].copy(),
        a=motion.a[:, inner][:, ::stride].copy(),
        tau=predicted[-1],
        residuals=np.stack(residuals),
        valid=np.logical_and.reduce(valid),
        velocity_deadband=motion.velocity_deadband,
        segment_starts=(0,) if starts_segment else (),
    )

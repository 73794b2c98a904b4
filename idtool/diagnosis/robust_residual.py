"""`RobustResidual`: what a robust fit leaves along the logs, in units of each joint's noise.

Letters: nv joints, n samples.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.diagnosis.residual_series import residual_chunks, segments_between
from idtool.diagnosis.robust_fit import robust_coefficients
from idtool.estimation.dataset.experiment import Experiment, Progress

_MIN_NOISE = 1e-3  # of a joint's torque
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class RobustResidual:
    """Residual of a robust fit, in the band and at its rate.

    Attributes
    ----------
    t
        Time since the first sample of the first log [s], shape (n,).
    q, v
        Position and velocity, shape (nv, n).
    e
        Residual in units of the noise, shape (nv, n).
    noise
        Robust standard deviation of each joint's residual [N·m or N], shape (nv,).
    valid
        Mask of the samples at which it is known, shape (nv, n).
    segment_starts
        Indices at which a segment without a gap begins.
    """

    t: Array
    q: Array
    v: Array
    e: Array
    noise: Array
    valid: Mask
    segment_starts: tuple[int, ...]

    @property
    def segments(self) -> tuple[slice, ...]:
        """Parts without a gap."""
        return segments_between(self.segment_starts, len(self.t))

    def part(self, samples: slice, start: float) -> RobustResidual:
        """Samples of one log, whose times count from its own start [s]."""
        segment_starts = [
            first - samples.start for first in self.segment_starts if samples.start <= first < samples.stop
        ]
        q, v, e = (x[:, samples] for x in (self.q, self.v, self.e))
        return RobustResidual(
            self.t[samples] - start, q, v, e, self.noise, self.valid[:, samples], tuple(segment_starts)
        )

    @cached_property
    def levels(self) -> Array:
        """Rms over the joints, shape (n,)."""
        return _levels(self.e, self.valid)


def robust_residual(experiment: Experiment, theta: Array, progress: Progress, stage: str) -> RobustResidual:
    """Residual of a robust fit in units of each joint's noise.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients from which the fit starts, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.
    stage
        Name of this stage.
    """
    model = (experiment.equation, robust_coefficients(experiment, theta, progress))
    chunks = []
    segment_starts: list[int] = []
    count = 0
    torque_squares = np.zeros(len(experiment.equation.joints))
    for chunk in residual_chunks(experiment, [model], progress, stage):
        if chunk.segment_starts:
            segment_starts.append(count)
        count += len(chunk.t)
        torque_squares = torque_squares + np.square(chunk.tau).sum(axis=1)
        chunks.append((chunk.t, chunk.residuals[0], chunk.q, chunk.v, chunk.valid))
    t, residual, q, v, valid = (np.concatenate(arrays, axis=-1) for arrays in zip(*chunks, strict=True))

    noise = np.zeros(len(residual))
    for j, keep in enumerate(valid):
        if keep.any():
            noise[j] = _MAD_TO_SIGMA * float(np.median(np.abs(residual[j][keep])))
    noise = np.maximum(noise, _MIN_NOISE * np.sqrt(torque_squares / max(count, 1)))
    noise = np.where(noise > 0, noise, 1.0)
    return RobustResidual(t, q, v, residual / noise[:, None], noise, valid, tuple(segment_starts))


def _levels(residual: Array, valid: Mask) -> Array:
    """Rms over the valid joints, shape (n,); where none is, the lower of the nearest levels before and after."""
    count = valid.sum(axis=0)
    known = np.flatnonzero(count)
    if not len(known):
        return np.zeros(residual.shape[1])
    level = np.sqrt(np.square(residual * valid).sum(axis=0) / np.maximum(count, 1))
    after = np.minimum(np.searchsorted(known, np.arange(len(level))), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(level[known[before]], level[known[after]])
    return np.asarray(np.where(count > 0, level, nearest))

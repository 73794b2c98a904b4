"""The noise floor: what no model could come below, by the residual's own spectrum.

Noise of torque sensors is white, that of encoders grows with the fourth power of the frequency by the time that it has
become an acceleration. What a model lacks follows the motion, whose power is at low frequencies, or comes in bursts. So
the power density above the motion's, in the quieter moments, is fitted with N0 + N4 f^4 and taken for noise down to
0 Hz. Where a joint rests, friction can be anything up to its level: what is left there is no model's to explain either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.signal import periodogram

from idtool.common.arrays import Array, Mask
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked

_ABOVE = 0.3  # of the band, from where the residual's spectrum is taken for noise
_FITS = 4
_STANDS_OUT = 4.0  # times the noise: a line, and no noise
_SAMPLES = 64  # of a periodogram, at the decimated rate
_QUIET = 0.25  # of the moments
_OF_MEAN = -np.log(1 - _QUIET)  # that quantile of a periodogram of noise, over its mean
_LEAST = 12  # moments, to say anything
_MOVING = 0.7  # of a moment


@dataclass(frozen=True)
class Floor:
    """Noise in the residual, by joint.

    Attributes
    ----------
    rms
        What noise and rest leave in the band, shape (nv,) [N·m or N].
    noise, residual
        What noise and what the model leaves while the joint moves, shape (nv,).
    slow
        Power of the residual where the motion's is, over that of the noise there, shape (nv,).
    """

    rms: Array
    noise: Array
    residual: Array
    slow: Array

    def less(self, shares: Array) -> Floor:
        """The same where shares of the residual's power, shape (nv,), are known to be structure."""
        noise = np.minimum(self.noise, self.residual * np.sqrt(np.clip(1 - shares, 0.0, 1.0)))
        rms = np.sqrt(np.maximum(np.square(self.rms) - np.square(self.noise) + np.square(noise), 0.0))
        return replace(self, noise=noise, rms=rms)


@dataclass
class _Sums:
    moving: Array
    resting: Array
    count: Array
    rests: Array


def noise_floor(experiment: Experiment, theta: Array, progress: Progress, apart: float = 0.0) -> Floor:
    """The floor that the residual of a model shows, on what was held out, else on the training data.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Its coefficients, shape (p,).
    progress
        Told how far it has come.
    apart
        From reversals, that counts as moving [s].
    """
    held_out = any(run.held_out for run in experiment.runs)
    low_pass, dt = experiment.runs[0].signals.low_pass, experiment.runs[0].signals.log.dt
    sums = _Sums(*np.zeros((4, len(experiment.equation.joints))))
    powers: list[list[Array]] = [[] for _ in experiment.equation.joints]
    f: Array = np.fft.rfftfreq(_SAMPLES, dt * low_pass.stride).astype(np.float64)
    for run in experiment.runs:
        parts = run.held_out if held_out else run.train
        for batch in tracked(run.signals.batches(parts), parts, progress, "looking for the noise floor"):
            e = batch.filter(LinearizedModel(experiment.equation, theta, batch.motion).residual)
            keep = np.array(experiment.equation.clean_samples(batch, apart))
            sums.moving += (np.square(e) * keep).sum(axis=1)
            sums.resting += (np.square(e) * ~keep).sum(axis=1)
            sums.count, sums.rests = sums.count + keep.sum(axis=1), sums.rests + (~keep).sum(axis=1)
            for own, row, sure in zip(powers, e, keep, strict=True):
                own += _moments(row, sure, dt * low_pass.stride)
    residual = np.sqrt(sums.moving / np.maximum(sums.count, 1))
    through, band = _passed(low_pass.kernel, f, dt), experiment.band_hz
    found = [_judged(f, np.array(own), through, band) for own in powers]
    noise = np.minimum([rms if rms is not None else r for (rms, _), r in zip(found, residual, strict=True)], residual)
    total = (np.square(noise) * sums.count + sums.resting) / np.maximum(sums.count + sums.rests, 1)
    return Floor(np.sqrt(total), noise, residual, np.array([slow for _, slow in found]))


def _moments(e: Array, sure: Mask, dt: float) -> list[Array]:
    """Periodograms of stretches in which the joint moves most of the time; where it turns round, of a straight line."""
    if not sure.any():
        return []
    at = np.arange(len(e))
    whole = np.interp(at, at[sure], e[sure])
    starts = [k for k in range(0, len(e) - _SAMPLES + 1, _SAMPLES // 2) if sure[k : k + _SAMPLES].mean() > _MOVING]
    some = [whole[k : k + _SAMPLES] / np.sqrt(sure[k : k + _SAMPLES].mean()) for k in starts]
    return list(periodogram(np.array(some), 1 / dt, window="hann", detrend=False)[1]) if some else []


def _judged(f: Array, powers: Array, through: Array, band: float) -> tuple[float | None, float]:
    """Rms of the noise in the band, and the residual's power where the motion's is over the noise's."""
    if len(powers) < _LEAST:
        return None, 1.0
    quiet = np.quantile(powers, _QUIET, axis=0) / _OF_MEAN
    noise = _white(f, quiet / np.maximum(through, 1e-300), band) * through
    low = f < _ABOVE * band
    return float(np.sqrt(noise.sum() * (f[1] - f[0]))), float(powers.mean(axis=0)[low].sum() / noise[low].sum())


def _passed(kernel: Array, f: Array, dt: float) -> Array:
    """Share of the power at each frequency that the filter lets pass."""
    at = np.arange(len(kernel)) - len(kernel) // 2
    return np.square(np.cos(2 * np.pi * np.outer(f, at) * dt) @ kernel)


def _white(f: Array, density: Array, band: float) -> Array:
    """N0 + N4 f^4 by the density above the motion's, at all frequencies; what stands out is left out."""
    use = (f > _ABOVE * band) & (f < 0.95 * band)
    rows = np.column_stack([np.ones_like(f), (f / band) ** 4])
    noise = np.full_like(f, np.median(density[use]))
    for _ in range(_FITS):
        own = use & (density < _STANDS_OUT * noise)
        c, _ = nnls(rows[own] / noise[own, None], density[own] / noise[own])
        noise = np.maximum(rows @ c, 1e-3 * noise)
    return np.asarray(noise)

"""Power density of signals by Welch's method, as `scipy.signal.welch` has it, whose import takes 0.4 s."""

from __future__ import annotations

from typing import Literal

import numpy as np

from idtool.common.arrays import Array

_SEGMENTS_AT_ONCE = 64  # that are transformed together


def power_density(
    x: Array, dt: float, segment: int, average: Literal["mean", "median"] = "mean"
) -> tuple[Array, Array]:
    """One-sided power density: segments that overlap by half, each without its mean, under a Hann window.

    Parameters
    ----------
    x
        Evenly sampled, shape (..., N).
    dt
        Sample time [s].
    segment
        Samples of a segment, at most N.
    average
        Over the segments; the median is divided by its bias for noise.

    Returns
    -------
    Frequencies [Hz], shape (F,), and density [square of x's unit per Hz], shape (..., F).

    Source: Welch, The use of fast Fourier transform for the estimation of power spectra, 1967; bias of the median:
    Allen et al., FINDCHIRP, arXiv gr-qc/0509116, appendix B
    """
    segments = np.lib.stride_tricks.sliding_window_view(x, segment, axis=-1)[..., :: segment - segment // 2, :]
    count = segments.shape[-2]
    density = np.empty((*segments.shape[:-1], segment // 2 + 1))
    for first in range(0, count, _SEGMENTS_AT_ONCE):
        part = segments[..., first : first + _SEGMENTS_AT_ONCE, :]
        own = periodograms(part - part.mean(axis=-1, keepdims=True), dt)
        density[..., first : first + _SEGMENTS_AT_ONCE, :] = own
    if average == "median":
        k = 2.0 * np.arange(1, (count - 1) // 2 + 1)
        averaged = np.median(density, axis=-2) / (1 + (1 / (k + 1) - 1 / k).sum())
    else:
        averaged = density.mean(axis=-2)
    return np.asarray(np.fft.rfftfreq(segment, dt), dtype=float), np.asarray(averaged)


def periodograms(x: Array, dt: float) -> Array:
    """One-sided power density of series under a Hann window, shape (..., N) to (..., N // 2 + 1); dt [s] apart."""
    length = x.shape[-1]
    window = np.hanning(length + 1)[:-1]  # periodic
    spectrum = np.fft.rfft(x * window)
    density = (np.square(spectrum.real) + np.square(spectrum.imag)) * (dt / (window @ window or 1.0))
    density[..., 1 : (length + 1) // 2] *= 2  # all but 0 and the Nyquist frequency stand for a negative one too
    return np.asarray(density)

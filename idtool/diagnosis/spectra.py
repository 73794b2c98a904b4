"""Spectra of a torque over time frequency and over the angle of its joint.

Over frequency: Welch's method (1967). Over the angle: at each number of periods per turn n, the sine of n q that fits
best in least squares (Lomb 1976, with positions for times), by Fourier transforms of the torque binned by position.

Letters: n samples, f frequencies, a numbers of periods per turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, ComplexArray, Indices, Mask
from idtool.common.fourier import fast_length

WINDOW_SECONDS = 4.0  # length of the windows of Welch's method
_MAX_PERIODS = 300.0  # per turn
_BINS_PER_PERIOD = 16  # bins of position in the shortest period
_OVERSAMPLING = 8  # points of the angle spectrum per resolvable number of periods
_MAX_BINS = 1 << 20
_SLOW_QUANTILE = 0.25  # share of the samples in which the band must contain a ripple
_MIN_DETERMINANT = 1e-3  # below it, a fraction of a period: a sine can't be separated from a constant


def masked_power_density(
    x: Array, valid: Mask, dt: Array, segments: Sequence[slice], band: float
) -> tuple[Array, Array]:
    """One-sided power density over frequency.

    Parameters
    ----------
    x
        Samples, shape (n,).
    valid
        Which of them count, shape (n,); the others are taken as zero.
    dt
        Time from each to the next [s], shape (n,).
    segments
        Parts without a gap, each with one sample time.
    band
        Highest frequency [Hz].

    Returns
    -------
    Frequencies [Hz], shape (f,), and the density [(unit of x)²/Hz], shape (f,).
    """
    lengths = [max(round(WINDOW_SECONDS / float(dt[segment.start])), 2) for segment in segments]
    count = min([int(band * WINDOW_SECONDS), *(length // 2 for length in lengths)])
    power = np.zeros(count)
    weight = 0.0
    masked = np.where(valid, x, 0.0)
    for segment, length in zip(segments, lengths, strict=True):
        hann = np.hanning(length + 2)[1:-1]
        for first in _window_starts(segment, length):
            end = min(first + length, segment.stop)
            window = hann[: end - first]
            spectrum = np.fft.rfft(masked[first:end] * window, length)[1 : count + 1]
            power += 2 * float(dt[segment.start]) * np.square(np.abs(spectrum))
            weight += float(np.square(window) @ valid[first:end])
    frequencies = np.arange(1, count + 1) / WINDOW_SECONDS
    return frequencies, power / weight if weight else power


def _window_starts(segment: slice, length: int) -> Indices:
    """First samples of windows that cover a segment, each overlapping the next by half."""
    count = max(-(-2 * (segment.stop - segment.start) // length) - 1, 1)
    last = max(segment.stop - length, segment.start)
    return np.linspace(segment.start, last, count).astype(np.intp)


def angle_spectrum(x: Array, q: Array, v: Array, band: float) -> tuple[Array, Array]:
    """Amplitude of the best sine over the angle, by its periods per turn.

    The lowest number has one period over the travel; the highest is what the band still contains.

    Parameters
    ----------
    x
        Samples, shape (n,).
    q, v
        Position [rad or m] and velocity, shape (n,).
    band
        Highest frequency in time that x contains [Hz].

    Returns
    -------
    Periods per turn, or per 2π m, shape (a,), and amplitudes [unit of x], shape (a,).
    """
    if not len(q):
        return np.zeros(0), np.zeros(0)
    travel = float(np.ptp(q))
    slow_speed = float(np.quantile(np.abs(v), _SLOW_QUANTILE))
    highest = min(_MAX_PERIODS, 2 * np.pi * band / slow_speed if slow_speed > 0 else np.inf)
    lowest = 2 * np.pi / travel if travel > 0 else np.inf
    if highest <= lowest:
        return np.zeros(0), np.zeros(0)

    bins = min(int(np.ceil(travel * highest * _BINS_PER_PERIOD / (2 * np.pi))), _MAX_BINS)
    width = travel / bins
    index = np.minimum(((q - float(q.min())) / width).astype(np.intp), bins - 1)
    counts = np.bincount(index, minlength=bins)
    totals = np.bincount(index, x - x.mean(), bins)
    size = fast_length(_OVERSAMPLING * bins)
    count_transform = np.conj(np.fft.rfft(counts, size))  # Σ exp(i n q)
    total_transform = np.conj(np.fft.rfft(totals, size))  # Σ x exp(i n q)

    last = min(int(highest * size * width / (2 * np.pi)), (len(count_transform) - 1) // 2)
    k = np.arange(_OVERSAMPLING, last + 1)
    periods = np.asarray(k * (2 * np.pi / (size * width)))
    return periods, _amplitude(len(x), count_transform[k], count_transform[2 * k], total_transform[k])


def _amplitude(n: int, first: ComplexArray, second: ComplexArray, with_x: ComplexArray) -> Array:
    """Amplitude of c cos + s sin + constant fitted to x, from the sums of exp(i n q), exp(2 i n q), x exp(i n q)."""
    c = first.real / n
    s = first.imag / n
    cc = (1 + second.real / n) / 2 - c * c
    ss = (1 - second.real / n) / 2 - s * s
    cs = second.imag / (2 * n) - c * s
    determinant = cc * ss - cs * cs
    safe = np.where(determinant > _MIN_DETERMINANT, determinant, np.inf)
    x = with_x.real / n
    y = with_x.imag / n
    return np.asarray(np.hypot((ss * x - cs * y) / safe, (cc * y - cs * x) / safe))

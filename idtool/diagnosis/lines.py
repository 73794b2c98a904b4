"""Spectra of a torque over time frequency and over the angle of its joint.

Over frequency: Welch's method (1967). Over the angle: at each number of periods per turn n, the sine of n q that fits
best in least squares (Lomb 1976, of positions in place of times), by Fourier transforms of the torque binned by
position.

Letters: n samples, f frequencies, a numbers of periods per turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import fft

from idtool.common.arrays import Array, ComplexArray, Indices, Mask

SECONDS = 4.0  # that a stretch lasts of which a spectrum is taken
_PERIODS = 300.0  # per turn, at the most
_ACROSS = 16  # bins of position in the shortest period
_FINE = 8  # points of the spectrum in what the travel can tell apart
_BINS = 1 << 20  # at the most
_SLOW = 0.25  # of the samples, of which the band must hold a ripple


def density(x: Array, kept: Mask, step: Array, stretches: Sequence[slice], band: float) -> tuple[Array, Array]:
    """Power density over frequency, one-sided.

    Parameters
    ----------
    x
        Samples, shape (n,).
    kept
        Which of them count, shape (n,); the others are taken as zero.
    step
        Time from each to the next [s], shape (n,).
    stretches
        Those without a gap, each of one step.
    band
        Highest frequency [Hz].

    Returns
    -------
    Frequencies [Hz], shape (f,), and the density [(unit of x)²/Hz], shape (f,).
    """
    lengths = [max(round(SECONDS / float(step[part.start])), 2) for part in stretches]
    count = min([int(band * SECONDS), *(length // 2 for length in lengths)])
    power, size = np.zeros(count), 0.0
    known = np.where(kept, x, 0.0)
    for part, length in zip(stretches, lengths, strict=True):
        window = np.hanning(length + 2)[1:-1]
        for first in _starts(part, length):
            last = min(first + length, part.stop)
            own = window[: last - first]
            lines = fft.rfft(known[first:last] * own, length)[1 : count + 1]
            power += 2 * float(step[part.start]) * np.square(np.abs(lines))
            size += float(np.square(own) @ kept[first:last])
    return np.arange(1, count + 1) / SECONDS, power / size if size else power


def _starts(part: slice, length: int) -> Indices:
    """Where windows begin that cover a stretch, each half over the next."""
    count = max(-(-2 * (part.stop - part.start) // length) - 1, 1)
    return np.linspace(part.start, max(part.stop - length, part.start), count).astype(np.intp)


def ripple(x: Array, q: Array, v: Array, band: float) -> tuple[Array, Array]:
    """Amplitude of the best sine over the angle, by its periods per turn: from one over the travel to what is seen.

    Parameters
    ----------
    x
        Samples, shape (n,).
    q, v
        Position [rad or m] and velocity, shape (n,).
    band
        Highest frequency in time that x holds [Hz].

    Returns
    -------
    Periods per turn, or 2π m, shape (a,), and amplitudes [unit of x], shape (a,).
    """
    low, travel = (float(q.min()), float(np.ptp(q))) if len(q) else (0.0, 0.0)
    slow = float(np.quantile(np.abs(v), _SLOW)) if len(v) else 0.0
    most = min(_PERIODS, 2 * np.pi * band / slow if slow > 0 else np.inf)
    least = 2 * np.pi / travel if travel > 0 else np.inf
    if most <= least:
        return np.zeros(0), np.zeros(0)
    bins = min(int(np.ceil(travel * most * _ACROSS / (2 * np.pi))), _BINS)
    width = travel / bins
    index = np.minimum(((q - low) / width).astype(np.intp), bins - 1)
    count, total = np.bincount(index, minlength=bins), np.bincount(index, x - x.mean(), bins)
    size = fft.next_fast_len(_FINE * bins, real=True)
    of_count, of_total = (np.conj(fft.rfft(y, size)) for y in (count, total))  # Σ y exp(i n q)
    k = np.arange(_FINE, min(int(most * size * width / (2 * np.pi)), (len(of_count) - 1) // 2) + 1)
    n = np.asarray(k * (2 * np.pi / (size * width)))
    return n, _amplitude(len(x), of_count[k], of_count[2 * k], of_total[k])


def _amplitude(n: int, one: ComplexArray, two: ComplexArray, with_x: ComplexArray) -> Array:
    """Of c cos + s sin + constant fitted to x, by the sums of exp(i n q), exp(2 i n q) and x exp(i n q)."""
    c, s = one.real / n, one.imag / n
    cc, ss, cs = (1 + two.real / n) / 2 - c * c, (1 - two.real / n) / 2 - s * s, two.imag / (2 * n) - c * s
    det = cc * ss - cs * cs
    safe = np.where(det > 1e-3, det, np.inf)  # a fraction of a period: no sine of its own
    x, y = with_x.real / n, with_x.imag / n
    return np.asarray(np.hypot((ss * x - cs * y) / safe, (cc * y - cs * x) / safe))

"""Statistics of one signal x, in its own unit: N samples, dt seconds apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Mask
from idtool.data.logs.stored_arrays import column_blocks
from idtool.data.power_density import power_density

_MIN_SAMPLES = 100  # samples that a share is taken of
_MIN_LEVELS = 16  # fewer are believed only where most samples repeat one
_GRID_TOLERANCE = 0.15  # steps off the grid that count as on it; without a grid 30 % of the samples are
_MIN_GRID_SHARE = 0.95
_ENOUGH_DISTANCES = 100  # between levels, to tell that they have no common step
_MAX_OFF_GRID_SHARE = 0.25  # of distances, off by twice the tolerance: without a grid it is 40 %, with one at most 10 %
_MIN_RELATIVE_STEP = 1e-6  # of the range: a finer step is as good as none
_PROBE_LEVELS = 512  # levels that are tried before all are
_FLOOR_FACTOR = 10  # a single spectrum's bin of noise reaches ten times its median once in a thousand
_MAX_DIVISOR = 16  # a signal that was scaled after quantisation may skip levels


class ColumnStatistics(NamedTuple):
    """Least and greatest value, root mean square and number of values that are not finite, each of shape (nj,)."""

    low: Array
    high: Array
    rms: Array
    not_finite: NDArray[np.int64]


def column_statistics(x: Array) -> ColumnStatistics:
    """`ColumnStatistics` of x, shape (N, nj), over its finite values, in one pass; NaN for a column of none."""
    low = np.full(x.shape[1], np.nan)
    high = np.full(x.shape[1], np.nan)
    squares = np.zeros(x.shape[1])
    not_finite = np.zeros(x.shape[1], dtype=np.int64)
    for columns in column_blocks(x):
        is_finite = np.isfinite(columns)
        if not is_finite.all():
            columns[~is_finite] = np.nan
            not_finite += np.count_nonzero(~is_finite, axis=1)
        low = np.fmin(low, np.fmin.reduce(columns, axis=1))
        high = np.fmax(high, np.fmax.reduce(columns, axis=1))
        columns[~is_finite] = 0.0
        squares += np.einsum("ij,ij->i", columns, columns)
    rms = np.sqrt(squares / np.maximum(len(x) - not_finite, 1))
    return ColumnStatistics(low, high, rms, not_finite)


def quantisation(x: Array) -> float | None:
    """Smallest common step of a signal's values, in its unit; None where it is continuous or constant.

    Steps between neighbouring levels give a first guess; a scaled signal may skip levels, so its integer fractions
    are tried as well. A guess is made exact over ever wider spans of levels and accepted when the levels lie on its
    grid. Values rounded to a few decimals do, as they should.
    """
    levels = np.unique(x)
    if len(levels) < 2 or (len(levels) < _MIN_LEVELS and len(levels) > len(x) / 2):
        return None
    steps = np.diff(levels)
    span = float(levels[-1] - levels[0])
    smallest = float(np.percentile(steps, 5))
    guess = float(np.median(steps[steps <= 1.5 * smallest]))
    for divisor in range(1, _MAX_DIVISOR + 1):
        step = _refined_step(levels[:_PROBE_LEVELS], guess / divisor)
        if step > _MIN_RELATIVE_STEP * span and _on_grid(levels[:_PROBE_LEVELS], step):
            step = _refined_step(levels, step)
            if step > 0 and _on_grid(levels, step):
                return step
    return None


def _refined_step(levels: Array, step: float) -> float:
    """Step that best explains the distances between levels; 0 if none does.

    It is determined from short distances, then from ever longer ones. A distance is of use once the step is known well
    enough to count the steps in it.
    """
    offset = 1
    max_count = 4
    while offset < len(levels):
        distance = levels[offset:] - levels[:-offset]
        count = np.round(distance / step)
        is_short = count <= max_count
        short_count, short_distance = count[is_short], distance[is_short]
        if short_count.any():
            step = float(short_distance @ short_count / (short_count @ short_count))
            if len(short_count) >= _ENOUGH_DISTANCES and _are_off_grid(short_distance / step):
                return 0.0
        if len(short_count) > len(count) // 2:
            offset *= 2
        max_count *= 2
    return step


def _are_off_grid(steps: Array) -> bool:
    """True if more numbers of steps are far from whole than on any grid."""
    is_off = np.abs(steps - np.round(steps)) > 2 * _GRID_TOLERANCE
    return bool(np.count_nonzero(is_off) > _MAX_OFF_GRID_SHARE * len(steps))


def _on_grid(levels: Array, step: float) -> bool:
    phase = (levels - levels[0]) / step
    phase -= np.angle(np.mean(np.exp(2j * np.pi * phase))) / (2 * np.pi)
    return bool(np.mean(np.abs(phase - np.round(phase)) < _GRID_TOLERANCE) > _MIN_GRID_SHARE)


def noise_level(x: Array) -> float:
    """Standard deviation of a signal's white noise, in its unit; x of one segment, shape (N,).

    The lesser of two estimates: third differences, which a few jumps such as dry friction's do not disturb, and the
    upper half of the spectrum, which smooth fast motion does not reach.
    """
    if len(x) < 16:
        return 0.0
    from_differences = float(np.median(np.abs(np.diff(x, 3)))) / (0.6745 * np.sqrt(20))
    t = np.linspace(-1, 1, len(x))
    detrended = x - x.mean() - (t @ x) / (t @ t) * t
    _, density = power_density(detrended, 1.0, min(len(x), 1024))
    from_spectrum = np.sqrt(0.5 * np.median(density[len(density) // 2 :]))
    return float(min(from_differences, from_spectrum))


def power_band(pieces: Sequence[Array], dt: float, derivatives: int = 0, share: float = 0.99) -> float | None:
    """Frequency below which ``share`` of a signal's power lies [Hz], by Welch's method; None without power.

    What is not well above the floor of white noise, read from the upper quarter of the spectrum, is not counted: it
    would fill any band.

    Parameters
    ----------
    pieces
        The signal's runs without a gap, each of shape (N,); those that hold no whole window of ten seconds, or of the
        longest run, are passed over.
    dt
        Sample time [s].
    derivatives
        1 for the power of the signal's derivative.
    share
        Of the power.
    """
    window = min(max(len(x) for x in pieces), max(int(10 / dt), 256))
    f = np.fft.rfftfreq(window, dt)
    density = np.zeros(len(f))
    for x in pieces:
        if len(x) >= window:
            density += len(x) * power_density(x, 1.0, window)[1]
    floor = np.median(density[-(len(f) // 4) - 1 :])
    density[density < _FLOOR_FACTOR * floor] = 0
    power = np.cumsum(density * f ** (2 * derivatives))
    if not power[-1] > 0:
        return None
    return float(f[np.searchsorted(power, share * power[-1])])


def stale_share(x: Array, moving: Mask, step: float | None, noise: float) -> float | None:
    """Share of samples equal to the one before while the signal changes; None where it hardly ever does.

    It changes where over eight samples to either side it covers so many quantisation steps a sample that neither
    quantisation nor noise repeats a value by chance.

    Parameters
    ----------
    x
        One segment of the signal, shape (N,).
    moving
        Where the joint moves, shape (N,).
    step
        The signal's quantisation step, in its unit.
    noise
        Its noise, standard deviation.
    """
    half = 8
    if len(x) <= 2 * half:
        return None
    change = np.abs(x[2 * half :] - x[: -2 * half]) / (2 * half)
    least_change = 2 * step + 3 * noise if step else 0.0
    is_changing = moving[half:-half] & (change > least_change)
    if is_changing.sum() < _MIN_SAMPLES:
        return None
    repeats = x[half:-half] == x[half - 1 : -half - 1]
    return float(np.mean(repeats[is_changing]))


def stuck_share(x: Array, low: float, high: float, step: float | None) -> float:
    """Share of samples, shape (N,), that sit at the signal's lowest or highest value as on an end stop.

    A turning point gathers samples too, but its neighbourhood gathers nearly as many: the extreme value has to hold
    five times what the next step, or thousandth of the range, holds.
    """
    if len(x) < _MIN_SAMPLES or not low < high:
        return 0.0
    total = 0.0
    tolerance = max(0.5 * (step or 0.0), 1e-9 * (high - low))
    width = max(step or 0.0, 1e-3 * (high - low))
    for depth in (high - x, x - low):
        share = np.mean(depth <= tolerance)
        neighbour_share = np.mean(depth <= 1.5 * width) - share
        if share > 1e-3 and share > 5 * neighbour_share:
            total += float(share)
    return total

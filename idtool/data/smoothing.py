"""Moving averages, for what every log passes through: `scipy.ndimage` has them too but takes long to import."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from idtool.common.arrays import Array, ComplexArray

Series = TypeVar("Series", Array, ComplexArray)

_REACH = 4.0  # standard deviations to either side, beyond which a Gaussian is cut off


def moving_mean(x: Series, width: int) -> Series:
    """Mean of so many samples around each, shape (..., N); at the ends the series continues as its mirror image."""
    margin = np.zeros((x.ndim, 2), dtype=int)
    margin[-1] = width // 2, width - width // 2 - 1
    sums = np.cumsum(np.pad(x, margin, mode="symmetric"), axis=-1)
    sums[..., width:] -= sums[..., :-width]
    return sums[..., width - 1 :] / width


def gaussian_mean(x: Array, sigma: float) -> Array:
    """Mean around each sample by a Gaussian of standard deviation ``sigma`` [samples], continued alike, shape (N,)."""
    reach = int(_REACH * sigma + 0.5)
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / sigma))
    padded = np.pad(x, reach, mode="symmetric")
    return np.convolve(padded, weights / weights.sum(), mode="valid")

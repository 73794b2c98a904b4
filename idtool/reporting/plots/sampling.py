"""Values for drawing: limited in number, rounded to visible digits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array

_DIGITS = 5  # of a curve's largest value
_MAX_DECIMALS = 12


def merge_stretches(x: Array, count: int) -> Array:
    """The least and greatest value of ``count`` stretches at a time; NaN only where all are.

    Where the curve falls, the greatest comes first, so that a smooth one is drawn smooth.

    Parameters
    ----------
    x
        Pairs of values, shape (rows, 2 stretches).
    count
        Number of stretches to merge.

    Returns
    -------
    Shape (rows, 2 ceil(stretches / count)).
    """
    short = -x.shape[1] % (2 * count)
    blocks = np.pad(x, [(0, 0), (0, short)], constant_values=np.nan).reshape(len(x), -1, 2 * count)
    low, high = np.fmin.reduce(blocks, axis=-1), np.fmax.reduce(blocks, axis=-1)
    around = np.pad(low + high, [(0, 0), (1, 1)], mode="edge")
    falls = around[:, 2:] < around[:, :-2]
    pairs = np.stack([np.where(falls, high, low), np.where(falls, low, high)], axis=-1)
    return np.asarray(pairs.reshape(len(x), -1))


def round_curve(x: Array) -> list[float | None]:
    """A curve to five digits of its largest value; None breaks the line."""
    largest = float(np.fmax.reduce(np.abs(x), initial=0.0))
    decimals = _DIGITS - 1 - math.floor(math.log10(largest)) if largest else 0
    values = x.round(min(decimals, _MAX_DECIMALS)).tolist()
    return [None if math.isnan(value) else value for value in values]


def round_significant(x: Iterable[float | None], digits: int = 4) -> list[float | None]:
    """Values to so many digits each, as a logarithmic axis needs them; None for what is not finite."""
    return [None if v is None or not math.isfinite(v) else float(f"{v:.{digits}g}") for v in x]


def subsample_indices(count: int, max_count: int) -> NDArray[np.int64]:
    """Indices of about ``max_count`` of ``count`` values, evenly spread, with the last one."""
    step = max(math.ceil(count / max(max_count, 1)), 1)
    return np.arange(count - 1, -1, -step)[::-1] if count else np.arange(0)


def largest_indices(x: Array, points: int) -> NDArray[np.int64]:
    """Indices of the largest value in each of so many intervals."""
    if len(x) <= points:
        return np.arange(len(x))
    edges = np.linspace(0, len(x), points + 1).astype(int)
    known = np.nan_to_num(x, nan=-np.inf)
    return np.array([low + int(np.argmax(known[low:high])) for low, high in itertools.pairwise(edges)])

"""Types of arrays, and runs of a mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def mask_runs(mask: Mask) -> Indices:
    """First index of each run of True and the one after its last, shape (k, 2)."""
    return np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)


def dilated(mask: Mask, reach: int) -> Mask:
    """Samples no more than so many samples from one that is True, shape (N,)."""
    count = np.cumsum(np.pad(mask, (reach + 1, reach)))  # of True so far, from so many samples before the first
    return np.asarray(count[2 * reach + 1 :] > count[: -2 * reach - 1])


def joined_runs(mask: Mask, min_gap: float) -> list[tuple[int, int]]:
    """`mask_runs`, those less than ``min_gap`` samples apart joined."""
    runs: list[tuple[int, int]] = []
    for begin, end in mask_runs(mask).tolist():
        if runs and begin - runs[-1][1] < min_gap:
            runs[-1] = (runs[-1][0], end)
        else:
            runs.append((begin, end))
    return runs

"""Types of arrays, and runs of a mask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def mask_runs(mask: Mask) -> Indices:
    """First index of each run of True and the one after its last, shape (k, 2)."""
    return np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)


def items_at(buffer: bytes, offsets: Indices, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Items of a type at ascending offsets in a buffer, shape (k,); a view if they are at equal distances."""
    distances = np.diff(offsets)
    if len(distances) and (distances == distances[0]).all():
        return np.ndarray(len(offsets), dtype, buffer, int(offsets[0]), strides=(int(distances[0]),))
    if not len(offsets):
        return np.empty(0, dtype)
    at_every_byte = np.ndarray(len(buffer) - dtype.itemsize + 1, dtype, buffer, strides=(1,))
    return np.asarray(at_every_byte[offsets])


def indices_by_value(x: Indices) -> list[tuple[int, Indices]]:
    """Each value in an array of integers, ascending, with the indices of its entries, ascending."""
    if len(x) and (x == x[0]).all():  # much faster than looking for different ones
        return [(int(x[0]), np.arange(len(x)))]
    order = np.argsort(x, kind="stable")
    values, starts = np.unique(x[order], return_index=True)
    return list(zip(values.tolist(), np.split(order, starts[1:]), strict=True)) if len(x) else []


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

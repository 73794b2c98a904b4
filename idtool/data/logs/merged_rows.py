"""Samples with stamps of their own as the rows of one table: samples with the same time share a row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices

_KEY = np.dtype([("t", "f8"), ("occurrence", "i8")])


def merge_rows(t: Array, others: Sequence[Array]) -> tuple[Array, list[Indices]]:
    """Times of the rows, and the sample of each source in every row.

    Parameters
    ----------
    t
        Times of the first source, shape (N,), whose order is kept.
    others
        Times of each other source, which must be finite.

    Returns
    -------
    Times of the rows, shape (M,), and for the first source and each other the index of its sample in every row, shape
    (M,); -1: it has none.
    """
    keys = [_keys(times) for times in (t, *others)]
    unique, ids = np.unique(np.concatenate(keys), return_inverse=True)
    ids_by_source = np.split(ids.ravel(), np.cumsum([len(of_source) for of_source in keys])[:-1])
    is_of_first = np.zeros(len(unique), dtype=bool)
    is_of_first[ids_by_source[0]] = True
    added = np.flatnonzero(~is_of_first)
    place = np.searchsorted(np.fmax.accumulate(t), unique["t"][added], side="right") if len(t) else np.zeros_like(added)
    row_ids = np.insert(ids_by_source[0], place, added)
    samples = []
    for of_source in ids_by_source:
        sample_of_id = np.full(len(unique), -1)
        sample_of_id[of_source] = np.arange(len(of_source))
        samples.append(sample_of_id[row_ids])
    times = np.insert(t, place, unique["t"][added])
    return times, samples


def take_rows(x: Array, samples: Indices) -> Array:
    """Values of a source, shape (k, …), in rows; NaN where it has no sample."""
    padded = np.concatenate([x, np.full((1, *x.shape[1:]), np.nan)])
    return padded[samples]


def _keys(t: Array) -> NDArray[np.void]:
    """Each time with the number of the same times before it; times that are not finite match none of another source."""
    known = np.where(np.isfinite(t), t, np.inf)
    order = np.argsort(known, kind="stable")
    in_order = known[order]
    keys = np.empty(len(t), _KEY)
    keys["t"] = known
    keys["occurrence"][order] = np.arange(len(t)) - np.searchsorted(in_order, in_order)
    return keys

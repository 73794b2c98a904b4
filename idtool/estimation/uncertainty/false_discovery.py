"""Control of false discoveries among many tests, as in `scipy.stats.false_discovery_control`, slow to import."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array, Mask


def discoveries(p_values: Array, rate: float) -> Mask:
    """Tests, shape (k,), that are significant if a share ``rate`` of those may be false.

    Source: Benjamini & Hochberg, Controlling the false discovery rate, 1995
    """
    order = np.argsort(p_values)
    bounds = rate * np.arange(1, len(order) + 1) / max(len(order), 1)
    below = np.flatnonzero(p_values[order] < bounds)
    significant = np.zeros(len(order), dtype=bool)
    significant[order[: below.max(initial=-1) + 1]] = True
    return significant

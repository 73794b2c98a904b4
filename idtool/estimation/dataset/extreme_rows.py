"""`ExtremeRows`: the rows of the torque equation at which something is least or greatest, in stretches of time.

From them, curves of any model can be drawn: no spike of what they were chosen by is lost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices

QUANTITIES = 2  # that rows are chosen by: the measured torque, and the error of the model before the fit
ROWS_PER_BIN = 2 * QUANTITIES  # where each is least and greatest


class ExtremeRows:
    """Rows of each joint in stretches of time, called bins.

    Attributes
    ----------
    rows
        Per joint the rows, shape (bins, `ROWS_PER_BIN`, width_j); NaN where there are none.
    extremes
        What each was chosen by, shape (nv, bins, `ROWS_PER_BIN`).

    Parameters
    ----------
    widths
        Number of values in a row of each joint.
    bins
        Number of bins.
    """

    def __init__(self, widths: Sequence[int], bins: int) -> None:
        self.rows = [np.full((bins, ROWS_PER_BIN, width), np.nan) for width in widths]
        self.extremes = np.full((len(widths), bins, ROWS_PER_BIN), np.inf)
        self.extremes[:, :, 1::2] = -np.inf

    def add(self, joint: int, bins: Indices, parts: Sequence[Array], quantities: Sequence[Array]) -> None:
        """Add rows of a joint.

        Parameters
        ----------
        joint
            Index of the joint.
        bins
            The bin of each, ascending, shape (n,).
        parts
            The rows in parts, shape (w, n) each; their widths w add up to that of a row.
        quantities
            What they are chosen by, shape (n,) each.
        """
        for i, quantity in enumerate(quantities):
            known = np.flatnonzero(np.isfinite(quantity))
            if not len(known):
                continue
            values = quantity[known]
            known_bins = bins[known]
            starts = np.flatnonzero(np.diff(known_bins, prepend=-1))
            own_bins, counts = known_bins[starts], np.diff(starts, append=len(known))
            for column, extreme in ((2 * i, np.minimum), (2 * i + 1, np.maximum)):
                extremes = extreme.reduceat(values, starts)
                places = np.flatnonzero(values == np.repeat(extremes, counts))
                first_places = places[np.searchsorted(places, starts)]
                chosen = known[first_places]
                rows = np.concatenate([part[:, chosen] for part in parts]).T
                self._replace(joint, column, own_bins, extremes, rows)

    def merge(self, other: ExtremeRows) -> None:
        """Add the rows of another."""
        bins = np.arange(self.extremes.shape[1])
        for joint, rows in enumerate(other.rows):
            for column in range(ROWS_PER_BIN):
                self._replace(joint, column, bins, other.extremes[joint, :, column], rows[:, column])

    def _replace(self, joint: int, column: int, bins: Indices, extremes: Array, rows: Array) -> None:
        """Take rows, shape (k, width), that are more extreme than those of their bins, shape (k,)."""
        present = self.extremes[joint, bins, column]
        is_more_extreme = extremes > present if column % 2 else extremes < present
        chosen = bins[is_more_extreme]
        self.extremes[joint, chosen, column] = extremes[is_more_extreme]
        self.rows[joint][chosen, column] = rows[is_more_extreme]

"""`ExtremeRows`: the rows of the torque equation at which something is least or greatest, in stretches of time.

From them, curves of any model can be drawn: no spike of what they were chosen by is lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices

QUANTITIES = 2  # that rows are chosen by: the measured torque, and the error of the model before the fit
ROWS_PER_BIN = 2 * QUANTITIES  # where each is least and greatest
BY_MEASURED_TORQUE = slice(2)  # of these, the ones that do not depend on a model


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

    def add(self, bins: Indices, rows: Sequence[Sequence[Array]], quantities: Sequence[Array]) -> None:
        """Add rows of all joints.

        Parameters
        ----------
        bins
            The bin of each of n samples, ascending, shape (n,).
        rows
            Per joint its rows in parts, shape (w, n) each; their widths w add up to that of a row.
        quantities
            What they are chosen by, shape (nv, n) each.
        """
        if not len(bins):
            return
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        own_bins, counts = bins[starts], np.diff(starts, append=len(bins))
        for i, quantity in enumerate(quantities):
            is_known = np.isfinite(quantity)
            for column, extreme, unknown in ((2 * i, np.minimum, np.inf), (2 * i + 1, np.maximum, -np.inf)):
                values = np.where(is_known, quantity, unknown)
                extremes = extreme.reduceat(values, starts, axis=1)
                is_extreme = values == np.repeat(extremes, counts, axis=1)
                places = np.where(is_extreme, np.arange(len(bins)), len(bins))
                first_places = np.minimum.reduceat(places, starts, axis=1)
                for joint, chosen in self._more_extreme(column, own_bins, extremes):
                    own_places = first_places[joint, chosen]
                    own_rows = np.concatenate([part[:, own_places] for part in rows[joint]]).T
                    self._replace(joint, column, own_bins[chosen], extremes[joint, chosen], own_rows)

    def merge(self, other: ExtremeRows) -> None:
        """Add the rows of another."""
        bins = np.arange(self.extremes.shape[1])
        for column in range(ROWS_PER_BIN):
            extremes = other.extremes[:, :, column]
            for joint, chosen in self._more_extreme(column, bins, extremes):
                self._replace(joint, column, chosen, extremes[joint, chosen], other.rows[joint][chosen, column])

    def _more_extreme(self, column: int, bins: Indices, extremes: Array) -> Iterator[tuple[int, Indices]]:
        """Joints, and the indices of those values, shape (nv, k), that are more extreme than those of their bins."""
        present = self.extremes[:, bins, column]
        is_more_extreme = extremes > present if column % 2 else extremes < present
        for joint in np.flatnonzero(is_more_extreme.any(axis=1)).tolist():
            yield joint, np.flatnonzero(is_more_extreme[joint])

    def _replace(self, joint: int, column: int, bins: Indices, extremes: Array, rows: Array) -> None:
        """Replace the rows of some bins, shape (k, width), and what they were chosen by, shape (k,)."""
        self.extremes[joint, bins, column] = extremes
        self.rows[joint][bins, column] = rows

"""`RowFilter`: takes rows of the torque equation to the band, and tells which of them count.

With a fixed base, each row is filtered by itself. With unknown contact forces, the rows are projected first, so that
what stands in one row appears in others too.

Shapes: nv rows, m columns, N samples, n samples after decimation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Batch
from idtool.dynamics.contact_model import ContactModel

Counts = Sequence[Array] | Sequence[Mask]  # per row, the share of each filtered sample that counts, shape (n,)

_MIN_SHARE_OF_ROW = 1e-6  # that unknown contact forces leave, for it to count


class RowFilter(ABC):
    """Takes rows of one batch to the band.

    Attributes
    ----------
    batch
        The batch.
    """

    batch: Batch

    @property
    @abstractmethod
    def counts(self) -> Counts:
        """Per row, the share of each filtered sample that counts, from 0 to 1, shape (n,)."""

    @abstractmethod
    def all_rows(self, rows: Array) -> Array:
        """Filtered rows of all coordinates, from shape (nv, ..., N) to (nv, ..., n)."""

    @abstractmethod
    def one_row(self, row: int, columns: Array) -> tuple[Indices, Array]:
        """Filtered columns that stand in one row only.

        Parameters
        ----------
        row
            The row.
        columns
            The columns in it, shape (m, N).

        Returns
        -------
        The k rows in which they appear, and the filtered columns in these, shape (k, m, n).
        """


@dataclass(frozen=True)
class SeparateRows(RowFilter):
    """Rows of a robot with a fixed base.

    Attributes
    ----------
    masks
        Per row, mask of the filtered samples that count, shape (n,).
    """

    batch: Batch
    masks: Sequence[Mask]

    @property
    @override
    def counts(self) -> Sequence[Mask]:
        return self.masks

    @override
    def all_rows(self, rows: Array) -> Array:
        return self.batch.filter(rows)

    @override
    def one_row(self, row: int, columns: Array) -> tuple[Indices, Array]:
        return np.array([row]), self.batch.filter(columns)[None]


@dataclass(frozen=True)
class ProjectedRows(RowFilter):
    """Rows without what unknown contact forces can exert.

    The squared error of a row is the noise's square times the share of the row that these forces leave.

    Attributes
    ----------
    contacts
        The contacts.
    projector
        From `ContactModel.projector`, shape (N, nv, nv).
    key
        Key of the projector, equal for equal ones along the motion; None: not known.
    """

    batch: Batch
    contacts: ContactModel
    projector: Array
    key: Hashable | None = None

    @cached_property
    def _shares(self) -> Sequence[Array]:
        diagonal = np.ascontiguousarray(np.diagonal(self.projector, axis1=1, axis2=2).T)
        shares = np.clip(self.batch.filter(diagonal), 0.0, 1.0)
        shares[shares < _MIN_SHARE_OF_ROW] = 0.0  # what is left of the row is rounding
        return list(shares)

    @property
    @override
    def counts(self) -> Sequence[Array]:
        return self._shares

    @override
    def all_rows(self, rows: Array) -> Array:
        return self.batch.filter(self.contacts.project(self.projector, rows))

    @override
    def one_row(self, row: int, columns: Array) -> tuple[Indices, Array]:
        noise = self.contacts.noise
        passed_on = self.projector[:, :, row] * (noise / noise[row])  # (N, nv)
        rows = np.flatnonzero(passed_on.any(axis=0))
        filtered = np.empty((len(rows), len(columns), len(self.batch.t)))
        for out, shares in zip(filtered, passed_on[:, rows].T, strict=True):
            out[:] = self.batch.filter(columns * shares)
        return rows, filtered

"""`RowFilter`: low-pass and decimation of rows of the torque equation, and the share of each sample that counts.

Without contacts, each row is filtered by itself. With unknown contact forces, the rows are projected first, so that a
column of one row appears in others too.

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

Shares = Sequence[Array] | Sequence[Mask]  # per row, the share of each filtered sample that counts, shape (n,)

_MIN_SHARE = 1e-6  # of a row; less is rounding of the projection


class RowFilter(ABC):
    """Filter of the rows along one batch.

    Attributes
    ----------
    batch
        The batch.
    key
        Key under which what it has filtered may be kept: equal for equal filters along the motion. None: not kept.
    """

    batch: Batch
    key: Hashable | None = None

    @property
    @abstractmethod
    def shares(self) -> Shares:
        """Per row, the share of each filtered sample that counts, from 0 to 1, shape (n,)."""

    @abstractmethod
    def filter_rows(self, rows: Array) -> Array:
        """Filtered rows of all coordinates, from shape (nv, ..., N) to (nv, ..., n)."""

    @abstractmethod
    def filter_columns_of_row(self, row: int, columns: Array) -> tuple[Indices, Array]:
        """Filtered columns that are nonzero in one row only.

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
    """Filter of a robot without contacts: each row by itself.

    Attributes
    ----------
    masks
        Per row, mask of the filtered samples that count, shape (n,).
    """

    batch: Batch
    masks: Sequence[Mask]

    @property
    @override
    def shares(self) -> Sequence[Mask]:
        return self.masks

    @override
    def filter_rows(self, rows: Array) -> Array:
        return self.batch.filter(rows)

    @override
    def filter_columns_of_row(self, row: int, columns: Array) -> tuple[Indices, Array]:
        return np.array([row]), self.batch.filter(columns)[None]


@dataclass(frozen=True)
class ProjectedRows(RowFilter):
    """Filter that leaves out what unknown contact forces can exert.

    The expected squared error of a row is the square of its noise times the share that these forces leave of it: the
    diagonal of the projector, which varies slowly within the length of the filter.

    Attributes
    ----------
    contacts
        The contacts.
    projector
        From `ContactModel.projector`, shape (N, nv, nv).
    key
        As in `RowFilter`.
    """

    batch: Batch
    contacts: ContactModel
    projector: Array
    key: Hashable | None = None

    @cached_property
    def _row_shares(self) -> Sequence[Array]:
        diagonal = np.diagonal(self.projector, axis1=1, axis2=2).T
        filtered = self.batch.filter(np.ascontiguousarray(diagonal))
        shares = np.clip(filtered, 0.0, 1.0)  # the filter overshoots where a contact opens
        shares[shares < _MIN_SHARE] = 0.0
        return list(shares)

    @property
    @override
    def shares(self) -> Sequence[Array]:
        return self._row_shares

    def filtered_projector(self) -> Array:
        """The projector through the filter, shape (n, nv, nv)."""
        by_element = np.ascontiguousarray(np.moveaxis(self.projector, 0, -1))
        return np.asarray(np.moveaxis(self.batch.filter(by_element), -1, 0))

    @cached_property
    def _gains(self) -> Array:
        """Matrices that take rows to projected rows, shape (N, nv, nv)."""
        return self.contacts.gains(self.projector)

    @override
    def filter_rows(self, rows: Array) -> Array:
        return self.batch.filter(multiply_by_sample(self._gains, rows))

    @override
    def filter_columns_of_row(self, row: int, columns: Array) -> tuple[Indices, Array]:
        gains = self._gains[:, :, row]  # (N, nv)
        rows = np.flatnonzero(gains.any(axis=0))
        filtered = np.empty((len(rows), len(columns), len(self.batch.t)))
        for out, gain in zip(filtered, gains[:, rows].T, strict=True):
            out[:] = self.batch.filter(columns * gain)
        return rows, filtered


def multiply_by_sample(matrices: Array, rows: Array) -> Array:
    """Product of each sample's matrix and rows.

    Parameters
    ----------
    matrices
        Shape (N, nv, nv).
    rows
        Shape (nv, ..., N).

    Returns
    -------
    The shape of the rows.
    """
    nv, count = len(rows), rows.shape[-1]
    by_sample = np.moveaxis(rows.reshape(nv, -1, count), -1, 0)  # (N, nv, columns)
    product = matrices @ by_sample
    in_time = np.ascontiguousarray(np.moveaxis(product, 0, -1))  # which a filter reads along
    return in_time.reshape(rows.shape)

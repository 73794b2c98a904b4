"""`RowFilter`: low-pass and decimation of rows of the torque equation, and the share of each sample that counts.

Without contacts, each row is filtered by itself. With unknown contact forces, the rows are projected first, so that a
column of one row appears in others too.

Shapes: nv rows, m columns, N samples, n samples after decimation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from functools import cached_property

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.data.signals import Batch
from idtool.dynamics.contact_model import ContactModel

Shares = Sequence[Array] | Sequence[Mask]  # per row, the share of each filtered sample that counts, shape (n,)

_MIN_SHARE = 1e-6  # of a row; less is rounding of the projection
_SAMPLES_TOGETHER = 128  # whose matrices, rows and products fit in a processor's cache
_ENTRIES_TOGETHER = 1 << 17  # of products, which fit there until they are filtered
_FEW_ROWS = 6  # up to which sums over rows are faster than a product of matrices for each sample


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
    def filter_columns(self, rows: Indices, columns: Array) -> tuple[Indices, Array]:
        """Filtered columns that are nonzero in some rows only.

        Parameters
        ----------
        rows
            The k rows.
        columns
            The columns in them, shape (k, m, N).

        Returns
        -------
        The r rows in which they appear behind the filter, and the filtered columns in these, shape (r, m, n).
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
    def filter_columns(self, rows: Indices, columns: Array) -> tuple[Indices, Array]:
        return rows, self.batch.filter(columns)


@dataclass(frozen=True)
class ProjectedRows(RowFilter):
    """Filter that leaves out what unknown contact forces can exert.

    The expected squared error of a row is the square of its noise times the share that these forces leave of it: the
    diagonal of the projector, filtered as the rows are.

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

    @cached_property
    def _gains_time_last(self) -> Array:
        """Gains with time as the last axis, contiguous, shape (nv, nv, N)."""
        return np.ascontiguousarray(np.moveaxis(self._gains, 0, -1))

    @cached_property
    def _is_nonzero(self) -> Mask:
        """True for entries of the gains that are nonzero at any sample, shape (nv, nv)."""
        return np.asarray(self._gains.any(axis=0))

    @override
    def filter_rows(self, rows: Array) -> Array:
        return self.batch.filter(multiply_by_sample(self._gains, rows))

    @override
    def filter_columns(self, rows: Indices, columns: Array) -> tuple[Indices, Array]:
        output_rows = np.flatnonzero(self._is_nonzero[:, rows].any(axis=1))
        k, m, _ = columns.shape
        if not len(output_rows):  # unknown forces explain all of the rows
            return output_rows, np.empty((0, m, len(self.batch.t)))
        if k <= _FEW_ROWS or m == 1:
            return output_rows, self._filter_in_blocks(output_rows, rows, columns)
        gains = self._gains[:, output_rows[:, None], rows]
        return output_rows, self.batch.filter(multiply_by_sample(gains, columns))

    def _filter_in_blocks(self, output_rows: Indices, rows: Indices, columns: Array) -> Array:
        """Filtered products of gains and columns, shape (r, m, n), in blocks of both that stay in the cache."""
        _, m, N = columns.shape
        filtered = np.empty((len(output_rows), m, len(self.batch.t)))
        columns_per_block = min(m, max(_ENTRIES_TOGETHER // N, 1))
        rows_per_block = max(_ENTRIES_TOGETHER // (columns_per_block * N), 1)
        for first_column in range(0, m, columns_per_block):
            column_block = slice(first_column, first_column + columns_per_block)
            for first_row in range(0, len(output_rows), rows_per_block):
                row_block = slice(first_row, first_row + rows_per_block)
                gains = self._gains_time_last[output_rows[row_block, None], rows]
                products = np.einsum("rkn,kmn->rmn", gains, columns[:, column_block])
                filtered[row_block, column_block] = self.batch.filter(products)
        return filtered


def multiply_by_sample(matrices: Array, rows: Array) -> Array:
    """Product of each sample's matrix and rows.

    Parameters
    ----------
    matrices
        Shape (N, r, k).
    rows
        Shape (k, ..., N).

    Returns
    -------
    Shape (r, ..., N).
    """
    r, k = matrices.shape[1:]
    columns_and_time = rows.shape[1:]
    signals = rows.reshape(-1, columns_and_time[-1])  # (k m, N)
    products = np.empty((r * (len(signals) // k), signals.shape[1]))
    for first in range(0, signals.shape[1], _SAMPLES_TOGETHER):
        part = slice(first, first + _SAMPLES_TOGETHER)
        own_matrices = np.ascontiguousarray(matrices[part])
        by_sample = np.ascontiguousarray(signals[:, part].T).reshape(len(own_matrices), k, -1)
        own_products = own_matrices @ by_sample
        products[:, part] = own_products.reshape(len(own_products), -1).T
    return products.reshape(r, *columns_and_time)

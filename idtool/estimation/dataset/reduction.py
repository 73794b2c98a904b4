"""Triangular factors of the data. Factors merge, so a log of any length becomes a small matrix.

For rows A = [Y, tau], the factor R of A = QR has ‖A x‖ = ‖R x‖ for every x, so that with x = [theta; −1] the sum of
squared residuals of any theta is that of R's few rows. QR, not the normal equations, which would square the condition
number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.threads import in_threads
from idtool.dynamics.regrouping import RegroupedModel


@dataclass(frozen=True)
class Factor:
    """A factor of one joint's rows.

    Attributes
    ----------
    R
        Factor of [Y_j, tau_j], shape (at most m_j + 1, m_j + 1); a triangle, unless dependent columns were added.
    rows
        Number of rows that went into it; without contact forces, what they leave of rows counts as a share of one.
    independent
        Number of independent rows that they are worth: filtered samples repeat each other.
    """

    R: Array
    rows: float
    independent: float

    def __add__(self, other: Factor) -> Factor:
        """The factor of both factors' rows together; associative and, up to signs, commutative."""
        return Factor.merged((self, other))

    @classmethod
    def merged(cls, factors: Sequence[Factor]) -> Factor:
        """The factor of all factors' rows together."""
        R = _triangle(np.concatenate([factor.R for factor in factors]))
        return cls(R, sum(factor.rows for factor in factors), sum(factor.independent for factor in factors))

    @classmethod
    def from_columns(cls, block: Array, redundancy: float = 1.0) -> Factor:
        """The factor of columns and torque, shape (m_j + 1, n); ``redundancy`` of their samples are worth one."""
        return cls(_triangle(block.T), block.shape[1], block.shape[1] / redundancy)

    @classmethod
    def from_shares(cls, block: Array, shares: Array, redundancy: float = 1.0) -> Factor:
        """The factor of the samples that count, as many as the sum of their shares of a row, shape (n,)."""
        counts = shares > 0
        factor = cls.from_columns(block if counts.all() else block[:, counts], redundancy)
        rows = float(shares.sum())
        return cls(factor.R, rows, rows / redundancy)

    def without_columns(self, columns: Indices) -> Factor:
        """The factor of what the best coefficients of some columns leave of the others and of the torque."""
        eliminated = self.R[:, columns]
        others = np.delete(self.R, columns, axis=1)
        if not eliminated.size:
            return Factor(others, self.rows, self.independent)
        explained = eliminated @ np.linalg.lstsq(eliminated, others, rcond=None)[0]
        return Factor(_triangle(others - explained), self.rows, self.independent)

    def without_last_column(self) -> Factor:
        """The factor of the same rows without what is last in them."""
        R = self.R[:, :-1]
        if len(R) and not R[-1].any():  # as of a triangle
            R = R[:-1]
        return Factor(_triangle(R), self.rows, self.independent)

    def squared_error(self, theta: Array) -> float:
        """Sum of squared residuals ‖Y_j theta − tau_j‖² for the joint's m_j coefficients [(N·m)²]."""
        return float(self.squared_errors(theta[None])[0])

    def squared_errors(self, thetas: Array) -> Array:
        """Sums of squared residuals of several models, shape (models, m_j) to (models,) [(N·m)²]."""
        residuals = thetas @ self.R[:, :-1].T - self.R[:, -1]
        return np.asarray(np.square(residuals).sum(axis=1))


Reduction = tuple[Factor, ...]  # one per joint


def empty(active: Iterable[Indices]) -> Reduction:
    """The reduction of no rows: neutral in `merge`."""
    return tuple(Factor(np.zeros((0, len(columns) + 1)), 0, 0.0) for columns in active)


def merge(a: Reduction, b: Reduction) -> Reduction:
    """The reduction of the rows of both, joint by joint."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def reduce_blocks(blocks: Iterable[list[Array]], start: Reduction, redundancy: float = 1.0) -> Reduction:
    """The reduction of a stream of blocks, one array per joint, on top of ``start``; see `Factor.from_columns`."""
    total = start
    for block in blocks:
        total = merge(total, tuple(Factor.from_columns(columns, redundancy) for columns in block))
    return total


def with_all_columns(reductions: Sequence[Reduction], regrouped: RegroupedModel) -> list[Reduction]:
    """Reductions with the columns of bodies that were left out.

    Parameters
    ----------
    reductions
        Of rows of the regrouped equation.
    regrouped
        The model without dependent columns.
    """
    factors_by_joint = list(zip(*reductions, strict=True))

    def with_own_columns(joint: int) -> list[Factor]:
        factors = factors_by_joint[joint]
        rows = regrouped.all_columns(joint, np.concatenate([factor.R for factor in factors]))
        ends = np.cumsum([len(factor.R) for factor in factors])
        own_rows = np.split(rows, ends[:-1])
        return [replace(factor, R=R) for factor, R in zip(factors, own_rows, strict=True)]

    size = sum(factor.R.size for factors in factors_by_joint for factor in factors)
    by_joint = in_threads(with_own_columns, range(len(factors_by_joint)), size)
    return list(zip(*by_joint, strict=True))


def _triangle(rows: Array) -> Array:
    """R of a QR decomposition; fewer rows than columns stay as they are."""
    if len(rows) <= rows.shape[1]:
        return rows
    return np.asarray(np.linalg.qr(rows, mode="r"))

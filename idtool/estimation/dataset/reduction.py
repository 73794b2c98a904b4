"""Blocks → their triangular factors. Factors merge, so a log of any length becomes a small matrix.

For rows A = [Y, tau], the factor R of A = QR has ‖A x‖ = ‖R x‖ for every x, so that with x = [theta; −1] the sum of
squared residuals of any theta is that of R's few rows. QR, not the normal equations, which would square the condition
number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from idtool.common.arrays import Array, Indices


@dataclass(frozen=True)
class Factor:
    """What is left of one joint's rows.

    Attributes
    ----------
    R
        Triangular factor of [Y_j, tau_j], shape (at most m_j + 1, m_j + 1).
    rows
        How many rows went into it.
    independent
        How many independent ones they are worth: filtered samples repeat each other.
    """

    R: Array
    rows: int
    independent: float

    def __add__(self, other: Factor) -> Factor:
        """The factor of both factors' rows together; associative and, up to signs, commutative."""
        return Factor.joined((self, other))

    @classmethod
    def joined(cls, factors: Sequence[Factor]) -> Factor:
        """The factor of all factors' rows together."""
        R = _triangle(np.concatenate([factor.R for factor in factors]))
        return cls(R, sum(factor.rows for factor in factors), sum(factor.independent for factor in factors))

    @classmethod
    def of(cls, block: Array, redundancy: float = 1.0) -> Factor:
        """The factor of a block of columns, shape (m_j + 1, n), of which ``redundancy`` rows are worth one."""
        return cls(_triangle(block.T), block.shape[1], block.shape[1] / redundancy)

    def squares(self, theta: Array) -> float:
        """Sum of squared residuals ‖Y_j theta − tau_j‖² for the joint's m_j coefficients [(N·m)²]."""
        return float(np.square(self.R @ np.append(theta, -1.0)).sum())


Reduction = tuple[Factor, ...]  # one a joint


def empty(active: Iterable[Indices]) -> Reduction:
    """The reduction of no rows: neutral in `merge`."""
    return tuple(Factor(np.zeros((0, len(columns) + 1)), 0, 0.0) for columns in active)


def merge(a: Reduction, b: Reduction) -> Reduction:
    """The reduction of both one's rows, joint by joint."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def reduce_blocks(blocks: Iterable[list[Array]], start: Reduction, redundancy: float = 1.0) -> Reduction:
    """The reduction of a stream of blocks, one array a joint, on top of ``start``; see `Factor.of`."""
    return reduce(lambda total, block: merge(total, tuple(Factor.of(b, redundancy) for b in block)), blocks, start)


def _triangle(rows: Array) -> Array:
    """The R of a QR decomposition, without Q; fewer rows than columns stay as they are."""
    if len(rows) <= rows.shape[1]:
        return rows
    return np.asarray(np.linalg.qr(rows, mode="r"))

"""A log's rows in consecutive blocks of time, each as R-factors: resampled and compared without reading again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.estimation.dataset.reduction import Factor, Reduction, merge

_MOST = 256  # blocks of all logs together
_LEAST = 24  # of them, however much memory they take
_MEMORY = 256 << 20  # bytes that they may take
_PERIODS = 4.0  # of the band's highest frequency that a block lasts at least


@dataclass(frozen=True)
class Blocks:
    """One log.

    Attributes
    ----------
    name
        The log's.
    parts
        The reductions of its consecutive blocks, of about equal length; one that lies across a gap counts as one.
    seconds
        How long a block is [s].
    """

    name: str
    parts: tuple[Reduction, ...]
    seconds: float

    def __len__(self) -> int:
        return len(self.parts)

    @property
    def total(self) -> Reduction:
        """All of the log."""
        return together(self.parts)

    def of(self, change: Callable[[Reduction], Reduction]) -> Blocks:
        """The same with every block's reduction changed."""
        return replace(self, parts=tuple(map(change, self.parts)))

    def joined(self, count: int) -> Blocks:
        """The same with so many blocks in one; a rest of up to half of that joins the last."""
        starts = list(range(0, max(len(self) - count // 2, 1), count))
        parts = [self.parts[i:j] for i, j in zip(starts, [*starts[1:], len(self)], strict=True)]
        return replace(self, parts=tuple(map(together, parts)), seconds=self.seconds * count)


def together(reductions: Sequence[Reduction]) -> Reduction:
    """All rows of several reductions as one, joint by joint."""
    return tuple(Factor.joined(factors) for factors in zip(*reductions, strict=True))


def most_blocks(active: Iterable[Indices]) -> int:
    """How many blocks of a model whose joints have so many coefficients are held in memory."""
    size = 8 * sum((len(columns) + 1) ** 2 for columns in active)
    return int(np.clip(_MEMORY // size, _LEAST, _MOST))


def block_rows(rows: int, seconds: float, band_hz: float, most: int) -> int:
    """How many rows a block has.

    Parameters
    ----------
    rows
        Of all logs.
    seconds
        From one row to the next [s].
    band_hz
        The low-pass's cut-off [Hz].
    most
        Blocks of all logs together.
    """
    return max(int(np.ceil(_PERIODS / band_hz / seconds)), -(-rows // most))


def cut(rows: Iterable[tuple[list[Array], list[Mask]]], length: int, redundancy: float) -> Iterator[Reduction]:
    """Blocks of so many rows from a stream of them.

    Parameters
    ----------
    rows
        Per joint the columns, shape (m_j + 1, n), and which of the n count.
    length
        Rows in a block, whether they count or not.
    redundancy
        See `Factor.of`.
    """
    begun: Reduction | None = None
    filled = 0
    for columns, kept in rows:
        first, count = 0, columns[0].shape[1]
        while first < count:
            part = slice(first, min(first + length - filled, count))
            pairs = zip(columns, kept, strict=True)
            own = tuple(Factor.of(x[:, part][:, keep[part]], redundancy) for x, keep in pairs)
            begun = own if begun is None else merge(begun, own)
            filled, first = filled + part.stop - first, part.stop
            if filled == length:
                yield begun
                begun, filled = None, 0
    if begun is not None:
        yield begun

"""Consecutive blocks of a log as R-factors, which can be resampled and compared without reading the log again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.threads import in_threads
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.reduction import Factor, Reduction, merge

_MOST_BLOCKS = 256  # of all logs together
_FEWEST_BLOCKS = 24  # of them, however much memory they take
_FEWEST_BLOCKS_OF_LOG = 4  # that a log of many may have
_MEMORY = 256 << 20  # bytes that they may take
_PERIODS = 4.0  # of the band's highest frequency that a block lasts at least


@dataclass(frozen=True)
class Blocks:
    """One log in blocks.

    Attributes
    ----------
    name
        The log's name.
    parts
        The reductions of its consecutive blocks, of about equal length; one that lies across a gap counts as one.
    seconds
        Length of a block [s].
    merged
        The reduction of the whole log, if it is known.
    """

    name: str
    parts: tuple[Reduction, ...]
    seconds: float
    merged: Reduction | None = None

    def __len__(self) -> int:
        return len(self.parts)

    @cached_property
    def total(self) -> Reduction:
        """The reduction of the whole log."""
        return self.merged or merge_reductions(self.parts)

    def map(self, change: Callable[[Reduction], Reduction]) -> Blocks:
        """Blocks with every reduction changed."""
        return replace(self, parts=tuple(change(part) for part in self.parts), merged=None)

    def regrouped(self, count: int) -> Blocks:
        """Blocks that are ``count`` times as long; a rest of up to half of that joins the last."""
        starts = list(range(0, max(len(self) - count // 2, 1), count))
        stops = [*starts[1:], len(self)]
        parts = tuple(merge_reductions(self.parts[i:j]) for i, j in zip(starts, stops, strict=True))
        return replace(self, parts=parts, seconds=self.seconds * count)


def merge_reductions(reductions: Sequence[Reduction]) -> Reduction:
    """The reduction of all rows of several reductions, joint by joint."""
    if len(reductions) == 1:
        return reductions[0]
    factors_of_joints = list(zip(*reductions, strict=True))
    work = sum(factor.R.size for reduction in reductions for factor in reduction)
    return tuple(in_threads(Factor.merged, factors_of_joints, work))


def most_blocks(columns: Iterable[int]) -> int:
    """Number of blocks that fit in memory, by the number of columns of each joint beside its torque."""
    size = 8 * sum((count + 1) ** 2 for count in columns)
    return int(np.clip(_MEMORY // size, _FEWEST_BLOCKS, _MOST_BLOCKS))


def rounded_count(log_count: int) -> int:
    """The next power of two, so that what is kept of a log seldom changes as further logs are recorded."""
    return 1 << (log_count - 1).bit_length()


def block_rows(rows: Sequence[int], steps: Sequence[float], band_hz: float, most: int, logs: int) -> list[int]:
    """Number of rows in a block of each log.

    A block lasts four periods of the band, doubled until there are few enough. Blocks of a part of the logs are
    therefore as long as those of all logs together, or can be merged into these; see `merged_blocks`.

    Parameters
    ----------
    rows
        Number of rows of each log.
    steps
        Time from one row of a log to the next [s].
    band_hz
        The low-pass's cut-off [Hz].
    most
        Largest number of blocks of all logs together, but for one of each.
    logs
        Number of logs of which these are some. The more there are, the fewer blocks one of them has.
    """
    shortest = [max(int(np.ceil(_PERIODS / band_hz / step)), 1) for step in steps]
    most_of_log = max(most // max(logs, 1), _FEWEST_BLOCKS_OF_LOG)
    factor = 1
    while True:
        lengths = [factor * length for length in shortest]
        counts = [-(-count // length) for count, length in zip(rows, lengths, strict=True)]
        if sum(counts) <= max(most, len(counts)) and max(counts, default=0) <= most_of_log:
            return lengths
        factor *= 2


def merged_blocks(blocks: Mapping[int, Reduction], factor: int) -> list[Reduction]:
    """Reductions of blocks that are longer by a factor.

    Parameters
    ----------
    blocks
        Reductions of a log's blocks, by their number in the log.
    factor
        Number of consecutive blocks that become one.
    """
    groups: dict[int, list[Reduction]] = {}
    for number, block in blocks.items():
        groups.setdefault(number // factor, []).append(block)
    return [merge_reductions(group) for group in groups.values()]


def cut_into_blocks(
    rows: Iterable[tuple[list[Array], Shares]], length: int, redundancy: float, first_row: int = 0
) -> Iterator[tuple[int, Reduction]]:
    """Reductions of blocks of ``length`` rows each from a stream of rows, with their numbers.

    Parameters
    ----------
    rows
        Per joint the columns, shape (m_j + 1, n), and which of the n count, or with which share of a row each does.
    length
        Rows in a block, including those that don't count.
    redundancy
        See `Factor.from_columns`.
    first_row
        Number of rows before those of the stream; the first block is then cut off at its beginning.
    """
    block: Reduction | None = None
    row = first_row
    for columns, shares in rows:
        first, count = 0, columns[0].shape[1]
        while first < count:
            number, filled = divmod(row, length)
            part = slice(first, min(first + length - filled, count))
            pairs = zip(columns, shares, strict=True)
            new = tuple(Factor.from_shares(x[:, part], share[part].astype(float), redundancy) for x, share in pairs)
            block = new if block is None else merge(block, new)
            row += part.stop - part.start
            first = part.stop
            if row % length == 0:
                yield number, block
                block = None
    if block is not None:
        yield row // length, block

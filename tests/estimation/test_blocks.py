"""Blocks of a stream of rows against the whole array: sums of products are what an R-factor keeps of its rows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from idtool.estimation.dataset.blocks import (
    Blocks,
    block_rows,
    cut_into_blocks,
    merge_reductions,
    merged_blocks,
    most_blocks,
)
from idtool.estimation.dataset.reduction import Factor, Reduction, merge

Array = NDArray[np.float64]
Batches = list[tuple[list[Array], list[NDArray[np.bool_]]]]

WIDTHS = (3, 4)  # columns of two joints, the torque among them


class Stream:
    """Two joints' rows, and which of them count."""

    def __init__(self, rows: int, seed: int, kept: float = 0.8) -> None:
        rng = np.random.default_rng(seed)
        self.rows = rows
        self.columns = [rng.normal(size=(width, rows)) for width in WIDTHS]
        self.kept = [rng.random(rows) < kept for _ in WIDTHS]

    def batches(self, ends: list[int]) -> Batches:
        """The same in pieces that end there and at the end."""
        edges = [0, *sorted(end % (self.rows + 1) for end in ends), self.rows]
        pieces = [slice(i, j) for i, j in itertools.pairwise(edges)]
        return [([x[:, piece] for x in self.columns], [keep[piece] for keep in self.kept]) for piece in pieces]

    def products(self, first: int, last: int) -> list[Array]:
        """Sums of products of the rows that count."""
        parts = [x[:, first:last][:, keep[first:last]] for x, keep in zip(self.columns, self.kept, strict=True)]
        return [part @ part.T for part in parts]

    def counts(self, first: int, last: int) -> list[int]:
        return [int(keep[first:last].sum()) for keep in self.kept]


def assert_same(reduction: Reduction, stream: Stream, first: int, last: int, redundancy: float) -> None:
    """A reduction is that of some of a stream's rows."""
    for factor, product, count in zip(reduction, stream.products(first, last), stream.counts(first, last), strict=True):
        np.testing.assert_allclose(factor.R.T @ factor.R, product, rtol=0, atol=1e-10)
        assert factor.rows == count
        assert factor.independent == pytest.approx(count / redundancy)
        assert len(factor.R) <= factor.R.shape[1]


streams = st.builds(Stream, st.integers(1, 90), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 1.0]))


@given(streams, st.integers(1, 40), st.lists(st.integers(0, 100), max_size=6))
def test_a_block_holds_its_rows_wherever_batches_end(stream: Stream, length: int, ends: list[int]) -> None:
    """Empty batches, batches of many blocks and blocks of many batches; the last block is shorter."""
    numbers, blocks = zip(*cut_into_blocks(stream.batches(ends), length, 2.5), strict=True)
    assert numbers == tuple(range(-(-stream.rows // length)))
    for i, block in enumerate(blocks):
        assert_same(block, stream, i * length, min((i + 1) * length, stream.rows), 2.5)
    assert_same(merge_reductions(blocks), stream, 0, stream.rows, 2.5)
    assert_same(Blocks("log", tuple(blocks), 1.0).total, stream, 0, stream.rows, 2.5)


@given(streams, st.integers(1, 40), st.lists(st.integers(0, 100), max_size=6), st.integers(0, 100))
def test_parts_of_a_stream_give_parts_of_its_blocks(stream: Stream, length: int, ends: list[int], cut: int) -> None:
    """A block that lies across two parts is the two parts' together."""
    batches = stream.batches(ends)
    first, second = batches[: cut % len(batches)], batches[cut % len(batches) :]
    rows_before = sum(columns[0].shape[1] for columns, _ in first)
    parts = [*cut_into_blocks(first, length, 2.5), *cut_into_blocks(second, length, 2.5, rows_before)]
    blocks: dict[int, Reduction] = {}
    for number, part in parts:
        blocks[number] = merge(blocks[number], part) if number in blocks else part
    assert list(blocks) == list(range(-(-stream.rows // length)))
    for number, block in blocks.items():
        assert_same(block, stream, number * length, min((number + 1) * length, stream.rows), 2.5)


def test_nothing_gives_no_block() -> None:
    assert not list(cut_into_blocks([], 10, 1.0))
    assert not list(cut_into_blocks(Stream(0, 1).batches([]), 10, 1.0))


def test_blocks_come_before_the_log_is_at_its_end() -> None:
    """So that no more of a log is in memory than a batch."""
    stream, read = Stream(100, 3), []

    def batches() -> Iterator[tuple[list[Array], list[NDArray[np.bool_]]]]:
        for i, batch in enumerate(stream.batches([20, 40, 60, 80])):
            read.append(i)
            yield batch

    blocks = cut_into_blocks(batches(), 10, 1.0)
    next(blocks)
    next(blocks)
    assert read == [0]
    next(blocks)
    assert read == [0, 1]


def numbered(count: int) -> Blocks:
    """Blocks of one row each that holds the block's number."""
    factors = [Factor(np.array([[1.0 + i]]), 1, 1.0) for i in range(count)]
    return Blocks("log", tuple((factor,) for factor in factors), 0.25)


@given(st.integers(1, 60), st.integers(1, 12))
def test_joined_blocks_are_consecutive_and_about_as_long(count: int, each: int) -> None:
    """A rest of more than half of a block is one of its own, a shorter one lengthens the last."""
    joined = numbered(count).regrouped(each)
    sizes = [part[0].rows for part in joined.parts]
    assert sum(sizes) == count
    assert set(sizes[:-1]) <= {each}
    if count >= each:
        assert each / 2 < sizes[-1] <= each * 1.5
    numbers = np.arange(1.0, count + 1)
    edges = np.cumsum([0, *sizes])
    for part, (i, j) in zip(joined.parts, itertools.pairwise(edges), strict=True):
        assert float(np.square(part[0].R).sum()) == pytest.approx(np.square(numbers[i:j]).sum())
    assert joined.seconds == pytest.approx(0.25 * each)
    assert joined.name == "log"
    assert len(joined) == len(sizes)


ROWS = st.lists(st.integers(0, 10**7), min_size=1, max_size=8)


@given(ROWS, st.floats(1e-4, 0.1), st.floats(0.5, 100), st.integers(24, 256))
def test_a_block_is_four_periods_doubled_until_there_are_few_enough(
    rows: list[int], step: float, band: float, most: int
) -> None:
    """Four periods of the band's upper end; no more blocks than are wanted, but for one of each log."""
    (length, *others) = block_rows(rows, [step] * len(rows), band, most, len(rows))
    (shortest,) = block_rows([1], [step], band, most, 1)
    assert set(others) <= {length}
    assert shortest * step * band >= 4 * (1 - 1e-12)
    assert shortest == 1 or (shortest - 1) * step * band < 4 * (1 + 1e-12)
    assert np.log2(length / shortest).is_integer()

    def is_enough(n: int) -> bool:
        counts = [-(-count // n) for count in rows]
        return sum(counts) <= max(most, len(rows)) and max(counts) <= max(most // len(rows), 4)

    assert is_enough(length)
    assert length == shortest or not is_enough(length // 2)


@given(ROWS, st.data())
def test_blocks_of_one_log_can_be_merged_into_those_of_all(rows: list[int], data: st.DataObject) -> None:
    """Whether it was reduced alone, or as one of all of them."""
    i = data.draw(st.integers(0, len(rows) - 1))
    of_all = block_rows(rows, [0.0125] * len(rows), 40.0, 256, len(rows))[i]
    for logs in (1, len(rows)):
        (alone,) = block_rows([rows[i]], [0.0125], 40.0, 256, logs)
        assert of_all % alone == 0


def test_merged_blocks_are_those_of_the_longer_length() -> None:
    stream = Stream(4000, 5, kept=0.8)
    short = dict(cut_into_blocks(stream.batches([7, 1900]), 50, 1.0))
    long = [block for _, block in cut_into_blocks(stream.batches([7, 1900]), 400, 1.0)]
    merged = merged_blocks(short, 8)
    assert len(merged) == len(long)
    for block, expected in zip(merged, long, strict=True):
        for factor, other in zip(block, expected, strict=True):
            np.testing.assert_allclose(factor.R.T @ factor.R, other.R.T @ other.R, atol=1e-9)
            assert (factor.rows, factor.independent) == (other.rows, other.independent)


@given(st.lists(st.integers(0, 4000), min_size=1, max_size=8))
def test_blocks_in_memory_are_bounded(sizes: list[int]) -> None:
    """256 at most, 24 at least, in between 256 MiB; of triangles that are stored as squares."""
    count = most_blocks(sizes)
    assert 24 <= count <= 256
    each = 8 * sum((size + 1) ** 2 for size in sizes)
    assert count == 24 or count * each <= 256 << 20
    assert count == 256 or (count + 1) * each > 256 << 20


def test_a_block_takes_no_more_memory_than_it_is_counted_for() -> None:
    stream = Stream(4000, 5, kept=1.0)
    blocks = cut_into_blocks(stream.batches([7, 1900]), 500, 1.0)
    bytes_held = [sum(factor.R.nbytes for factor in block) for _, block in blocks]
    assert max(bytes_held) <= 8 * sum(width**2 for width in WIDTHS)

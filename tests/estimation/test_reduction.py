"""The triangular factors: a monoid, and as good as the rows they stand for."""

from __future__ import annotations

from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from idtool.estimation.dataset.reduction import Factor, Reduction, empty, merge, reduce_blocks

Array = NDArray[np.float64]

COLUMNS = (4, 1, 7)  # of three joints
ACTIVE = tuple(np.arange(m) for m in COLUMNS)

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
lengths = st.lists(st.integers(0, 12), min_size=1, max_size=6)


def random_block(rng: np.random.Generator, rows: int) -> list[Array]:
    """Columns and torque of every joint, (m + 1, rows) each."""
    return [rng.normal(size=(m + 1, rows)) for m in COLUMNS]


def reduced(block: list[Array], redundancy: float = 1.0) -> Reduction:
    return tuple(Factor.from_columns(rows, redundancy) for rows in block)


def residual(rows: Array, theta: Array) -> float:
    """‖Y theta − tau‖² of rows as they are, (m + 1, n)."""
    return float(np.square(theta @ rows[:-1] - rows[-1]).sum())


def assert_same(a: Reduction, b: Reduction) -> None:
    """Two reductions stand for the same rows: R'R is the same, and so are the counts."""
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x.R.T @ x.R, y.R.T @ y.R, rtol=1e-9, atol=1e-9)
        assert x.rows == y.rows
        assert x.independent == pytest.approx(y.independent)


@given(seeds, st.integers(0, 40))
def test_the_residual_is_that_of_the_rows(rng: np.random.Generator, rows: int) -> None:
    block = random_block(rng, rows)
    for m, columns, factor in zip(COLUMNS, block, reduced(block), strict=True):
        theta = rng.normal(size=m)
        assert factor.squared_error(theta) == pytest.approx(residual(columns, theta), rel=1e-9, abs=1e-12)
        assert factor.R.shape == (min(rows, m + 1), m + 1)
        assert factor.rows == rows


@given(seeds, st.lists(st.integers(0, 12), min_size=3, max_size=3))
def test_merging_is_associative(rng: np.random.Generator, rows: list[int]) -> None:
    a, b, c = (reduced(random_block(rng, n), redundancy=2.0) for n in rows)
    assert_same(merge(merge(a, b), c), merge(a, merge(b, c)))


@given(seeds, st.integers(0, 20))
def test_no_rows_are_neutral(rng: np.random.Generator, rows: int) -> None:
    a = reduced(random_block(rng, rows), redundancy=3.0)
    assert_same(merge(a, empty(ACTIVE)), a)
    assert_same(merge(empty(ACTIVE), a), a)
    for factor, columns in zip(empty(ACTIVE), ACTIVE, strict=True):
        assert factor.squared_error(rng.normal(size=len(columns))) == 0
        assert (factor.rows, factor.independent) == (0, 0)


@given(seeds, lengths)
def test_the_order_of_merging_does_not_matter(rng: np.random.Generator, rows: list[int]) -> None:
    parts = [reduced(random_block(rng, n)) for n in rows]
    shuffled = [parts[i] for i in rng.permutation(len(parts))]
    a, b = reduce(merge, parts), reduce(merge, shuffled)
    assert_same(a, b)
    for m, x, y in zip(COLUMNS, a, b, strict=True):
        theta = rng.normal(size=m)
        assert x.squared_error(theta) == pytest.approx(y.squared_error(theta), rel=1e-9, abs=1e-12)


@given(seeds, lengths)
def test_many_small_blocks_are_one_big_one(rng: np.random.Generator, rows: list[int]) -> None:
    blocks = [random_block(rng, n) for n in rows]
    whole = [np.concatenate([block[j] for block in blocks], axis=1) for j in range(len(COLUMNS))]
    merged = reduce_blocks(iter(blocks), empty(ACTIVE), redundancy=2.5)
    assert_same(merged, reduced(whole, redundancy=2.5))
    assert all(factor.independent == pytest.approx(sum(rows) / 2.5) for factor in merged)
    for m, columns, factor in zip(COLUMNS, whole, merged, strict=True):
        theta = rng.normal(size=m)
        assert factor.squared_error(theta) == pytest.approx(residual(columns, theta), rel=1e-9, abs=1e-12)
        assert len(factor.R) <= m + 1


def test_a_stream_goes_on_from_where_another_ended(rng: np.random.Generator) -> None:
    first, second = ([random_block(rng, 5) for _ in range(3)] for _ in range(2))
    middle = reduce_blocks(first, empty(ACTIVE))
    assert_same(reduce_blocks(second, middle), reduce_blocks([*first, *second], empty(ACTIVE)))
    assert_same(reduce_blocks([], middle), middle)


def test_the_least_squares_solution_is_that_of_the_rows(rng: np.random.Generator) -> None:
    blocks = [random_block(rng, 50) for _ in range(4)]
    for j, factor in enumerate(reduce_blocks(blocks, empty(ACTIVE))):
        rows = np.concatenate([block[j] for block in blocks], axis=1)
        ours = np.linalg.lstsq(factor.R[:, :-1], factor.R[:, -1], rcond=None)[0]
        np.testing.assert_allclose(ours, np.linalg.lstsq(rows[:-1].T, rows[-1], rcond=None)[0], atol=1e-10)


def test_a_factor_keeps_what_normal_equations_lose(rng: np.random.Generator) -> None:
    """Two columns that differ by 1e-9: their difference is a digit below what YᵀY can hold."""
    y = rng.normal(size=300)
    rows = np.stack([y, y + 1e-9 * rng.normal(size=300), rng.normal(size=300)])
    factor = reduce_blocks(([part] for part in np.split(rows, 10, axis=1)), empty([np.arange(2)]))[0]
    least = np.linalg.svd(rows[:-1].T, compute_uv=False)[-1]
    assert np.linalg.svd(factor.R[:, :-1], compute_uv=False)[-1] == pytest.approx(least, rel=1e-4)
    assert abs(np.linalg.eigvalsh(rows[:-1] @ rows[:-1].T)[0] / least**2 - 1) > 1e-2

"""Tests of `ExtremeRows`: the least and greatest rows of stretches of time, batch after batch."""

from __future__ import annotations

import numpy as np

from idtool.estimation.dataset.extreme_rows import ExtremeRows

BINS, WIDTH, COUNT = 7, 3, 200


def random_rows(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    bins = np.sort(rng.integers(BINS - 1, size=COUNT))  # the last one stays empty
    return bins, rng.normal(size=(WIDTH, COUNT)), [rng.normal(size=COUNT), rng.normal(size=COUNT)]


def test_rows_are_those_at_which_a_quantity_is_least_and_greatest() -> None:
    bins, rows, quantities = random_rows(np.random.default_rng(0))
    extremes = ExtremeRows([WIDTH], BINS)
    half = COUNT // 2
    extremes.add(bins[:half], [[rows[:, :half]]], [quantity[None, :half] for quantity in quantities])
    extremes.add(bins[half:], [[rows[:, half:]]], [quantity[None, half:] for quantity in quantities])
    for k in range(BINS - 1):
        own = np.flatnonzero(bins == k)
        for i, quantity in enumerate(quantities):
            least, greatest = own[quantity[own].argmin()], own[quantity[own].argmax()]
            np.testing.assert_array_equal(extremes.rows[0][k, 2 * i], rows[:, least])
            np.testing.assert_array_equal(extremes.rows[0][k, 2 * i + 1], rows[:, greatest])
    assert np.isnan(extremes.rows[0][-1]).all()


def test_unknown_values_are_passed_over() -> None:
    bins, rows, quantities = random_rows(np.random.default_rng(1))
    quantities[0][bins == 2] = np.nan
    quantities[0][:5] = np.nan
    quantities[1][:] = np.nan
    extremes = ExtremeRows([WIDTH], BINS)
    extremes.add(bins, [[rows[:2], rows[2:]]], [quantity[None] for quantity in quantities])
    own = np.flatnonzero((bins == 0) & np.isfinite(quantities[0]))
    np.testing.assert_array_equal(extremes.rows[0][0, 0], rows[:, own[quantities[0][own].argmin()]])
    assert np.isnan(extremes.rows[0][2, :2]).all()
    assert np.isnan(extremes.rows[0][:, 2:]).all()

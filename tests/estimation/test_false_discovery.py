"""Discoveries among many tests as scipy has them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import false_discovery_control

from idtool.estimation.uncertainty.false_discovery import discoveries


@pytest.mark.parametrize("count", [1, 2, 10, 200])
@pytest.mark.parametrize("small", [0.0, 0.1, 1.0])
def test_discoveries_are_those_by_adjusted_p_values(count: int, small: float, rng: np.random.Generator) -> None:
    for _ in range(50):
        p_values = rng.random(count) * np.where(rng.random(count) < small, 1e-3, 1.0)
        expected = false_discovery_control(p_values) < 0.05
        np.testing.assert_array_equal(discoveries(p_values, 0.05), expected)


def test_no_test_no_discovery() -> None:
    assert discoveries(np.array([]), 0.05).shape == (0,)
    assert not discoveries(np.array([0.9, 0.2]), 0.05).any()


def test_few_of_what_is_discovered_are_false(rng: np.random.Generator) -> None:
    """Half of the tests have nothing to discover; their p-values are even between 0 and 1."""
    shares = []
    for _ in range(400):
        is_true = rng.random(40) < 0.5
        found = discoveries(np.where(is_true, rng.random(40) ** 4, rng.random(40)), 0.05)
        shares.append((found & ~is_true).sum() / max(found.sum(), 1))
    assert np.mean(shares) < 0.05

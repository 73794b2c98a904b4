"""Power densities as scipy has them."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from scipy.signal import periodogram, welch

from idtool.data.power_density import periodograms, power_density


@pytest.mark.parametrize("average", ["mean", "median"])
@pytest.mark.parametrize(
    ("shape", "segment"), [((1000,), 256), ((1000,), 255), ((3, 40_000), 128), ((300,), 300), ((2, 17), 16), ((9,), 2)]
)
def test_the_density_is_that_of_scipy(
    shape: tuple[int, ...], segment: int, average: Literal["mean", "median"], rng: np.random.Generator
) -> None:
    x = 3.0 + np.cumsum(rng.standard_normal(shape), axis=-1)
    expected_f, expected = welch(x, 500.0, nperseg=segment, average=average)
    f, density = power_density(x, 1 / 500, segment, average)
    np.testing.assert_allclose(f, expected_f, rtol=1e-12)
    np.testing.assert_allclose(density, expected, rtol=1e-12, atol=1e-12 * expected.max())


def test_a_segment_of_one_sample_has_no_power() -> None:
    f, density = power_density(np.array([1.0, 2.0]), 0.1, 1)
    assert (f.tolist(), density.tolist()) == ([0.0], [0.0])


def test_white_noise_has_its_variance(rng: np.random.Generator) -> None:
    f, density = power_density(2.0 * rng.standard_normal(200_000), 1e-3, 500)
    assert density.sum() * f[1] == pytest.approx(4.0, rel=0.02)
    _, by_median = power_density(2.0 * rng.standard_normal(200_000), 1e-3, 500, "median")
    assert by_median.sum() * f[1] == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize("length", [2, 15, 64])
def test_periodograms_are_those_of_scipy(length: int, rng: np.random.Generator) -> None:
    x = 1.0 + rng.standard_normal((3, length))
    _, expected = periodogram(x, 200.0, window="hann", detrend=False)
    np.testing.assert_allclose(periodograms(x, 1 / 200), expected, rtol=1e-12, atol=1e-12 * expected.max())

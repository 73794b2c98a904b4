"""Moving averages as scipy has them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from idtool.data.smoothing import gaussian_mean, moving_mean


@pytest.mark.parametrize("width", [1, 2, 5, 16, 40, 90])
def test_a_moving_mean(width: int, rng: np.random.Generator) -> None:
    x = rng.standard_normal(40)
    np.testing.assert_allclose(moving_mean(x, width), uniform_filter1d(x, width), rtol=0, atol=1e-13)
    rows = rng.standard_normal((3, 40))
    np.testing.assert_allclose(moving_mean(rows, width), uniform_filter1d(rows, width), rtol=0, atol=1e-13)
    z = x + 1j * rng.standard_normal(40)
    np.testing.assert_allclose(moving_mean(z, width), uniform_filter1d(z, width), rtol=0, atol=1e-13)


@pytest.mark.parametrize("sigma", [0.4, 3.0, 50.0])
def test_a_mean_by_a_gaussian(sigma: float, rng: np.random.Generator) -> None:
    x = rng.standard_normal(120)
    np.testing.assert_allclose(gaussian_mean(x, sigma), gaussian_filter1d(x, sigma), rtol=0, atol=1e-13)

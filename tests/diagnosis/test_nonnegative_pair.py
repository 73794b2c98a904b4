"""Two coefficients that are not negative, as scipy has them."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from idtool.diagnosis.noise_floor import _nonnegative_pair


def test_coefficients_are_those_of_scipy(rng: np.random.Generator) -> None:
    """Whatever the signs of the unconstrained ones are."""
    for _ in range(300):
        A = np.abs(rng.standard_normal((12, 2)))
        b = A @ rng.standard_normal(2) + 0.1 * rng.standard_normal(12)
        expected, _ = nnls(A, b)
        np.testing.assert_allclose(_nonnegative_pair(A, b), expected, rtol=0, atol=1e-12)

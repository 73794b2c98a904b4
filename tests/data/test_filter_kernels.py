"""Kernels of filters from their transforms against scipy's recursive filters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from idtool.data.filters import zero_phase_butterworth

ORDERS = range(1, 9)


@pytest.mark.parametrize("cutoff", [0.003, 0.01, 0.04, 0.1, 0.25, 0.4, 0.44])
@pytest.mark.parametrize("order", ORDERS)
def test_the_kernel_is_the_response_of_both_passes(order: int, cutoff: float) -> None:
    kernel = zero_phase_butterworth(order, cutoff)
    impulse = np.zeros(2 * len(kernel))
    impulse[0] = 1.0
    response = signal.sosfilt(signal.butter(order, 2 * cutoff, output="sos"), impulse)
    expected = signal.correlate(response, response)
    reach = len(kernel) // 2
    middle = len(expected) // 2
    expected = expected[middle - reach : middle + reach + 1]
    np.testing.assert_allclose(kernel, expected, rtol=0, atol=1e-12 * expected.max())


@pytest.mark.parametrize("order", ORDERS)
def test_the_kernel_of_a_low_cutoff_is_that_of_more_digits(order: int) -> None:
    """A recursive filter loses digits here, so the transform is taken in extended precision on a longer grid."""
    cutoff = 0.001
    kernel = zero_phase_butterworth(order, cutoff)
    reach = len(kernel) // 2
    f = np.arange(8 * reach + 1, dtype=np.longdouble) / (16 * reach)
    turn = np.arctan2(np.longdouble(0), np.longdouble(-1))
    ratio = np.tan(turn * f) / np.tan(turn * np.longdouble(cutoff))
    expected = np.fft.irfft(1 / (1 + ratio ** (2 * order)))[: reach + 1]
    np.testing.assert_allclose(kernel[reach:], expected.astype(float), rtol=0, atol=1e-12 * float(expected[0]))

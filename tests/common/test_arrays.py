"""Masks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from idtool.common.arrays import dilated


@pytest.mark.parametrize("reach", [1, 2, 7, 200])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_a_mask_is_dilated(reach: int, share: float, rng: np.random.Generator) -> None:
    mask = rng.random(150) < share
    np.testing.assert_array_equal(dilated(mask, reach), binary_dilation(mask, iterations=reach))
    np.testing.assert_array_equal(dilated(mask, 0), mask)

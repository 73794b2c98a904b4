"""Lengths of Fourier transforms as scipy has them."""

from __future__ import annotations

from scipy.fft import next_fast_len

from idtool.common.fourier import fast_length


def test_fast_lengths() -> None:
    for least in [*range(1, 3000), 65_537, 10**6 + 1, 10**9 + 7]:
        assert fast_length(least) == next_fast_len(least, real=True)

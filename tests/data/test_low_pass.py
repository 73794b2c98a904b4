"""The zero-phase low-pass against scipy's filter run forwards and backwards."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from idtool.data.filters import LowPass

Array = NDArray[np.float64]

BANDS = [(40.0, 4, 0.001), (5.0, 2, 0.001), (20.0, 1, 0.002), (12.0, 8, 0.01), (200.0, 4, 0.001), (90.0, 3, 0.005)]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def whole(low_pass: LowPass, x: Array) -> Array:
    """All of a signal, both of its ends included."""
    return low_pass(x, 0, 0)


@pytest.mark.parametrize(("cutoff", "order", "dt"), BANDS)
def test_away_from_the_ends_it_is_scipys_filtfilt(cutoff: float, order: int, dt: float) -> None:
    low_pass = LowPass(cutoff, order, dt)
    x = np.random.default_rng(1).normal(size=(3, 4 * low_pass.reach + 50)).cumsum(axis=1)
    expected = sosfiltfilt(butter(order, cutoff, fs=1 / dt, output="sos"), x, axis=1)
    inside = slice(2 * low_pass.reach, -2 * low_pass.reach)
    np.testing.assert_allclose(whole(low_pass, x)[:, inside], expected[:, inside], rtol=0, atol=1e-5 * np.abs(x).max())


@pytest.mark.parametrize(("cutoff", "order", "dt"), BANDS)
def test_a_wave_at_the_cut_off_comes_out_half_as_high_and_not_shifted(cutoff: float, order: int, dt: float) -> None:
    low_pass = LowPass(cutoff, order, dt)
    phase = 2 * np.pi * cutoff * dt * np.arange(4 * low_pass.reach)
    x = np.stack([np.sin(phase), np.cos(phase)])
    inside = slice(low_pass.reach, -low_pass.reach)
    np.testing.assert_allclose(whole(low_pass, x)[:, inside], 0.5 * x[:, inside], atol=1e-5)


@given(seeds, st.sampled_from(BANDS), st.integers(2, 9))
def test_decimation_keeps_every_so_manieth_sample(
    rng: np.random.Generator, band: tuple[float, int, float], stride: int
) -> None:
    every, some = LowPass(*band), LowPass(*band, stride=stride)
    x = rng.normal(size=(2, int(rng.integers(1, 900))))
    np.testing.assert_allclose(whole(some, x), whole(every, x)[:, ::stride], rtol=0, atol=1e-12)


@given(seeds, st.sampled_from(BANDS), st.integers(1, 7))
def test_parts_with_their_surroundings_give_what_the_whole_gives(
    rng: np.random.Generator, band: tuple[float, int, float], stride: int
) -> None:
    low_pass = LowPass(*band, stride=stride)
    x = rng.normal(size=(2, 2000))
    cuts = [0, *(stride * np.unique(rng.integers(1, 2000 // stride, 4))).tolist(), 2000]
    parts = []
    for start, stop in pairwise(cuts):
        before, after = min(start, low_pass.reach), min(2000 - stop, low_pass.reach)
        parts.append(low_pass(x[:, start - before : stop + after], before, after))
    np.testing.assert_allclose(np.concatenate(parts, axis=1), whole(low_pass, x), rtol=0, atol=1e-12)


@given(seeds, st.sampled_from(BANDS), st.integers(1, 50))
def test_constants_pass_unchanged_up_to_the_ends(
    rng: np.random.Generator, band: tuple[float, int, float], count: int
) -> None:
    constants = rng.normal(size=(3, 1)) * np.ones(count)
    np.testing.assert_allclose(whole(LowPass(*band), constants), constants, rtol=1e-12)


@pytest.mark.parametrize(("cutoff", "order", "dt"), BANDS)
def test_a_ramp_passes_unchanged_away_from_the_ends(cutoff: float, order: int, dt: float) -> None:
    low_pass = LowPass(cutoff, order, dt)
    ramp = np.arange(3.0 * low_pass.reach)
    inside = slice(low_pass.reach, -low_pass.reach)
    np.testing.assert_allclose(whole(low_pass, ramp)[inside], ramp[inside], rtol=1e-12)


@pytest.mark.parametrize(("cutoff", "order", "dt"), BANDS)
def test_from_the_edge_on_at_most_two_percent_of_the_weight_lie_beyond_the_end(
    cutoff: float, order: int, dt: float
) -> None:
    low_pass = LowPass(cutoff, order, dt)
    beyond = np.concatenate([np.ones(low_pass.reach), np.zeros(3 * low_pass.reach)])
    weight = np.abs(low_pass(beyond, low_pass.reach, low_pass.reach))
    assert weight[low_pass.edge :].max() <= 0.02 < weight[: low_pass.edge].max()


@pytest.mark.parametrize("stride", [1, 6, 25])
def test_redundancy_is_how_many_samples_are_worth_one(stride: int) -> None:
    """The mean of n samples, of which ``redundancy`` are worth one, has redundancy / n of their variance."""
    low_pass = LowPass(20, 4, 0.001, stride)
    x = np.random.default_rng(2).normal(size=(3000, 3000 + 2 * low_pass.reach))
    y = low_pass(x, low_pass.reach, low_pass.reach)
    worth = y.mean(axis=1).var() * y.shape[1] / y.var()
    assert low_pass.redundancy == pytest.approx(worth, rel=0.1)


@pytest.mark.parametrize("stride", [1, 5, 8])
@pytest.mark.parametrize(("before", "samples", "after"), [(400, 1000, 400), (0, 777, 3), (0, 50, 0)])
def test_share_of_masked_samples(rng: np.random.Generator, stride: int, before: int, samples: int, after: int) -> None:
    """It is the sum of the kernel's magnitude at the masked samples; beyond the data, none is masked."""
    low_pass = LowPass(25.0, 4, 1e-3, stride)
    before, after = min(before, low_pass.reach), min(after, low_pass.reach)
    mask = rng.random(before + samples + after) < 0.02
    weights = np.abs(low_pass.kernel) / np.abs(low_pass.kernel).sum()
    expected = np.convolve(mask, weights)[low_pass.reach :][before : len(mask) - after : stride]
    np.testing.assert_allclose(low_pass.masked_share(mask, before, after), expected, atol=1e-12)

"""How many independent samples a residual is worth: closed forms, and the scatter of many estimates."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt

from idtool.estimation.evaluation.spectrum import Correlations

Array = NDArray[np.float64]

DT = 1e-3


def autoregressive(rng: np.random.Generator, a: float, shape: tuple[int, ...]) -> Array:
    """x(t) = a x(t − 1) + noise, of unit variance."""
    noise = rng.normal(size=(*shape[:-1], shape[-1] + 500))
    return np.asarray(lfilter([np.sqrt(1 - a * a)], [1, -a], noise, axis=-1)[..., 500:])


def counted(residual: Array, torque: Array, stride: int = 1, ends: Sequence[int] = (), dt: float = DT) -> Correlations:
    """One joint or several, in batches that end there."""
    found = Correlations()
    edges = [0, *ends, residual.shape[1]]
    for i, j in itertools.pairwise(edges):
        found.add(residual[:, i:j], torque[:, i:j], stride, dt)
    return found


@pytest.mark.parametrize(("cutoff", "order"), [(40.0, 4), (10.0, 2)])
def test_filtered_white_noise_is_worth_its_band(rng: np.random.Generator, cutoff: float, order: int) -> None:
    """By the equivalent bandwidth of a Butterworth run both ways, ∫ (1 + (f/f_c)^2n)^−2 df in closed form.

    Two independent samples for each hertz and second, where the torque is slow.
    """
    N = 100_000
    sections = butter(order, cutoff, fs=1 / DT, output="sos")
    residual = sosfiltfilt(sections, rng.normal(size=(3, N)), axis=1)
    torque = np.ones((3, N))
    m = 2 * order
    bandwidth = cutoff * (1 - 1 / m) * (np.pi / m) / np.sin(np.pi / m)
    for stride in (1, 4):
        independent = counted(residual, torque, stride).independent(stride)
        assert independent.shape == (3,)
        assert independent.mean() == pytest.approx(2 * bandwidth * N * DT, rel=0.15)


@pytest.mark.parametrize(("a", "b"), [(0.9, 0.95), (0.98, 0.98), (0.99, 0.5), (0.0, 0.99)])
def test_bartletts_formula_for_two_autoregressive_series(rng: np.random.Generator, a: float, b: float) -> None:
    """n (1 − a b) / (1 + a b)."""
    N = 100_000
    residual, torque = autoregressive(rng, a, (2, N)), autoregressive(rng, b, (2, N))
    expected = N * (1 - a * b) / (1 + a * b)
    np.testing.assert_allclose(counted(residual, torque).independent(1), expected, rtol=0.15)


def test_it_is_the_scatter_of_a_slope(rng: np.random.Generator) -> None:
    """The variance of least squares of one column is that of so many independent samples, over 600 noises."""
    N, a = 5000, 0.95
    x = autoregressive(rng, 0.97, (1, N))
    noises = autoregressive(rng, a, (600, N))
    slopes = noises @ x[0] / (x[0] @ x[0])
    independent = np.mean([counted(e[None], x).independent(1)[0] for e in noises[:50]])
    assert np.var(slopes) == pytest.approx(1 / (np.square(x).mean() * independent), rel=0.25)
    assert np.var(slopes) > 10 / (x[0] @ x[0])  # where every sample counted as independent


def test_a_faster_motion_sees_more_of_a_slow_residual(rng: np.random.Generator) -> None:
    """What is slow itself hides in a slow motion and averages out over a fast one."""
    N = 50_000
    t = DT * np.arange(N)
    residual = autoregressive(rng, 0.995, (1, N))
    slow, fast = (np.sin(2 * np.pi * f * t)[None] for f in (0.2, 20.0))
    assert counted(residual, fast).independent(1)[0] > 10 * counted(residual, slow).independent(1)[0]


def test_no_residual_is_worth_more_than_its_samples(rng: np.random.Generator) -> None:
    """Not one whose values alternate, nor white noise."""
    N = 10_000
    torque = autoregressive(rng, 0.9, (1, N))
    for a in (-0.9, 0.0):
        assert counted(autoregressive(rng, a, (1, N)), torque).independent(1)[0] <= N
    alternating = counted(autoregressive(rng, -0.9, (1, N)), torque).independent(5)
    assert alternating[0] <= N / 5


def test_batches_of_any_number_add_up(rng: np.random.Generator) -> None:
    """Each is a sum of products of its own; but for what lies across their ends, that is the sum over the whole."""
    N = 60_000
    residual, torque = autoregressive(rng, 0.9, (2, N)), autoregressive(rng, 0.95, (2, N))
    whole = counted(residual, torque)
    for ends in ((30_000,), (10_000, 20_000, 59_990), (59_000,), (3, 4, 4, 30_000)):
        parts = counted(residual, torque, ends=ends)
        assert parts.samples == N
        np.testing.assert_allclose(parts.residual[:, 0], whole.residual[:, 0], rtol=1e-10)
        np.testing.assert_allclose(parts.independent(1), whole.independent(1), rtol=0.1)


def test_the_sums_are_those_of_products() -> None:
    """Of two batches, the second too short for all lags; by np.correlate, every second sample."""
    rng = np.random.default_rng(2)
    pieces = [rng.normal(size=(2, 1, n)) for n in (41, 8)]
    for order in (pieces, pieces[::-1]):
        found = Correlations()
        for residual, torque in order:
            found.add(residual, torque, 2, 0.1)
        for name, place in (("residual", 0), ("torque", 1)):
            expected = np.zeros(10)  # 2 s
            for piece in pieces:
                x = piece[place, 0, ::2]
                full = np.correlate(x, x, "full")[len(x) - 1 :][:10]
                expected[: len(full)] += full
            np.testing.assert_allclose(getattr(found, name)[0], expected, atol=1e-12)


def test_without_samples_or_residual() -> None:
    assert Correlations().independent(3).shape == (0,)
    nothing = np.zeros((2, 0))
    found = counted(nothing, nothing)
    assert found.samples == 0
    still = counted(np.zeros((2, 900)), np.ones((2, 900)))
    np.testing.assert_allclose(still.independent(3), 300)

"""Two-stage least squares on factors against its definition on the samples, and against errors in the variables."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import subspace_angles

from idtool.estimation.dataset.reduction import Factor, Reduction, merge
from idtool.estimation.two_stage import correlations, first_stage_f_statistic, project, unprojected

Array = NDArray[np.float64]

THETA = np.array([1.5, -0.7, 3.0, 0.2])
SCALES = np.array([1e-3, 1.0, 30.0, 0.1])  # of the columns, as those of masses and inertias


def stacked(Z: Array, Y: Array, tau: Array, redundancy: float = 1.0) -> Factor:
    """The factor of [Z, Y, tau]."""
    return Factor.from_columns(np.column_stack([Z, Y, tau]).T, redundancy)


def minimum(factor: Factor) -> Array:
    """The theta of least squares, the shortest one."""
    return np.linalg.lstsq(factor.R[:, :-1], factor.R[:, -1], rcond=1e-10)[0]


def textbook(Z: Array, Y: Array, tau: Array) -> Array:
    """First stage: Y regressed on Z; second: tau on what that explains."""
    explained = Z @ np.linalg.lstsq(Z, Y, rcond=1e-10)[0]
    return np.linalg.lstsq(explained, tau, rcond=1e-10)[0]


@pytest.fixture
def rows(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Instruments, rows that hold noise, and torque, of 300 samples."""
    true = rng.normal(size=(300, 4)) * SCALES
    Y = true + 0.3 * rng.normal(size=true.shape) * SCALES
    return true + 0.1 * rng.normal(size=true.shape) * SCALES, Y, true @ THETA + 0.1 * rng.normal(size=300)


def test_it_is_two_stage_least_squares(rows: tuple[Array, Array, Array]) -> None:
    (found,) = project((stacked(*rows),))
    np.testing.assert_allclose(minimum(found), textbook(*rows), rtol=1e-9)


def test_as_many_instruments_as_coefficients_solve_their_equations(rows: tuple[Array, Array, Array]) -> None:
    Z, Y, tau = rows
    (found,) = project((stacked(*rows),))
    np.testing.assert_allclose(minimum(found), np.linalg.solve(Z.T @ Y, Z.T @ tau), rtol=1e-9)
    assert found.squared_error(minimum(found)) < 1e-18 * np.square(tau).sum()


def test_the_cost_is_that_of_projected_residuals(rows: tuple[Array, Array, Array], rng: np.random.Generator) -> None:
    Z, Y, tau = rows
    Z = Z[:, [0, 1, 1, 0]]  # fewer independent instruments than coefficients
    (found,) = project((stacked(Z, Y, tau),))
    assert len(found.R) == 2
    for theta in rng.normal(size=(5, 4)):
        projected = Z @ np.linalg.lstsq(Z, Y @ theta - tau, rcond=1e-10)[0]
        assert found.squared_error(theta) == pytest.approx(np.square(projected).sum(), rel=1e-9)


def test_rows_as_their_own_instruments_give_least_squares(rng: np.random.Generator) -> None:
    Y = rng.normal(size=(200, 5)) * [1e-4, 1.0, 50.0, 1.0, 1.0]
    Y[:, 3], Y[:, 4] = Y[:, 0] + 2 * Y[:, 1], 0.0
    tau = rng.normal(size=200)
    (found,) = project((stacked(Y, Y, tau),))
    best = np.linalg.lstsq(Y, tau, rcond=1e-10)[0]
    least = np.square(Y @ best - tau).sum()
    assert found.squared_error(best) == pytest.approx(0, abs=1e-12)
    for theta in (np.zeros(5), rng.normal(size=5)):
        assert found.squared_error(theta) + least == pytest.approx(np.square(Y @ theta - tau).sum(), rel=1e-9)


def test_without_noise_any_instruments_give_the_truth(rng: np.random.Generator) -> None:
    Y = rng.normal(size=(100, 4)) * SCALES
    (found,) = project((stacked(Y + 3 * rng.normal(size=Y.shape) * SCALES, Y, Y @ THETA),))
    np.testing.assert_allclose(minimum(found), THETA, rtol=1e-9)


def test_units_of_instruments_do_not_matter(rows: tuple[Array, Array, Array]) -> None:
    Z, Y, tau = rows
    before, after = (project((stacked(Z * size, Y, tau),))[0] for size in (1.0, [1e9, 1e-7, 1.0, 1e4]))
    np.testing.assert_allclose(minimum(after), minimum(before), rtol=1e-9)


def test_pieces_merge_into_the_whole(rows: tuple[Array, Array, Array], rng: np.random.Generator) -> None:
    whole = (stacked(*rows),)
    parts: list[Reduction] = [(stacked(*(x[piece] for x in rows)),) for piece in (slice(7), slice(7, 150))]
    merged = merge(merge(*parts), (stacked(*(x[150:] for x in rows)),))
    for reduced in (project, unprojected):
        (one,), (other,) = reduced(whole), reduced(merged)
        assert (one.rows, one.independent) == (other.rows, other.independent) == (300, 300.0)
        for theta in rng.normal(size=(5, 4)):
            assert other.squared_error(theta) == pytest.approx(one.squared_error(theta), rel=1e-9)


def test_what_is_not_projected_is_all_there_was(rows: tuple[Array, Array, Array], rng: np.random.Generator) -> None:
    _, Y, tau = rows
    (found,) = unprojected((stacked(*rows, redundancy=3.0),))
    assert found.R.shape == (5, 5)
    assert (found.rows, found.independent) == (300, 100.0)
    theta = rng.normal(size=4)
    assert found.squared_error(theta) == pytest.approx(np.square(Y @ theta - tau).sum(), rel=1e-9)


def test_noise_in_the_rows_biases_least_squares_and_not_this(rng: np.random.Generator) -> None:
    n, truth = 40_000, THETA / SCALES
    true = rng.normal(size=(n, 4)) * SCALES
    Z, Y = (true + 0.5 * rng.normal(size=true.shape) * SCALES for _ in range(2))
    factor = stacked(Z, Y, true @ truth + 0.1 * rng.normal(size=n))
    noise = np.sqrt(0.1**2 + 0.25 * np.square(THETA).sum())  # of tau − Y theta
    error = noise * np.sqrt(1.25 / n) / SCALES  # of what Z tells; least squares' is smaller
    attenuated = truth / 1.25  # 1 / (1 + 0.5²)
    assert (np.abs(minimum(unprojected((factor,))[0]) - attenuated) < 4 * error).all()
    assert (np.abs(minimum(project((factor,))[0]) - truth) < 4 * error).all()
    assert (np.abs(attenuated - truth)[:3] > 8 * error[:3]).all()


def test_correlations_are_cosines_of_angles_between_spaces(rows: tuple[Array, Array, Array]) -> None:
    Z, Y, tau = rows
    found = correlations(stacked(Z, Y, tau), np.full(4, 1e9))
    np.testing.assert_allclose(found, np.sort(np.cos(subspace_angles(Z, Y)))[::-1], rtol=1e-9)


def test_what_no_column_tells_has_no_correlation(rows: tuple[Array, Array, Array]) -> None:
    Z, Y, tau = rows
    size = np.array([1e9, 1e9, 0.1 / np.linalg.norm(Y[:, 2]), 1e9])
    found = correlations(stacked(Z, Y, tau), size)
    np.testing.assert_allclose(found, np.sort(np.cos(subspace_angles(Z, Y[:, [0, 1, 3]])))[::-1], rtol=1e-2)


def test_instruments_of_another_motion_are_weak(rows: tuple[Array, Array, Array], rng: np.random.Generator) -> None:
    Z, Y, tau = rows
    strength = [
        first_stage_f_statistic(correlations(stacked(instruments, Y, tau), np.full(4, 1e9)), 300.0)
        for instruments in (Z, rng.normal(size=Z.shape), Y)
    ]
    assert strength[0] > 100
    assert strength[1] < 2
    assert strength[2] > 1e9

"""Metrics against their definitions and invariances, and the projection against cvxpy and the theory of projections."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from synthetic import point_parameters, points_in

from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import J_BASIS, LENGTH_POWERS, from_pseudo_inertia, parameter_transform, pseudo_inertia
from idtool.robot.metric import (
    FLOOR,
    entropic_divergence,
    entropic_gradient,
    euclidean_metric,
    nearest_realizable,
    pullback_metric,
)

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
UNITS = 1e3 * 1e3**LENGTH_POWERS  # grams and millimetres
NOWHERE = np.diag([0.0, 0.0, 0.0, 1.0])


def random_ellipsoid(rng: np.random.Generator) -> Ellipsoid:
    return Ellipsoid.from_axes(0.2 * rng.normal(size=3), rng.uniform(0.1, 0.4, 3), rotation(rng))


def body(rng: np.random.Generator, S: Ellipsoid, count: int = 8) -> Array:
    """Points of mass in an ellipsoid."""
    return point_parameters(rng.uniform(0.1, 1, count), points_in(rng, S, count))


def anywhere(rng: np.random.Generator, reference: Array, deviation: float) -> Array:
    """Parameters that are nobody's, as far from a reference as so many times the reference itself."""
    F = np.linalg.cholesky(pseudo_inertia(reference))
    E = rng.normal(size=(4, 4))
    return np.asarray(from_pseudo_inertia(F @ (np.eye(4) + deviation * (E + E.T)) @ F.T))


def squared(M: Array, delta: Array) -> float:
    return float(delta @ M @ delta)


def other_frame(rng: np.random.Generator) -> tuple[Array, Array]:
    """A change of frame as the matrix for pi, and as that for homogeneous points."""
    R, p = rotation(rng), rng.normal(size=3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return parameter_transform(R, p), T


@given(seeds)
def test_the_euclidean_metric_squares_relative_deviations(rng: np.random.Generator) -> None:
    delta = rng.normal(size=10)
    mass, length = 0.5, 0.2
    mc, inertia = delta[1:4] / 0.1, delta[4:] / 0.02
    expected = (delta[0] / 0.5) ** 2 + mc @ mc + inertia @ inertia
    assert squared(euclidean_metric(mass, length), delta) == pytest.approx(expected)
    assert squared(euclidean_metric(1e3 * mass, 1e3 * length), delta * UNITS) == pytest.approx(expected)


@given(seeds)
def test_the_pullback_metric_is_that_of_positive_definite_matrices(rng: np.random.Generator) -> None:
    references = np.stack([body(rng, random_ellipsoid(rng)) for _ in range(3)])
    delta = rng.normal(size=10)
    for reference, M in zip(references, pullback_metric(references), strict=True):
        relative = np.linalg.solve(pseudo_inertia(reference), pseudo_inertia(delta))
        np.testing.assert_allclose(M, pullback_metric(reference))
        np.testing.assert_allclose(M, M.T)
        assert squared(M, delta) == pytest.approx(0.5 * np.trace(relative @ relative))
    assert pullback_metric(references.reshape(3, 1, 10)).shape == (3, 1, 10, 10)


@given(seeds)
def test_the_pullback_metric_and_the_divergence_know_no_units_and_no_frames(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    reference, pi = body(rng, S), body(rng, S)
    X, _ = other_frame(rng)
    distance = squared(pullback_metric(reference), pi - reference)
    assert squared(pullback_metric(X @ reference), X @ (pi - reference)) == pytest.approx(distance, rel=1e-6)
    assert squared(pullback_metric(UNITS * reference), UNITS * (pi - reference)) == pytest.approx(distance, rel=1e-6)
    divergence = entropic_divergence(pi, reference)
    assert entropic_divergence(X @ pi, X @ reference) == pytest.approx(divergence, rel=1e-6)
    assert entropic_divergence(UNITS * pi, UNITS * reference) == pytest.approx(divergence, rel=1e-6)


@given(seeds)
def test_the_divergence_is_its_formula(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    reference, pi = body(rng, S), body(rng, S)
    at, there = pseudo_inertia(pi), pseudo_inertia(reference)
    determinants = np.linalg.slogdet(there)[1] - np.linalg.slogdet(at)[1]
    expected = determinants + np.trace(np.linalg.solve(there, at)) - 4
    assert entropic_divergence(pi, reference) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(seeds, st.floats(1e-6, 0.1))
def test_the_divergence_is_positive_but_at_the_reference(rng: np.random.Generator, deviation: float) -> None:
    reference = body(rng, random_ellipsoid(rng))
    assert abs(entropic_divergence(reference, reference)) < 1e-12
    assert entropic_divergence(anywhere(rng, reference, deviation), reference) > 0.1 * deviation**2


def test_the_divergence_is_infinite_beyond_what_can_exist(rng: np.random.Generator) -> None:
    reference = body(rng, random_ellipsoid(rng))
    assert entropic_divergence(-reference, reference) == np.inf
    assert entropic_divergence(np.zeros(10), reference) == np.inf


@given(seeds)
def test_the_divergences_gradient(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    reference, pi = body(rng, S), body(rng, S)
    F = np.linalg.cholesky(pseudo_inertia(pi))
    gradient = entropic_gradient(pi, reference)
    for _ in range(3):
        E = rng.normal(size=(4, 4))
        step = from_pseudo_inertia(1e-4 * F @ (E + E.T) @ F.T)
        difference = entropic_divergence(pi + step, reference) - entropic_divergence(pi - step, reference)
        assert 2 * gradient @ step == pytest.approx(difference, rel=1e-5, abs=1e-7)
    np.testing.assert_allclose(entropic_gradient(pi, pi), np.zeros(10), atol=1e-6 * np.abs(pullback_metric(pi)).max())


@given(seeds)
def test_twice_the_pullback_metric_is_the_divergences_hessian_at_the_reference(rng: np.random.Generator) -> None:
    reference = body(rng, random_ellipsoid(rng))
    M = pullback_metric(reference)
    for _ in range(3):
        delta = anywhere(rng, reference, 1e-4) - reference
        difference = entropic_gradient(reference + delta, reference) - entropic_gradient(reference - delta, reference)
        np.testing.assert_allclose(difference, 2 * 2 * M @ delta, atol=1e-5 * float(np.abs(M @ delta).max()))
        assert entropic_divergence(reference + delta, reference) == pytest.approx(squared(M, delta), rel=1e-2)


@pytest.mark.parametrize(
    "function", [pullback_metric, lambda r: entropic_divergence(r, r), lambda r: nearest_realizable(r, r)]
)
def test_a_reference_without_volume_is_refused(function: object) -> None:
    flat = point_parameters(np.ones(4), np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [2, 3, 1.0]]))
    with pytest.raises(ValueError, match="needs a positive definite"):
        function(flat)  # type: ignore[operator]


def by_cvxpy(pi: Array, reference: Array, Q: Array | None, floor: float) -> Array:
    """The nearest parameters, in units of the reference's mass and of its root mean square distance."""
    J = pseudo_inertia(reference)
    unit = J[3, 3] * np.sqrt(np.trace(J[:3, :3]) / J[3, 3]) ** LENGTH_POWERS
    x = cp.Variable(10)
    root = np.linalg.cholesky(pullback_metric(reference) * unit[:, None] * unit)
    F = np.linalg.inv(np.linalg.cholesky(J))
    seen = sum(x[k] * (F @ (J_BASIS[k] * unit[k]) @ F.T) for k in range(10))
    inside = [seen >> floor * np.eye(4)]
    if Q is not None:
        inside.append(np.einsum("kij,ji->k", J_BASIS, Q) * unit / J[3, 3] @ x >= floor)
    objective = cp.Minimize(cp.sum_squares(root.T @ (x - pi / unit)))
    cp.Problem(objective, inside).solve(solver=cp.CLARABEL)
    return np.asarray(x.value * unit)


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_body_is_cvxpys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    S = random_ellipsoid(rng)
    reference = body(rng, S)
    pi = anywhere(rng, reference, rng.choice([0.3, 2.0, 20.0]))
    M = pullback_metric(reference)
    for Q in (None, S.Q):
        floor = float(rng.choice([1e-6, 1e-2]))
        ours, theirs = nearest_realizable(pi, reference, Q, floor), by_cvxpy(pi, reference, Q, floor)
        size = squared(M, pi - reference)
        assert squared(M, ours - theirs) < 1e-8 * size  # cvxpy's solver ends within 1e-8 of its cost
        assert squared(M, ours - pi) == pytest.approx(squared(M, theirs - pi), abs=1e-7 * size)


@given(seeds, st.sampled_from([0.05, 0.3, 2.0, 1e3, 1e6]))
def test_the_nearest_body_can_exist_and_projecting_it_again_changes_nothing(
    rng: np.random.Generator, deviation: float
) -> None:
    S = random_ellipsoid(rng)
    reference = body(rng, S)
    pi = anywhere(rng, reference, deviation)
    for Q in (None, S.Q):
        nearest = nearest_realizable(pi, reference, Q)
        assert np.linalg.eigvalsh(pseudo_inertia(nearest))[0] > 0
        if Q is not None:
            trace = np.trace(pseudo_inertia(nearest) @ Q)
            assert trace > 0
            assert trace >= (1 - 1e-9 - 1e-9 * deviation) * FLOOR * reference[0]
        again = nearest_realizable(nearest, reference, Q)
        assert squared(pullback_metric(reference), again - nearest) < 1e-16 * (1 + deviation**2)


@given(seeds)
def test_a_body_that_can_exist_is_returned_as_it_is(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    pi, reference = body(rng, S, 30), body(rng, S, 30)
    np.testing.assert_array_equal(nearest_realizable(pi, reference, S.Q), pi)
    np.testing.assert_array_equal(nearest_realizable(pi, reference), pi)


@given(seeds, st.sampled_from([0.3, 2.0, 50.0]))
def test_a_projection_brings_no_two_farther_apart(rng: np.random.Generator, deviation: float) -> None:
    S = random_ellipsoid(rng)
    reference = body(rng, S)
    M = pullback_metric(reference)
    first = anywhere(rng, reference, deviation)
    second = first + rng.choice([1e-3, 1.0]) * (anywhere(rng, reference, deviation) - reference)
    for Q in (None, S.Q):
        ends = nearest_realizable(first, reference, Q) - nearest_realizable(second, reference, Q)
        assert squared(M, ends) <= squared(M, first - second) * (1 + 1e-9)


@given(seeds, st.sampled_from([0.3, 2.0, 50.0]))
def test_every_body_is_seen_from_the_nearest_one_at_an_obtuse_angle(rng: np.random.Generator, deviation: float) -> None:
    """The variational inequality ⟨pi − pi', z − pi'⟩ ≤ 0 for all z in the set, which only the projection fulfils."""
    S = random_ellipsoid(rng)
    reference = body(rng, S, 30)
    M = pullback_metric(reference)
    pi = anywhere(rng, reference, deviation)
    nearest = nearest_realizable(pi, reference, S.Q)
    others = [body(rng, S, 30) * rng.uniform(0.1, 3) for _ in range(10)] + [0.5 * nearest, 2 * nearest]
    least = FLOOR * reference  # what keeps the others as far inside as the projection is
    for other in others:
        inside = other + least
        angle = (pi - nearest) @ M @ (inside - nearest)
        assert angle <= 1e-5 * np.sqrt(squared(M, pi - nearest) * squared(M, inside - nearest)) + 1e-12


@given(seeds, st.sampled_from([0.3, 2.0, 50.0]))
def test_the_nearest_body_is_the_same_in_all_units_and_frames(rng: np.random.Generator, deviation: float) -> None:
    S = random_ellipsoid(rng)
    reference = body(rng, S)
    pi = anywhere(rng, reference, deviation)
    X, T = other_frame(rng)
    back = np.linalg.inv(T)
    scale = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    M = pullback_metric(reference)
    for Q, Q_there, Q_millimetres in ((None, None, None), (S.Q, back.T @ S.Q @ back, scale @ S.Q @ scale)):
        nearest = nearest_realizable(pi, reference, Q)
        there = np.linalg.solve(X, nearest_realizable(X @ pi, X @ reference, Q_there))
        millimetres = nearest_realizable(UNITS * pi, UNITS * reference, Q_millimetres) / UNITS
        for other in (there, millimetres):
            assert squared(M, other - nearest) < 1e-12 * (1 + deviation**2)


@given(seeds)
def test_several_bodies_at_once_are_each_projected(rng: np.random.Generator) -> None:
    shapes = [random_ellipsoid(rng) for _ in range(6)]
    references = np.stack([body(rng, S) for S in shapes])
    pi = np.stack([anywhere(rng, r, d) for r, d in zip(references, [0, 0.01, 0.3, 2, 50, 1e4], strict=True)])
    Q = np.stack([NOWHERE, *(S.Q for S in shapes[1:])])
    together = nearest_realizable(pi.reshape(2, 3, 10), references.reshape(2, 3, 10), Q.reshape(2, 3, 4, 4))
    for one, here, reference, shape in zip(together.reshape(6, 10), pi, references, [None, *Q[1:]], strict=True):
        np.testing.assert_allclose(one, nearest_realizable(here, reference, shape), rtol=1e-9, atol=1e-12)
    trajectory = nearest_realizable(pi, references[3], Q[3])  # one reference and one shape for all
    np.testing.assert_allclose(trajectory[5], nearest_realizable(pi[5], references[3], Q[3]))


@given(seeds)
def test_a_shape_that_demands_a_positive_mass_demands_nothing_more(rng: np.random.Generator) -> None:
    reference = body(rng, random_ellipsoid(rng))
    pi = anywhere(rng, reference, 3.0)
    np.testing.assert_allclose(nearest_realizable(pi, reference, NOWHERE), nearest_realizable(pi, reference), atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_reference_outside_its_ellipsoid_still_has_a_nearest_body_inside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    S = random_ellipsoid(rng)
    reference = body(rng, Ellipsoid.from_axes(np.array(S.center) + 3, S.semi_axes, S.rotation))
    nearest = nearest_realizable(reference, reference, S.Q)
    assert np.trace(pseudo_inertia(nearest) @ S.Q) > 0
    assert np.linalg.eigvalsh(pseudo_inertia(nearest))[0] > 0
    ours, theirs = nearest_realizable(reference, reference, S.Q, 1e-3), by_cvxpy(reference, reference, S.Q, 1e-3)
    M = pullback_metric(reference)
    assert squared(M, ours - theirs) < 1e-6 * squared(M, ours - reference)


def test_parameters_that_are_no_numbers_are_refused(rng: np.random.Generator) -> None:
    reference = body(rng, random_ellipsoid(rng))
    with pytest.raises(ValueError, match="must be finite"):
        nearest_realizable(np.full(10, np.nan), reference)

"""The priors' distances against their definitions, and the estimates they lead to against scipy's and numpy's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import random_urdf
from scipy.optimize import minimize
from synthetic import Synthetic, bounds, point_parameters, synthetic

from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.estimate import estimate
from idtool.estimation.problem.prior import LogDet, log_dets, moved_priors, prior_rows, realizable_prior
from idtool.robot.config import Regularization
from idtool.robot.inertia import J_BASIS, PI_SIZE, pseudo_inertia
from idtool.robot.sets import constraint_sets
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

SETS = constraint_sets()
NO_FRICTION = {"friction": {"viscous": False, "coulomb": False}}
HELD = 1e-8  # of the relative Euclidean distance, with any prior, so that nothing is left undetermined

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def bregman(pi: Array, prior: Array) -> float:
    """−log det J + log det Ĵ + Tr(Ĵ⁻¹ J) − 4."""
    J, J_hat = pseudo_inertia(pi), pseudo_inertia(prior)
    distance = np.log(np.linalg.det(J_hat)) - np.log(np.linalg.det(J)) + np.trace(np.linalg.solve(J_hat, J)) - 4
    return float(distance)


def second_order(pi: Array, prior: Array) -> float:
    """½ Tr(Ĵ⁻¹ δJ Ĵ⁻¹ δJ)."""
    X = np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(pi - prior))
    return float(0.5 * np.trace(X @ X))


@pytest.fixture
def robot(robot_of: Callable[[str], Robot]) -> Callable[..., Synthetic]:
    """A robot of three revolute joints without friction; its prior is another body than the truth."""

    def make(count: int = 80, **config: Any) -> Synthetic:
        rng = np.random.default_rng(2)
        read = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
        return synthetic(rng, read, count, {**bounds(rng, read), **NO_FRICTION, **config})

    return make


def scales(s: Synthetic) -> Array:
    return np.array([c.scale for c in s.linear.coefficients], dtype=float)


def priors(s: Synthetic) -> list[Array]:
    """What the geometric distances are from, body by body."""
    return [
        realizable_prior(body.pi, own) for body, own in zip(s.model.bodies, scales(s).reshape(-1, PI_SIZE), strict=True)
    ]


def near(s: Synthetic, rng: np.random.Generator, spread: float) -> Array:
    """Parameters of all bodies that lie off the prior by a share of each J, in random directions."""
    found = []
    for prior in priors(s):
        root = np.linalg.cholesky(pseudo_inertia(prior))
        change = rng.normal(size=(4, 4))
        J = root @ (np.eye(4) + 0.5 * spread * (change + change.T)) @ root.T
        found.append(np.linalg.lstsq(J_BASIS.reshape(PI_SIZE, -1).T, J.ravel(), rcond=None)[0])
    return np.concatenate(found)


def distance(
    s: Synthetic, kind: str, theta: Array, weight: float = 0.3, known: EqualityConstraints | None = None
) -> float:
    """What is added to the cost."""
    regularization = Regularization.model_validate({"kind": kind, "weight": weight})
    known = known or EqualityConstraints.none(len(theta))
    unit = scales(s)
    rows = prior_rows(s.linear, s.model.bodies, regularization, unit)
    terms = log_dets(s.linear, s.model.bodies, regularization, known, unit[known.free])
    z = theta[known.free] / unit[known.free]
    return float(np.square(rows @ np.append(theta, -1.0)).sum()) + sum(term.value(z) for term in terms)


def test_each_distance_is_what_it_is_called(robot: Callable[..., Synthetic], rng: np.random.Generator) -> None:
    s = robot()
    for spread in (1e-3, 0.05, 0.15):
        theta = near(s, rng, spread)
        pairs = list(zip(theta.reshape(-1, PI_SIZE), priors(s), strict=True))
        deviation = (theta - s.linear.prior) / scales(s)
        expected = {
            "none": 0.0,
            "euclidean": np.square(deviation).sum(),
            "entropic": sum(bregman(pi, prior) for pi, prior in pairs),
            "pullback": sum(second_order(pi, prior) for pi, prior in pairs),
        }
        for kind, value in expected.items():
            assert distance(s, kind, theta) == pytest.approx(0.3 * value, rel=1e-6, abs=1e-12)
        assert distance(s, "entropic", theta, weight=0.0) == 0


def test_copies_are_held_to_their_own_priors(robot: Callable[..., Synthetic], rng: np.random.Generator) -> None:
    s = robot(mirror=[{"body": "link3", "of": "link1", "plane": "yz"}])
    theta = s.equalities.K @ near(s, rng, 0.02)[s.equalities.free]
    pairs = list(zip(theta.reshape(-1, PI_SIZE), priors(s), strict=True))
    value = distance(s, "entropic", theta, known=s.equalities)
    assert value == pytest.approx(0.3 * sum(bregman(pi, prior) for pi, prior in pairs), rel=1e-9)


def test_at_the_prior_every_distance_is_zero(robot: Callable[..., Synthetic]) -> None:
    s = robot()
    for kind in ("entropic", "pullback"):
        assert distance(s, kind, np.concatenate(priors(s))) == pytest.approx(0, abs=1e-9)
    assert distance(s, "euclidean", s.linear.prior) == 0


def test_beyond_what_bodies_can_be_the_divergence_is_infinite(robot: Callable[..., Synthetic]) -> None:
    s = robot()
    theta = np.concatenate(priors(s))
    theta[PI_SIZE] *= -1
    assert distance(s, "entropic", theta) == np.inf


@given(seeds)
def test_the_divergences_gradient_is_that_of_finite_differences(rng: np.random.Generator) -> None:
    spread = rng.normal(size=(4, 4))
    term = LogDet(2, (np.eye(4) + 0.2 * spread) @ J_BASIS @ (np.eye(4) + 0.2 * spread).T, rng.uniform(0.1, 10))
    z = rng.normal(size=15)
    z[term.z_slice] = point_parameters(rng.uniform(0.5, 1, 6), rng.normal(size=(6, 3)))
    step = 1e-5
    numeric = [(term.value(z + step * e) - term.value(z - step * e)) / (2 * step) for e in np.eye(15)[2 : 2 + PI_SIZE]]
    exact = term.gradient(z)
    np.testing.assert_allclose(exact, numeric, rtol=1e-4, atol=1e-5 * np.abs(exact).max())


def fitted(
    s: Synthetic, tau: Array, kind: str, weight: float, set_name: str = "full", units: str = "relative"
) -> Array:
    regularization = Regularization.model_validate({"kind": kind, "weight": weight, "units": units})
    sets = [SETS[set_name]] * len(s.model.bodies)
    return estimate(s.linear, s.model.bodies, s.reduction(tau), sets, regularization).theta


def misfit(s: Synthetic, tau: Array) -> tuple[Array, Array]:
    """A and b of the cost's other part, ‖A theta − b‖²: the samples, and the little that holds what they do not."""
    sigma = free_noise(s.linear, s.reduction(tau))
    n = s.Y.shape[1]
    rows = (s.Y / sigma[:, None, None]).reshape(-1, s.Y.shape[-1]) / np.sqrt(n)
    torque = np.concatenate([s.Y @ s.linear.prior, tau], axis=1)
    heavier = max(1.0, np.linalg.norm(torque[:, n:] / sigma[:, None]) / np.linalg.norm(torque[:, :n] / sigma[:, None]))
    held = np.sqrt(HELD) / (heavier * scales(s))
    A = np.concatenate([rows, np.diag(held)])
    return A, np.concatenate([(tau / sigma[:, None]).ravel() / np.sqrt(n), held * s.linear.prior])


@pytest.mark.parametrize("weight", [1e-3, 1e-1])
def test_the_entropic_estimate_is_the_least_that_scipy_finds(robot: Callable[..., Synthetic], weight: float) -> None:
    """The divergence keeps bodies off what cannot be, so that nothing but the cost matters; by a trust region."""
    s = robot()
    tau = s.noisy(1.0)
    A, b = misfit(s, tau)
    unit = scales(s)
    J_hat = [np.linalg.inv(pseudo_inertia(prior)) for prior in priors(s)]

    def cost(z: Array) -> float:
        if min(np.linalg.eigvalsh(pseudo_inertia(pi))[0] for pi in (unit * z).reshape(-1, PI_SIZE)) <= 0:
            return np.inf
        pairs = zip((unit * z).reshape(-1, PI_SIZE), priors(s), strict=True)
        return float(np.square(A @ (unit * z) - b).sum()) + weight * sum(bregman(pi, prior) for pi, prior in pairs)

    def slope(z: Array) -> Array:
        bodies = zip((unit * z).reshape(-1, PI_SIZE), J_hat, strict=True)
        own = [np.einsum("kij,ji->k", J_BASIS, inverse - np.linalg.inv(pseudo_inertia(pi))) for pi, inverse in bodies]
        return np.asarray(unit * (2 * A.T @ (A @ (unit * z) - b) + weight * np.concatenate(own)))

    def curvature(z: Array) -> Array:
        H = 2 * A.T @ A
        for i, pi in enumerate((unit * z).reshape(-1, PI_SIZE)):
            Y = np.linalg.inv(pseudo_inertia(pi)) @ J_BASIS
            H[PI_SIZE * i : PI_SIZE * (i + 1), PI_SIZE * i : PI_SIZE * (i + 1)] += weight * np.einsum(
                "kij,lji->kl", Y, Y
            )
        return np.asarray(unit[:, None] * H * unit)

    start = np.concatenate(priors(s)) / unit
    best = minimize(
        cost, start, jac=slope, hess=curvature, method="trust-exact", options={"gtol": 1e-11, "maxiter": 500}
    )
    ours = fitted(s, tau, "entropic", weight) / unit
    assert cost(ours) == pytest.approx(cost(best.x), rel=1e-9)
    np.testing.assert_allclose(ours, best.x, rtol=0, atol=1e-3 * np.abs(best.x).max())
    assert np.abs(best.x - start).max() > 0.1
    assert np.abs(slope(ours)).max() < 1e-3 * np.abs(slope(start)).max()


@pytest.mark.parametrize("kind", ["pullback", "si"])
def test_a_quadratic_prior_is_one_of_least_squares(robot: Callable[..., Synthetic], kind: str) -> None:
    """No inequalities: numpy's least squares over all rows and the prior's."""
    s = robot()
    tau = s.noisy(1.0)
    A, b = misfit(s, tau)
    L, prior = np.eye(len(s.theta)), s.linear.prior
    if kind == "pullback":
        prior = np.concatenate(priors(s))
        for i, pi in enumerate(priors(s)):
            X = np.linalg.solve(pseudo_inertia(pi), J_BASIS)
            M = 0.5 * np.einsum("kij,lji->kl", X, X)
            L[PI_SIZE * i : PI_SIZE * (i + 1), PI_SIZE * i : PI_SIZE * (i + 1)] = np.linalg.cholesky(M).T
    pull = np.sqrt(1e-2)
    expected = np.linalg.lstsq(np.vstack([A, pull * L]), np.concatenate([b, pull * L @ prior]), rcond=None)[0]
    ours = fitted(s, tau, kind.replace("si", "euclidean"), 1e-2, "none", "si" if kind == "si" else "relative")
    np.testing.assert_allclose(
        ours / scales(s), expected / scales(s), rtol=0, atol=1e-4 * np.abs(expected / scales(s)).max()
    )


def test_for_small_deviations_entropic_and_pullback_are_the_same(robot: Callable[..., Synthetic]) -> None:
    """Their estimates differ by the square of how far the truth lies off the prior."""
    s = robot()
    apart, off = [], []
    for spread in (0.1, 0.02):
        theta = near(s, np.random.default_rng(3), spread)
        tau = s.Y @ theta
        entropic, pullback = (fitted(s, tau, kind, 1.0) / scales(s) for kind in ("entropic", "pullback"))
        apart.append(np.abs(entropic - pullback).max())
        off.append(np.abs(entropic - np.concatenate(priors(s)) / scales(s)).max())
    assert apart[0] < 0.01 * off[0]
    assert off[1] == pytest.approx(0.2 * off[0], rel=0.1)
    assert apart[1] < 0.1 * apart[0]


@pytest.mark.parametrize("kind", ["euclidean", "entropic", "pullback"])
def test_the_heavier_a_prior_the_nearer_the_estimate(robot: Callable[..., Synthetic], kind: str) -> None:
    """In its own distance."""
    s = robot()
    tau = s.noisy(0.5)
    distances = [distance(s, kind, fitted(s, tau, kind, weight)) for weight in (1e-3, 1e-1, 1e1, 1e3)]
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 1e-2 * distances[0]


@given(seeds)
def test_a_prior_well_inside_is_taken_as_it_is(rng: np.random.Generator) -> None:
    unit = np.repeat([0.7, 0.7 * 0.2, 0.7 * 0.04], [1, 3, 6])
    inside = point_parameters(rng.uniform(0.1, 0.2, 12), 0.2 * rng.normal(size=(12, 3)))
    np.testing.assert_array_equal(realizable_prior(inside, unit), inside)


@given(seeds)
def test_a_prior_that_no_body_can_have_gives_way_to_one_well_inside(rng: np.random.Generator) -> None:
    """A point of mass, a rod, an indefinite inertia, or none at all."""
    length, mass = 0.2, 0.7
    unit = mass * length ** np.repeat([0.0, 1.0, 2.0], [1, 3, 6])
    point = point_parameters(np.array([mass]), 0.1 * rng.normal(size=(1, 3)))
    rod = point_parameters(np.full(2, 0.5 * mass), 0.1 * rng.normal(size=(2, 3)))
    indefinite = rod + mass * length**2 * np.array([0, 0, 0, 0, *rng.normal(size=6)])
    rows = np.array([length, length, length, 1.0])
    for pi in (point, rod, indefinite, np.zeros(PI_SIZE)):
        moved = realizable_prior(pi, unit)
        least = np.linalg.eigvalsh(pseudo_inertia(moved) / (mass * np.outer(rows, rows)))[0]
        assert least > 1e-4
        assert not np.array_equal(moved, pi)
    sure = realizable_prior(rod, unit)
    np.testing.assert_allclose(realizable_prior(sure, unit), sure, rtol=1e-9, atol=1e-12)


def test_which_priors_were_moved_is_told(robot_of: Callable[[str], Robot], rng: np.random.Generator) -> None:
    text = random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0)
    first, second = text.split('<link name="link2">', 1)
    bare = f'{first}<link name="link2">{second[second.index("</link>") :]}'
    s = synthetic(rng, robot_of(bare), 20, {**NO_FRICTION})
    moved = moved_priors(s.linear, s.model.bodies, Regularization(kind="entropic"))
    assert moved_priors(s.linear, s.model.bodies, Regularization(kind="euclidean")) == ()
    assert "link2" in moved
    for body, pi, own in zip(s.model.bodies, priors(s), scales(s).reshape(-1, PI_SIZE), strict=True):
        assert (body.name in moved) == (not np.array_equal(pi, body.pi))
        assert np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0
        assert own[0] > 0

"""Estimates from rows that Pinocchio made, against numpy's least squares and the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic

from idtool.estimation.problem.estimate import Estimate, estimate
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE, pseudo_inertia
from idtool.robot.sets import constraint_sets
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Data = Callable[..., Synthetic]

SETS = constraint_sets()
KINDS = ("none", "semi", "full", "com_ellipsoid", "ellipsoid")  # what random bodies in ellipsoids are members of
NONE = Regularization(kind="none")
PRIOR = Regularization(kind="euclidean", weight=1e-6)


@pytest.fixture
def data(robot_of: Callable[[str], Robot]) -> Data:
    """Random robots of three joints with as many ellipsoids a link, and so many samples of their motion."""

    def make(seed: int, count: int = 300, each: int = 1, **config: Any) -> Synthetic:
        rng = np.random.default_rng(seed)
        robot = robot_of(random_urdf(rng, size=3, kinds=("revolute", "prismatic"), mimic=0, massless=0))
        return synthetic(rng, robot, count, {**bounds(rng, robot, each), **config})

    return make


def estimate_of(s: Synthetic, tau: Array, kind: str, regularization: Regularization = PRIOR) -> Estimate:
    bodies = s.model.bodies
    return estimate(s.linear, bodies, s.reduction(tau), [SETS[kind]] * len(bodies), regularization)


def least_squares(Y: Array, tau: Array, sigma: Array) -> Array:
    """The least theta of ‖(Y theta − tau) / sigma‖ over the rows of all joints, shape (p,)."""
    rows, b = (Y / sigma[:, None, None]).reshape(-1, Y.shape[-1]), (tau / sigma[:, None]).ravel()
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1
    return np.asarray(np.linalg.lstsq(rows / size, b, rcond=1e-10)[0] / size)


@pytest.mark.parametrize("seed", range(4))
def test_without_constraints_and_prior_the_prediction_is_that_of_least_squares(data: Data, seed: int) -> None:
    """Joints alike at first, then twice weighted by what the fit before leaves of them."""
    s = data(seed)
    tau = s.noisy(0.1)
    sigma = np.ones(3)
    for _ in range(2):
        sigma = np.std(s.Y @ least_squares(s.Y, tau, sigma) - tau, axis=1)
    theta = least_squares(s.Y, tau, sigma)
    ours = estimate_of(s, tau, "none", NONE)
    np.testing.assert_allclose((s.Y @ ours.theta).T / sigma, (s.Y @ theta).T / sigma, rtol=0, atol=2e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("regularization", [NONE, PRIOR], ids=["none", "euclidean"])
def test_a_torque_without_noise_is_recovered(data: Data, kind: str, regularization: Regularization) -> None:
    for seed in range(3):
        s = data(seed)
        ours = estimate_of(s, s.tau, kind, regularization)
        np.testing.assert_allclose(s.Y @ ours.theta, s.tau, rtol=0, atol=1e-6 * np.abs(s.tau).max())


@pytest.mark.parametrize("kind", ["none", "full", "ellipsoid"])
def test_what_was_identified_predicts_other_motions_of_the_robot(data: Data, kind: str) -> None:
    """To a share of the noise that goes with √(unknowns / samples), here less than half."""
    for seed in range(3):
        s, other = data(seed, count=500), data(seed, count=800)
        ours = estimate_of(s, s.noisy(0.05), kind)
        fresh = other.Y @ ours.theta - other.Y @ s.theta
        assert (fresh.std(axis=1) < 0.5 * 0.05 * s.tau.std(axis=1)).all()


@pytest.mark.parametrize("seed", range(4))
def test_one_very_noisy_joint_does_not_spoil_the_others(data: Data, seed: int) -> None:
    """Their torque is predicted as well as from their own rows alone, and far better than with all weighted alike."""
    s = data(seed, count=600)
    tau = s.noisy(0.01)
    tau[1] += 30 * s.tau[1].std() * np.random.default_rng(9).normal(size=600)
    good, sigma = s.Y[[0, 2]], 0.01 * s.tau[[0, 2]].std(axis=1)

    def error(theta: Array) -> float:
        """The others' rms error in units of their noise."""
        return float(np.sqrt(np.mean(((good @ (theta - s.theta)).T / sigma) ** 2)))

    ours = error(estimate_of(s, tau, "none").theta)
    assert ours < 1.2 * error(least_squares(good, tau[[0, 2]], sigma))
    assert ours < 0.1 * error(least_squares(s.Y, tau, np.ones(3)))


@pytest.mark.parametrize("kind", ["none", "ellipsoid"])
def test_the_noise_of_every_joint_is_told(data: Data, kind: str) -> None:
    s = data(1, count=2000)
    sigma = np.array([0.5, 3.0, 0.02])
    tau = s.tau + sigma[:, None] * np.random.default_rng(3).normal(size=s.tau.shape)
    np.testing.assert_allclose(estimate_of(s, tau, kind).noise, sigma, rtol=0.06)


@pytest.mark.parametrize("kind", KINDS)
def test_friction_is_never_negative(data: Data, kind: str) -> None:
    """In truth there is none: noise makes it as often negative as positive, but for the bound."""
    found = []
    for seed in range(4):
        s = data(seed)
        frictionless = s.theta.copy()
        frictionless[PI_SIZE * len(s.model.bodies) :] = 0
        tau = s.Y @ frictionless
        tau += 0.3 * tau.std() * np.random.default_rng(seed).normal(size=tau.shape)
        found.append(estimate_of(s, tau, kind).theta[PI_SIZE * len(s.model.bodies) :])
    friction = np.concatenate(found)
    assert (friction >= 0).all()
    assert np.count_nonzero(friction < 1e-5) > 4
    assert np.count_nonzero(friction > 1e-3) > 4


def in_ellipsoid(pi: Array, Q: Array) -> bool:
    J = pseudo_inertia(pi)
    return bool(np.linalg.eigvalsh(J)[0] > 0 and np.trace(J @ Q) > 0)


@pytest.mark.parametrize("each", [1, 2, 3])
def test_every_body_is_the_sum_of_parts_within_their_ellipsoids(data: Data, each: int) -> None:
    """From a torque that is nothing but noise, so that the bodies lie on the boundary of what can be."""
    for seed in range(3):
        s = data(seed, count=60, each=each)
        ours = estimate_of(s, s.noisy(3.0), "ellipsoid")
        for i, (body, parts) in enumerate(zip(s.model.bodies, ours.pieces, strict=True)):
            pi = ours.theta[PI_SIZE * i : PI_SIZE * (i + 1)]
            assert parts.shape == (each, PI_SIZE)
            np.testing.assert_allclose(parts.sum(axis=0), pi, rtol=1e-12, atol=1e-15)
            assert all(in_ellipsoid(p, S.Q) for p, S in zip(parts, body.ellipsoids, strict=True))
            assert np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0


def test_a_body_with_mass_at_both_ends_needs_the_union(data: Data) -> None:
    """On the union the torque is matched; on a single one of its ellipsoids it cannot be."""
    s = data(5, each=2)
    tau, reduction = s.noisy(0.01), s.reduction(s.noisy(0.01))
    narrow = [replace(body, ellipsoids=body.ellipsoids[:1]) for body in s.model.bodies]
    single = estimate(s.linear, narrow, reduction, [SETS["ellipsoid"]] * 3, PRIOR)
    assert single.certificate.objective > 1.5 * estimate_of(s, tau, "ellipsoid").certificate.objective


@pytest.mark.parametrize("regularization", [NONE, PRIOR], ids=["none", "euclidean"])
def test_what_the_data_do_not_tell_stays_at_the_prior(data: Data, regularization: Regularization) -> None:
    """In units of the bodies' scales the estimate differs from the prior by nothing that leaves all torques alone."""
    for seed in range(3):
        s = data(seed, friction={"viscous": False, "coulomb": False})
        scale = np.array([c.scale for c in s.linear.coefficients], dtype=float)
        rows = s.Y.reshape(-1, len(scale)) * scale
        _, values, Vt = np.linalg.svd(rows, full_matrices=False)
        unseen = Vt[np.count_nonzero(values > 1e-9 * values[0]) :]
        assert len(unseen) > 5
        ours = estimate_of(s, s.noisy(0.1), "none", regularization)
        change = (ours.theta - s.linear.prior) / scale
        assert np.abs(change).max() > 0.1
        np.testing.assert_allclose(unseen @ change, 0, atol=1e-3 * np.abs(change).max())


def test_the_heavier_the_prior_the_nearer_the_estimate_to_it(data: Data) -> None:
    s = data(2, friction={"viscous": False, "coulomb": False})
    scale = np.array([c.scale for c in s.linear.coefficients], dtype=float)
    tau = s.noisy(0.3)
    distances = []
    for weight in (1e-6, 1e-3, 1.0, 1e3, 1e8):
        theta = estimate_of(s, tau, "none", Regularization(kind="euclidean", weight=weight)).theta
        distances.append(np.linalg.norm((theta - s.linear.prior) / scale))
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 1e-3 * distances[0]

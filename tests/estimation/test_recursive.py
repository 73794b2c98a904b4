"""The recursive fit: where it converges to, that it stays in the set, and what it forgets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, bounds, point_parameters, synthetic

from idtool.estimation.online.recursive import RecursiveFit, units
from idtool.estimation.problem.estimate import estimate, solve
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import LENGTH_POWERS
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Made = Callable[..., Synthetic]

SETS = ["none", "semi", "full", "com_ellipsoid", "ellipsoid"]


@pytest.fixture
def made(rng: np.random.Generator, robot_of: Callable[[str], Robot]) -> Made:
    """Rows of a robot of three joints and its true coefficients."""

    def make(count: int, each: int = 1, **config: Any) -> Synthetic:
        robot = robot_of(random_urdf(rng, 3, ["revolute", "prismatic"], mimic=0, massless=0))
        return synthetic(rng, robot, count, {**bounds(rng, robot, each), **config})

    return make


def started(made: Synthetic, name: str, kind: str = "euclidean") -> RecursiveFit:
    sets = [choose_set(body, name) for body in made.model.bodies]
    return RecursiveFit(made.linear, made.model, sets, kind, made.equalities)


def run(fit: RecursiveFit, made: Synthetic, tau: Array, gamma: float = 1.0) -> Array:
    """All samples one after the other; the estimates after each, shape (n, p)."""
    rows = made.Y @ fit.T
    everything = np.ones(len(rows), dtype=bool)
    found = []
    for W, torque in zip(np.moveaxis(rows, 1, 0), tau.T, strict=True):
        fit.update(W, torque, everything, gamma, 0.05, 1.0)
        found.append(fit.theta)
    return np.array(found)


def determined(made: Synthetic, scale: Array) -> Array:
    """Combinations of the coefficients that the rows determine, without unit, shape (rank, p)."""
    _, s, Vt = np.linalg.svd(np.concatenate(list(made.Y)) * scale)
    return np.asarray(Vt[: len(s)][s > 1e-9 * s[0]] / scale)


def pseudo(pi: Array) -> Array:
    """The second moments of the points [x; 1], written out."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = pi
    half = 0.5 * (xx + yy + zz)
    return np.array(
        [[half - xx, -xy, -xz, x], [-xy, half - yy, -yz, y], [-xz, -yz, half - zz, z], [x, y, z, m]],
    )


def trace_with(ellipsoid: Ellipsoid, pi: Array) -> float:
    """∫ (1 − the squared distance in semi-axes) dm, from the moments."""
    shape = ellipsoid.rotation @ np.diag(np.square(ellipsoid.semi_axes) ** -1.0) @ ellipsoid.rotation.T
    c, J = np.asarray(ellipsoid.center), pseudo(pi)
    spread = J[:3, :3] - np.outer(c, J[:3, 3]) - np.outer(J[:3, 3], c) + J[3, 3] * np.outer(c, c)
    return float(pi[0] - np.trace(shape @ spread))


@pytest.mark.parametrize("name", SETS)
def test_without_noise_it_comes_to_the_truth(made: Made, name: str) -> None:
    data = made(600)
    fit = started(data, name)
    B = determined(data, fit.units)
    error = np.linalg.norm((run(fit, data, data.tau) - data.theta) @ B.T, axis=1)
    assert error[-1] < 2e-3 * np.linalg.norm(B @ (data.linear.prior - data.theta))


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("each", [1, 2])
def test_every_estimate_is_in_its_set(made: Made, name: str, each: int) -> None:
    data = made(150, each)
    fit = started(data, name)
    theta = np.vstack([fit.theta, run(fit, data, data.noisy(0.5), gamma=0.95)])
    inertial = 10 * len(data.model.bodies)
    assert (theta[:, inertial:] >= 0).all()
    J = np.array([[pseudo(pi) for pi in row[:inertial].reshape(-1, 10)] for row in theta])
    least = np.linalg.eigvalsh(J)[..., 0]
    if name == "none":
        assert least.min() < 0
        return
    inertia = np.einsum("...ii->...", J[..., :3, :3])[..., None, None] * np.eye(3) - J[..., :3, :3]
    m, h = J[..., 3, 3], J[..., :3, 3]
    c = h / m[..., None]
    about = inertia - m[..., None, None] * (
        np.square(c).sum(-1)[..., None, None] * np.eye(3) - c[..., :, None] * c[..., None, :]
    )
    assert m.min() > 0
    assert np.linalg.eigvalsh(about).min() > 0
    if name == "semi":
        return
    assert least.min() > 0
    if each == 1 and name == "ellipsoid":
        for i, body in enumerate(data.model.bodies):
            assert min(trace_with(body.ellipsoids[0], row[10 * i : 10 * i + 10]) for row in theta) > 0
    if each == 1 and name == "com_ellipsoid":
        for i, body in enumerate(data.model.bodies):
            assert all(body.ellipsoids[0].contains(centre) for centre in c[:, i])


def test_none_is_plain_recursive_least_squares(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """The normal equations of all samples, each forgotten by its age, and of a prior of one unit's deviation."""
    monkeypatch.setattr(RecursiveFit, "noise", property(lambda fit: np.ones(len(fit.squares))))
    data = made(80, friction={"viscous": False, "coulomb": False})
    fit, tau, gamma = started(data, "none"), data.noisy(0.1), 0.97
    theta = run(fit, data, tau, gamma)
    scale = np.array([c.scale for c in data.linear.coefficients])
    for last in (0, 7, 79):
        age = gamma ** (last - np.arange(last + 1))
        Y, y = data.Y[:, : last + 1], tau[:, : last + 1]
        grown = max(np.square(y).sum() / np.square(Y @ data.linear.prior).sum(), 1.0)
        P = np.einsum("jnk,n,jnl->kl", Y, age, Y) + np.diag(scale**-2.0 * (1 / grown + 1e-8))
        q = np.einsum("jnk,n,jn->k", Y, age, y) + scale**-2.0 * (1 / grown + 1e-8) * data.linear.prior
        np.testing.assert_allclose(theta[last] / scale, np.linalg.solve(P, q) / scale, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["full", "ellipsoid"])
@pytest.mark.parametrize("kind", ["euclidean", "pullback"])
def test_it_tracks_the_constrained_optimum_of_what_is_not_forgotten(made: Made, name: str, kind: str) -> None:
    data = made(300)
    fit = started(data, name, kind)
    run(fit, data, data.noisy(1.0), gamma=0.98)
    P, q = fit.normal()
    A = np.asarray(np.linalg.cholesky(P).T, dtype=np.float64)
    b = np.asarray(np.linalg.solve(A.T, q), dtype=np.float64)
    problem = replace(fit.problem, A=A, b=b, constant=0.0)  # one piece a body: z is x
    best = problem.cost(solve(problem)[0])
    x, free = (np.asarray(np.linalg.solve(*pair), dtype=np.float64) for pair in ((fit.T, fit.theta), (P, q)))
    assert -1e-6 * best < problem.cost(x) - best < 0.2
    assert best > problem.cost(free) + 0.5  # so that the set matters


def test_it_comes_to_the_fit_of_the_whole_log(made: Made) -> None:
    data = made(1500)
    tau = data.noisy(0.03)
    fit = started(data, "ellipsoid")
    theta = run(fit, data, tau)
    sets = [choose_set(body, "ellipsoid") for body in data.model.bodies]
    whole = estimate(
        data.linear,
        data.model.bodies,
        data.reduction(tau),
        sets,
        data.config.regularization.fixed_or_weak(),
        data.equalities,
    )
    B = determined(data, fit.units)
    start, offline, online = (np.linalg.norm(B @ (t - data.theta)) for t in (theta[0], whole.theta, theta[-1]))
    assert np.linalg.norm(B @ (whole.theta - theta[-1])) < 0.02 * start, (start, offline, online)


def test_forgetting_follows_a_payload_and_remembering_does_not(made: Made) -> None:
    data = made(1200)
    heavier = data.theta.copy()
    heavier[20:30] += point_parameters(np.array([0.5]), np.array([data.model.bodies[2].ellipsoids[0].center]))
    tau = np.concatenate([data.tau[:, :600], (data.Y @ heavier)[:, 600:]], axis=1)
    errors = []
    for gamma in (0.97, 1.0):
        fit = started(data, "ellipsoid")
        theta = run(fit, data, tau, gamma)[-1]
        B = determined(data, fit.units)
        errors.append(np.linalg.norm(B @ (theta - heavier)) / np.linalg.norm(B @ (data.theta - heavier)))
    assert errors[0] < 0.15
    assert errors[1] > 0.8


def test_a_prior_that_only_holds_a_place_does_not_hold_it_back(made: Made) -> None:
    data = made(1200)
    bodies = tuple(replace(body, pi=1e-3 * body.pi) for body in data.model.bodies)
    model = replace(data.model, bodies=bodies)
    rigid = replace_coefficients(data, 1e-3)
    sets = [choose_set(body, "ellipsoid") for body in bodies]
    fit = RecursiveFit(rigid.linear, model, sets, "euclidean", data.equalities)
    theta = run(fit, rigid, data.tau)
    B = determined(data, units(data.linear, data.model))
    assert np.linalg.norm(B @ (theta[-1] - data.theta)) < 0.02 * np.linalg.norm(B @ data.theta)


def replace_coefficients(data: Synthetic, factor: float) -> Synthetic:
    """The same torque equation with a prior and sizes of inertia so much smaller."""
    rigid = data.linear.effects[0]
    rigid.coefficients = tuple(
        replace(c, prior=factor * c.prior, scale=factor * (c.scale or 0.0)) for c in rigid.coefficients
    )
    return data


def test_typical_sizes_of_friction_are_what_the_joint_carries(made: Made) -> None:
    data = made(1)
    found = units(data.linear, data.model)
    inertial = 10 * len(data.model.bodies)
    scale = np.array([c.scale or np.nan for c in data.linear.coefficients])
    np.testing.assert_array_equal(found[:inertial], scale[:inertial])
    support = data.model.support()
    for c, size in zip(data.linear.coefficients[inertial:], found[inertial:], strict=True):
        j = data.linear.joints.index(c.owner)
        power = LENGTH_POWERS[0] if data.model.joints[j].kind == "prismatic" else LENGTH_POWERS[1]
        carried = sum(scale[10 * i + int(power)] for i in np.flatnonzero(support[:, j]))
        assert size == pytest.approx(9.81 * carried)

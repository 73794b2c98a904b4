"""The charts of the local estimators: what they describe, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from charts import (
    CHARTS,
    FRICTION,
    MIRROR,
    Array,
    State,
    definite,
    difference,
    laid,
    random_problem,
)
from robots import rotation
from scipy.spatial.transform import Rotation
from triangles import triangle_margin

from idtool.estimation.problem.local import Chart, LogCholesky, Manifold, Residuals, spectral
from idtool.estimation.problem.prior import LogDet
from idtool.robot.inertia import (
    PI_SIZE,
    from_mass_com_inertia,
    from_pseudo_inertia,
    parameter_transform,
    pseudo_inertia,
)
from idtool.robot.urdf.reading import Robot


@pytest.fixture
def state(robot_of: Callable[[str], Robot]) -> State:
    """See `random_problem`."""
    return partial(random_problem, robot_of)


def test_log_cholesky_is_that_of_pinocchio(rng: np.random.Generator) -> None:
    """Rucker & Wensing's closed form of pi and its Jacobian, as Pinocchio has them."""
    y = rng.normal(size=(20, PI_SIZE))
    chart = laid(LogCholesky, definite(rng, 20))
    theirs = [pin.LogCholeskyParameters(row) for row in y]
    pi = from_pseudo_inertia(chart.pseudo_inertias(y))
    np.testing.assert_allclose(pi, [p.toDynamicParameters() for p in theirs], rtol=1e-12, atol=1e-12)
    jacobians = from_pseudo_inertia(chart.derivatives(y)).swapaxes(-1, -2)
    np.testing.assert_allclose(jacobians, [p.calculateJacobian() for p in theirs], rtol=1e-12, atol=1e-12)


def test_the_manifold_is_that_of_theorem_2(rng: np.random.Generator) -> None:
    """pi of mass, centre, axes and principal moments, these the sums of two mu each (21)."""
    J = definite(rng, 10)
    chart = laid(Manifold, J)
    for y, body in zip(chart.y, from_pseudo_inertia(J), strict=True):
        mass, c, mu, w = np.split(y, [1, 4, 7])
        assert not w.any()
        turn = rng.normal(size=3)
        mu = rng.uniform(0.1, 1, 3)
        moved = np.concatenate([mass, c, mu, np.tan(np.linalg.norm(turn) / 2) * turn / np.linalg.norm(turn)])
        alone = Manifold(pseudo_inertia(body)[None], np.zeros((1, 4, 4)))
        assert np.linalg.det(alone.R[0]) == pytest.approx(1)
        R = alone.R[0] @ Rotation.from_rotvec(turn).as_matrix()
        inertia = R @ np.diag(mu.sum() - mu) @ R.T
        found = from_pseudo_inertia(alone.pseudo_inertias(moved[None]))[0]
        np.testing.assert_allclose(found, from_mass_com_inertia(float(mass[0]), c, inertia), atol=1e-12)


@pytest.mark.parametrize("kind", CHARTS.values())
@pytest.mark.parametrize("spread", [0.0, 1.0, 6.0])
def test_every_body_is_described(kind: type[Chart], spread: float, rng: np.random.Generator) -> None:
    J = definite(rng, 50, spread)
    chart = laid(kind, J)
    np.testing.assert_allclose(chart.pseudo_inertias(chart.y), J, atol=1e-12 * np.abs(J).max())


def test_only_bodies_are_described(rng: np.random.Generator) -> None:
    y = 2 * rng.normal(size=(200, PI_SIZE))
    for kind in CHARTS.values():
        chart = laid(kind, definite(rng, 200))
        J = chart.pseudo_inertias(np.maximum(y, chart.lower + 1e-6))
        assert (np.linalg.eigvalsh(J)[:, 0] >= -1e-12 * np.abs(J).max(axis=(1, 2))).all()
        assert min(triangle_margin(pi) / np.abs(pi).max() for pi in from_pseudo_inertia(J)) > -1e-9


def test_frames(rng: np.random.Generator) -> None:
    """In another frame the manifold's m and mu stay and c and R go along; moved, log-Cholesky's t alone changes."""
    J = definite(rng, 5)
    R, p = rotation(rng), rng.normal(size=3)
    seen = pseudo_inertia(from_pseudo_inertia(J) @ parameter_transform(R, p).T)
    here, there = laid(Manifold, J), laid(Manifold, seen)
    np.testing.assert_allclose(there.y[:, [0, 4, 5, 6]], here.y[:, [0, 4, 5, 6]], rtol=1e-10)
    np.testing.assert_allclose(there.y[:, 1:4], here.y[:, 1:4] @ R.T + p, atol=1e-10)
    moved = pseudo_inertia(from_pseudo_inertia(J) @ parameter_transform(np.eye(3), p).T)
    y, z = laid(LogCholesky, J).y, laid(LogCholesky, moved).y
    np.testing.assert_allclose(z, y + np.append(np.zeros(7), p), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("kind", CHARTS.values())
def test_derivatives_of_the_pseudo_inertia(kind: type[Chart], rng: np.random.Generator) -> None:
    chart = laid(kind, definite(rng, 3))
    y = chart.y + 0.3 * np.abs(rng.normal(size=chart.y.shape))
    ours = chart.derivatives(y)
    for body in range(3):

        def moved(row: Array, body: int = body) -> Array:
            return np.asarray(chart.pseudo_inertias(np.concatenate([y[:body], row[None], y[body + 1 :]]))[body])

        np.testing.assert_allclose(np.moveaxis(ours[body], 0, -1), difference(moved, y[body]), atol=1e-8)


@pytest.mark.parametrize("name", CHARTS)
@pytest.mark.parametrize("prior", [("euclidean", 1e-2), ("entropic", 0.5)])
def test_residuals_are_the_cost_and_their_jacobian_its_derivative(state: State, name: str, prior: Any) -> None:
    problem, start = state(*prior, **FRICTION, **MIRROR)
    residuals = Residuals(problem)
    chart = laid(CHARTS[name], pseudo_inertia(start[residuals.bodies]))
    others = np.random.default_rng(0).uniform(0.1, 1, len(problem.other_coefficients))
    v = np.concatenate([(chart.y + 0.1).ravel(), others])
    z = residuals.z(chart, v)
    assert np.square(residuals.value(v, chart)).sum() + problem.constant == pytest.approx(problem.cost(z), rel=1e-12)
    ours = residuals.jacobian(v, chart)
    numeric = difference(lambda v: residuals.value(v, chart), v)
    np.testing.assert_allclose(ours, numeric, atol=1e-7 * np.abs(ours).max())
    for body, slope in zip(residuals.bodies, residuals.slope(z), strict=True):

        def cost(pi: Array, body: Array = body) -> Array:
            moved = z.copy()
            moved[body] = pi
            return np.array([problem.cost(moved)])

        along = np.einsum("kij,ij->k", pseudo_inertia(np.eye(PI_SIZE)), slope)
        np.testing.assert_allclose(along, difference(cost, z[body])[0], rtol=1e-5, atol=1e-5 * np.abs(along).max())


@pytest.mark.parametrize("spread", [0.0, 1e-7, 1e-3, 1e-2, 1.0, 5.0])
def test_a_log_det_is_a_sum_of_squares(spread: float, rng: np.random.Generator) -> None:
    """At eigenvalues that are far apart, nearly one, nearly equal, and equal."""
    G = pseudo_inertia(np.eye(PI_SIZE))
    term = LogDet(0, G, 0.7)
    for J in definite(rng, 10, spread):
        z = from_pseudo_inertia(J)
        value, derivative = spectral(term, z)
        values = np.linalg.eigvalsh(J)
        e = values - 1
        expected = 0.7 * np.where(np.abs(e) < 1e-4, e**2 / 2 - e**3 / 3, e - np.log(values)).sum()
        assert np.square(value).sum() == pytest.approx(expected, rel=1e-6, abs=1e-30)
        numeric = difference(lambda z: spectral(term, z)[0], z, 1e-6 * values[0])
        np.testing.assert_allclose(derivative, numeric, atol=1e-6 * np.abs(derivative).max())
    same = 3.0 * np.eye(4)
    numeric = difference(lambda z: spectral(term, z)[0], from_pseudo_inertia(same))
    np.testing.assert_allclose(spectral(term, from_pseudo_inertia(same))[1], numeric, atol=1e-8)

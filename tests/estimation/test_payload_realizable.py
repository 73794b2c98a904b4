"""A payload that could exist, nearest to what the data say: cvxpy finds no nearer one."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic import point_parameters

from idtool.dynamics.effects.payload import nearest_realizable

Array = NDArray[np.float64]

SEEDS = range(5)


def pseudo_inertia(pi: Array) -> Array:
    """J (4, 4) of [m, h, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz]."""
    xx, xy, yy, xz, yz, zz = pi[4:]
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    J = np.zeros((4, 4))
    J[:3, :3] = np.trace(moments) / 2 * np.eye(3) - moments
    J[:3, 3] = J[3, :3] = pi[1:4]
    J[3, 3] = pi[0]
    return J


def load(rng: np.random.Generator, points: int = 6) -> Array:
    """Points of mass about a place 0.1 m away."""
    places = rng.normal(size=(points, 3)) * 0.04 + [0.1, -0.02, 0.05]
    return point_parameters(rng.uniform(0.05, 0.2, points), places)


def information(rng: np.random.Generator, rank: int = 10) -> Array:
    """What data may say: mass and moments to very different accuracy, all of it correlated."""
    size = 1 / np.array([0.02, *[2e-3] * 3, *[4e-4] * 6])
    Y = rng.normal(size=(rank if rank < 10 else 40, 10)) * size
    return np.asarray(Y.T @ Y)


def nearest(c: Array, V: Array) -> Array:
    """By semidefinite programming, shape (10,)."""
    size = np.array([1, *[0.1] * 3, *[0.01] * 6])
    values, vectors = np.linalg.eigh(V * np.outer(size, size))
    root = (vectors * np.sqrt(np.maximum(values, 0))).T / size
    units = np.outer(metres := np.array([0.1, 0.1, 0.1, 1]), metres)
    basis = np.stack([(pseudo_inertia(one) / units).ravel() for one in np.diag(size)])
    x = cp.Variable(10)
    J = cp.reshape(basis.T @ x, (4, 4), order="C")
    scale = np.linalg.norm(root @ c)
    cp.Problem(cp.Minimize(cp.sum_squares((root * size / scale) @ x - root @ c / scale)), [J >> 0]).solve(
        solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-9
    )
    return np.asarray(size * x.value)


def distance(pi: Array, c: Array, V: Array) -> float:
    """In standard errors."""
    return float(np.sqrt(max((pi - c) @ V @ (pi - c), 0.0)))


def exists(pi: Array) -> bool:
    """Whether a density of mass has these parameters."""
    J = pseudo_inertia(pi)
    return bool(np.linalg.eigvalsh(J)[0] >= -1e-12 * np.trace(J))


@pytest.mark.parametrize("seed", SEEDS)
def test_what_could_exist_stays_as_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    c = load(rng)
    found = nearest_realizable(c, information(rng))
    assert found is not None
    np.testing.assert_allclose(found, c, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_could_not_goes_to_the_nearest_that_could(seed: int) -> None:
    """By many standard errors, one of which is large against the inertia of a small body."""
    rng = np.random.default_rng(100 + seed)
    V = information(rng)
    c = load(rng) + 30 * np.linalg.solve(np.linalg.cholesky(V).T, rng.normal(size=10))
    assert not exists(c)
    found = nearest_realizable(c, V)
    assert found is not None
    assert exists(found)
    best = distance(nearest(c, V), c, V)
    assert best > 0.1
    assert distance(found, c, V) == pytest.approx(best, rel=1e-3)
    np.testing.assert_allclose(found, nearest(c, V), rtol=2e-2, atol=1e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_data_do_not_see_may_be_anything(seed: int) -> None:
    """Six numbers of ten are seen: where a body exists that has these, one is found."""
    rng = np.random.default_rng(200 + seed)
    V = information(rng, rank=6)
    unseen = np.linalg.svd(V)[2][6:]
    true, far = load(rng), unseen.T @ rng.normal(size=4) * 0.05
    for off in (far, far + rng.normal(size=10) * [0.02, *[0.01] * 3, *[1e-3] * 6]):
        c = true + off
        assert c[0] > 0
        assert not exists(c)
        found = nearest_realizable(c, V)
        assert found is not None
        assert exists(found)
        assert distance(found, c, V) <= 1.01 * distance(nearest(c, V), c, V) + 1e-3
    assert distance(true, true + far, V) < 1e-3


@pytest.mark.parametrize("mass", [0.0, -0.3])
def test_what_has_no_mass_is_no_payload(mass: float) -> None:
    rng = np.random.default_rng(0)
    c = load(rng)
    c[0] = mass
    assert nearest_realizable(c, information(rng)) is None

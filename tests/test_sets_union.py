"""Bodies on a union of ellipsoids (Cor. 2): members where parts can be found, by a problem of its own for cvxpy."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import rotation
from synthetic import point_parameters, points_in

from idtool.ellipsoid import Ellipsoid
from idtool.sets import Inequality, constraint_sets

Array = NDArray[np.float64]

SETS = constraint_sets()


def two_ellipsoids(rng: np.random.Generator) -> tuple[Ellipsoid, Ellipsoid]:
    """Side by side, at any angle, without a point in common."""
    centers = [[-1.5, 0, 0], [1.5, 0, 0]] @ rotation(rng).T
    first, second = (Ellipsoid.along(center, rng.uniform(0.4, 1, 3), rotation(rng)) for center in centers)
    return first, second


def union_margin(kind: str, ellipsoids: tuple[Ellipsoid, ...], pi: Array) -> float:
    """How far inside their sets parts can be that sum to pi; negative: there are none."""
    parts = SETS[kind].parts(ellipsoids)
    x = [cp.Variable(10) for _ in parts]
    t = cp.Variable()
    inside = [
        sum(x_k[i] * G for i, G in enumerate(inequality.G)) >> t * np.eye(inequality.G.shape[-1])
        for x_k, inequalities in zip(x, parts, strict=True)
        for inequality in inequalities
    ]
    program = cp.Problem(cp.Maximize(t), [*inside, sum(x) == pi])
    program.solve(solver=cp.CLARABEL)
    return float(program.value)


def mass_in(rng: np.random.Generator, *ellipsoids: Ellipsoid) -> Array:
    places = np.concatenate([points_in(rng, S, 6) for S in ellipsoids])
    return point_parameters(rng.uniform(0.1, 1, len(places)), places)


def margin(inequalities: tuple[Inequality, ...], pi: Array) -> float:
    return min(inequality.margin(pi, np.ones(10)) for inequality in inequalities)


@pytest.mark.parametrize("seed", range(6))
def test_a_body_with_mass_in_both_is_a_member_of_the_union_and_of_neither_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    both = two_ellipsoids(rng)
    pi = mass_in(rng, *both)
    for S in both:
        assert margin(SETS["ellipsoid"].inequalities(S), pi) < 0
    assert union_margin("ellipsoid", both, pi) > 0


@pytest.mark.parametrize("seed", range(3))
def test_a_body_with_mass_in_one_is_a_member_too(seed: int) -> None:
    """The other part has no mass: the margin is 0."""
    rng = np.random.default_rng(seed)
    first, second = two_ellipsoids(rng)
    pi = mass_in(rng, first)
    assert margin(SETS["ellipsoid"].inequalities(first), pi) > 0
    assert union_margin("ellipsoid", (first, second), pi) > -1e-7


@pytest.mark.parametrize("seed", range(6))
def test_mass_between_the_ellipsoids_is_not_in_their_union(seed: int) -> None:
    """A small body half-way, where the centre of mass of a body in both may well be."""
    rng = np.random.default_rng(seed)
    both = two_ellipsoids(rng)
    middle = 0.5 * (np.array(both[0].center) + both[1].center)
    pi = point_parameters(np.full(8, 0.2), middle + 0.1 * rng.normal(size=(8, 3)))
    assert union_margin("ellipsoid", both, pi) < 0


@pytest.mark.parametrize("kind", ["none", "semi", "full"])
def test_sets_without_ellipsoids_take_a_body_as_one(rng: np.random.Generator, kind: str) -> None:
    (only,) = SETS[kind].parts(two_ellipsoids(rng))
    assert len(only) == len(SETS[kind].inequalities(None))


@pytest.mark.parametrize("kind", ["com_ellipsoid", "ellipsoid"])
def test_sets_with_ellipsoids_give_each_its_part(rng: np.random.Generator, kind: str) -> None:
    both = two_ellipsoids(rng)
    pi = mass_in(rng, *both)
    for S, inequalities in zip(both, SETS[kind].parts(both), strict=True):
        assert margin(inequalities, pi) == margin(SETS[kind].inequalities(S), pi)
    (only,) = SETS[kind].parts(())
    assert margin(only, pi) == margin(SETS["full"].inequalities(None), pi)

"""Bodies on a union of ellipsoids (Cor. 2): members where parts can be found, by a problem of its own for cvxpy."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from robots import rotation
from synthetic import bounded_body, point_parameters, points_in

from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import Piece
from idtool.robot.sets import constraint_sets
from idtool.robot.shapes import Shape
from idtool.robot.shapes.box import Box

Array = NDArray[np.float64]

SETS = constraint_sets()


def two_ellipsoids(rng: np.random.Generator) -> tuple[Ellipsoid, Ellipsoid]:
    """Side by side, at any angle, without a point in common."""
    centers = [[-1.5, 0, 0], [1.5, 0, 0]] @ rotation(rng).T
    first, second = (Ellipsoid.from_axes(center, rng.uniform(0.4, 1, 3), rotation(rng)) for center in centers)
    return first, second


def union_margin(kind: str, bounds: tuple[Ellipsoid | Shape, ...], pi: Array) -> float:
    """How far inside their sets parts can be that sum to pi; negative: there are none."""
    parts = SETS[kind].pieces(bounded_body(*bounds))
    x = [cp.Variable(10) for _ in parts]
    t = cp.Variable()
    inside = []
    for x_k, piece in zip(x, parts, strict=True):
        for inequality in piece.inequalities:
            value = sum(x_k[i] * G for i, G in enumerate(inequality.G))
            matrix = inequality.G.ndim == 3
            inside.append(value >> t * np.eye(inequality.G.shape[-1]) if matrix else value >= t)
    program = cp.Problem(cp.Maximize(t), [*inside, sum(x) == pi])
    program.solve(solver=cp.CLARABEL)
    return float(program.value)


def mass_in(rng: np.random.Generator, *ellipsoids: Ellipsoid) -> Array:
    places = np.concatenate([points_in(rng, S, 6) for S in ellipsoids])
    return point_parameters(rng.uniform(0.1, 1, len(places)), places)


def margin(piece: Piece, pi: Array) -> float:
    return min(inequality.margin(pi, 1.0, 1.0) for inequality in piece.inequalities)


def alone(kind: str, *ellipsoids: Ellipsoid) -> Piece:
    """The one piece of a body on its own."""
    (piece,) = SETS[kind].pieces(bounded_body(*ellipsoids))
    return piece


@pytest.mark.parametrize("seed", range(6))
def test_a_body_with_mass_in_both_is_a_member_of_the_union_and_of_neither_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    both = two_ellipsoids(rng)
    pi = mass_in(rng, *both)
    for S in both:
        assert margin(alone("ellipsoid", S), pi) < 0
    assert union_margin("ellipsoid", both, pi) > 0


@pytest.mark.parametrize("seed", range(3))
def test_a_body_with_mass_in_one_is_a_member_too(seed: int) -> None:
    """The other part has no mass: the margin is 0."""
    rng = np.random.default_rng(seed)
    first, second = two_ellipsoids(rng)
    pi = mass_in(rng, first)
    assert margin(alone("ellipsoid", first), pi) > 0
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
    only = alone(kind, *two_ellipsoids(rng))
    assert len(only.inequalities) == len(alone(kind).inequalities)


@pytest.mark.parametrize("kind", ["com_ellipsoid", "ellipsoid"])
def test_sets_with_ellipsoids_give_each_its_part(rng: np.random.Generator, kind: str) -> None:
    both = two_ellipsoids(rng)
    pi = mass_in(rng, *both)
    for S, piece in zip(both, SETS[kind].pieces(bounded_body(*both)), strict=True):
        assert margin(piece, pi) == margin(alone(kind, S), pi)


@pytest.mark.parametrize("seed", range(3))
def test_an_ellipsoid_and_a_shape_are_a_union_too(seed: int) -> None:
    """A ball at one end and a box at the other; with mass in both, neither alone will do."""
    rng = np.random.default_rng(seed)
    ball = Ellipsoid((-1.5, 0, 0), (0.5, 0.5, 0.5))
    box = Box((1.5, 0.0, 0.0), (0.8, 0.4, 0.6))
    places = np.concatenate([points_in(rng, ball, 6), box.center + rng.uniform(-0.5, 0.5, (8, 3)) * [0.8, 0.4, 0.6]])
    pi = point_parameters(rng.uniform(0.1, 1, len(places)), places)
    assert union_margin("shape", (ball, box), pi) > 0
    assert union_margin("ellipsoid", (ball,), pi) < 0
    assert union_margin("shape", (box,), pi) < 0

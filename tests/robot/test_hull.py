"""Convex hulls: of any points, and conditions on the bodies in them that exclude none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots import rotation
from solids import Array, Largest, Problem, body, inside, largest_on_grid, margin, on_ball, random_shape, seeds
from synthetic import bounded_body

from idtool.estimation.problem.realizability import check_realizability
from idtool.robot.ellipsoid import minimum_volume_ellipsoid
from idtool.robot.inertia import from_pseudo_inertia, pseudo_inertia
from idtool.robot.sets import constraint_sets
from idtool.robot.shapes import Hull

TETRAHEDRON = Hull.around([[1, 0, 0], [0, 1, 0], [0, 0, 2], [-1, -1, -1]])


def polyhedron(rng: np.random.Generator) -> tuple[Hull, Array]:
    """A hull of some points, round, flat or with corners, near the origin or far away; and the points."""
    count = int(rng.choice([4, 6, 12, 60, 400]))
    points = on_ball(rng, count, 3) if rng.random() < 0.5 else rng.normal(size=(count, 3))
    points = points * np.exp(rng.uniform(np.log(0.02), np.log(0.4), 3)) @ rotation(rng)
    points = points + rng.choice([0, 0.3, 1.0]) * rng.normal(size=3)
    return Hull.around(points), points


# --- no real body is excluded ---


@given(seeds, st.integers(1, 12))
def test_mass_anywhere_in_a_hull_is_admitted(rng: np.random.Generator, count: int) -> None:
    """At its corners, on its edges and faces and inside, spread out and close together."""
    hull, points = polyhedron(rng)
    corners = points[rng.integers(len(points), size=(3, count))]
    middle = rng.dirichlet(np.full(len(points), 0.3)) @ points
    share = rng.random((count, 1))
    shares = rng.dirichlet(np.ones(3), count)
    for places in (
        corners[0],
        np.broadcast_to(middle, (count, 3)),
        corners[0, :1] + share * (corners[1, :1] - corners[0, :1]),
        np.einsum("nk,kni->ni", shares, corners),
        middle + 0.05 * (corners[0] - middle),
        rng.dirichlet(np.full(len(points), 1 / len(points)), count) @ points,
    ):
        pi = body(rng.uniform(0.1, 1, count), places)
        assert margin(hull, pi) > -1e-9
        assert check_realizability(bounded_body(hull), pi).violations == ()


@settings(max_examples=20)
@given(seeds)
def test_a_compact_body_anywhere_in_a_hull_is_admitted(rng: np.random.Generator) -> None:
    """A cube 15 % of the hull's size, such as a motor in a shell."""
    hull, points = polyhedron(rng)
    edge = 0.15 * hull.size
    cube = 0.5 * edge * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) @ rotation(rng)
    places = rng.dirichlet(np.ones(len(points)), 200) @ points
    fitting = [place for place in places if hull.contains(place + cube).all()]
    assume(fitting)
    for place in fitting:
        sigma = edge**2 / 12 * np.eye(3)
        J = np.block([[sigma + np.outer(place, place), place[:, None]], [place, np.ones(1)]])
        pi = 0.7 * from_pseudo_inertia(J)
        assert margin(hull, pi) > 0
        assert check_realizability(bounded_body(hull), pi).violations == ()


@settings(max_examples=20)
@given(seeds)
def test_a_hull_of_many_points_holds_the_mass_that_they_held(rng: np.random.Generator) -> None:
    """It is simplified, and grows thereby."""
    points = on_ball(rng, 600, 3) * rng.uniform(0.05, 1, 3)
    points = np.sign(points) * np.abs(points) ** rng.uniform(0.2, 1)
    hull = Hull.around(points)
    assert len(hull.vertices) <= 100
    assert hull.contains(points).all()
    masses = rng.exponential(size=600) ** rng.uniform(1, 8)
    assert margin(hull, body(masses, points)) > -1e-9


# --- what is admitted beyond ---


@given(seeds)
def test_a_centre_of_mass_outside_a_hull_is_refused(rng: np.random.Generator) -> None:
    """However small the body. Of a hull of few faces; one of many is simplified."""
    hull = Hull.around(rng.normal(size=(8, 3)) * rng.uniform(0.1, 1, 3))
    corners = np.array(hull.vertices)
    middle = corners.mean(axis=0)
    surface = corners[rng.integers(len(corners))]
    com = middle + 1.02 * (surface - middle)
    assert margin(hull, body(np.ones(1), com[None])) < -1e-3
    assert check_realizability(bounded_body(hull), body(np.ones(1), com[None])).violations


@given(seeds)
def test_a_body_too_large_for_a_hull_is_refused(rng: np.random.Generator) -> None:
    shape = random_shape(rng, "hull")
    places = inside(rng, shape, 40)[::2]  # its corners
    middle = np.mean(np.unique(places, axis=0), axis=0)
    assert margin(shape, body(np.ones(20), places)) > -1e-9
    assert margin(shape, body(np.ones(20), middle + 2.5 * (places - middle))) < -1e-3


def test_a_body_in_the_least_ellipsoid_but_not_in_the_hull_is_refused() -> None:
    corners = np.array(TETRAHEDRON.vertices)
    S = minimum_volume_ellipsoid(corners)
    pi = body(np.ones(2), S.center + 0.8 * np.array([[1, 0, 0], [-1, 0, 0]]))
    assert np.trace(pseudo_inertia(pi) @ S.Q) > 0
    assert margin(TETRAHEDRON, pi) < -0.01
    assert check_realizability(bounded_body(TETRAHEDRON), pi).violations


def test_a_tetrahedron_s_conditions_suffice(rng: np.random.Generator) -> None:
    """Its second moments in barycentric coordinates are a 4×4 matrix without negative entry: completely positive."""
    hull = Hull.around(TETRAHEDRON.vertices)
    places = np.concatenate([hull.vertices, hull._lattice(0.03)])
    problem = Problem(hull)
    for _ in range(10):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        lifted = np.column_stack([places, np.ones(len(places))])
        values = np.einsum("ni,ij,nj->n", lifted, W, lifted)
        assert problem.least(W) == pytest.approx(values.min(), abs=2e-3 * float(np.ptp(values)))
        assert problem.least(W) <= values.min() + 1e-5


def test_what_is_admitted_is_hardly_larger_than_what_a_fine_grid_of_masses_can_be() -> None:
    """And smaller than what the least ellipsoid admits, or the second moment of masses at the corners."""
    rng = np.random.default_rng(4)
    forms = ("conditions", "corners", "ellipsoid")
    beyond: dict[str, list[float]] = {form: [] for form in forms}
    for count in (4, 6, 8, 12, 40):
        hull = Hull.around(rng.normal(size=(count, 3)))
        corners = np.array(hull.vertices)
        places = np.concatenate([corners, hull._lattice((hull.volume / 2000) ** (1 / 3))])
        largest = {form: Largest(hull, form) for form in forms}
        for _ in range(5):
            com = rng.dirichlet(np.full(len(corners), 0.5)) @ corners * 0.8 + 0.2 * corners.mean(axis=0)
            root = rng.normal(size=(3, 3))
            true = largest_on_grid(places, com, root @ root.T)
            if true > 0.05:
                for form in forms:
                    beyond[form].append(largest[form].size(com, root @ root.T) / true - 1)
    assert len(beyond["conditions"]) > 15
    assert min(min(values) for values in beyond.values()) > -1e-3
    assert np.median(beyond["conditions"]) < 0.03
    assert np.mean(beyond["conditions"]) < min(
        0.06, 0.6 * np.mean(beyond["corners"]), 0.2 * np.mean(beyond["ellipsoid"])
    )


@given(seeds)
def test_a_hull_s_conditions_move_with_the_body(rng: np.random.Generator) -> None:
    """Turned, mirrored and moved, also where they are made from some of many faces."""
    hull, points = polyhedron(rng)
    R, p = rotation(rng) * rng.choice([-1, 1]), rng.normal(size=3)
    pi = body(rng.uniform(0.1, 1, 6), points[rng.integers(len(points), size=6)])
    T = np.block([[R, p[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    moved = from_pseudo_inertia(T @ pseudo_inertia(pi) @ T.T)
    values = [
        within.G.T @ x
        for (_, within), x in (
            (hull.pieces()[0].inequalities, pi),
            (hull.transformed(R, p).pieces()[0].inequalities, moved),
        )
    ]
    np.testing.assert_allclose(values[1], values[0], atol=1e-7)


# --- places for point masses ---


@given(seeds)
def test_masses_at_a_hull_s_places_are_the_set_of_points(rng: np.random.Generator) -> None:
    """The inner approximation that `constraints: points` asks for."""
    shape = random_shape(rng, "hull")
    (piece,) = constraint_sets()["points"].pieces(bounded_body(shape))
    places = shape.grid(120)
    masses = rng.uniform(0, 1, len(places))
    np.testing.assert_allclose(piece.basis @ masses, body(masses, places), rtol=1e-9, atol=1e-12)
    assert shape.contains(places).all()
    assert isinstance(shape, Hull)
    assert {tuple(x) for x in places} >= set(shape.vertices)
    assert margin(shape, piece.basis @ masses) > -1e-9


# --- the solid ---


@given(seeds, st.integers(4, 300))
def test_a_hull_holds_its_points(rng: np.random.Generator, count: int) -> None:
    points = rng.normal(size=(count, 3)) * rng.uniform(0.2, 1, 3) @ rotation(rng) + 10 * rng.normal(size=3)
    shape = Hull.around(points)
    assert len(shape.vertices) <= 100
    if count > 8:  # fewer may span next to no volume, and are thickened
        assert {tuple(x) for x in shape.vertices} <= {tuple(x) for x in points.tolist()}
    if count < 60:
        assert shape.contains(points).all()


def test_a_hull_of_many_vertices_grows_a_little(rng: np.random.Generator) -> None:
    points = on_ball(rng, 20_000, 3) * [1.0, 0.3, 0.1]
    volumes = []
    for most in (20, 40, 100):
        shape = Hull.around(points, most)
        assert 0.8 * most <= len(shape.vertices) <= most
        assert shape.contains(points).all()
        volumes.append(shape.volume / (4 / 3 * np.pi * 0.03))
    assert 1.5 > volumes[0] > volumes[1] > volumes[2] > 1
    assert volumes[2] < 1.1


def test_a_box_with_round_edges_keeps_its_flat_sides(rng: np.random.Generator) -> None:
    ball = on_ball(rng, 3000, 3)
    points = 0.1 * ball + np.sign(ball) * [1.0, 0.6, 0.3]
    shape = Hull.around(points, max_vertices=40)
    assert shape.contains(points).all()
    np.testing.assert_allclose(np.max(shape.vertices, axis=0), points.max(axis=0), rtol=0.05)
    np.testing.assert_allclose(np.min(shape.vertices, axis=0), points.min(axis=0), rtol=0.05)


@pytest.mark.parametrize(
    "points",
    [
        [[1, 2, 3]],
        [[1, 2, 3]] * 5,
        [[0, 0, 0], [1, 2, 3]],
        [[0, 0, 0], [1, 2, 3], [2, 4, 6]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]],
        [[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1 + 1e-9]],
    ],
    ids=["a point", "the same point", "two points", "a line", "a triangle", "a square", "a square but for rounding"],
)
def test_a_hull_of_points_without_volume_is_thin(points: list[list[float]]) -> None:
    shape = Hull.around(points)
    assert shape.contains(points, tolerance=1e-6).all()
    longest = max(float(np.linalg.norm(np.ptp(points, axis=0))), 1e-3)
    corners = np.array(shape.vertices)
    least = np.linalg.svd(corners - corners.mean(axis=0))[1][-1] / np.sqrt(len(corners))
    assert 0.003 * longest < least < 0.006 * longest  # half a hundredth of the extent to either side
    if np.ptp(points, axis=0).any():  # a point's are lost in the rounding of its distance from the origin
        assert margin(shape, body(np.ones(len(points)), np.array(points))) > -1e-9


@pytest.mark.parametrize("points", [[], [[0, 0, np.nan]], [[0, 0, 0], [np.inf, 0, 0]]])
def test_a_hull_of_nothing_or_of_points_nowhere_is_refused(points: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="at least one point, all of them finite"):
        Hull.around(points)

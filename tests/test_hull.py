"""Convex hulls: of any points, and the point masses that stand for bodies in them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import rotation
from scipy.optimize import nnls
from solids import (
    Array,
    body,
    on_ball,
    random_shape,
    seeds,
)

from idtool.inertia import POWERS, transformation
from idtool.shapes import Hull


@given(seeds)
def test_masses_at_a_hull_s_places_are_admitted_and_are_their_body(rng: np.random.Generator) -> None:
    shape = random_shape(rng, "hull")
    (piece,) = shape.pieces()
    places = shape.grid(200)
    masses = rng.uniform(0, 1, len(places))
    np.testing.assert_allclose(piece.basis @ masses, body(masses, places), rtol=1e-9, atol=1e-12)
    assert shape.contains(places).all()
    assert {tuple(x) for x in places} >= set(getattr(shape, "vertices"))  # noqa: B009
    for inequality in piece.inequalities:
        assert inequality.margin(masses, 1.0, shape.size, piece.powers) >= 0
        assert inequality.margin(-masses, 1.0, shape.size, piece.powers) < 0


@given(seeds)
def test_a_body_spread_over_a_hull_is_point_masses_at_its_places(rng: np.random.Generator) -> None:
    """Mass beyond the solid never is."""
    shape = random_shape(rng, "hull")
    assert isinstance(shape, Hull)
    (piece,) = shape.pieces()
    corners = np.array(shape.vertices)
    places = rng.dirichlet(np.full(len(corners), 3 / len(corners)), 200) @ corners
    relative = transformation(np.eye(3), -corners.mean(axis=0)) / shape.size ** POWERS[:, None]

    def missed(pi: Array) -> float:
        return float(nnls(relative @ piece.basis, relative @ pi)[1] / pi[0])

    assert missed(body(np.ones(200), places)) < 1e-9
    assert missed(body(np.ones(len(corners)), corners + 0.5 * (corners - corners.mean(axis=0)))) > 1e-3


@given(seeds, st.integers(4, 300))
def test_a_hull_holds_its_points(rng: np.random.Generator, count: int) -> None:
    points = rng.normal(size=(count, 3)) * rng.uniform(0.2, 1, 3) @ rotation(rng) + 10 * rng.normal(size=3)
    shape = Hull.around(points)
    assert len(shape.vertices) <= 100
    if count > 8:  # fewer may span next to no volume, and are thickened
        assert {tuple(x) for x in shape.vertices} <= {tuple(x) for x in points.tolist()}
    if count < 60:
        assert shape.contains(points).all()


def test_a_hull_of_many_vertices_keeps_the_outermost(rng: np.random.Generator) -> None:
    points = on_ball(rng, 20_000, 3) * [1.0, 0.3, 0.1]
    shape = Hull.around(points)
    assert 80 <= len(shape.vertices) <= 100
    assert shape.volume == pytest.approx(4 / 3 * np.pi * 0.03, rel=0.08)
    assert shape.contains(0.9 * points).all()
    assert Hull.around(points, most=20).volume < shape.volume


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
    (piece,) = shape.pieces()
    assert piece.basis.shape == (10, 200)


@pytest.mark.parametrize("points", [[], [[0, 0, np.nan]], [[0, 0, 0], [np.inf, 0, 0]]])
def test_a_hull_of_nothing_or_of_points_nowhere_is_refused(points: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="at least one point, all of them finite"):
        Hull.around(points)

"""Few points around many: corners of the hull or of a polyhedron a little larger, in memory that grows with them."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.spatial import ConvexHull
from solids import on_ball

from idtool.robot.bounding import bounding_ellipsoids
from idtool.robot.convex import enclosing_planes, enclosing_points, polyhedron_corners
from idtool.robot.ellipsoid import minimum_volume_ellipsoid
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
MANY = 12_000


def beyond(points: Array, corners: Array) -> float:
    """How far points lie beyond the hull of the corners, relative to its extent."""
    planes = ConvexHull(corners).equations
    farthest = max(float((points @ plane[:3] + plane[3]).max()) for plane in planes)
    return farthest / float(np.ptp(corners, axis=0).max())


@given(seeds, st.integers(5, 200))
def test_of_few_points_it_is_the_corners_of_their_hull(rng: np.random.Generator, count: int) -> None:
    points = rng.normal(size=(count, 3)) * rng.uniform(0.1, 1, 3) @ rotation(rng) + 10 * rng.normal(size=3)
    expected = points[ConvexHull(points).vertices]
    assert {tuple(x) for x in enclosing_points(points)} == {tuple(x) for x in expected}


@pytest.mark.parametrize("kind", ["round", "slender", "sheared", "with flat faces", "full of points inside"])
def test_many_points_are_enclosed_by_few(kind: str, rng: np.random.Generator) -> None:
    ball = on_ball(rng, MANY, 3)
    solids = {
        "round": ball,
        "slender": ball * [1, 0.1, 0.01],
        "sheared": ball @ rng.normal(size=(3, 3)),
        "with flat faces": ball / np.abs(ball).max(axis=1, keepdims=True),
        "full of points inside": rng.normal(size=(MANY, 3)),
    }
    points = solids[kind] @ rotation(rng) + 3 * rng.normal(size=3)
    corners = enclosing_points(points)
    assert len(corners) < 5000
    assert beyond(points, corners) < 1e-12
    assert ConvexHull(corners).volume < 1.02 * ConvexHull(points).volume


def test_repeated_points_are_taken_once(rng: np.random.Generator) -> None:
    points = rng.normal(size=(500, 3))
    expected = {tuple(x) for x in enclosing_points(points)}
    assert {tuple(x) for x in enclosing_points(np.tile(points, (MANY // 500 + 1, 1)))} == expected


@pytest.mark.parametrize("count", [300, MANY])
def test_points_without_volume_keep_their_rim(count: int, rng: np.random.Generator) -> None:
    R, p = rotation(rng), rng.normal(size=3)
    angle = rng.uniform(0, 2 * np.pi, count)
    disc = np.column_stack([np.cos(angle), 0.5 * np.sin(angle), np.zeros(count)])
    rim = (enclosing_points(disc @ R.T + p) - p) @ R
    assert np.abs(rim[:, 2]).max() < 1e-12
    assert (ConvexHull(rim[:, :2]).equations @ np.column_stack([disc[:, :2], np.ones(count)]).T).max() < 1e-12
    assert np.hypot(rim[:, 0], 2 * rim[:, 1]).max() < 1.005
    line = np.outer(np.linspace(-1, 1, count), [1, 2, 3]) + p
    np.testing.assert_allclose(np.sort(enclosing_points(line), axis=0), line[[0, -1]])
    np.testing.assert_array_equal(enclosing_points(np.tile(p, (count, 1))), p[None])


@given(seeds, st.integers(4, 60), st.integers(6, 40))
def test_planes_enclose_points(rng: np.random.Generator, count: int, most: int) -> None:
    """Their faces' own where these are few enough."""
    points = rng.normal(size=(count, 3)) * rng.uniform(0.05, 1, 3) @ rotation(rng) + 3 * rng.normal(size=3)
    planes, faces = enclosing_planes(points, most), ConvexHull(points).equations
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1)
    assert len(planes) <= most
    np.testing.assert_allclose((points @ planes[:, :3].T + planes[:, 3]).max(axis=0), 0, atol=1e-12)
    corners = polyhedron_corners(planes, points.mean(axis=0))
    assert beyond(points, corners) < 1e-9
    if len(faces) <= most:
        assert same_rows(planes, faces)
        assert same_rows(corners, points[ConvexHull(points).vertices])


def same_rows(a: Array, b: Array) -> bool:
    """Whether every row of one is all but a row of the other."""
    near = np.linalg.norm(a[:, None] - b, axis=2)
    return bool(max(near.min(axis=0).max(), near.min(axis=1).max()) < 1e-6)


def test_the_more_planes_the_less_is_enclosed_beside(rng: np.random.Generator) -> None:
    points = on_ball(rng, 3000, 3) * [1, 0.5, 0.2]
    volumes = []
    for most in (6, 12, 24, 52):
        corners = polyhedron_corners(enclosing_planes(points, most), points.mean(axis=0))
        assert len(corners) <= 2 * most - 4
        volumes.append(ConvexHull(corners).volume / ConvexHull(points).volume)
    assert np.all(np.diff(volumes) < 0)
    assert volumes[2] < 1.25
    assert volumes[3] < 1.1


def test_a_prism_s_faces_are_one_plane_each() -> None:
    """However many triangles they are made of."""
    angle = np.arange(12) * np.pi / 6
    prism = np.array([[np.cos(a), np.sin(a), z] for a in angle for z in (-1, 1)])
    assert len(enclosing_planes(prism, 30)) == 14


@pytest.fixture
def peak() -> Callable[[Callable[[], object]], int]:
    """The most memory that numpy and Python hold during a call beyond what they held before [bytes]."""

    def measure(call: Callable[[], object]) -> int:
        tracemalloc.start()
        try:
            call()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    return measure


def test_the_memory_grows_with_the_points_alone(
    rng: np.random.Generator, peak: Callable[[Callable[[], object]], int]
) -> None:
    points = on_ball(rng, 200_000, 3)  # the square of their number is beyond any memory
    assert peak(lambda: minimum_volume_ellipsoid(points)) < 12 * points.nbytes
    assert peak(lambda: enclosing_points(points)) < 12 * points.nbytes


def test_a_fine_mesh_s_ellipsoid_takes_memory_like_its_file(
    robot_of: Callable[[str | bytes], Robot], tmp_path: Path, peak: Callable[[Callable[[], object]], int]
) -> None:
    """Of a ball whose every vertex is a corner of its hull."""
    trimesh.creation.icosphere(subdivisions=7, radius=0.3).export(tmp_path / "ball.stl")  # 328,000 triangles
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    geometry = f'<collision><geometry><mesh filename="{tmp_path}/ball.stl"/></geometry></collision>'
    robot = robot_of(f'<robot name="r"><link name="a">{mass}{geometry}</link></robot>')
    found: list[Array] = []
    used = peak(lambda: found.append(np.array(bounding_ellipsoids(robot, 0.0)[0]["a"].semi_axes)))
    assert used < 12 * (tmp_path / "ball.stl").stat().st_size
    np.testing.assert_allclose(found, 0.3, rtol=0.005)
    assert np.min(found) >= 0.3 * (1 - 1e-6)

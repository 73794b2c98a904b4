"""The pieces that links are made of: primitives, meshes, and what stands in for those that cannot be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from sentences import sentences
from touching import BOX, LOWER, SPHERE, UPPER, Build, arm, checked, solid

from idtool.robot.collision import SelfCollision

Array = NDArray[np.float64]
Written = Callable[[str, str], Path]


def mesh(points: Array) -> str:
    """The hull of points as an OBJ file."""
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in ConvexHull(points).simplices)])


def ball(count: int, radius: float) -> Array:
    """Points on a sphere, shape (count, 3)."""
    x = np.random.default_rng(3).normal(size=(count, 3))
    return np.asarray(radius * x / np.linalg.norm(x, axis=1)[:, None])


def test_a_mesh_is_its_hull_in_its_scale(build: Build, written: Written) -> None:
    corners = np.array([[x, y, z] for x in (0, 2) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    written(mesh(corners), "box.obj")
    tip = solid('<mesh filename="box.obj" scale="0.1 0.05 0.01"/>')
    found = checked(build(arm(solid(SPHERE.format(0.1)), "", tip), ["j1", "j2"]))
    assert found.clearance(np.array([[1.0, 0.0], [0.0, np.pi]])) == pytest.approx([0.7, -0.1], abs=1e-5)


def test_a_mesh_of_many_vertices_is_not_taken_for_smaller(build: Build, written: Written) -> None:
    written(mesh(ball(4000, 0.2)), "ball.obj")
    ours = solid('<mesh filename="ball.obj"/>')
    found = checked(build(arm(solid(SPHERE.format(0.1)), "", ours), ["j1", "j2"]))
    angle = np.linspace(-2.5, 2.5, 60)
    away = np.sqrt(UPPER**2 + LOWER**2 + 2 * UPPER * LOWER * np.cos(angle)) - 0.3
    lost = away - found.clearance(np.stack([0 * angle, angle]))
    assert lost.min() > -2e-4  # the mesh itself is inside the sphere by so much
    assert lost.max() < 0.005
    assert all(part.shape.num_points <= 400 for part in found._parts if hasattr(part.shape, "num_points"))


def test_a_flat_mesh_has_a_thickness(build: Build, written: Written) -> None:
    plate = "\n".join(["v 0 -1 -1", "v 0 1 -1", "v 0 0 1", "f 1 2 3"])
    written(plate, "plate.obj")
    tip = solid('<mesh filename="plate.obj"/>')
    found = checked(build(arm(solid(SPHERE.format(0.1)), "", tip), ["j1", "j2"]))
    assert found.clearance(np.zeros((2, 1))) == pytest.approx([0.7 - 0.0005], abs=1e-5)


def test_many_pieces_are_one_hull(build: Build) -> None:
    tip = "".join(solid(SPHERE.format(0.01), f"{0.1 * np.cos(x)} {0.1 * np.sin(x)} 0") for x in np.arange(17))
    found = checked(build(arm(solid(SPHERE.format(0.1)), "", tip), ["j1", "j2"]))
    assert len(found._parts) == 2
    assert found.clearance(np.zeros((2, 1))) == pytest.approx([0.8 - 0.1 - 0.11], abs=0.005)


def test_a_mesh_that_is_missing_is_said(build: Build) -> None:
    """Once for all; the visual stands in where there is one, the rest of the link where there is none."""
    missing = solid('<mesh filename="package://robot/lost.stl"/>')
    visual = solid(SPHERE.format(0.2), tag="visual")
    found = checked(build(arm(solid(SPHERE.format(0.1)), "", missing + visual), ["j1", "j2"]))
    assert sentences(found.notices) == ()
    assert found.clearance(np.zeros((2, 1))) == pytest.approx([0.5], abs=1e-5)
    model = build(arm(solid(SPHERE.format(0.1)), missing, solid(SPHERE.format(0.1)) + missing), ["j1", "j2"])
    found = checked(model)
    (warning,) = sentences(found.notices)
    assert warning.startswith("the self-collision check ignores geometry of upper, tip: line 1: mesh")
    assert "package://robot/lost.stl is not found" in warning
    assert found.clearance(np.zeros((2, 1))) == pytest.approx([0.6], abs=1e-5)
    model = build(arm(missing, missing, missing), ["j1", "j2"])
    assert SelfCollision.from_model(model) is None


@pytest.mark.parametrize(
    ("shape", "why"),
    [
        ("", "collision has no geometry"),
        ('<sphere radius="nan"/>', "sphere radius 'nan' should be a finite number"),
        ("<sphere/>", "sphere radius '' should be a finite number"),
        ('<box size="1 1"/>', "box size '1 1' should be 3 finite numbers"),
        ('<box size="1 1 1e300"/>', "box size '1 1 1e300' should be 3 finite numbers"),
        ('<cone radius="1"/>', "cone is not a supported geometry"),
        ('<mesh filename="https://x/y.stl"/>', "is not downloaded"),
    ],
)
def test_strange_geometry_is_left_out_and_said(build: Build, shape: str, why: str) -> None:
    small = solid(SPHERE.format(0.05))
    found = checked(build(arm(small, solid(shape), small), ["j1", "j2"]))
    (warning,) = sentences(found.notices)
    assert why in warning
    assert "give another file" not in warning
    assert found.pairs == (("base", "tip"),)


def test_shapes_without_extent(build: Build) -> None:
    point = SPHERE.format(0)
    for shape in (BOX.format(0, 0, 0), '<cylinder radius="0" length="0"/>', '<capsule radius="0" length="0"/>'):
        found = checked(build(arm(solid(point), "", solid(shape)), ["j1", "j2"]))
        assert found.clearance(np.zeros((2, 2))) == pytest.approx([0.8, 0.8], abs=1e-5)

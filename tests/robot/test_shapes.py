"""Bounding shapes: what a density inside one has, and what a body that does not fit has not.

Moments are written out from their definition, J = Σ m [x; 1][x; 1]ᵀ, and places are drawn from each solid by its own
definition, in a frame of its own, turned and moved.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots import rotation
from scipy.spatial.transform import Rotation
from solids import (
    KINDS,
    body,
    inside,
    kinds,
    margin,
    margins,
    on_ball,
    one_piece,
    random_shape,
    seeds,
)

from idtool.robot.ellipsoid import Ellipsoid, minimum_volume_ellipsoid
from idtool.robot.inertia import J_BASIS, LENGTH_POWERS, from_mass_com_inertia, from_pseudo_inertia, parameter_transform
from idtool.robot.shapes import Hull, Shape, known_shapes
from idtool.robot.shapes.box import Box
from idtool.robot.shapes.capsule import Capsule
from idtool.robot.shapes.cylinder import Cylinder

# --- what a density inside has ---


def test_every_shape_is_known_by_its_kind(rng: np.random.Generator) -> None:
    assert set(known_shapes()) == set(KINDS)
    for kind in KINDS:
        assert type(random_shape(rng, kind)) is known_shapes()[kind]


@given(seeds, one_piece, st.integers(1, 12))
def test_mass_inside_is_admitted(rng: np.random.Generator, kind: str, count: int) -> None:
    shape = random_shape(rng, kind)
    assert margin(shape, body(rng.uniform(0.1, 1, count), inside(rng, shape, count))) >= -1e-10


@given(seeds, st.integers(1, 12))
def test_mass_inside_a_capsule_is_admitted_part_by_part(rng: np.random.Generator, count: int) -> None:
    shape = random_shape(rng, "capsule")
    assert isinstance(shape, Capsule)
    places, masses = inside(rng, shape, count), rng.uniform(0.1, 1, count)
    height = (places - shape.center) @ Rotation.from_euler("xyz", shape.rpy).as_matrix()[:, 2]
    half = 0.5 * shape.length
    parts = (np.abs(height) <= half, height < -half, height > half)
    assert len(shape.pieces()) == len(parts)
    for piece, part in zip(shape.pieces(), parts, strict=True):
        if part.any():
            assert min(margins(piece, body(masses[part], places[part]), shape.size)) >= -1e-9


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_a_uniform_body_is_well_inside(kind: str, rng: np.random.Generator) -> None:
    """Its second moments, in closed form, are a third or a quarter of the square of half the extent."""
    shape = random_shape(rng, kind)
    assert isinstance(shape, Box | Cylinder)
    half = np.divide(shape.sides, 2) if isinstance(shape, Box) else np.array([shape.radius] * 2 + [shape.length / 2])
    sigma = np.diag(half**2 / (3 if isinstance(shape, Box) else np.array([4, 4, 3])))
    R = Rotation.from_euler("xyz", shape.rpy).as_matrix()
    pi = from_mass_com_inertia(2.0, np.array(shape.center), 2.0 * R @ (np.trace(sigma) * np.eye(3) - sigma) @ R.T)
    _, *own = margins(shape.pieces()[0], pi, shape.size)
    assert min(own) > 0.4


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_a_point_on_the_surface_is_just_admitted_and_beyond_it_is_not(kind: str, rng: np.random.Generator) -> None:
    shape = random_shape(rng, kind)
    assert isinstance(shape, Box | Cylinder)
    surface = inside(rng, shape, 20)[::2]
    for x in surface:
        pi = body(np.ones(1), x[None])
        _, *own = margins(shape.pieces()[0], pi, shape.size)
        assert min(own) == pytest.approx(0, abs=1e-10)
        beyond = shape.center + 1.01 * (x - shape.center)
        assert margin(shape, body(np.ones(1), beyond[None])) < -1e-3


# --- what no density inside has ---


@given(seeds, one_piece)
def test_a_centre_of_mass_outside_is_refused(rng: np.random.Generator, kind: str) -> None:
    """However small the body."""
    shape = random_shape(rng, kind)
    assert isinstance(shape, Box | Cylinder)
    com = shape.center + 1.02 * (inside(rng, shape, 1)[0] - shape.center)
    small = com + rng.uniform(0, 0.1) * shape.size * on_ball(rng, 4, 3)
    small += com - small.mean(axis=0)
    assert not shape.contains(com)
    assert margin(shape, body(np.ones(4), small)) < 0


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_a_body_too_large_for_the_shape_is_refused(kind: str, rng: np.random.Generator) -> None:
    shape = random_shape(rng, kind)
    assert isinstance(shape, Box | Cylinder)
    places = inside(rng, shape, 40)[::2]
    both = np.concatenate([places, 2 * np.array(shape.center) - places])  # centred
    assert margin(shape, body(np.ones(len(both)), both)) >= -1e-10
    larger = shape.center + 1.5 * (both - shape.center)
    assert margin(shape, body(np.ones(len(both)), larger)) < -1e-3


def test_a_body_that_fits_the_box_s_ellipsoid_but_not_the_box_is_refused() -> None:
    half = np.array([0.1, 0.05, 0.02])
    corners = np.array(list(product((-1, 1), repeat=3))) * half
    S = minimum_volume_ellipsoid(corners)
    pi = body(np.array([1.0, 1.0]), np.array([[0.16, 0, 0], [-0.16, 0, 0]]))
    trace = float(np.einsum("kij,ji,k->", J_BASIS, S.Q, pi))
    assert trace > 0
    x, y, z = (2 * half).tolist()
    assert margin(Box((0, 0, 0), (x, y, z)), pi) < -0.1


def test_a_body_that_fits_the_cylinder_s_box_but_not_the_cylinder_is_refused() -> None:
    pi = body(np.ones(4), np.array([[0.09, 0.09, 0], [-0.09, 0.09, 0], [0.09, -0.09, 0], [-0.09, -0.09, 0.0]]))
    assert margin(Box((0, 0, 0), (0.2, 0.2, 0.3)), pi) >= -1e-12  # it is flat
    assert margin(Cylinder((0, 0, 0), 0.1, 0.3), pi) < -0.1


def test_mass_at_one_end_of_a_cylinder_cannot_lie_beyond_its_rim() -> None:
    """The second-order cone's product alone sees it: all other conditions hold."""
    pi = body(np.ones(3), np.array([[0.13, 0, 0.15], [0, 0, -0.15], [0, 0, -0.15]]))
    density, disc_and_slab, upper, lower = margins(Cylinder((0, 0, 0), 0.1, 0.3).pieces()[0], pi, 0.1)
    assert min(density, disc_and_slab, lower) >= -1e-12
    assert upper < -0.1


def test_a_box_needs_the_signs_of_three_products_at_once() -> None:
    """No body has E[xy] = E[xz] = E[yz] = −½ on |x|, |y|, |z| ≤ 1: at every corner an even number of them is −1."""
    J = np.eye(4)
    J[:3, :3] = 1.4 * np.eye(3) / 1.4 - 0.45 * (np.ones((3, 3)) - np.eye(3))
    pi = from_pseudo_inertia(J)
    assert np.linalg.eigvalsh(J)[0] > 0
    assert all(1 - abs(J[i, j]) > 0 for i, j in combinations(range(3), 2))
    assert margin(Box((0, 0, 0), (2, 2, 2)), pi) < -0.1


# --- frames, units, places ---


@given(seeds, one_piece)
def test_the_conditions_move_with_the_body(rng: np.random.Generator, kind: str) -> None:
    shape, R, p = random_shape(rng, kind), rotation(rng), rng.normal(size=3)
    pi = body(rng.uniform(0.1, 1, 6), inside(rng, shape, 6, reach=1.2))
    _, *own = margins(shape.pieces()[0], pi, shape.size)
    _, *moved = margins(shape.transformed(R, p).pieces()[0], parameter_transform(R, p) @ pi, shape.size)
    np.testing.assert_allclose(moved, own, atol=1e-8)


@given(seeds, kinds)
def test_a_moved_shape_holds_the_moved_points(rng: np.random.Generator, kind: str) -> None:
    shape, R, p = random_shape(rng, kind), rotation(rng), rng.normal(size=3)
    x = np.concatenate([inside(rng, shape, 10), inside(rng, shape, 10) + 3 * shape.size * on_ball(rng, 10, 3)])
    moved = shape.transformed(R, p)
    np.testing.assert_array_equal(moved.contains(x @ R.T + p, tolerance=1e-6), shape.contains(x, tolerance=1e-6))
    assert moved.size == pytest.approx(shape.size)
    assert moved.contains(x[:10] @ R.T + p, tolerance=1e-6).all()


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 2])
def test_a_shape_turned_to_where_its_angles_are_not_unique(angle: float) -> None:
    box = Box((1, 0, 0), (0.1, 0.2, 0.3)).transformed(Rotation.from_euler("y", angle).as_matrix(), np.zeros(3))
    np.testing.assert_allclose(np.abs(box.rotation), [[0, 0, 1], [0, 1, 0], [1, 0, 0]], atol=1e-7)


@given(seeds, one_piece, st.sampled_from([0.95, 1.05]))
def test_millimetres_and_grams_change_nothing(rng: np.random.Generator, kind: str, reach: float) -> None:
    shape = random_shape(rng, kind)
    pi = body(rng.uniform(0.1, 1, 30), inside(rng, shape, 30, reach))
    data = shape.to_dict()
    scaled = {name: np.multiply(data[name], 1e3).tolist() for name in data if name not in ("kind", "rpy")}
    large = type(shape).from_dict({**data, **scaled})
    assert large.size == pytest.approx(1e3 * shape.size)
    assert margin(large, 1e3 * pi * 1e3**LENGTH_POWERS) == pytest.approx(margin(shape, pi), abs=1e-8)


@given(seeds, kinds)
def test_plain_data_and_back(rng: np.random.Generator, kind: str) -> None:
    shape = random_shape(rng, kind)
    data = shape.to_dict()
    assert data["kind"] == kind
    again = known_shapes()[kind].from_dict(data)
    if isinstance(shape, Hull):
        assert set(getattr(again, "vertices")) == set(shape.vertices)  # noqa: B009
    else:
        assert again == shape
        assert known_shapes()[kind].from_dict({k: v for k, v in data.items() if k != "kind"}) == shape


@pytest.mark.parametrize("kind", KINDS)
def test_contains_tells_inside_from_outside(kind: str, rng: np.random.Generator) -> None:
    for _ in range(20):
        shape = random_shape(rng, kind)
        x = inside(rng, shape, 40)
        assert shape.contains(x, tolerance=1e-6).all()
        assert shape.contains(x.reshape(4, 10, 3), tolerance=1e-6).shape == (4, 10)
        assert bool(shape.contains(x[0], tolerance=1e-6))
        if not isinstance(shape, Hull):
            away = np.array(getattr(shape, "center"))  # noqa: B009
            assert not shape.contains(away + 1.02 * (inside(rng, shape, 40)[::2] - away)).all()
        far = x + 100 * shape.size * on_ball(rng, 1, 3)
        assert not shape.contains(far).any()


@pytest.mark.parametrize("kind", [*KINDS, "ellipsoid"])
@pytest.mark.parametrize("count", [1, 60, 150, 1000])
def test_a_grid_is_inside_reaches_the_boundary_and_leaves_no_hole(
    kind: str, count: int, rng: np.random.Generator
) -> None:
    solid: Shape | Ellipsoid = Ellipsoid((1, 2, 3), (0.1, 0.3, 0.2), (0.3, 0.2, 0.1))
    if kind != "ellipsoid":
        solid = random_shape(rng, kind)
    x = solid.grid(count)
    assert solid.contains(x).all()
    assert len(x) <= max(1.1 * count, 60)
    assert len(x) >= 0.6 * count
    if count >= 60:
        directions = on_ball(rng, 50, 3)
        reach, full = ((y @ directions.T).max(axis=0) for y in (x, solid.grid(20_000) if kind != "hull" else x))
        assert (full - reach < 0.6 * solid.size).all()
    if count == 1000:
        apart = (4.2 / len(x)) ** (1 / 3) * solid.size  # the side of a place's share of the volume
        others = solid.grid(300 if kind == "hull" else 3000)
        hole = np.linalg.norm(others[:, None] - x, axis=2).min(axis=1).max()
        assert hole < 3 * apart

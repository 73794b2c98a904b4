"""Bounding shapes: what a density inside one has, and what a body that does not fit has not.

Moments are written out from their definition, J = Σ m [x; 1][x; 1]ᵀ, and places are drawn from each solid by its own
definition, in a frame of its own, turned and moved.
"""

from __future__ import annotations

from itertools import combinations, product

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from idtool.ellipsoid import Ellipsoid, smallest_around
from idtool.inequality import Piece
from idtool.inertia import BASIS, POWERS, from_mass_com_inertia, from_pseudo_inertia, transformation
from idtool.shapes import Hull, Shape, known_shapes
from idtool.shapes.box import Box
from idtool.shapes.capsule import Capsule
from idtool.shapes.cylinder import Cylinder

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
KINDS = ("box", "cylinder", "capsule", "hull")
kinds = st.sampled_from(KINDS)
one_piece = st.sampled_from(("box", "cylinder"))


def random_shape(rng: np.random.Generator, kind: str) -> Shape:
    """A shape anywhere, turned any way, some ten centimetres large."""
    a, b, c = rng.uniform(0.03, 0.4, 3).tolist()
    x, y, z = rng.normal(size=3).tolist()
    place, rpy = (x, y, z), (float(rng.uniform(-3, 3)), float(rng.uniform(-1.5, 1.5)), float(rng.uniform(-3, 3)))
    if kind == "box":
        return Box(place, (a, b, c), rpy)
    if kind == "cylinder":
        return Cylinder(place, a, b, rpy)
    if kind == "capsule":
        return Capsule(place, a, b, rpy)
    return Hull.around(rng.normal(size=(rng.integers(4, 60), 3)) * [a, b, c] + place)


def turned(shape: Box | Cylinder | Capsule, local: Array) -> Array:
    """Points of a shape's own frame in the body's."""
    return np.asarray(local @ Rotation.from_euler("xyz", shape.rpy).as_matrix().T + shape.center)


def on_ball(rng: np.random.Generator, count: int, dimension: int) -> Array:
    x = rng.normal(size=(count, dimension))
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


def inside(rng: np.random.Generator, shape: Shape, count: int, reach: float = 1.0) -> Array:
    """Places in a shape, half of them on its surface or at ``reach`` times it; shape (count, 3)."""
    share = np.where(np.arange(count) % 2 == 0, 1.0, rng.random(count))[:, None] * reach
    if isinstance(shape, Box):
        x = rng.uniform(-1, 1, (count, 3))
        return turned(shape, share * x / np.abs(x).max(axis=1, keepdims=True) * np.divide(shape.sides, 2))
    if isinstance(shape, Cylinder):
        height = rng.choice([-1, 1, rng.uniform(-1, 1)], (count, 1)) * shape.length / 2
        return turned(shape, np.column_stack([on_ball(rng, count, 2) * shape.radius * share, height]))
    if isinstance(shape, Capsule):
        spine = np.column_stack([np.zeros((count, 2)), rng.uniform(-0.5, 0.5, count) * shape.length])
        return turned(shape, spine + on_ball(rng, count, 3) * shape.radius * share)
    assert isinstance(shape, Hull)
    corners = np.array(shape.vertices)
    x = rng.dirichlet(np.full(len(corners), 0.3), count) @ corners
    return np.asarray(np.where(np.arange(count)[:, None] % 2, x, corners[rng.integers(len(corners), size=count)]))


def body(masses: Array, places: Array) -> Array:
    """The pi of point masses."""
    lifted = np.column_stack([places, np.ones(len(masses))])
    return from_pseudo_inertia(lifted.T @ (lifted * masses[:, None]))


def margins(piece: Piece, pi: Array, length: float) -> list[float]:
    """Of a piece whose unknowns are pi itself."""
    np.testing.assert_array_equal(piece.basis, np.eye(10))
    return [inequality.margin(pi, pi[0], length, piece.powers) for inequality in piece.inequalities]


def margin(shape: Shape, pi: Array) -> float:
    (piece,) = shape.pieces()
    return min(margins(piece, pi, shape.size))


class Problem:
    """The least W · pi of a body of mass 1 kg that a shape's pieces admit."""

    def __init__(self, shape: Shape) -> None:
        self.cost = cp.Parameter(10)
        pieces = shape.pieces()
        x = [cp.Variable(piece.basis.shape[1]) for piece in pieces]
        pi = sum(piece.basis @ part for piece, part in zip(pieces, x, strict=True))
        demands = [pi[0] == 1]
        for piece, part in zip(pieces, x, strict=True):
            for inequality in piece.inequalities:
                G = inequality.G
                value = sum(part[k] * G[k] for k in range(len(G)))
                demands.append(value >= 0 if G.ndim == 2 else 0.5 * (value + value.T) >> 0)
        self.problem = cp.Problem(cp.Minimize(self.cost @ pi), demands)

    def least(self, W: Array) -> float:
        """Of Tr(J W)."""
        self.cost.value = np.einsum("kij,ij->k", BASIS, W)
        return float(self.problem.solve(solver="CLARABEL"))


def form(W: Array, x: Array) -> Array:
    """[x; 1]ᵀ W [x; 1] for points, shape (n, 3)."""
    lifted = np.column_stack([x, np.ones(len(x))])
    return np.asarray(np.einsum("ni,ij,nj->n", lifted, W, lifted))


def least_on_box(W: Array) -> float:
    """The least of [x; 1]ᵀ W [x; 1] on |x_i| ≤ 1: at a stationary point of one of its faces, edges or corners."""
    A, b, least = W[:3, :3], W[:3, 3], np.inf
    for sides in product((-1.0, 0.0, 1.0), repeat=3):
        x = np.array(sides)
        free = np.flatnonzero(x == 0)
        x[free] = np.linalg.solve(A[np.ix_(free, free)], -(A[free] @ x + b[free]))
        if np.abs(x).max() <= 1:
            least = min(least, float(form(W, x[None])[0]))
    return least


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
    places = rng.dirichlet(np.ones(len(corners)), 200) @ corners
    relative = transformation(np.eye(3), -corners.mean(axis=0)) / shape.size ** POWERS[:, None]

    def missed(pi: Array) -> float:
        return float(nnls(relative @ piece.basis, relative @ pi)[1] / pi[0])

    assert missed(body(np.ones(200), places)) < 1e-9
    assert missed(body(np.ones(len(corners)), corners + 0.5 * (corners - corners.mean(axis=0)))) > 1e-3


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


@pytest.mark.parametrize("kind", KINDS)
def test_the_centre_of_mass_reaches_the_surface_and_no_farther(kind: str, rng: np.random.Generator) -> None:
    """The farthest centre of mass along a direction n is the solid's own extent along it, in closed form."""
    for _ in range(4):
        R, n = rotation(rng), on_ball(rng, 1, 3)[0]
        across, along = np.linalg.norm((R.T @ n)[:2]), abs((R.T @ n)[2])
        solids: dict[str, tuple[Shape, float]] = {
            "box": (Box((0, 0, 0), (2, 1, 3)), np.abs(R.T @ n) @ [1, 0.5, 1.5]),
            "cylinder": (Cylinder((0, 0, 0), 0.7, 3), 0.7 * across + 1.5 * along),
            "capsule": (Capsule((0, 0, 0), 0.7, 3), 0.7 + 1.5 * along),
            "hull": (Hull.around([[1, 0, 0], [0, 1, 0], [0, 0, 2], [-1, -1, -1]]), 0.0),
        }
        shape, extent = solids[kind]
        shape = shape.moved(R, np.array([0.1, 0.2, -0.3]))
        if isinstance(shape, Hull):
            extent = (np.array(shape.vertices) @ n).max()
        else:
            extent += np.array([0.1, 0.2, -0.3]) @ n
        W = np.zeros((4, 4))
        W[:3, 3] = W[3, :3] = -0.5 * n
        assert Problem(shape).least(W) == pytest.approx(-extent, abs=1e-4)


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
    S = smallest_around(corners)
    pi = body(np.array([1.0, 1.0]), np.array([[0.16, 0, 0], [-0.16, 0, 0]]))
    trace = float(np.einsum("kij,ji,k->", BASIS, S.Q, pi))
    assert trace > 0
    x, y, z = (2 * half).tolist()
    assert margin(Box((0, 0, 0), (x, y, z)), pi) < -0.1


def test_a_body_that_fits_the_cylinder_s_box_but_not_the_cylinder_is_refused() -> None:
    pi = body(np.ones(4), np.array([[0.09, 0.09, 0], [-0.09, 0.09, 0], [0.09, -0.09, 0], [-0.09, -0.09, 0.0]]))
    assert margin(Box((0, 0, 0), (0.2, 0.2, 0.3)), pi) >= 0
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


# --- how tight ---


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_whatever_a_fine_grid_of_masses_admits_is_admitted(kind: str, rng: np.random.Generator) -> None:
    """And what is admitted lies on the grid after a step of a fifth towards a body spread over the whole solid."""
    shape = Box((0, 0, 0), (2, 2, 2)) if kind == "box" else Cylinder((0, 0, 0), 1.0, 2.0)
    grid = np.array([body(np.ones(1), x[None]) for x in shape.grid(1000)]).T
    both, neither = 0, 0
    for _ in range(60):
        c, A = rng.uniform(-0.7, 0.7, 3), rng.normal(size=(3, 3))
        sigma = A @ A.T
        sigma *= rng.uniform(0.3, 1.3) * ((1 - c**2) / np.diag(sigma)).min()
        pi = from_mass_com_inertia(1.0, c, np.trace(sigma) * np.eye(3) - sigma)
        on_grid, admitted = nnls(grid, pi)[1] < 1e-9, margin(shape, pi) >= 0
        assert admitted or not on_grid
        if admitted:
            assert nnls(grid, 0.8 * pi + 0.2 * grid.mean(axis=1))[1] < 1e-9
        both, neither = both + (on_grid and admitted), neither + (not on_grid and not admitted)
    assert min(both, neither) > 5


def test_the_cylinder_s_conditions_suffice(rng: np.random.Generator) -> None:
    """The least Tr(J W) they admit is the least of the quadratic form itself, whatever W: no body more."""
    problem, places = Problem(Cylinder((0, 0, 0), 1.0, 2.0)), Cylinder((0, 0, 0), 1.0, 2.0).grid(60_000)
    for _ in range(12):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        values = form(W, places)
        assert problem.least(W) == pytest.approx(values.min(), abs=3e-3 * float(np.ptp(values)))
        assert problem.least(W) <= values.min() + 1e-6


def test_the_capsule_s_conditions_suffice(rng: np.random.Generator) -> None:
    shape = Capsule((0, 0, 0), 1.0, 2.0)
    problem, places = Problem(shape), shape.grid(60_000)
    for _ in range(6):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        values = form(W, places)
        assert problem.least(W) == pytest.approx(values.min(), abs=5e-3 * float(np.ptp(values)))


def test_the_box_s_conditions_all_but_suffice(rng: np.random.Generator) -> None:
    problem = Problem(Box((0, 0, 0), (2, 2, 2)))
    for _ in range(40):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        least = least_on_box(W)
        assert least - 5e-3 * float(np.linalg.norm(W)) <= problem.least(W) <= least + 1e-6


# --- frames, units, places ---


@given(seeds, one_piece)
def test_the_conditions_move_with_the_body(rng: np.random.Generator, kind: str) -> None:
    shape, R, p = random_shape(rng, kind), rotation(rng), rng.normal(size=3)
    pi = body(rng.uniform(0.1, 1, 6), inside(rng, shape, 6, reach=1.2))
    _, *own = margins(shape.pieces()[0], pi, shape.size)
    _, *moved = margins(shape.moved(R, p).pieces()[0], transformation(R, p) @ pi, shape.size)
    np.testing.assert_allclose(moved, own, atol=1e-8)


@given(seeds, kinds)
def test_a_moved_shape_holds_the_moved_points(rng: np.random.Generator, kind: str) -> None:
    shape, R, p = random_shape(rng, kind), rotation(rng), rng.normal(size=3)
    x = np.concatenate([inside(rng, shape, 10), inside(rng, shape, 10) + 3 * shape.size * on_ball(rng, 10, 3)])
    moved = shape.moved(R, p)
    np.testing.assert_array_equal(moved.contains(x @ R.T + p, tolerance=1e-6), shape.contains(x, tolerance=1e-6))
    assert moved.size == pytest.approx(shape.size)
    assert moved.contains(x[:10] @ R.T + p, tolerance=1e-6).all()


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 2])
def test_a_shape_turned_to_where_its_angles_are_not_unique(angle: float) -> None:
    box = Box((1, 0, 0), (0.1, 0.2, 0.3)).moved(Rotation.from_euler("y", angle).as_matrix(), np.zeros(3))
    np.testing.assert_allclose(np.abs(box.rotation), [[0, 0, 1], [0, 1, 0], [1, 0, 0]], atol=1e-7)


@given(seeds, one_piece, st.sampled_from([0.95, 1.05]))
def test_millimetres_and_grams_change_nothing(rng: np.random.Generator, kind: str, reach: float) -> None:
    shape = random_shape(rng, kind)
    pi = body(rng.uniform(0.1, 1, 30), inside(rng, shape, 30, reach))
    data = shape.to_dict()
    scaled = {name: np.multiply(data[name], 1e3).tolist() for name in data if name not in ("kind", "rpy")}
    large = type(shape).from_dict({**data, **scaled})
    assert large.size == pytest.approx(1e3 * shape.size)
    assert margin(large, 1e3 * pi * 1e3**POWERS) == pytest.approx(margin(shape, pi), abs=1e-8)


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


# --- hulls ---


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

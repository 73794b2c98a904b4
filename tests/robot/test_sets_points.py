"""Point masses on a grid: a polyhedron within the realizable parameters, against point bodies and scipy's NNLS."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import random_urdf
from scipy.optimize import nnls
from synthetic import Synthetic, bounded_body, bounds, point_parameters, random_ellipsoid, synthetic

from idtool.estimation.problem.estimate import estimate
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import Piece
from idtool.robot.inertia import PI_SIZE, from_mass_com_inertia
from idtool.robot.sets import constraint_sets
from idtool.robot.shapes import Shape
from idtool.robot.shapes.box import Box
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

SETS = constraint_sets()
PRIOR = Regularization(kind="euclidean", weight=1e-6)

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def piece_of(body: Body) -> Piece:
    (piece,) = SETS["points"].pieces(body)
    return piece


def places(piece: Piece) -> Array:
    """Where the masses sit, from the parameters of a kilogram at each."""
    assert (piece.basis[0] == 1).all()
    return piece.basis[1:4].T


def distance(piece: Piece, pi: Array, S: Ellipsoid) -> float:
    """How far pi is from the polyhedron, in units of its mass and the ellipsoid's size: Lawson and Hanson's NNLS."""
    units = pi[0] * S.size ** np.repeat([0.0, 1.0, 2.0], [1, 3, 6])
    return float(nnls(piece.basis / units[:, None] * pi[0], pi / units)[1])


@given(seeds)
def test_a_body_is_the_sum_of_point_masses_within_its_bounds(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    piece = piece_of(bounded_body(S))
    at = places(piece)
    assert 90 <= len(at) <= 150
    assert S.contains(at).all()
    x = rng.exponential(size=len(at)) * (rng.random(len(at)) < 0.3)
    np.testing.assert_allclose(piece.basis @ x, point_parameters(x, at), rtol=1e-12, atol=1e-12)


@given(seeds)
def test_what_it_admits_is_realizable_on_the_ellipsoid(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    piece = piece_of(bounded_body(S))
    x = rng.exponential(size=piece.basis.shape[1]) ** rng.uniform(1, 6)
    (outer,) = SETS["ellipsoid"].pieces(bounded_body(S))
    margins = [i.margin(piece.basis @ x, x.sum(), S.size) for i in outer.inequalities]
    assert min(margins) > -1e-9


@given(seeds)
def test_its_inequalities_are_no_negative_mass_and_a_density(rng: np.random.Generator) -> None:
    piece = piece_of(bounded_body(random_ellipsoid(rng)))
    positive, density = piece.inequalities
    x = rng.exponential(size=piece.basis.shape[1])
    assert positive.margin(x, 1.0, 1.0, piece.powers) == x.min()
    assert density.margin(x, 1.0, 1.0, piece.powers) > 0
    x[rng.integers(len(x))] = -0.1
    assert positive.margin(x, 1.0, 1.0, piece.powers) == -0.1


@given(seeds, st.floats(0.3, 0.8))
def test_it_holds_solid_ellipsoids(rng: np.random.Generator, share: float) -> None:
    """Homogeneous, concentric with the bound: I_C = m/5 (b² + c², …)."""
    S = random_ellipsoid(rng)
    squares = (share * np.array(S.semi_axes)) ** 2
    inertia = S.rotation @ np.diag((squares.sum() - squares) / 5) @ S.rotation.T
    assert distance(piece_of(bounded_body(S)), from_mass_com_inertia(2.0, S.center, inertia), S) < 1e-9


@given(seeds)
def test_it_leaves_out_bodies_that_could_exist(rng: np.random.Generator) -> None:
    """All mass in one point of the surface between the places: realizable, but not with masses at the places."""
    S = random_ellipsoid(rng)
    piece = piece_of(bounded_body(S))
    direction = rng.normal(size=3)
    place = direction / np.linalg.norm(direction) * S.semi_axes @ S.rotation.T + S.center
    gap = np.linalg.norm((places(piece) - place) @ S.rotation / S.semi_axes, axis=1).min()
    pi = point_parameters(np.array([1.0]), place[None])
    (outer,) = SETS["ellipsoid"].pieces(bounded_body(S))
    assert min(i.margin(pi, 1.0, S.size) for i in outer.inequalities) > -1e-9
    assert distance(piece, pi, S) > 1e-3 * gap**2
    assert not SETS["points"].automatic


@pytest.mark.parametrize(
    "solids",
    [
        (Box((1.5, 0.0, 0.0), (0.8, 0.4, 0.6)),),
        (Box((1.5, 0.0, 0.0), (0.8, 0.4, 0.6)), Ellipsoid((-1.5, 0.0, 0.0), (0.5, 0.2, 0.3))),
    ],
    ids=["box", "box and ellipsoid"],
)
def test_the_places_are_shared_out_among_all_bounds(solids: tuple[Ellipsoid | Shape, ...]) -> None:
    at = places(piece_of(bounded_body(*solids)))
    inside = np.array([solid.contains(at) for solid in solids])
    assert inside.any(axis=0).all()
    assert (inside.sum(axis=1) >= 60 / len(solids)).all()


@pytest.fixture
def data(robot_of: Callable[[str], Robot]) -> Synthetic:
    """A robot of three links with an ellipsoid each."""
    rng = np.random.default_rng(4)
    robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    return synthetic(rng, robot, 200, bounds(rng, robot))


def test_bodies_made_of_masses_at_the_places_are_recovered(data: Synthetic) -> None:
    """From torque without noise: prediction, and all that the data determine."""
    rng = np.random.default_rng(0)
    theta = data.theta.copy()
    for i, body in enumerate(data.model.bodies):
        at = places(piece_of(body))
        theta[PI_SIZE * i : PI_SIZE * (i + 1)] = point_parameters(rng.uniform(0.0, 0.02, len(at)), at)
    tau = data.Y @ theta
    ours = estimate(data.linear, data.model.bodies, data.reduction(tau), [SETS["points"]] * 3, PRIOR)
    np.testing.assert_allclose(data.Y @ ours.theta, tau, rtol=0, atol=1e-6 * np.abs(tau).max())
    assert ours.certificate.certified


def test_an_estimate_is_a_sum_of_masses_and_costs_more_than_one_on_the_ellipsoid(data: Synthetic) -> None:
    rng = np.random.default_rng(1)
    reduction = data.reduction(data.tau + 2 * data.tau.std(axis=1, keepdims=True) * rng.normal(size=data.tau.shape))
    points, ellipsoid = (
        estimate(data.linear, data.model.bodies, reduction, [SETS[kind]] * 3, PRIOR) for kind in ("points", "ellipsoid")
    )
    assert points.certificate.objective > ellipsoid.certificate.objective * (1 + 1e-6)
    for i, body in enumerate(data.model.bodies):
        pi = points.theta[PI_SIZE * i : PI_SIZE * (i + 1)]
        assert distance(piece_of(body), pi, body.ellipsoids[0]) < 1e-9
        np.testing.assert_allclose(points.pieces[i], pi[None], rtol=1e-9, atol=1e-15)

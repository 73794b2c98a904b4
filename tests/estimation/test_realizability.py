"""The verdict on bodies within their bounds, and what shows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.spatial.transform import Rotation
from solids import inside, random_shape
from synthetic import bounded_body, point_parameters, points_in, random_ellipsoid

from idtool.estimation.problem.projection import Metric, project
from idtool.estimation.problem.realizability import RealizabilityCheck, check_realizability
from idtool.robot.body import Body
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import LENGTH_POWERS, from_mass_com_inertia, pseudo_inertia
from idtool.robot.sets import choose_set
from idtool.robot.shapes import Hull
from idtool.robot.shapes.box import Box
from idtool.robot.shapes.capsule import Capsule
from idtool.robot.shapes.cylinder import Cylinder

Array = NDArray[np.float64]

METRICS: tuple[Metric, ...] = ("euclidean", "pullback")
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def mass_within(rng: np.random.Generator, *bounds: Ellipsoid, count: int = 8, reach: float = 0.8) -> Array:
    """Parameters of points of mass in each of the bounds, shrunk by ``reach``."""
    inner = [Ellipsoid.from_axes(e.center, reach * np.array(e.semi_axes), e.rotation) for e in bounds]
    places = np.concatenate([points_in(rng, e, count) for e in inner])
    return point_parameters(rng.uniform(0.1, 1, len(places)), places)


def shown(verdict: RealizabilityCheck, pi: Array, size: float) -> None:
    """The witness has the body's parameters, and no negative mass."""
    assert verdict.violations == ()
    assert (verdict.masses > 0).all()
    unit = pi[0] * size**LENGTH_POWERS
    np.testing.assert_allclose(point_parameters(verdict.masses, verdict.points) / unit, pi / unit, rtol=0, atol=1e-9)


def extent(*bounds: Ellipsoid) -> float:
    return max(float(np.linalg.norm(e.center)) + max(e.semi_axes) for e in bounds)


@given(seeds, st.integers(1, 12))
def test_mass_in_an_ellipsoid_is_shown_by_four_points_in_it(rng: np.random.Generator, count: int) -> None:
    S = random_ellipsoid(rng)
    pi = mass_within(rng, S, count=count, reach=1.0)
    verdict = check_realizability(bounded_body(S), pi)
    shown(verdict, pi, extent(S))
    assert len(verdict.masses) <= 4
    assert verdict.pieces is None
    assert S.contains(verdict.points, tolerance=1e-9 * extent(S) ** 2 / min(S.semi_axes) ** 2).all()


@given(seeds, st.integers(2, 8), st.integers(2, 3))
def test_mass_in_a_union_is_shown_by_four_points_in_each(rng: np.random.Generator, count: int, number: int) -> None:
    bounds = [random_ellipsoid(rng) for _ in range(number)]
    pi = mass_within(rng, *bounds, count=count)
    verdict = check_realizability(bounded_body(*bounds), pi)
    assert verdict.pieces is not None
    assert verdict.pieces.shape == (number, 10)
    shown(verdict, pi, extent(*bounds))
    assert len(verdict.masses) <= 4 * number
    first = 0
    for S, piece in zip(bounds, verdict.pieces, strict=True):
        inside = np.cumsum(verdict.masses[first:]) <= piece[0] * (1 + 1e-9)  # its own points come one after another
        points = verdict.points[first:][inside]
        assert 1 <= len(points) <= 4
        assert S.contains(points, tolerance=1e-6).all()
        np.testing.assert_allclose(verdict.masses[first:][inside].sum(), piece[0], rtol=1e-9)
        first += len(points)
    assert first == len(verdict.masses)


@given(seeds)
def test_a_point_of_mass_in_each_of_a_union_is_no_violation(rng: np.random.Generator) -> None:
    """Parts without volume are on the boundary of all that they must fulfil."""
    bounds = [random_ellipsoid(rng) for _ in range(2)]
    pi = mass_within(rng, *bounds, count=1)
    assert check_realizability(bounded_body(*bounds), pi).violations == ()


@given(seeds)
def test_mass_in_an_ellipsoid_and_a_hull_is_split_between_them(rng: np.random.Generator) -> None:
    S, hull = random_ellipsoid(rng), random_shape(rng, "hull")
    assert isinstance(hull, Hull)
    corners = np.array(hull.vertices)
    spread = rng.dirichlet(np.full(len(corners), 3 / len(corners)), 100) @ corners
    pi = mass_within(rng, S) + point_parameters(np.full(100, 0.02), spread)
    verdict = check_realizability(bounded_body(S, hull), pi)
    assert verdict.violations == ()
    assert verdict.pieces is not None
    unit = pi[0] * max(extent(S), float(np.abs(corners).max())) ** LENGTH_POWERS
    np.testing.assert_allclose(verdict.pieces.sum(axis=0) / unit, pi / unit, rtol=0, atol=1e-12)
    assert len(verdict.masses) == len(verdict.points) == 0  # the hull has only conditions


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule", "hull"])
@pytest.mark.parametrize("seed", range(4))
def test_mass_in_other_shapes_is_no_violation(kind: str, seed: int) -> None:
    """Nothing shows it: there are only conditions."""
    rng = np.random.default_rng(seed)
    shape = random_shape(rng, kind)
    places = inside(rng, shape, 12)
    verdict = check_realizability(bounded_body(shape), point_parameters(rng.uniform(0.1, 1, 12), places))
    assert verdict.violations == ()
    assert len(verdict.masses) == len(verdict.points) == 0


@given(seeds)
def test_without_bounds_every_body_that_can_exist_is_shown(rng: np.random.Generator) -> None:
    pi = mass_within(rng, random_ellipsoid(rng))
    verdict = check_realizability(bounded_body(), pi)
    shown(verdict, pi, 3.0)
    np.testing.assert_allclose(verdict.masses, pi[0] / 4)


BALL, BOX = Ellipsoid((0.1, 0.0, -0.2), (0.3, 0.2, 0.4)), Box((0.1, 0.0, -0.2), (0.3, 0.2, 0.4))
APART = Ellipsoid((2.0, 0.0, 0.0), (0.3, 0.3, 0.3))
FITTING = from_mass_com_inertia(2.0, (0.1, 0.0, -0.2), np.diag([0.01, 0.01, 0.01]))
FAR = from_mass_com_inertia(2.0, (0.8, 0.0, -0.2), np.diag([0.01, 0.01, 0.01]))
BETWEEN = from_mass_com_inertia(2.0, (1.05, 0.0, -0.1), np.diag([0.01, 0.01, 0.01]))
TRIANGLE = from_mass_com_inertia(2.0, (0.1, 0.0, -0.2), np.diag([0.01, 0.01, 0.03]))
NEGATIVE = from_mass_com_inertia(2.0, (0.1, 0.0, -0.2), np.diag([-0.01, 0.01, 0.01]))

REFUSED: dict[str, tuple[Body, Array, str]] = {
    "no mass": (bounded_body(BALL), np.zeros(10), "mass is not positive: 0 kg"),
    "a negative mass": (bounded_body(), -FITTING, "mass is not positive: -2 kg"),
    "no number": (bounded_body(BALL), np.full(10, np.nan), "parameters are not finite"),
    "a triangle inequality": (bounded_body(), TRIANGLE, "I1 + I2 < I3: 0.01 + 0.01 < 0.03 kg·m²"),
    "the same in bounds": (bounded_body(BALL, APART), TRIANGLE, "I1 + I2 < I3: 0.01 + 0.01 < 0.03 kg·m²"),
    "a negative moment": (bounded_body(BALL), NEGATIVE, "principal moment I1 is negative: -0.01 kg·m²"),
    "an ellipsoid": (bounded_body(BALL), FAR, "some mass lies beyond its "),
    "a box": (bounded_body(BOX), FAR, "some mass lies beyond its bounding shape"),
    "a cylinder": (bounded_body(Cylinder(BOX.center, 0.2, 0.4)), FAR, "some mass lies beyond its bounding shape"),
    "a union": (bounded_body(BALL, APART), BETWEEN, "no density on the union of its 2 bounding shapes"),
    "a capsule": (bounded_body(Capsule(BOX.center, 0.2, 0.4)), FAR, "no density on the union of its 3 bounding shapes"),
    "a hull": (bounded_body(Hull.around(BOX.grid(8))), FAR, "some mass lies beyond its bounding shape"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_with_the_reason(case: str) -> None:
    body, pi, reason = REFUSED[case]
    verdict = check_realizability(body, pi)
    assert any(reason in violation for violation in verdict.violations), verdict.violations
    assert all(violation.isprintable() for violation in verdict.violations)
    assert verdict.pieces is None
    assert len(verdict.masses) == len(verdict.points) == 0
    if "mass" not in case and "number" not in case:
        assert check_realizability(body, FITTING).violations == ()


@given(seeds, st.floats(0.02, 3))
def test_a_body_is_refused_exactly_where_its_trace_is_negative(rng: np.random.Generator, spread: float) -> None:
    """Thm 4, with the matrices of the paper."""
    S = random_ellipsoid(rng)
    sigma = (axes := rotation(rng)) @ np.diag((spread * rng.uniform(0.05, 1, 3)) ** 2) @ axes.T
    pi = from_mass_com_inertia(1.5, S.center + 0.3 * rng.normal(size=3), 1.5 * (np.trace(sigma) * np.eye(3) - sigma))
    trace = float(np.trace(pseudo_inertia(pi) @ S.Q)) / 1.5
    if abs(trace) > 1e-6 * (1 + np.linalg.norm(S.center) / min(S.semi_axes)) ** 2:
        assert bool(check_realizability(bounded_body(S), pi).violations) == (trace < 0)


def test_pieces_that_are_known_are_not_sought(rng: np.random.Generator) -> None:
    bounds = random_ellipsoid(rng), random_ellipsoid(rng)
    pieces = np.array([mass_within(rng, S) for S in bounds])
    verdict = check_realizability(bounded_body(*bounds), pieces.sum(axis=0), pieces)
    np.testing.assert_array_equal(verdict.pieces, pieces)
    shown(verdict, pieces.sum(axis=0), extent(*bounds))


def test_pieces_of_another_set_are(rng: np.random.Generator) -> None:
    """Such as those of a fit that demanded full consistency alone."""
    bounds = random_ellipsoid(rng), random_ellipsoid(rng)
    pi = mass_within(rng, *bounds)
    verdict = check_realizability(bounded_body(*bounds), pi, pi[None])
    assert verdict.pieces is not None
    assert verdict.pieces.shape == (2, 10)
    shown(verdict, pi, extent(*bounds))


def test_pieces_of_a_looser_set_that_has_as_many_are_not_believed(rng: np.random.Generator) -> None:
    """Such as those of a fit that demanded the centres of mass alone in the ellipsoids."""
    wide = from_mass_com_inertia(1.0, (0.0, 0.0, 0.0), 10 * np.eye(3))
    small = from_mass_com_inertia(1.0, APART.center, 1e-3 * np.eye(3))
    verdict = check_realizability(bounded_body(BALL, APART), wide + small, np.array([wide, small]))
    assert verdict.violations != ()
    assert len(verdict.masses) == 0


def test_the_projection_of_what_cannot_be_can(rng: np.random.Generator) -> None:
    """Whatever the bounds are: the verdict and the projection speak of the same sets."""
    turn = tuple(Rotation.from_matrix(rotation(rng)).as_euler("xyz").tolist())
    for bounds in (
        (),
        (BALL,),
        (BALL, APART),
        (BOX,),
        (BOX, APART),
        (Cylinder(BOX.center, 0.2, 0.4, turn),),
        (Capsule(BOX.center, 0.2, 0.4, turn),),
        (Hull.around(BOX.grid(8)),),
    ):
        body = bounded_body(*bounds)
        for pi in (TRIANGLE, NEGATIVE, FAR, BETWEEN):
            if check_realizability(body, pi).violations:
                for metric in METRICS:
                    nearest = project(pi, choose_set(body), replace(body, pi=pi), metric)
                    assert check_realizability(body, nearest.pi).violations == (), (bounds, metric)

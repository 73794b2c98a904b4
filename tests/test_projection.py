"""Projection onto every set in both metrics, and the verdict on bodies within their bounds with what shows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation
from solids import inside, random_shape
from synthetic import bounded_body, point_parameters, points_in, random_ellipsoid

from idtool.body import Body
from idtool.effects.rigid_body import length, scales
from idtool.ellipsoid import Ellipsoid
from idtool.inertia import POWERS, from_mass_com_inertia, pseudo_inertia, transformation
from idtool.metric import nearest_realizable, pullback
from idtool.prior import reference
from idtool.projection import Metric, Projection, Verdict, judge, project
from idtool.sets import choose_set, constraint_sets
from idtool.shapes import Hull
from idtool.shapes.box import Box
from idtool.shapes.capsule import Capsule
from idtool.shapes.cylinder import Cylinder

Array = NDArray[np.float64]

SETS = constraint_sets()
METRICS: tuple[Metric, ...] = ("euclidean", "pullback")
KINDS = ("none", "semi", "full", "known_com", "com_ellipsoid", "ellipsoid", "union", "points", "shape")
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def some_body(rng: np.random.Generator, kind: str) -> Body:
    """A body with what the set needs, its own parameters those of mass within its bounds."""
    first, second = random_ellipsoid(rng), random_ellipsoid(rng)
    com = None
    if kind == "known_com":
        body, pi = bounded_body(), mass_within(rng, first)
        com = pi[1:4] / pi[0]
        body = bounded_body(com=com)
    elif kind == "union":
        body, pi = bounded_body(first, second), mass_within(rng, first, second)
    elif kind == "shape":
        box = Box((0.3, -0.2, 0.1), (0.8, 0.4, 0.6), (0.3, -0.4, 0.5))
        body, pi = bounded_body(box, first), mass_within(rng, first)
    else:
        body, pi = bounded_body(first), mass_within(rng, first)
    return replace(body, pi=pi)


def set_of(kind: str) -> str:
    return "ellipsoid" if kind == "union" else kind


def mass_within(rng: np.random.Generator, *bounds: Ellipsoid, count: int = 8, reach: float = 0.8) -> Array:
    """Parameters of points of mass in each of the bounds, shrunk by ``reach``."""
    inner = [Ellipsoid.along(e.center, reach * np.array(e.semi_axes), e.rotation) for e in bounds]
    places = np.concatenate([points_in(rng, e, count) for e in inner])
    return point_parameters(rng.uniform(0.1, 1, len(places)), places)


def units_of(body: Body) -> Array:
    return scales(body, float(body.pi[0]))


def disturbed(rng: np.random.Generator, body: Body, share: float = 0.5) -> Array:
    """The body's parameters with an error of a share of its mass and size; its mass stays positive."""
    off = body.pi + share * units_of(body) * rng.normal(size=10)
    off[0] = abs(off[0])
    return np.asarray(off)


def metric_at(body: Body, pi: Array, metric: Metric) -> Array:
    """Shape (10, 10), in units of the body."""
    unit = scales(body, float(pi[0]))
    return np.eye(10) if metric == "euclidean" else unit[:, None] * pullback(reference(pi, unit)) * unit


def members(rng: np.random.Generator, body: Body, kind: str) -> Array:
    """Parameters well within a set, shape (30, 10): of mass in the bounds, or at the places or the centre given."""
    found = []
    for _ in range(30):
        if kind == "points":
            (piece,) = SETS["points"].pieces(body)
            found.append(piece.basis @ rng.uniform(0.1, 1, piece.basis.shape[1]))
        elif kind == "known_com":
            spread = 0.2 * rng.normal(size=(3, 3))
            sigma = spread @ spread.T + 0.01 * np.eye(3)
            found.append(
                from_mass_com_inertia(rng.uniform(0.5, 2), body.com or (), np.trace(sigma) * np.eye(3) - sigma)
            )
        else:
            found.append(mass_within(rng, *body.ellipsoids))
    pi = np.array(found)
    return np.asarray(pi * body.pi[0] / pi[:, :1] * rng.uniform(0.3, 3, (30, 1)))


def is_member(body: Body, kind: str, found: Projection, tolerance: float) -> bool:
    """Whether the pieces sum to the parameters, and each is in its set."""
    pieces = SETS[set_of(kind)].pieces(body)
    unit = units_of(body)
    assert np.abs((found.pieces.sum(axis=0) - found.pi) / unit).max() < 1e-12
    if kind == "known_com":
        assert np.abs(found.pi[1:4] / found.pi[0] - body.com).max() < 1e-7 * length(body)
    if kind == "points":
        basis, weight = pieces[0].basis, length(body) ** -POWERS / found.pi[0]
        return float(nnls(basis * weight[:, None], found.pi * weight)[1]) < 1e-6
    mass = float(unit[0])
    pairs = zip(found.pieces, pieces, strict=True)
    return min([i.margin(pi, mass, length(body)) for pi, p in pairs for i in p.inequalities], default=0.0) >= -tolerance


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_nearest_parameters_are_in_the_set(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    for _ in range(5):
        body = some_body(rng, kind)
        pi = disturbed(rng, body)
        found = project(pi, SETS[set_of(kind)], body, metric)
        assert is_member(body, kind, found, 0.0)
        if kind == "none":
            np.testing.assert_allclose(found.pi / units_of(body), pi / units_of(body), atol=1e-6)
        else:
            assert found.distance > 1e-2


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_is_that_from_what_was_projected(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    body = some_body(rng, kind)
    pi = disturbed(rng, body)
    found = project(pi, SETS[set_of(kind)], body, metric)
    off = (found.pi - pi) / scales(body, float(pi[0]))
    assert found.distance == pytest.approx(np.sqrt(off @ metric_at(body, pi, metric) @ off), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", KINDS)
def test_projecting_again_changes_nothing(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    for _ in range(3):
        body = some_body(rng, kind)
        once = project(disturbed(rng, body, 0.1), SETS[set_of(kind)], body, metric).pi
        twice = project(once, SETS[set_of(kind)], body, metric).pi
        np.testing.assert_allclose(twice / units_of(body), once / units_of(body), rtol=0, atol=1e-5)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_whole_set_lies_beyond_the_nearest_parameters(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    """⟨pi − P(pi), y − P(pi)⟩ ≤ 0 for all y in a convex set, and for no other P(pi) in it."""
    for _ in range(3):
        body = some_body(rng, kind)
        pi = disturbed(rng, body, 0.1)
        unit = scales(body, float(pi[0]))
        found = project(pi, SETS[set_of(kind)], body, metric)
        M = metric_at(body, pi, metric)
        away = M @ ((pi - found.pi) / unit)
        for y in members(rng, body, "ellipsoid" if kind == "shape" else kind):
            beyond = (y - found.pi) / unit
            assert away @ beyond <= 2e-3 * max(found.distance, 1e-3) * np.sqrt(beyond @ M @ beyond)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", ["full", "ellipsoid", "union", "com_ellipsoid", "known_com", "points"])
def test_a_member_is_its_own_nearest(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    body = some_body(rng, kind)
    for pi in members(rng, body, kind)[:5]:
        found = project(pi, SETS[set_of(kind)], body, metric)
        np.testing.assert_allclose(found.pi / units_of(body), pi / units_of(body), rtol=0, atol=1e-5)
        assert found.distance < 1e-4


@pytest.mark.parametrize("kind", ["full", "ellipsoid"])
def test_the_solver_and_the_closed_form_agree(rng: np.random.Generator, kind: str) -> None:
    """Two ellipsoids that are the same are one, but are left to the solver; to a share of the distance."""
    for _ in range(8):
        body = some_body(rng, kind)
        twice = replace(body, ellipsoids=body.ellipsoids * 2)
        pi = disturbed(rng, body, 0.1)
        unit = scales(body, float(pi[0]))
        closed = nearest_realizable(pi, reference(pi, unit), body.ellipsoids[0].Q if kind == "ellipsoid" else None)
        ours = project(pi, SETS[kind], body, "pullback")
        np.testing.assert_array_equal(ours.pi, closed)
        solved = project(pi, SETS[kind], twice, "pullback")
        M, off = metric_at(body, pi, "pullback"), (solved.pi - closed) / unit
        assert np.sqrt(off @ M @ off) < 2e-3 * max(ours.distance, 1e-2)
        assert solved.distance == pytest.approx(ours.distance, rel=1e-4, abs=5e-3)


def moved(body: Body, pi: Array, R: Array, p: Array, size: float, mass: float) -> tuple[Body, Array]:
    """The same body in a frame in which its own sits at R, p, in units of which ``size`` are a metre."""
    to = size**POWERS * mass
    T = transformation(R, p)
    bounds = tuple(
        Ellipsoid.along(size * (R @ e.center + p), size * np.array(e.semi_axes), R @ e.rotation)
        for e in body.ellipsoids
    )
    return replace(body, ellipsoids=bounds, pi=to * (T @ body.pi)), to * (T @ pi)


@pytest.mark.parametrize(("kind", "tolerance"), [("full", 1e-9), ("ellipsoid", 1e-9), ("union", 2e-3)])
def test_the_pullback_does_not_depend_on_units_and_frames(
    rng: np.random.Generator, kind: str, tolerance: float
) -> None:
    """But for the margin and the tolerance of what is left to the solver, in shares of the distance."""
    for _ in range(5):
        body = some_body(rng, kind)
        pi = disturbed(rng, body, 0.1)
        frame = rotation(rng), rng.normal(size=3), 1e3, 1e3
        there, pi_there = moved(body, pi, *frame)
        here, far = (project(x, SETS[set_of(kind)], b, "pullback") for x, b in ((pi, body), (pi_there, there)))
        unit = scales(there, float(pi_there[0]))
        M, off = metric_at(there, pi_there, "pullback"), (far.pi - moved(body, here.pi, *frame)[1]) / unit
        assert np.sqrt(off @ M @ off) < tolerance * max(here.distance, 1.0)
        assert far.distance == pytest.approx(here.distance, rel=1e-4, abs=5e-3)


def test_the_euclidean_does_not_depend_on_units(rng: np.random.Generator) -> None:
    body = some_body(rng, "union")
    pi = disturbed(rng, body)
    there, pi_there = moved(body, pi, np.eye(3), np.zeros(3), 1e3, 1e3)
    here, far = (project(x, SETS["ellipsoid"], b) for x, b in ((pi, body), (pi_there, there)))
    np.testing.assert_allclose(far.pi / units_of(there), here.pi / units_of(body), rtol=0, atol=1e-6)
    assert far.distance == pytest.approx(here.distance, rel=1e-6)


def shown(verdict: Verdict, pi: Array, size: float) -> None:
    """The witness has the body's parameters, and no negative mass."""
    assert verdict.violations == ()
    assert (verdict.masses > 0).all()
    unit = pi[0] * size**POWERS
    np.testing.assert_allclose(point_parameters(verdict.masses, verdict.points) / unit, pi / unit, rtol=0, atol=1e-9)


def extent(*bounds: Ellipsoid) -> float:
    return max(float(np.linalg.norm(e.center)) + max(e.semi_axes) for e in bounds)


@given(seeds, st.integers(1, 12))
def test_mass_in_an_ellipsoid_is_shown_by_four_points_in_it(rng: np.random.Generator, count: int) -> None:
    S = random_ellipsoid(rng)
    pi = mass_within(rng, S, count=count, reach=1.0)
    verdict = judge(bounded_body(S), pi)
    shown(verdict, pi, extent(S))
    assert len(verdict.masses) <= 4
    assert verdict.pieces is None
    assert S.contains(verdict.points, tolerance=1e-9 * extent(S) ** 2 / min(S.semi_axes) ** 2).all()


@given(seeds, st.integers(2, 8), st.integers(2, 3))
def test_mass_in_a_union_is_shown_by_four_points_in_each(rng: np.random.Generator, count: int, number: int) -> None:
    bounds = [random_ellipsoid(rng) for _ in range(number)]
    pi = mass_within(rng, *bounds, count=count)
    verdict = judge(bounded_body(*bounds), pi)
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
    assert judge(bounded_body(*bounds), pi).violations == ()


@given(seeds)
def test_mass_spread_over_a_hull_is_shown_by_points_in_it(rng: np.random.Generator) -> None:
    """At its vertices and at places inside."""
    hull = random_shape(rng, "hull")
    assert isinstance(hull, Hull)
    corners = np.array(hull.vertices)
    assume(hull.size > 0.2 * np.ptp(corners, axis=0).max())  # a sliver has too few places across
    places = rng.dirichlet(np.full(len(corners), 3 / len(corners)), 200) @ corners
    pi = point_parameters(rng.uniform(0.1, 1, 200), places)
    verdict = judge(bounded_body(hull), pi)
    shown(verdict, pi, float(np.abs(corners).max()))
    assert hull.contains(verdict.points).all()


@given(seeds)
def test_mass_in_an_ellipsoid_and_a_hull_is_shown_in_both(rng: np.random.Generator) -> None:
    S, hull = random_ellipsoid(rng), random_shape(rng, "hull")
    assert isinstance(hull, Hull)
    corners = np.array(hull.vertices)
    spread = rng.dirichlet(np.full(len(corners), 3 / len(corners)), 100) @ corners
    pi = mass_within(rng, S) + point_parameters(np.full(100, 0.02), spread)
    verdict = judge(bounded_body(S, hull), pi)
    assert verdict.violations == ()
    assert verdict.pieces is not None
    unit = pi[0] * max(extent(S), float(np.abs(corners).max())) ** POWERS
    np.testing.assert_allclose(verdict.pieces.sum(axis=0) / unit, pi / unit, rtol=0, atol=1e-12)
    if len(verdict.masses):
        shown(verdict, pi, max(extent(S), float(np.abs(corners).max())))
        assert (S.contains(verdict.points, tolerance=1e-6) | hull.contains(verdict.points)).all()


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule"])
@pytest.mark.parametrize("seed", range(4))
def test_mass_in_other_shapes_is_no_violation(kind: str, seed: int) -> None:
    """Nothing shows it: there are only conditions."""
    rng = np.random.default_rng(seed)
    shape = random_shape(rng, kind)
    places = inside(rng, shape, 12)
    verdict = judge(bounded_body(shape), point_parameters(rng.uniform(0.1, 1, 12), places))
    assert verdict.violations == ()
    assert len(verdict.masses) == len(verdict.points) == 0


@given(seeds)
def test_without_bounds_every_body_that_can_exist_is_shown(rng: np.random.Generator) -> None:
    pi = mass_within(rng, random_ellipsoid(rng))
    verdict = judge(bounded_body(), pi)
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
    "a hull": (
        bounded_body(Hull.around(BOX.grid(8))),
        FAR,
        "point masses at the vertices and inside of its hull leave",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_with_the_reason(case: str) -> None:
    body, pi, reason = REFUSED[case]
    verdict = judge(body, pi)
    assert any(reason in violation for violation in verdict.violations), verdict.violations
    assert all(violation.isprintable() for violation in verdict.violations)
    assert verdict.pieces is None
    assert len(verdict.masses) == len(verdict.points) == 0
    if "mass" not in case and "number" not in case:
        assert judge(body, FITTING).violations == ()


@given(seeds, st.floats(0.02, 3))
def test_a_body_is_refused_exactly_where_its_trace_is_negative(rng: np.random.Generator, spread: float) -> None:
    """Thm 4, with the matrices of the paper."""
    S = random_ellipsoid(rng)
    sigma = (axes := rotation(rng)) @ np.diag((spread * rng.uniform(0.05, 1, 3)) ** 2) @ axes.T
    pi = from_mass_com_inertia(1.5, S.center + 0.3 * rng.normal(size=3), 1.5 * (np.trace(sigma) * np.eye(3) - sigma))
    trace = float(np.trace(pseudo_inertia(pi) @ S.Q)) / 1.5
    if abs(trace) > 1e-6 * (1 + np.linalg.norm(S.center) / min(S.semi_axes)) ** 2:
        assert bool(judge(bounded_body(S), pi).violations) == (trace < 0)


def test_pieces_that_are_known_are_not_sought(rng: np.random.Generator) -> None:
    bounds = random_ellipsoid(rng), random_ellipsoid(rng)
    pieces = np.array([mass_within(rng, S) for S in bounds])
    verdict = judge(bounded_body(*bounds), pieces.sum(axis=0), pieces)
    np.testing.assert_array_equal(verdict.pieces, pieces)
    shown(verdict, pieces.sum(axis=0), extent(*bounds))


def test_pieces_of_another_set_are(rng: np.random.Generator) -> None:
    """Such as those of a fit that demanded full consistency alone."""
    bounds = random_ellipsoid(rng), random_ellipsoid(rng)
    pi = mass_within(rng, *bounds)
    verdict = judge(bounded_body(*bounds), pi, pi[None])
    assert verdict.pieces is not None
    assert verdict.pieces.shape == (2, 10)
    shown(verdict, pi, extent(*bounds))


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
            if judge(body, pi).violations:
                for metric in METRICS:
                    nearest = project(pi, choose_set(body), replace(body, pi=pi), metric)
                    assert judge(body, nearest.pi).violations == (), (bounds, metric)

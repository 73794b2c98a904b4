"""Projection onto every set in both metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.optimize import nnls
from synthetic import bounded_body, point_parameters, points_in, random_ellipsoid

from idtool.dynamics.effects.rigid_body import parameter_scales, typical_length
from idtool.estimation.problem.prior import realizable_prior
from idtool.estimation.problem.projection import Metric, Projection, project
from idtool.robot.body import Body
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import LENGTH_POWERS, from_mass_com_inertia, parameter_transform
from idtool.robot.metric import nearest_realizable, pullback_metric
from idtool.robot.sets import constraint_sets
from idtool.robot.shapes.box import Box

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
    inner = [Ellipsoid.from_axes(e.center, reach * np.array(e.semi_axes), e.rotation) for e in bounds]
    places = np.concatenate([points_in(rng, e, count) for e in inner])
    return point_parameters(rng.uniform(0.1, 1, len(places)), places)


def units_of(body: Body) -> Array:
    return parameter_scales(body, float(body.pi[0]))


def disturbed(rng: np.random.Generator, body: Body, share: float = 0.5) -> Array:
    """The body's parameters with an error of a share of its mass and size; its mass stays positive."""
    off = body.pi + share * units_of(body) * rng.normal(size=10)
    off[0] = abs(off[0])
    return np.asarray(off)


def metric_at(body: Body, pi: Array, metric: Metric) -> Array:
    """Shape (10, 10), in units of the body."""
    unit = parameter_scales(body, float(pi[0]))
    return np.eye(10) if metric == "euclidean" else unit[:, None] * pullback_metric(realizable_prior(pi, unit)) * unit


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
        assert np.abs(found.pi[1:4] / found.pi[0] - body.com).max() < 1e-7 * typical_length(body)
    if kind == "points":
        basis, weight = pieces[0].basis, typical_length(body) ** -LENGTH_POWERS / found.pi[0]
        return float(nnls(basis * weight[:, None], found.pi * weight)[1]) < 1e-6
    mass = float(unit[0])
    pairs = zip(found.pieces, pieces, strict=True)
    return (
        min([i.margin(pi, mass, typical_length(body)) for pi, p in pairs for i in p.inequalities], default=0.0)
        >= -tolerance
    )


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
    off = (found.pi - pi) / parameter_scales(body, float(pi[0]))
    assert found.distance == pytest.approx(np.sqrt(off @ metric_at(body, pi, metric) @ off), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", KINDS)
def test_projecting_again_changes_nothing(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    for _ in range(3):
        body = some_body(rng, kind)
        once = project(disturbed(rng, body, 0.1), SETS[set_of(kind)], body, metric)
        twice = project(once.pi, SETS[set_of(kind)], body, metric)
        # Far outside, the pull-back's eigenvalues lie 1e9 apart.
        assert twice.distance < (1e-2 if metric == "pullback" else 1e-4) * max(once.distance, 0.1)
        if metric == "euclidean":
            np.testing.assert_allclose(twice.pi / units_of(body), once.pi / units_of(body), rtol=0, atol=1e-5)


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_whole_set_lies_beyond_the_nearest_parameters(rng: np.random.Generator, kind: str, metric: Metric) -> None:
    """⟨pi − P(pi), y − P(pi)⟩ ≤ 0 for all y in a convex set, and for no other P(pi) in it."""
    for _ in range(3):
        body = some_body(rng, kind)
        pi = disturbed(rng, body, 0.1)
        unit = parameter_scales(body, float(pi[0]))
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
        unit = parameter_scales(body, float(pi[0]))
        closed = nearest_realizable(
            pi, realizable_prior(pi, unit), body.ellipsoids[0].Q if kind == "ellipsoid" else None
        )
        ours = project(pi, SETS[kind], body, "pullback")
        np.testing.assert_array_equal(ours.pi, closed)
        solved = project(pi, SETS[kind], twice, "pullback")
        M, off = metric_at(body, pi, "pullback"), (solved.pi - closed) / unit
        assert np.sqrt(off @ M @ off) < 2e-3 * max(ours.distance, 1e-2)
        assert solved.distance == pytest.approx(ours.distance, rel=1e-4, abs=5e-3)


def moved(body: Body, pi: Array, R: Array, p: Array, size: float, mass: float) -> tuple[Body, Array]:
    """The same body in a frame in which its own sits at R, p, in units of which ``size`` are a metre."""
    to = size**LENGTH_POWERS * mass
    T = parameter_transform(R, p)
    bounds = tuple(
        Ellipsoid.from_axes(size * (R @ e.center + p), size * np.array(e.semi_axes), R @ e.rotation)
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
        unit = parameter_scales(there, float(pi_there[0]))
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

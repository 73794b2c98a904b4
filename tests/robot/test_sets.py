"""Each set's inequalities against its definition: eigenvalues by numpy, and bodies made of points of mass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from synthetic import bounded_body, point_parameters, points_in, random_ellipsoid

from idtool.robot.body import Body
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import LENGTH_POWERS, from_mass_com_inertia, mass_com_inertia
from idtool.robot.sets import choose_set, constraint_sets
from idtool.robot.shapes.box import Box

Array = NDArray[np.float64]

SETS = constraint_sets()
LMIS = ("semi", "full", "com_ellipsoid", "ellipsoid")
BOX = Box((0.0, 0.0, 0.0), (0.1, 0.2, 0.3))
CLEAR = 1e-6  # a sample nearer to a set's boundary than this share of its size is no sample

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def margin(kind: str, pi: Array, body: Body | Ellipsoid | None = None, mass: float = 1.0, length: float = 1.0) -> float:
    """The least margin of a set's inequalities for a body of one piece; negative: not a member."""
    if body is None or isinstance(body, Ellipsoid):
        body = bounded_body(*([body] if body else []))
    (piece,) = SETS[kind].pieces(body)
    return min((i.margin(pi, mass, length) for i in piece.inequalities), default=np.inf)


def random_parameters(rng: np.random.Generator) -> Array:
    """Mass of either sign, centre anywhere, and principal moments that often break one condition or another."""
    axes = rotation(rng)
    moments = rng.uniform(-0.3, 2, 3)
    return from_mass_com_inertia(rng.uniform(-0.5, 2), rng.normal(size=3), axes @ np.diag(moments) @ axes.T)


def random_body(rng: np.random.Generator, ellipsoid: Ellipsoid, spread: float = 1.0) -> Array:
    """Points of mass around an ellipsoid's centre, within it where the spread is 1."""
    places = (points_in(rng, ellipsoid, 7) - ellipsoid.center) * spread + ellipsoid.center
    return point_parameters(rng.uniform(0.1, 1, 7), places)


@given(seeds)
def test_semi_consistent_is_positive_mass_and_a_positive_definite_inertia_about_the_centre(
    rng: np.random.Generator,
) -> None:
    pi = random_parameters(rng)
    mass, _, inertia = mass_com_inertia(pi)
    least = min(mass, float(np.linalg.eigvalsh(inertia)[0]))
    assume(abs(least) > CLEAR)
    assert (margin("semi", pi) > 0) == (least > 0)


@given(seeds)
def test_fully_consistent_is_that_and_the_triangle_inequalities(rng: np.random.Generator) -> None:
    pi = random_parameters(rng)
    mass, _, inertia = mass_com_inertia(pi)
    J1, J2, J3 = np.linalg.eigvalsh(inertia)
    least = min(mass, J1, J1 + J2 - J3, J1 + J3 - J2, J2 + J3 - J1)
    assume(abs(least) > CLEAR)
    assert (margin("full", pi) > 0) == (least > 0)


@given(seeds)
def test_the_centre_of_mass_counts_where_its_ellipsoid_does(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    pi = random_body(rng, S, spread=1.5)
    center = point_in_or_around(rng, S)
    mass, _, inertia = mass_com_inertia(pi)
    moved = from_mass_com_inertia(mass, center, inertia)
    assert (margin("com_ellipsoid", moved, S) > 0) == bool(S.contains(center))
    broken = from_mass_com_inertia(mass, S.center, np.diag([1.0, 1.0, 3.0]))
    assert margin("com_ellipsoid", broken, S) < 0


def point_in_or_around(rng: np.random.Generator, S: Ellipsoid) -> Array:
    """Inside or outside with equal chance, at least a thousandth from the surface."""
    direction = rng.normal(size=3)
    radius = rng.choice([rng.uniform(0, 0.999), rng.uniform(1.001, 3)])
    on_surface = direction / np.linalg.norm(direction) * S.semi_axes @ S.rotation.T
    return np.asarray(S.center + radius * on_surface)


@given(seeds, st.integers(1, 12))
def test_mass_inside_the_ellipsoid_is_realizable_on_it(rng: np.random.Generator, count: int) -> None:
    """Theorem 4, that the condition is necessary; up to three points lie in a plane, on the boundary of J ⪰ 0."""
    S = random_ellipsoid(rng)
    pi = point_parameters(rng.uniform(0.1, 1, count), points_in(rng, S, count))
    assert margin("ellipsoid", pi, S) > (0 if count > 3 else -1e-9)


@given(seeds, st.integers(4, 12))
def test_mass_all_outside_the_ellipsoid_is_not(rng: np.random.Generator, count: int) -> None:
    """Even where its centre lies inside and its density is one that could be."""
    S = random_ellipsoid(rng)
    directions = rng.normal(size=(count, 3))
    radii = rng.uniform(1.001, 2, count) / np.linalg.norm(directions, axis=1)
    outside = directions * radii[:, None] * S.semi_axes @ S.rotation.T + S.center
    pi = point_parameters(rng.uniform(0.1, 1, count), outside)
    assert margin("full", pi) > -1e-9
    assert margin("ellipsoid", pi, S) < 0


@given(seeds)
def test_a_tighter_set_lies_within_a_looser_one(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    pi = random_body(rng, S, spread=rng.uniform(0.5, 2.5)) + 0.05 * rng.normal(size=10)
    margins = np.array([margin(kind, pi, S) for kind in ("ellipsoid", "com_ellipsoid", "full", "semi", "none")])
    assume(np.abs(margins).min() > CLEAR)
    member = margins > 0
    assert (member[1:] >= member[:-1]).all(), margins


def test_each_set_is_smaller_than_the_one_before_it(rng: np.random.Generator) -> None:
    members = dict.fromkeys(("none", *LMIS), 0)
    S = random_ellipsoid(rng)
    for _ in range(600):
        pi = random_body(rng, S, spread=rng.uniform(0.5, 2.5)) + 0.3 * rng.normal(size=10)
        for kind in members:
            members[kind] += margin(kind, pi, S) > 0
    counts = list(members.values())
    assert counts == sorted(counts, reverse=True)
    assert len(set(counts)) == len(counts), counts
    assert counts[0] == 600
    assert counts[-1] > 0


@given(seeds, st.sampled_from(LMIS))
def test_whether_a_body_is_a_member_does_not_depend_on_units(rng: np.random.Generator, kind: str) -> None:
    """Grams and millimetres, and whatever else a body is measured in."""
    S = random_ellipsoid(rng)
    pi = random_body(rng, S, spread=rng.uniform(0.5, 2.5)) + 0.1 * rng.normal(size=10)
    here = margin(kind, pi, S)
    assume(abs(here) > CLEAR)
    for mass, length in ((1e-3, 1e-3), (50.0, 0.01), *rng.uniform(0.01, 100, (2, 2))):
        assert (margin(kind, pi, S, mass, length) > 0) == (here > 0)


@given(seeds, st.sampled_from(LMIS))
def test_a_body_in_other_units_measured_in_them_has_the_same_margin(rng: np.random.Generator, kind: str) -> None:
    S = random_ellipsoid(rng)
    pi = random_body(rng, S, spread=rng.uniform(0.5, 2.5))
    millimetres = Ellipsoid.from_axes(1e3 * np.array(S.center), 1e3 * np.array(S.semi_axes), S.rotation)
    grams = pi * 1e3 * 1e3**LENGTH_POWERS
    there = margin(kind, grams, millimetres, mass=700.0, length=300.0)
    assert there == pytest.approx(margin(kind, pi, S, mass=0.7, length=0.3), rel=1e-9, abs=1e-9)


@given(seeds)
def test_where_the_centre_is_known_its_3x3_form_is_full_consistency(rng: np.random.Generator) -> None:
    """Corollary 1, for masses and inertias of either sign."""
    pi = random_parameters(rng)
    known = bounded_body(com=pi[1:4] / pi[0])
    here, full = margin("known_com", pi, known), margin("full", pi)
    assume(min(abs(here), abs(full)) > CLEAR)
    assert (here > 0) == (full > 0)


@given(seeds)
def test_where_the_centre_is_known_no_more_than_3_by_3_is_demanded(rng: np.random.Generator) -> None:
    """The eigenvalues are those of Sigma_C = ½ Tr(I_C) 1 − I_C (17), and the mass."""
    pi = random_body(rng, random_ellipsoid(rng))
    mass, com, inertia = mass_com_inertia(pi)
    (piece,) = SETS["known_com"].pieces(bounded_body(com=com))
    covariance, weight = (np.tensordot(pi, inequality.G, axes=1) for inequality in piece.inequalities)
    np.testing.assert_allclose(covariance, 0.5 * np.trace(inertia) * np.eye(3) - inertia, atol=1e-12)
    np.testing.assert_allclose(weight, [mass])


@pytest.mark.parametrize(
    ("moments", "flat"), [((4, 3, 5), 0), ((3, 2, 5), 1), ((0, 2, 2), 2)], ids=["solid", "plate", "rod"]
)
def test_figure_2(moments: tuple[float, ...], flat: int) -> None:
    """Σ_C of a solid, a plate and a rod: the flat ones lie on the set's boundary, and have as many zero eigenvalues."""
    pi = from_mass_com_inertia(1.0, np.zeros(3), np.diag(moments))
    ((density,),) = (piece.inequalities for piece in SETS["full"].pieces(bounded_body()))
    eigenvalues = np.linalg.eigvalsh(np.tensordot(pi, density.G, axes=1))
    np.testing.assert_allclose(eigenvalues[:flat], 0, atol=1e-12)
    assert eigenvalues[flat] == pytest.approx(1)


@pytest.mark.parametrize(
    ("long_axis", "com", "trace"), [("x", 0.0, 0.52), ("x", 1.5, 0.07), ("z", 0.0, -0.04), ("x", 2.0, -0.28)]
)
def test_figure_3(long_axis: str, com: float, trace: float) -> None:
    """The centre of mass lies in the ellipsoid each time, the body only where Tr(JQ) is not negative."""
    S = Ellipsoid((0, 0, 0), (np.sqrt(5), np.sqrt(2), 1.0))
    sigma = np.diag([0.9 if axis == long_axis else 0.2 for axis in "xyz"])
    pi = from_mass_com_inertia(1.0, [com, 0, 0], np.trace(sigma) * np.eye(3) - sigma)
    assert margin("com_ellipsoid", pi, S) > 0
    (piece,) = SETS["ellipsoid"].pieces(bounded_body(S))
    assert piece.inequalities[1].margin(pi, 1.0, 1.0) == pytest.approx(trace)


def test_the_sets_stand_in_order_of_tightness() -> None:
    assert list(SETS) == ["none", "semi", "full", "known_com", "com_ellipsoid", "ellipsoid", "shape", "points"]


BALL = Ellipsoid((0, 0, 0), (1, 1, 1))
CENTRE = np.array([0.1, 0.0, 0.0])
FULL, KNOWN = bounded_body(), bounded_body(com=CENTRE)
ROUND, BOTH = bounded_body(BALL), bounded_body(BALL, com=CENTRE)
SQUARE, UNION = bounded_body(BOX), bounded_body(BALL, BOX)


@pytest.mark.parametrize(
    ("asked", "body", "chosen"),
    [
        # Not asked: the tightest that the body has what it takes for, but none that leaves out bodies that could exist.
        *((None, FULL, "full"), (None, KNOWN, "known_com"), (None, ROUND, "ellipsoid"), (None, BOTH, "ellipsoid")),
        *((None, SQUARE, "shape"), (None, UNION, "shape")),
        # Asked, and the body has what it takes.
        *((kind, ROUND, kind) for kind in SETS if kind not in ("known_com", "shape")),
        *(("known_com", BOTH, "known_com"), ("shape", SQUARE, "shape"), ("points", SQUARE, "points")),
        # Asked, and it has not: the next looser one that it has.
        *(("ellipsoid", FULL, "full"), ("com_ellipsoid", FULL, "full"), ("points", FULL, "full")),
        *(("known_com", ROUND, "full"), ("shape", ROUND, "ellipsoid"), ("ellipsoid", KNOWN, "known_com")),
        *(("points", KNOWN, "known_com"), ("ellipsoid", SQUARE, "full")),
    ],
)
def test_which_set_a_body_gets(asked: str | None, body: Body, chosen: str) -> None:
    assert choose_set(body, asked) is SETS[chosen]
    assert choose_set(body, asked).applies_to(body)

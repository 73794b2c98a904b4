"""The paper (arXiv 1701.04395) on S-density realizability, with four point masses for every body that has them.

Its other facts are tested with the code they are about: Fig. 2, the kinetic energy by both inertia matrices, (21), the
triangle inequalities and parallel axes (12) in test_inertia.py; Fig. 3's traces, and Thm 4 by four points built without
`idtool.robot.witness`, in test_ellipsoid.py; every set's definition in test_sets.py; unions (Cor. 2) in
test_sets_union.py.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from synthetic import point_parameters, points_in

from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import REALIZABLE, density_within
from idtool.robot.inertia import from_mass_com_inertia, mass_com_inertia, pseudo_inertia, spatial_inertia
from idtool.robot.witness import deviation_ellipsoid, find_witness, required_ellipsoid_scale, unrealizable_reasons

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
FIGURE_3 = Ellipsoid((0, 0, 0), (np.sqrt(5), np.sqrt(2), 1.0))
BALL = Ellipsoid((0, 0, 0), (1, 1, 1))
#: Long axis and centre of mass of the bodies of Fig. 3, and their Tr(JQ).
PLACEMENTS = {
    ("x", (0.0, 0, 0)): 0.52,
    ("x", (1.5, 0, 0)): 0.07,
    ("z", (0.0, 0, 0)): -0.04,
    ("x", (2.0, 0, 0)): -0.28,
}


def random_ellipsoid(rng: np.random.Generator) -> Ellipsoid:
    return Ellipsoid.from_axes(rng.normal(size=3), rng.uniform(0.2, 2, 3), rotation(rng))


def margins(pi: Array, S: Ellipsoid) -> tuple[float, float]:
    """Of J(pi) ⪰ 0, in units of its mass and the ellipsoid's size, and of Tr(JQ) ≥ 0, in units of its mass."""
    mass = abs(pi[0])
    return REALIZABLE.margin(pi, mass, S.size), density_within(S.Q, "").margin(pi, mass, S.size)


def spread(mass: float, com: Array, covariance: Array) -> Array:
    """Parameters of a body with Sigma_C = mass · covariance."""
    return from_mass_com_inertia(mass, com, mass * (np.trace(covariance) * np.eye(3) - covariance))


def body_of_figure_3(long_axis: str, com: tuple[float, ...]) -> Array:
    return spread(1.0, np.array(com), np.diag([0.9 if axis == long_axis else 0.2 for axis in "xyz"]))


def test_figure_3s_traces_fix_where_its_bodies_are() -> None:
    """The text gives four traces, not the placements.

    With the long axis along an axis of S and the centre on an axis of S, at a multiple of ½ and inside S, there is one
    placement for each trace: two that differ in the long axis alone, and two that differ from the first in the centre.
    """
    centres = {tuple(c * e) for e in np.eye(3) for c in np.arange(0, 2.5, 0.5) if FIGURE_3.contains(c * e)}
    found = {
        (axis, com): round(float(np.trace(pseudo_inertia(body_of_figure_3(axis, com)) @ FIGURE_3.Q)), 2)
        for axis, com in itertools.product("xyz", centres)
    }
    assert {place: trace for place, trace in found.items() if trace in PLACEMENTS.values()} == PLACEMENTS


@pytest.mark.parametrize(("place", "trace"), PLACEMENTS.items())
def test_figure_3s_bodies_have_four_points_in_the_ellipsoid_or_none(
    place: tuple[str, tuple[float, ...]], trace: float
) -> None:
    """As drawn: the bodies above with a density have four point masses, the others lie too far out though c ∈ S."""
    pi = body_of_figure_3(*place)
    density, inside = margins(pi, FIGURE_3)
    assert density > 0
    assert inside == pytest.approx(trace)
    np.testing.assert_allclose(sorted(deviation_ellipsoid(pi).semi_axes), np.sqrt([0.2, 0.2, 0.9]))
    if trace > 0:
        found = find_witness(pi, FIGURE_3)
        assert FIGURE_3.contains(found.points).all()
        np.testing.assert_allclose(point_parameters(found.masses, found.points), pi, atol=1e-12)
    else:
        assert required_ellipsoid_scale(pi, FIGURE_3) == pytest.approx(np.sqrt(1 - trace))
        with pytest.raises(ValueError, match="beyond its ellipsoid"):
            find_witness(pi, FIGURE_3)


@given(seeds)
def test_parallel_axes_for_second_moments_are_a_sum(rng: np.random.Generator) -> None:
    """Σ = Σ_C + m c cᵀ, the counterpart of (12); and J = [Σ_C, 0; 0, 0] + m [c; 1][c; 1]ᵀ."""
    masses, places = rng.uniform(0.1, 2, 6), rng.normal(size=(6, 3))
    m, c = masses.sum(), masses @ places / masses.sum()
    at_origin, at_centre = (pseudo_inertia(point_parameters(masses, p)) for p in (places, places - c))
    np.testing.assert_allclose(at_centre[:3, 3], np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(at_origin[:3, :3], at_centre[:3, :3] + m * np.outer(c, c), atol=1e-12)
    lifted = np.array([*c, 1.0])
    at_centre[3, 3] = 0
    np.testing.assert_allclose(at_origin, at_centre + m * np.outer(lifted, lifted), atol=1e-12)


@given(seeds)
def test_the_sums_counterpart_holds_for_parameters_that_no_body_has(rng: np.random.Generator) -> None:
    """Both theorems are algebra: they need a mass, not a density."""
    pi = rng.normal(size=10)
    m, c, inertia_c = mass_com_inertia(pi)
    sigma_c = 0.5 * np.trace(inertia_c) * np.eye(3) - inertia_c
    np.testing.assert_allclose(pseudo_inertia(pi)[:3, :3], sigma_c + m * np.outer(c, c), atol=1e-9 * (1 + 1 / abs(m)))


@given(seeds, st.sampled_from([3, 2, 1]))
def test_the_pseudo_inertia_loses_a_rank_with_every_dimension_of_the_body(rng: np.random.Generator, axes: int) -> None:
    """Σ_C and J lose a rank for a plate and two for a rod; the spatial inertia only for a rod."""
    places = rng.normal(size=(6, axes)) @ rotation(rng)[:axes] + rng.normal(size=3)
    pi = point_parameters(rng.uniform(0.1, 2, 6), places)
    assert (np.linalg.eigvalsh(pseudo_inertia(pi)) > 1e-9).sum() == axes + 1
    assert (np.linalg.eigvalsh(spatial_inertia(pi)) > 1e-9).sum() == {3: 6, 2: 6, 1: 5}[axes]


@given(seeds)
def test_the_nearer_the_centre_to_the_surface_the_smaller_the_body(rng: np.random.Generator) -> None:
    """With c at a share r of the way to the surface, the largest Σ_C/m is 1 − r² in squared semi-axes, and attained."""
    S = random_ellipsoid(rng)
    direction = rng.normal(size=3)
    to_surface = S.rotation @ (direction / np.linalg.norm(direction) * S.semi_axes)
    shape = rng.dirichlet(np.ones(3))
    axes = S.rotation @ np.diag(S.semi_axes) @ rotation(rng)
    for r in (0.0, 0.5, 0.9, 0.999):
        room = 1 - r**2
        com = S.center + r * to_surface
        largest, larger = (spread(2.0, com, g * room * axes @ np.diag(shape) @ axes.T) for g in (1 - 1e-6, 1 + 1e-6))
        assert margins(largest, S)[1] == pytest.approx(1e-6 * room, rel=1e-3, abs=1e-12)
        assert S.contains(find_witness(largest, S).points).all()
        assert margins(larger, S)[1] < 0
        assert unrealizable_reasons(larger, S)


@given(seeds)
def test_on_the_surface_the_point_mass_alone_is_left(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    direction = rng.normal(size=3)
    edge = S.center + S.rotation @ (direction / np.linalg.norm(direction) * S.semi_axes)
    point = spread(1.37, edge, np.zeros((3, 3)))
    assert unrealizable_reasons(point, S) == []
    np.testing.assert_allclose(find_witness(point, S).points, np.tile(edge, (4, 1)), atol=1e-6)
    along = rotation(rng)[0]
    for size in (1e-3, 1e-2, 1.0):
        rod = spread(2.0, edge, (size * S.size) ** 2 * np.outer(along, along))
        assert margins(rod, S)[0] > -1e-9
        assert unrealizable_reasons(rod, S)


@given(seeds, st.integers(1, 40))
def test_point_masses_in_the_ellipsoid_are_accepted(rng: np.random.Generator, count: int) -> None:
    """However the mass is spread over them, even if one has nearly all of it."""
    S = random_ellipsoid(rng)
    pi = point_parameters(rng.exponential(size=count) ** 4 + 1e-9, points_in(rng, S, count))
    assert min(margins(pi, S)) > -1e-9
    assert unrealizable_reasons(pi, S) == []
    found = find_witness(pi, S)
    sizes = pi[0] * (S.size + np.linalg.norm(S.center)) ** np.repeat([0, 1, 2], [1, 3, 6])
    np.testing.assert_allclose(point_parameters(found.masses, found.points) / sizes, pi / sizes, atol=1e-9)


@given(seeds)
def test_a_uniform_density_on_a_smaller_ellipsoid_inside_is_accepted(rng: np.random.Generator) -> None:
    """A solid ellipsoid of semi-axes a has Σ_C/m = diag(a²)/5: three fifths of Tr(JQ)/m are to spare at the largest."""
    S = random_ellipsoid(rng)
    share = rng.uniform(0.05, 1)
    centre = points_in(rng, S, 1)[0] * (1 - share) + share * np.array(S.center)  # the smaller one touches S at most
    pi = spread(3.0, centre, share**2 * S.Q_s / 5)
    density, inside = margins(pi, S)
    assert density > 0
    assert inside >= 1 - (1 - share) ** 2 - 0.6 * share**2 - 1e-9
    assert S.contains(find_witness(pi, S).points).all()


@given(seeds)
def test_a_body_with_a_negative_trace_is_refused_and_has_mass_outside(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    masses = rng.uniform(0.1, 1, 6)
    places = (points_in(rng, S, 6) - S.center) * 4 * rng.random((6, 1)) + S.center
    pi = point_parameters(masses, places)
    inside = margins(pi, S)[1]
    assert inside == pytest.approx(np.trace(pseudo_inertia(pi) @ S.Q) / masses.sum(), abs=1e-9)
    if inside < -1e-6:
        assert not S.contains(places).all()
        assert unrealizable_reasons(pi, S)
        with pytest.raises(ValueError, match="no mass density"):
            find_witness(pi, S)
    else:
        assert S.contains(find_witness(pi, S).points).all()


def test_a_centre_of_mass_inside_does_not_suffice() -> None:
    """Two points a thousand radii apart have theirs at the ball's centre."""
    pi = point_parameters(np.ones(2), np.array([[500.0, 0, 0], [-500.0, 0, 0]]))
    com = mass_com_inertia(pi)[1]
    assert BALL.contains(com)
    assert unrealizable_reasons(pi) == []
    assert required_ellipsoid_scale(pi, BALL) == pytest.approx(500)
    assert unrealizable_reasons(pi, BALL)


@given(seeds)
def test_points_outside_can_have_the_parameters_of_points_inside(rng: np.random.Generator) -> None:
    """Realizable on S says that some density on S has these parameters, not that the body's own lies in S."""
    far = np.array([[1.5, 0, 0], [-1.5, 0, 0]])
    near = np.array([[0, 0.2, 0], [0, -0.2, 0], [0, 0, 0.1], [0, 0, -0.1]])
    turned = np.concatenate([far, near]) @ rotation(rng).T
    pi = point_parameters(np.array([0.05, 0.05, 1, 1, 1, 1]), turned)
    assert not BALL.contains(turned).all()
    assert BALL.contains(find_witness(pi, BALL).points).all()

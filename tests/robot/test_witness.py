"""Four point masses for every body that can exist, and the reason for every one that can't."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.spatial.transform import Rotation
from synthetic import point_parameters, points_in

from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import REALIZABLE, density_within
from idtool.robot.inertia import (
    LENGTH_POWERS,
    from_mass_com_inertia,
    from_pseudo_inertia,
    parameter_transform,
    pseudo_inertia,
)
from idtool.robot.witness import (
    deviation_ellipsoid,
    find_witness,
    required_ellipsoid_scale,
    unrealizable_reasons,
    violations,
)

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def random_ellipsoid(rng: np.random.Generator, size: float = 1.0) -> Ellipsoid:
    return Ellipsoid.from_axes(size * rng.normal(size=3), size * rng.uniform(0.1, 2, 3), rotation(rng))


def on_surface(rng: np.random.Generator, S: Ellipsoid, count: int) -> Array:
    """Points of the surface, shape (count, 3)."""
    u = rng.normal(size=(count, 3))
    return np.asarray((u / np.linalg.norm(u, axis=1, keepdims=True) * S.semi_axes) @ S.rotation.T + S.center)


def check(pi: Array, S: Ellipsoid | None, tolerance: float = 1e-9) -> None:
    """The witness has the body's parameters, in units of its mass and size, no negative mass, and lies in S."""
    found = find_witness(pi, S)
    assert found.masses.shape == (4,)
    assert found.points.shape == (4, 3)
    assert (found.masses >= 0).all()
    size = 0.1 if S is None else max(float(np.linalg.norm(S.center)), *S.semi_axes)
    sizes = pi[0] * size**LENGTH_POWERS
    np.testing.assert_allclose(point_parameters(found.masses, found.points) / sizes, pi / sizes, atol=tolerance)
    np.testing.assert_allclose(found.pi / sizes, pi / sizes, atol=tolerance)
    if S is not None:
        assert S.contains(found.points, tolerance=1e-12 * (1 + (size / min(S.semi_axes)) ** 2)).all()


@given(seeds, st.integers(1, 12), st.floats(0.01, 1), st.sampled_from([1e-3, 1.0, 1e3]))
def test_mass_in_an_ellipsoid_has_a_witness_in_it(
    rng: np.random.Generator, count: int, spread: float, size: float
) -> None:
    """Up to three points of mass make a body without volume, on the boundary of J ⪰ 0."""
    S = random_ellipsoid(rng, size)
    inner = Ellipsoid(S.center, tuple(spread * a for a in S.semi_axes), S.rpy)  # type: ignore[arg-type]
    check(point_parameters(rng.uniform(0.1, 1, count), points_in(rng, inner, count)), S)


@given(seeds, st.integers(1, 12))
def test_mass_on_the_surface_has_a_witness_on_it(rng: np.random.Generator, count: int) -> None:
    """The boundary Tr(JQ) = 0: no point is left any room."""
    S = random_ellipsoid(rng)
    pi = point_parameters(rng.uniform(0.1, 1, count), on_surface(rng, S, count))
    check(pi, S)
    found = find_witness(pi, S)
    heavy = found.masses > 1e-6 * pi[0]
    u = (found.points[heavy] - S.center) @ S.rotation / S.semi_axes
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1, atol=1e-6)


@given(seeds, st.integers(1, 12))
def test_without_an_ellipsoid_four_equal_masses_do(rng: np.random.Generator, count: int) -> None:
    pi = point_parameters(rng.uniform(0.1, 1, count), 0.1 * rng.normal(size=(count, 3)))
    check(pi, None)
    np.testing.assert_allclose(find_witness(pi).masses, np.full(4, pi[0] / 4))


@pytest.mark.parametrize("axes", [3, 2, 1, 0], ids=["solid", "plate", "rod", "point"])
def test_a_witness_spans_no_more_than_its_body(rng: np.random.Generator, axes: int) -> None:
    S = random_ellipsoid(rng)
    spread = rotation(rng)[:, :axes] * [[0.01] * axes]
    places = S.center + rng.normal(size=(6, axes)) @ spread.T
    for found in (find_witness(point_parameters(np.ones(6), places), kind) for kind in (S, None)):
        singular = np.linalg.svd(found.points - found.masses @ found.points / 6, compute_uv=False)
        assert (singular > 1e-4).sum() == axes
        assert singular[axes:].max(initial=0.0) < 1e-6


@given(seeds)
def test_a_small_body_far_from_its_frame_keeps_its_spread(rng: np.random.Generator) -> None:
    """A millimetre at a distance of a metre: the witness has the body's second moment about its own centre."""
    S = random_ellipsoid(rng)
    places = S.center + 1e-3 * min(S.semi_axes) * rng.normal(size=(6, 3))
    pi = point_parameters(np.ones(6), places)
    found = find_witness(pi, S)
    centred = found.points - found.masses @ found.points / found.masses.sum()
    offset = places - places.mean(axis=0)
    expected = offset.T @ offset
    actual = centred.T @ (centred * found.masses[:, None])
    np.testing.assert_allclose(actual, expected, atol=1e-6 * float(np.trace(expected)))


@given(seeds)
def test_a_body_has_a_witness_in_an_ellipsoid_exactly_where_the_trace_is_not_negative(
    rng: np.random.Generator,
) -> None:
    S = random_ellipsoid(rng)
    places = (points_in(rng, S, 6) - S.center) * rng.uniform(0.5, 3) + S.center
    pi = point_parameters(rng.uniform(0.1, 1, 6), places)
    trace = np.trace(pseudo_inertia(pi) @ S.Q)
    assume(abs(trace) > 1e-6)
    if trace > 0:
        check(pi, S)
    else:
        with pytest.raises(ValueError, match="some mass lies beyond its ellipsoid"):
            find_witness(pi, S)


@pytest.mark.parametrize(
    ("pi", "reason"),
    [
        (from_mass_com_inertia(-0.2, [0, 0, 0.1], np.eye(3)), "mass is not positive: -0.2 kg"),
        (np.zeros(10), "mass is not positive: 0 kg"),
        (np.full(10, np.nan), "parameters are not finite"),
        (
            from_mass_com_inertia(1.0, [0.1, 0.2, 0.3], np.diag([0.003, 0.019, 0.012])),
            "I1 + I2 < I3: 0.003 + 0.012 < 0.019 kg·m² (by 21 %)",
        ),
        (
            from_mass_com_inertia(2.0, np.zeros(3), np.diag([0.5, 0.5, -0.01])),
            "principal moment I1 is negative: -0.01 kg·m²",
        ),
        (
            from_mass_com_inertia(2.0, np.zeros(3), np.diag([0.1, 0.2, 0.30001])),
            "I1 + I2 < I3: 0.1 + 0.2 < 0.30001 kg·m² (by 0.0033 %)",
        ),
    ],
)
def test_the_reason_is_named(pi: Array, reason: str) -> None:
    assert unrealizable_reasons(pi) == [reason]
    with pytest.raises(ValueError, match="no mass density has these parameters"):
        find_witness(pi)


def test_every_negative_moment_is_named() -> None:
    reasons = unrealizable_reasons(from_mass_com_inertia(2.0, np.zeros(3), np.diag([-0.5, 0.5, -0.01])))
    assert reasons == [
        "principal moment I1 is negative: -0.5 kg·m²",
        "principal moment I2 is negative: -0.01 kg·m²",
    ]


@given(seeds)
def test_a_reason_is_given_exactly_where_mass_moments_or_triangles_fail(rng: np.random.Generator) -> None:
    R = rotation(rng)
    mass, moments = rng.uniform(-0.3, 1), rng.uniform(-0.2, 1, 3)
    pi = from_mass_com_inertia(mass, rng.normal(size=3), R @ np.diag(moments) @ R.T)
    J1, J2, J3 = np.sort(moments)
    assume(abs(J1 + J2 - J3) > 1e-6)
    assert (not unrealizable_reasons(pi)) == (mass > 0 and J1 >= 0 and J1 + J2 > J3)


@pytest.mark.parametrize("moments", [(3, 2, 5), (0, 2, 2), (0, 0, 0)], ids=["plate", "rod", "point"])
@pytest.mark.parametrize("length", [1e-3, 1.0, 30.0])
def test_rounding_does_not_forbid_a_body_without_volume(
    rng: np.random.Generator, moments: tuple[float, ...], length: float
) -> None:
    for _ in range(50):
        R = rotation(rng)
        inertia = 0.01 * length**2 * R @ np.diag(moments) @ R.T
        pi = from_mass_com_inertia(rng.uniform(0.1, 5), length * rng.normal(size=3), inertia)
        assert unrealizable_reasons(pi) == []
        find_witness(pi)


@pytest.mark.parametrize(("relative", "accepted"), [(1e-10, True), (1e-7, False)])
def test_a_plate_may_break_its_triangle_inequality_by_what_rounding_does(relative: float, accepted: bool) -> None:
    pi = from_mass_com_inertia(1.0, np.zeros(3), np.diag([0.3, 0.2, 0.5 * (1 + relative)]))
    assert (unrealizable_reasons(pi) == []) == accepted
    assert (violations(pi, [REALIZABLE], 1.0, 1.0) == []) == accepted
    assert violations(pi, [REALIZABLE], 1.0, 1.0, tolerance=0.0)
    if accepted:
        check(pi, Ellipsoid((0, 0, 0), (1, 1, 1)))


def test_points_stay_inside_where_the_trace_is_negative_by_what_rounding_does(rng: np.random.Generator) -> None:
    """Nearly all of the mass at one place of the surface leaves the others light, and their places uncertain."""
    S = random_ellipsoid(rng)
    places = (on_surface(rng, S, 2) - S.center) * (1 + 1e-10) + S.center
    pi = point_parameters(np.array([1.0, 1e-9]), places)
    assert np.trace(pseudo_inertia(pi) @ S.Q) < -1e-10
    check(pi, S)


def test_a_point_that_is_too_light_to_have_a_place_is_put_at_the_centre_of_mass() -> None:
    """A rod of 1e-7 radii that ends at a ball's surface: its points are that end, and 2.5e-15 of it opposite."""
    s = 1e-7
    c = np.array([np.sqrt(1 - s**2), 0, 0])
    found = find_witness(from_mass_com_inertia(1.0, c, s**2 * np.diag([0.0, 1, 1])), Ellipsoid((0, 0, 0), (1, 1, 1)))
    assert found.masses.min() < 1e-14
    np.testing.assert_allclose(found.points, np.tile(c, (4, 1)), atol=1e-6)


@given(seeds)
def test_reach_is_the_root_mean_square_distance_in_semi_axes(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    masses, places = rng.uniform(0.1, 1, 6), S.center + rng.normal(size=(6, 3))
    u = (places - S.center) @ S.rotation / S.semi_axes
    expected = np.sqrt(masses @ np.square(u).sum(axis=1) / masses.sum())
    pi = point_parameters(masses, places)
    assert required_ellipsoid_scale(pi, S) == pytest.approx(expected)
    assert required_ellipsoid_scale(pi, S) ** 2 == pytest.approx(1 - np.trace(pseudo_inertia(pi) @ S.Q) / pi[0])
    assert np.linalg.norm(u, axis=1).max() >= expected  # some mass is at least that far


@given(seeds)
def test_an_ellipsoid_grown_by_the_reach_just_holds_the_body(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    pi = point_parameters(rng.uniform(0.1, 1, 6), S.center + 2 * rng.normal(size=(6, 3)))
    factor = required_ellipsoid_scale(pi, S)
    larger, smaller = (
        Ellipsoid(S.center, tuple(g * factor * a for a in S.semi_axes), S.rpy)  # type: ignore[arg-type]
        for g in (1 + 1e-6, 1 - 1e-6)
    )
    check(pi, larger)
    assert unrealizable_reasons(pi, smaller)


def test_a_body_too_large_for_its_ellipsoid_is_said_to_be_by_how_much() -> None:
    pi = point_parameters(np.full(2, 0.5), np.array([[0.26, 0, 0], [-0.26, 0, 0]]))
    sphere = Ellipsoid((0, 0, 0), (0.2, 0.2, 0.2))
    (reason,) = unrealizable_reasons(pi, sphere)
    assert reason == (
        "some mass lies beyond its ellipsoid, at least 30 % farther from the centre than the surface (Tr(JQ)/m = -0.69)"
    )
    (found,) = violations(pi, [REALIZABLE, density_within(sphere.Q, "mass within its ellipsoid")], 1.0, 0.2)
    assert found.label == "mass within its ellipsoid"
    assert found.amount == pytest.approx(0.69)
    assert found.text == reason.replace("ellipsoid,", "bounding shape,")


def test_violations_name_each_inequality_that_fails_and_no_other() -> None:
    sphere = density_within(Ellipsoid((0, 0, 0), (1, 1, 1)).Q, "sphere")
    small, broken = 1e-3 * np.eye(3), np.diag([1.0, 1.0, 3.0])
    labels = {
        case: [v.label for v in violations(pi, [REALIZABLE, sphere], 1.0, 1.0)]
        for case, pi in {
            "neither": from_mass_com_inertia(1.0, np.zeros(3), small),
            "density": from_mass_com_inertia(1.0, np.zeros(3), np.diag([1e-3, 1e-3, 3e-3])),
            "sphere": from_mass_com_inertia(1.0, [2.0, 0, 0], small),
            "both": from_mass_com_inertia(1.0, [2.0, 0, 0], broken),
        }.items()
    }
    expected = {
        "neither": [],
        "density": [REALIZABLE.label],
        "sphere": ["sphere"],
        "both": [REALIZABLE.label, "sphere"],
    }
    assert labels == expected
    (broken_density, _) = violations(from_mass_com_inertia(1.0, [2.0, 0, 0], broken), [REALIZABLE, sphere], 1.0, 1.0)
    assert broken_density.text == "I1 + I2 < I3: 1 + 1 < 3 kg·m² (by 33 %)"


@given(seeds)
def test_amounts_are_margins_and_the_same_in_all_units(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    pi = rng.normal(size=10)
    inequalities = [REALIZABLE, density_within(S.Q, "ellipsoid")]
    units = 1e3 * 1e3**LENGTH_POWERS  # grams and millimetres
    there = Ellipsoid.from_axes(1e3 * np.array(S.center), 1e3 * np.array(S.semi_axes), S.rotation)
    here = {v.label: v.amount for v in violations(pi, inequalities, 0.7, 0.3)}
    for label, amount in here.items():
        (inequality,) = (i for i in inequalities if i.label == label)
        assert amount == pytest.approx(-inequality.margin(pi, 0.7, 0.3))
    other = [REALIZABLE, density_within(there.Q, "ellipsoid")]
    assert {v.label: v.amount for v in violations(pi * units, other, 700, 300)} == pytest.approx(here, rel=1e-6)


def test_what_is_not_an_ellipsoid_is_told_in_its_own_terms() -> None:
    """A slab of half height 0.1 about z = 0.5; a half-space z ≤ 0; a sphere and that half-space at once."""
    slab = np.diag([0.0, 0.0, -100.0, 1.0])
    slab[3, 2] = slab[2, 3] = 50.0
    slab[3, 3] = 1 - 100 * 0.25
    below = np.zeros((4, 4))
    below[2, 3] = below[3, 2] = -0.5
    point = point_parameters(np.array([2.0]), np.array([[3.0, 0.0, 0.65]]))
    (beyond,) = violations(point, [density_within(slab, "slab")], 2.0, 1.0)
    assert "at least 50 % farther from the centre" in beyond.text
    (above,) = violations(point, [density_within(below, "below z = 0")], 2.0, 1.0)
    assert above.text == "below z = 0: violated by 0.65 in units of the body's mass and length"
    for A, b in (([1.0, 1.0, -1.0], 0.0), ([1.0, 1.0, 0.0], 0.5)):  # a hyperboloid and a paraboloid have no inside
        Q = np.diag([*(-np.array(A)), 1.0])
        Q[2, 3] = Q[3, 2] = b
        (open_,) = violations(point, [density_within(Q, "open")], 2.0, 1.0)
        assert open_.text.startswith("open: violated by")
    unit = Ellipsoid((3, 0, 0), (1, 1, 1)).Q
    (both,) = violations(point, [density_within(np.stack([unit, below]), "half a ball")], 2.0, 1.0)
    assert both.amount == pytest.approx(0.65)
    assert both.text.startswith("half a ball")


@given(seeds)
def test_the_deviation_ellipsoid_is_that_of_the_points(rng: np.random.Generator) -> None:
    masses, places = rng.uniform(0.1, 1, 8), rng.normal(size=(8, 3))
    E = deviation_ellipsoid(point_parameters(masses, places))
    mean = masses @ places / masses.sum()
    centred = places - mean
    covariance = centred.T @ (centred * masses[:, None]) / masses.sum()
    np.testing.assert_allclose(E.center, mean)
    np.testing.assert_allclose(E.Q_s, covariance, atol=1e-9)
    assert not E.contains(places, tolerance=-1e-9).all()  # some mass lies on or beyond it


@given(seeds)
def test_the_deviation_ellipsoid_moves_with_its_body(rng: np.random.Generator) -> None:
    pi = point_parameters(rng.uniform(0.1, 1, 8), rng.normal(size=(8, 3)))
    R, p = rotation(rng), rng.normal(size=3)
    E, moved = deviation_ellipsoid(pi), deviation_ellipsoid(parameter_transform(R, p) @ pi)
    np.testing.assert_allclose(moved.center, R @ E.center + p, atol=1e-9)
    np.testing.assert_allclose(moved.Q_s, R @ E.Q_s @ R.T, atol=1e-9)


def box(size: tuple[float, float, float], R: Array, com: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """Parameters of a uniform box, or of all bodies with its moments, as a cylinder has those of a square column."""
    squares = np.square(size) / 12
    return from_mass_com_inertia(2.0, com, R @ np.diag(2.0 * (squares.sum() - squares)) @ R.T)


ALONG = np.eye(3)
AT_45 = Rotation.from_euler("x", -45, degrees=True).as_matrix()


OBLIQUE = Rotation.from_euler("xyz", (0.3, -0.7, 1.1)).as_matrix()


@pytest.mark.parametrize("com", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.1), (0.0, 0.0, 0.3)])
@pytest.mark.parametrize("R", [ALONG, ALONG[:, [1, 2, 0]], ALONG[:, [1, 0, 2]], AT_45, AT_45[:, [1, 2, 0]], OBLIQUE])
@pytest.mark.parametrize(
    "size", [(0.1, 0.2, 0.4), (0.1, 0.1, 0.4), (0.3, 0.3, 0.1), (0.2, 0.2, 0.2), (0.02, 0.02, 0.04)]
)
def test_rounding_does_not_turn_axes_or_exchange_points(
    size: tuple[float, float, float], R: Array, com: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """Boxes, columns, plates and a cube, of which some are far away, in their least ellipsoid and in another one."""
    pi = box(size, R, com)
    own = Ellipsoid.from_axes(com, np.multiply(np.sqrt(3) / 2, size), R * np.sign(np.linalg.det(R)))
    other = Ellipsoid((0.01, 0.02, 0.05), (0.6, 0.5, 0.7))
    length = np.sqrt(np.abs(pi[4:]).max() / pi[0])
    scale = pi[0] * np.repeat([1, length, length**2], [1, 3, 6])
    for _ in range(10):
        nearly = pi + 1e-12 * scale * rng.normal(size=10)
        np.testing.assert_allclose(deviation_ellipsoid(nearly).rpy, deviation_ellipsoid(pi).rpy, atol=1e-8)
        for S in (own, other, None):
            np.testing.assert_allclose(find_witness(nearly, S).points, find_witness(pi, S).points, atol=1e-6)


def test_a_solid_ellipsoid_deviates_by_a_fifth_of_its_squared_semi_axes() -> None:
    a = np.array([0.3, 0.2, 0.1])
    square = a**2
    inertia = 2.0 / 5 * np.diag(square.sum() - square)
    E = deviation_ellipsoid(from_mass_com_inertia(2.0, [1, 2, 3], inertia))
    np.testing.assert_allclose(np.diag(E.Q_s), square / 5)


@pytest.mark.parametrize(
    ("second_moments", "semi_axes"),
    [((0.04, 0.01, 0.0), (0.2, 0.1, 2e-5)), ((0.04, 0, -0.01), (0.2, 2e-5, 2e-5)), ((0, 0, 0), (1e-6, 1e-6, 1e-6))],
    ids=["plate", "not a body", "point"],
)
def test_what_has_no_thickness_is_drawn_thin(second_moments: Array, semi_axes: tuple[float, ...]) -> None:
    J = np.diag([*(3.0 * np.array(second_moments)), 3.0])
    E = deviation_ellipsoid(from_pseudo_inertia(J))
    np.testing.assert_allclose(sorted(E.semi_axes, reverse=True), semi_axes)
    assert np.isfinite(E.Q).all()


@pytest.mark.parametrize("bad", [np.zeros(10), np.full(10, np.inf), -np.ones(10)])
def test_what_has_no_mass_has_no_deviation_ellipsoid(bad: Array) -> None:
    with pytest.raises(ValueError, match="this body has no standard-deviation ellipsoid"):
        deviation_ellipsoid(bad)

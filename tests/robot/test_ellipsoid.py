"""Ellipsoids against the paper's Theorem 4 and Figure 3, and least ellipsoids against optima known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from scipy.spatial.transform import Rotation

from idtool.robot.ellipsoid import Ellipsoid, minimum_volume_ellipsoid
from idtool.robot.inertia import from_mass_com_inertia, pseudo_inertia

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def random_ellipsoid(rng: np.random.Generator) -> Ellipsoid:
    """An ellipsoid anywhere, turned any way."""
    center, semi_axes, rpy = rng.normal(size=3), rng.uniform(0.1, 2, 3), rng.uniform(-3, 3, 3)
    return Ellipsoid(tuple(center.tolist()), tuple(semi_axes.tolist()), tuple(rpy.tolist()))


def inside(rng: np.random.Generator, S: Ellipsoid, count: int, reach: float = 1.0) -> Array:
    """Points in S, the farthest of them at ``reach`` times its surface; (count, 3)."""
    ball = rng.normal(size=(count, 3))
    ball *= (rng.random((count, 1)) / np.linalg.norm(ball, axis=1, keepdims=True)) * reach
    ball[0] *= reach / np.linalg.norm(ball[0])
    return np.asarray((ball * S.semi_axes) @ Rotation.from_euler("xyz", S.rpy).as_matrix().T + S.center)


def point_masses(masses: Array, places: Array) -> Array:
    """J = Σ m [x; 1][x; 1]ᵀ, shape (4, 4)."""
    lifted = np.column_stack([places, np.ones(len(masses))])
    return np.asarray(lifted.T @ (lifted * masses[:, None]))


def volume(S: Ellipsoid) -> float:
    """In units of the unit ball's."""
    return float(np.prod(S.semi_axes))


@given(seeds)
def test_a_point_is_inside_where_its_homogeneous_form_is_positive(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    x = inside(rng, S, 20, reach=1.6)
    lifted = np.column_stack([x, np.ones(len(x))])
    form = np.einsum("ni,ij,nj->n", lifted, S.Q, lifted)
    np.testing.assert_array_equal(S.contains(x), form >= 0)
    assert not S.contains(x).all()
    centre = np.array([*S.center, 1.0])
    assert centre @ S.Q @ centre == pytest.approx(1)


@given(seeds)
def test_the_tips_of_the_semi_axes_lie_on_the_surface(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    tips = np.asarray(S.center) + (S.rotation * S.semi_axes).T
    np.testing.assert_allclose(
        [(t - S.center) @ np.linalg.inv(S.Q_s) @ (t - S.center) for t in tips], np.ones(3), rtol=1e-9
    )
    lifted = np.column_stack([tips, np.ones(3)])
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", lifted, S.Q, lifted), np.zeros(3), atol=1e-9)
    assert S.contains(tips).all()
    assert not S.contains(np.asarray(S.center) + 1.001 * (tips - S.center)).any()


def test_roll_pitch_yaw_are_urdfs() -> None:
    """Roll about x first, then pitch about y, then yaw about z, all fixed axes: R = Rz Ry Rx."""
    roll, pitch, yaw = 0.3, -0.7, 1.9
    x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    y = [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    z = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    R = np.array(z) @ np.array(y) @ np.array(x)
    np.testing.assert_allclose(Ellipsoid((0, 0, 0), (1, 1, 1), (roll, pitch, yaw)).rotation, R, atol=1e-12)


@given(seeds)
def test_an_ellipsoid_from_its_axes_has_these_axes(rng: np.random.Generator) -> None:
    R = rotation(rng)
    S = Ellipsoid.from_axes([1, 2, 3], [0.1, 0.2, 0.3], R)
    np.testing.assert_allclose(S.rotation, R, atol=1e-9)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_an_ellipsoid_that_looks_straight_up_has_its_axes_too(pitch: float) -> None:
    """Roll and yaw are not unique there; any that make the rotation will do, without a warning."""
    R = Rotation.from_euler("xyz", [0.4, pitch, -0.9]).as_matrix()
    np.testing.assert_allclose(Ellipsoid.from_axes([0, 0, 0], [1, 2, 3], R).rotation, R, atol=1e-6)


@pytest.mark.parametrize(
    ("long_axis", "com", "trace"),
    [("x", 0.0, 0.52), ("x", 1.5, 0.07), ("z", 0.0, -0.04), ("x", 2.0, -0.28)],
)
def test_figure_3(long_axis: str, com: float, trace: float) -> None:
    """S with semi-axes √5, √2, 1; a body of 1 kg, its Σ_C/m with semi-axes √0.9, √0.2, √0.2.

    The figure's text gives these and the four traces, not the placements: those here are the body's long axis along an
    axis of S, and its centre on S's longest, inside S each time.
    """
    S = Ellipsoid((0, 0, 0), (np.sqrt(5), np.sqrt(2), 1.0))
    sigma = np.diag([0.9 if axis == long_axis else 0.2 for axis in "xyz"])
    pi = from_mass_com_inertia(1.0, [com, 0, 0], np.trace(sigma) * np.eye(3) - sigma)
    assert S.contains([com, 0, 0])
    assert np.linalg.eigvalsh(pseudo_inertia(pi)).min() > 0
    assert np.trace(pseudo_inertia(pi) @ S.Q) == pytest.approx(trace)


@given(seeds, st.integers(4, 12))
def test_mass_inside_an_ellipsoid_is_realizable_on_it(rng: np.random.Generator, count: int) -> None:
    S = random_ellipsoid(rng)
    J = point_masses(rng.uniform(0.1, 1, count), inside(rng, S, count))
    assert np.trace(J @ S.Q) >= 0


@given(seeds)
def test_mass_on_the_surface_is_just_realizable_and_beyond_it_is_not(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    surface = rng.normal(size=(8, 3))
    surface = surface / np.linalg.norm(surface, axis=1, keepdims=True)
    places = surface * S.semi_axes @ S.rotation.T
    masses = rng.uniform(0.1, 1, 8)
    assert np.trace(point_masses(masses, places + S.center) @ S.Q) == pytest.approx(0, abs=1e-9)
    assert np.trace(point_masses(masses, 1.01 * places + S.center) @ S.Q) < 0


@given(seeds)
def test_a_realizable_body_is_four_points_of_mass_inside(rng: np.random.Generator) -> None:
    """Theorem 4 the other way: Tr(JQ) ≥ 0 suffices. The four points are built from J and Q alone.

    With L Lᵀ = J, any orthogonal U gives J = Σ_k y_k y_kᵀ, y_k the columns of L U; U is chosen so that all y_kᵀ Q y_k
    equal Tr(JQ)/4, and y_k = √m_k [x_k; 1].
    """
    S = random_ellipsoid(rng)
    J = point_masses(rng.uniform(0.1, 1, 9), inside(rng, S, 9))
    Y = np.linalg.cholesky(J)
    for _ in range(3):  # one column after the other gets the mean by turning it towards one on the mean's other side
        form = np.diag(Y.T @ S.Q @ Y) - np.trace(J @ S.Q) / 4
        high, low = int(np.argmax(form)), int(np.argmin(form))
        y, z = Y[:, high], Y[:, low]
        t = np.roots([form[low], -2 * y @ S.Q @ z, form[high]]).real[0]
        c, s = 1 / np.hypot(1, t), t / np.hypot(1, t)
        Y[:, high], Y[:, low] = c * y - s * z, s * y + c * z
    masses, places = np.square(Y[3]), (Y[:3] / Y[3]).T
    np.testing.assert_allclose(point_masses(masses, places), J, rtol=1e-8, atol=1e-8)
    assert S.contains(places, tolerance=1e-6).all()


@given(seeds)
def test_the_centre_of_mass_nears_the_surface_only_as_the_body_shrinks_to_a_point(rng: np.random.Generator) -> None:
    S = random_ellipsoid(rng)
    edge = inside(rng, S, 1)[0]
    J = point_masses(rng.uniform(0.1, 1, 5), edge + 0.05 * min(S.semi_axes) * rng.normal(size=(5, 3)))
    mass = J[3, 3]
    J[:3, :3] += np.outer(edge, edge) * mass - np.outer(J[:3, 3], J[:3, 3]) / mass
    J[:3, 3] = J[3, :3] = mass * edge
    assert np.linalg.eigvalsh(J).min() > 0
    assert S.contains(edge)
    assert np.trace(J @ S.Q) < 0


def corners(half: Array) -> Array:
    """Of a box of half sides ``half``, shape (8, 3)."""
    return np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T * half


@given(seeds)
def test_the_least_ellipsoid_around_a_box_is_root_three_times_its_half_sides(rng: np.random.Generator) -> None:
    half, R, p = np.sort(rng.uniform(0.05, 1, 3)), rotation(rng), rng.normal(size=3) * 10
    S = minimum_volume_ellipsoid(corners(half) @ R.T + p)
    np.testing.assert_allclose(np.sort(S.semi_axes), np.sqrt(3) * half, rtol=1e-3)
    np.testing.assert_allclose(S.center, p, atol=1e-3 * half[0])
    np.testing.assert_allclose(S.Q_s, 3 * R @ np.diag(half**2) @ R.T, atol=1e-3)


def test_the_least_ellipsoid_around_a_regular_tetrahedron_is_its_sphere() -> None:
    S = minimum_volume_ellipsoid([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    np.testing.assert_allclose(S.semi_axes, np.full(3, np.sqrt(3)), rtol=1e-4)


@given(seeds, st.integers(1, 60))
def test_every_point_is_inside(rng: np.random.Generator, count: int) -> None:
    points = rng.normal(size=(count, 3)) @ rng.normal(size=(3, 3)) + rng.normal(size=3) * 100
    assert minimum_volume_ellipsoid(points).contains(points).all()


@given(seeds)
def test_no_ellipsoid_around_the_points_is_smaller(rng: np.random.Generator) -> None:
    """Ellipsoids nearby, grown until they hold every point, against the least one's volume."""
    points = rng.normal(size=(12, 3)) * [1.0, 0.6, 0.3]
    S = minimum_volume_ellipsoid(points, tolerance=1e-6)
    for size in (1e-3, 1e-2, 1e-1):
        L = np.linalg.cholesky(S.Q_s) @ (np.eye(3) + size * rng.normal(size=(3, 3)))
        local = (points - S.center - size * rng.normal(size=3)) @ np.linalg.inv(L).T
        grown = np.linalg.norm(local, axis=1).max()
        assert abs(np.linalg.det(L)) * grown**3 >= volume(S) * (1 - 1e-4)


@given(seeds)
def test_the_least_ellipsoid_moves_with_the_points(rng: np.random.Generator) -> None:
    """Under x → A x + b the least ellipsoid becomes A Q_s Aᵀ about A x_s + b."""
    points = rng.normal(size=(15, 3))
    A, b = rotation(rng) @ np.diag(rng.uniform(0.5, 2, 3)) @ rotation(rng), rng.normal(size=3)
    S, T = minimum_volume_ellipsoid(points, tolerance=1e-6), minimum_volume_ellipsoid(points @ A.T + b, tolerance=1e-6)
    np.testing.assert_allclose(T.center, A @ S.center + b, atol=1e-3)
    np.testing.assert_allclose(T.Q_s, A @ S.Q_s @ A.T, atol=1e-3 * float(np.linalg.norm(S.Q_s)))


def test_repeated_and_inner_points_change_nothing(rng: np.random.Generator) -> None:
    box = corners(np.array([0.1, 0.2, 0.3]))
    more = np.concatenate([box, box, rng.uniform(-1, 1, (50, 3)) * [0.1, 0.2, 0.3], np.zeros((1, 3))])
    np.testing.assert_allclose(minimum_volume_ellipsoid(more).Q_s, minimum_volume_ellipsoid(box).Q_s, atol=1e-4)


@pytest.mark.parametrize(
    "points",
    [
        [[1, 2, 3]],
        [[1, 2, 3]] * 4,
        [[0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [1, 2, 3], [2, 4, 6], [0.5, 1, 1.5]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]],
    ],
    ids=["a point", "the same point", "two points", "a line", "a triangle", "a square"],
)
def test_points_that_span_no_volume_get_a_thin_ellipsoid(points: list[list[float]]) -> None:
    S = minimum_volume_ellipsoid(points, min_thickness=0.05)
    assert S.contains(points).all()
    longest = max(float(np.linalg.norm(np.ptp(points, axis=0))) / 2, 0.5e-3)
    assert min(S.semi_axes) >= 0.9 * 0.05 * 0.7 * longest  # a diagonal is longer than the extent along an axis by √2
    assert min(S.semi_axes) <= 0.05 * 2 * longest


def test_a_thin_ellipsoid_lies_in_the_points_plane() -> None:
    S = minimum_volume_ellipsoid([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]])
    np.testing.assert_allclose(S.center, [0.5, 0.5, 1], atol=1e-4)
    np.testing.assert_allclose(np.diag(S.Q_s)[:2], [0.5, 0.5], rtol=1e-3)  # the circle through a unit square's corners
    assert S.Q_s[2, 2] == pytest.approx(0.05**2 / 2, rel=1e-2)  # of the distance to the corners


@pytest.mark.parametrize("points", [[], [[0, 0, np.nan]], [[0, 0, 0], [np.inf, 0, 0]]])
def test_no_points_and_points_nowhere_are_refused(points: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="at least one point, all of them finite"):
        minimum_volume_ellipsoid(points)


def test_the_box_of_a_cad_prior_lies_in_its_least_ellipsoid() -> None:
    """A solid box's own inertia is realizable on the least ellipsoid around its corners."""
    half = np.array([0.03, 0.03, 0.171])
    pi = from_mass_com_inertia(1.0, np.zeros(3), (half @ half * np.eye(3) - np.diag(half**2)) / 3)
    assert np.trace(pseudo_inertia(pi) @ minimum_volume_ellipsoid(corners(half)).Q) == pytest.approx(2 / 3, rel=1e-3)

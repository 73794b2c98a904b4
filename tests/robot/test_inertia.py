"""Inertia parameters against points of mass, Pinocchio and the paper's figures (arXiv 1701.04395)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import rotation
from triangles import triangle_margin

from idtool.robot import inertia

Array = NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
NAMES = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")


def points(rng: np.random.Generator, count: int = 6) -> tuple[Array, Array]:
    """Masses (count,) and their places (count, 3)."""
    return rng.uniform(0.1, 2, count), rng.normal(size=(count, 3))


def parameters(masses: Array, places: Array) -> Array:
    """The ten parameters of point masses, written out from their definition."""
    x, y, z = places.T
    moments = [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
    return np.array([np.sum(masses * f) for f in [np.ones_like(x), x, y, z, *moments]])


def pinocchio_inertia(pi: Array) -> pin.Inertia:
    """The same body as Pinocchio knows it."""
    return pin.Inertia.FromDynamicParameters(pi)


def test_the_order_of_the_parameters_is_fixed() -> None:
    assert inertia.PARAMETER_NAMES == NAMES
    assert len(inertia.PARAMETER_UNITS) == inertia.PI_SIZE == 10


@given(seeds)
def test_the_order_of_the_parameters_is_pinocchios(rng: np.random.Generator) -> None:
    masses, places = points(rng)
    mass, com, I_c = inertia.mass_com_inertia(parameters(masses, places))
    body = pin.Inertia(mass, com, I_c)
    np.testing.assert_allclose(body.toDynamicParameters(), parameters(masses, places), atol=1e-12)
    np.testing.assert_allclose(inertia.from_mass_com_inertia(mass, com, I_c), parameters(masses, places), atol=1e-12)


@given(seeds)
def test_the_pseudo_inertia_is_the_second_moment_of_the_points(rng: np.random.Generator) -> None:
    masses, places = points(rng)
    lifted = np.column_stack([places, np.ones(len(masses))])
    J = sum(m * np.outer(x, x) for m, x in zip(masses, lifted, strict=True))
    np.testing.assert_allclose(inertia.pseudo_inertia(parameters(masses, places)), J, atol=1e-12)
    np.testing.assert_allclose(inertia.from_pseudo_inertia(J), parameters(masses, places), atol=1e-12)


@given(seeds)
def test_the_pseudo_inertia_is_linear_and_its_basis_spans_it(rng: np.random.Generator) -> None:
    pi = rng.normal(size=(4, 5, 10))
    np.testing.assert_allclose(inertia.pseudo_inertia(pi), np.tensordot(pi, inertia.J_BASIS, axes=1), atol=1e-12)
    np.testing.assert_allclose(inertia.from_pseudo_inertia(inertia.pseudo_inertia(pi)), pi, atol=1e-12)


@given(seeds)
def test_the_spatial_inertia_is_pinocchios_with_angular_before_linear(rng: np.random.Generator) -> None:
    pi = parameters(*points(rng))
    swap = np.r_[3:6, 0:3]
    expected = pinocchio_inertia(pi).matrix()[np.ix_(swap, swap)]
    np.testing.assert_allclose(inertia.spatial_inertia(pi), expected, atol=1e-12)


@given(seeds)
def test_both_inertia_matrices_give_the_kinetic_energy_of_the_points(rng: np.random.Generator) -> None:
    masses, places = points(rng)
    pi = parameters(masses, places)
    w, v = rng.normal(size=(2, 3))
    energy = 0.5 * np.sum(masses * np.square(v + np.cross(w, places)).sum(axis=1))
    twist = np.concatenate([w, v])
    V = np.zeros((4, 4))
    V[:3, :3], V[:3, 3] = inertia.skew(w), v
    assert 0.5 * twist @ inertia.spatial_inertia(pi) @ twist == pytest.approx(energy)
    assert 0.5 * np.trace(V @ inertia.pseudo_inertia(pi) @ V.T) == pytest.approx(energy)


@given(seeds)
def test_the_cross_product_matrix(rng: np.random.Generator) -> None:
    x, y = rng.normal(size=(2, 3))
    np.testing.assert_allclose(inertia.skew(x) @ y, np.cross(x, y), atol=1e-14)


@given(seeds)
def test_six_numbers_and_a_symmetric_matrix_are_the_same(rng: np.random.Generator) -> None:
    A = rng.normal(size=(5, 3, 3))
    A += A.transpose(0, 2, 1)
    xx, xy, yy, xz, yz, zz = inertia.symmetric_entries(A).T
    np.testing.assert_array_equal(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1), A)
    np.testing.assert_array_equal(inertia.symmetric_matrix(inertia.symmetric_entries(A)), A)


@pytest.mark.parametrize(("sigma", "moments"), [((2, 3, 1), (4, 3, 5)), ((2, 3, 0), (3, 2, 5)), ((2, 0, 0), (0, 2, 2))])
def test_figure_2(sigma: tuple[float, ...], moments: tuple[float, ...]) -> None:
    """Second moments about the centre of mass and rotational inertia of three bodies (paper, Fig. 2)."""
    pi = inertia.from_mass_com_inertia(1.0, np.zeros(3), np.diag(moments))
    np.testing.assert_allclose(inertia.pseudo_inertia(pi), np.diag([*sigma, 1.0]), atol=1e-15)
    tight = 2 * min(sigma)
    assert triangle_margin(pi) == pytest.approx(tight)


@given(seeds)
def test_principal_moments_are_sums_of_the_second_moments(rng: np.random.Generator) -> None:
    """J₁ = μ₂ + μ₃ and cyclic (21)."""
    masses, places = points(rng)
    centred = places - masses @ places / masses.sum()
    mu = np.linalg.eigvalsh(centred.T @ (centred * masses[:, None]))
    moments = np.linalg.eigvalsh(inertia.mass_com_inertia(parameters(masses, places))[2])
    np.testing.assert_allclose(moments, [mu[0] + mu[1], mu[0] + mu[2], mu[1] + mu[2]], rtol=1e-9, atol=1e-12)
    assert triangle_margin(parameters(masses, places)) == pytest.approx(2 * mu[0], rel=1e-9, abs=1e-12)


@given(seeds)
def test_a_flat_body_makes_a_triangle_inequality_tight_and_a_solid_one_does_not(rng: np.random.Generator) -> None:
    masses, places = points(rng)
    flat = places * [1, 1, 0] @ rotation(rng).T + rng.normal(size=3)
    assert triangle_margin(parameters(masses, flat)) == pytest.approx(0, abs=1e-10)
    assert triangle_margin(parameters(masses, places)) > 1e-6


def test_a_body_can_have_positive_moments_and_not_exist() -> None:
    """Inertia diag(1, 1, 3) is positive definite but breaks 1 + 1 ≥ 3, so that J has a negative eigenvalue."""
    pi = inertia.from_mass_com_inertia(2.0, [0.1, 0.2, 0.3], np.diag([1.0, 1.0, 3.0]))
    assert np.linalg.eigvalsh(inertia.spatial_inertia(pi)).min() > 0
    assert np.linalg.eigvalsh(inertia.pseudo_inertia(pi)).min() < 0
    assert triangle_margin(pi) == pytest.approx(-1)


@given(seeds)
def test_parallel_axes(rng: np.random.Generator) -> None:
    """Ī = Ī_C + m S(c) S(c)ᵀ (12), with Ī_C that of the points moved to their centre."""
    masses, places = points(rng)
    mass, com, I_c = inertia.mass_com_inertia(parameters(masses, places))
    assert mass == pytest.approx(masses.sum())
    np.testing.assert_allclose(com, masses @ places / masses.sum())
    np.testing.assert_allclose(inertia.symmetric_entries(I_c), parameters(masses, places - com)[4:], atol=1e-12)


def test_a_body_without_mass_has_its_centre_at_the_origin() -> None:
    mass, com, I_c = inertia.mass_com_inertia([0, 0, 0, 0, 1, 2, 3, 4, 5, 6])
    assert mass == 0
    np.testing.assert_array_equal(com, np.zeros(3))
    np.testing.assert_array_equal(I_c, [[1, 2, 4], [2, 3, 5], [4, 5, 6]])


@given(seeds)
def test_another_frame_is_pinocchios_se3_action_and_the_points_moved(rng: np.random.Generator) -> None:
    masses, places = points(rng)
    R, p = rotation(rng), rng.normal(size=3)
    moved = inertia.parameter_transform(R, p) @ parameters(masses, places)
    np.testing.assert_allclose(moved, parameters(masses, places @ R.T + p), atol=1e-10)
    action = pinocchio_inertia(parameters(masses, places)).se3Action(pin.SE3(R, p))
    np.testing.assert_allclose(moved, action.toDynamicParameters(), atol=1e-10)


@given(seeds)
def test_frames_compose_and_undo(rng: np.random.Generator) -> None:
    (R, S), (p, s) = (rotation(rng), rotation(rng)), rng.normal(size=(2, 3))
    once = inertia.parameter_transform(R @ S, p + R @ s)
    np.testing.assert_allclose(inertia.parameter_transform(R, p) @ inertia.parameter_transform(S, s), once, atol=1e-10)
    back = inertia.parameter_transform(R.T, -R.T @ p)
    np.testing.assert_allclose(back @ inertia.parameter_transform(R, p), np.eye(10), atol=1e-10)

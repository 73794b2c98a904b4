"""Rotations as scipy has them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from idtool.robot.rotation import (
    quaternions,
    rotation_about,
    rotation_from_rpy,
    rotation_of_axes,
    rpy_from_rotation,
)

POLE = np.pi / 2


def test_roll_pitch_and_yaw(rng: np.random.Generator) -> None:
    for rpy in rng.uniform(-2 * np.pi, 2 * np.pi, (50, 3)):
        R = rotation_from_rpy(rpy)
        np.testing.assert_allclose(R, Rotation.from_euler("xyz", rpy).as_matrix(), rtol=0, atol=1e-15)
        np.testing.assert_allclose(rpy_from_rotation(R), Rotation.from_matrix(R).as_euler("xyz"), rtol=0, atol=1e-12)


@pytest.mark.parametrize("pitch", [POLE, -POLE, POLE + 1e-12, POLE - 1e-8, POLE - 1e-6, 1e-9 - POLE])
def test_angles_at_and_near_the_pole_make_the_same_rotation(pitch: float, rng: np.random.Generator) -> None:
    for roll, yaw in rng.uniform(-np.pi, np.pi, (20, 2)):
        R = rotation_from_rpy([roll, pitch, yaw])
        np.testing.assert_allclose(rotation_from_rpy(rpy_from_rotation(R)), R, rtol=0, atol=2e-9)


def test_at_the_pole_yaw_is_zero_and_no_angle_is_a_negative_zero() -> None:
    roll, pitch, yaw = rpy_from_rotation(rotation_from_rpy([0.3, POLE, -0.4]))
    assert (roll, pitch, yaw) == (pytest.approx(0.7), pytest.approx(POLE), 0.0)
    assert not np.signbit(rpy_from_rotation(np.eye(3))).any()


def signs() -> list[tuple[float, ...]]:
    return list(itertools.product((1.0, -1.0), repeat=3))


def test_axes_of_any_sign_have_one_rotation_and_no_other_turns_less(rng: np.random.Generator) -> None:
    for _ in range(20):
        axes = Rotation.random(rng=rng).as_matrix()
        R = rotation_of_axes(axes)
        assert np.linalg.det(R) == pytest.approx(1)
        np.testing.assert_allclose(np.abs(R), np.abs(axes))
        others = [axes * s for s in signs() if np.linalg.det(axes * s) > 0]
        assert Rotation.from_matrix(R).magnitude() == pytest.approx(min(Rotation.from_matrix(others).magnitude()))
        for s in signs():
            np.testing.assert_allclose(rotation_of_axes(axes * s), R)


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_rounding_does_not_turn_axes_along_those_of_the_frame(order: tuple[int, ...], rng: np.random.Generator) -> None:
    exact = np.eye(3)[:, order]
    angles = rpy_from_rotation(rotation_of_axes(exact))
    for s in signs():
        nearly = Rotation.from_rotvec(1e-13 * rng.normal(size=3)).as_matrix() @ exact
        np.testing.assert_allclose(rpy_from_rotation(rotation_of_axes(nearly * s)), angles, atol=1e-9)


def test_rotation_about_an_axis(rng: np.random.Generator) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3
    phi = rng.uniform(-9, 9, 40)
    expected = Rotation.from_rotvec(axis * phi[:, None]).as_matrix()
    np.testing.assert_allclose(rotation_about(axis, phi), expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(rotation_about(axis, phi[0]), expected[0], rtol=0, atol=1e-14)


def test_quaternions(rng: np.random.Generator) -> None:
    """Also of half turns, where the real part is zero."""
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    R = Rotation.concatenate([Rotation.random(200, rng), half_turns, Rotation.identity()]).as_matrix()
    np.testing.assert_allclose(quaternions(R), Rotation.from_matrix(R).as_quat(), rtol=0, atol=1e-14)

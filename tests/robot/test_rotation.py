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


def test_axes_along_those_of_the_frame_are_turned_by_the_smallest_angle_and_the_first_keep_their_signs() -> None:
    for order in itertools.permutations(range(3)):
        for s in signs():
            axes = np.eye(3)[:, order] * s
            R = rotation_of_axes(axes)
            even = [np.eye(3)[:, order] * t for t in signs() if np.linalg.det(np.eye(3)[:, order] * t) > 0]
            least = min(Rotation.from_matrix(even).magnitude())
            as_near = [other for other in even if Rotation.from_matrix(other).magnitude() < least + 1e-9]
            assert Rotation.from_matrix(R).magnitude() == pytest.approx(least)
            kept = [[(axes[:, k] == other[:, k]).all() for k in range(3)] for other in as_near]
            assert [(axes[:, k] == R[:, k]).all() for k in range(3)] == max(kept)


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

"""Rotation matrices from roll, pitch and yaw and about an axis, and back to angles and quaternions.

`scipy.spatial.transform` has these too, at the price of a tenth of a second for its import.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike

from idtool.common.arrays import Array
from idtool.robot.inertia import skew

_GIMBAL_LOCK = 1e-9  # cosine of the pitch, below which roll and yaw turn about the same axis
_TIE = 1e-6  # difference of the traces of rotations by the same angle


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Rotation by roll, pitch, yaw (3,) [rad] about the fixed axes x, y, z in this order, as in URDF; shape (3, 3)."""
    roll, pitch, yaw = np.asarray(rpy, dtype=float).tolist()
    sr, sp, sy = math.sin(roll), math.sin(pitch), math.sin(yaw)
    cr, cp, cy = math.cos(roll), math.cos(pitch), math.cos(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(R: Array) -> Array:
    """Roll, pitch and yaw of a rotation matrix (3, 3) [rad], shape (3,); at a pitch of ±90° yaw is 0."""
    cos_pitch = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], cos_pitch)
    yaw = math.atan2(R[1, 0], R[0, 0]) if cos_pitch > _GIMBAL_LOCK else 0.0
    _, y_axis, _ = rotation_from_rpy([0.0, 0.0, yaw]).T @ R  # what is left when yaw is undone: pitch after roll
    roll = math.atan2(-y_axis[2], y_axis[1])
    return np.array([roll, pitch, yaw]) + 0.0  # no negative zeros


def rotation_of_axes(axes: Array) -> Array:
    """Rotation matrix whose columns are given axes or their opposites, so that it turns by the smallest angle.

    If several turn by the same angle, the first axis keeps its sign, then the second.

    Parameters
    ----------
    axes
        Orthonormal columns, shape (3, 3).
    """
    handedness = np.sign(np.linalg.det(axes))
    cosines = np.diagonal(axes)
    candidates = np.array([[s, t, s * t * handedness] for s, t in itertools.product((1.0, -1.0), repeat=2)])
    traces = candidates @ cosines  # the greater, the smaller the angle
    is_smallest = traces > traces.max() - _TIE
    return np.asarray(axes * candidates[is_smallest.argmax()])


def rotation_about(axis: Array, angle: ArrayLike) -> Array:
    """Rotation about a unit vector (3,) by angles (...) [rad], shape (..., 3, 3): Rodrigues' formula."""
    S = skew(axis)
    phi = np.asarray(angle, dtype=float)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(phi) * S + (1 - np.cos(phi)) * (S @ S))


def quaternions(R: Array) -> Array:
    """Unit quaternions x, y, z, w of rotation matrices (n, 3, 3), shape (n, 4).

    Source: Shepperd, Quaternion from rotation matrix, 1978
    """
    outer = np.empty((len(R), 4, 4))  # 4 q qᵀ, whose every row is a multiple of q
    trace = np.trace(R, axis1=1, axis2=2)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[:, i, i] = 1 + 2 * R[:, i, i] - trace
        outer[:, i, j] = outer[:, j, i] = R[:, i, j] + R[:, j, i]
        outer[:, 3, i] = outer[:, i, 3] = R[:, k, j] - R[:, j, k]
    outer[:, 3, 3] = 1 + trace
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    rows = outer[np.arange(len(R)), largest]
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))

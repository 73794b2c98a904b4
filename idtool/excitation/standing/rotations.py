"""Rotation vectors and their rates, for many samples at once.

Letters: phi a rotation vector, R = exp(phi) its rotation; shape (N, 3) and (N, 3, 3).
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array

_SMALL = 1e-4  # rad, below which the series are exact to rounding


def skew_matrices(x: Array) -> Array:
    """Matrices of the cross products with vectors (..., 3), shape (..., 3, 3)."""
    S = np.zeros((*x.shape, 3))
    S[..., 0, 1], S[..., 1, 0] = -x[..., 2], x[..., 2]
    S[..., 0, 2], S[..., 2, 0] = x[..., 1], -x[..., 1]
    S[..., 1, 2], S[..., 2, 1] = -x[..., 0], x[..., 0]
    return S


def rate_to_angular_velocity(phi: Array) -> Array:
    """Left Jacobian of the rotations: the angular velocity along fixed axes is it times the rate of phi, (N, 3, 3)."""
    angle = np.linalg.norm(phi, axis=1)
    is_small = angle < _SMALL
    safe = np.where(is_small, 1.0, angle)
    first = np.where(is_small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(is_small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    S = skew_matrices(phi)
    return np.asarray(np.eye(3) + first[:, None, None] * S + second[:, None, None] * (S @ S))


def angular_velocity_to_rate(phi: Array) -> Array:
    """Inverse of `rate_to_angular_velocity`, for angles below a whole turn, shape (N, 3, 3)."""
    angle = np.linalg.norm(phi, axis=1)
    is_small = angle < _SMALL
    safe = np.where(is_small, 1.0, angle)
    half = safe / 2
    second = np.where(is_small, 1 / 12 + angle**2 / 720, (1 - half / np.tan(half)) / safe**2)
    S = skew_matrices(phi)
    return np.asarray(np.eye(3) - S / 2 + second[:, None, None] * (S @ S))

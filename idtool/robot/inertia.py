"""Inertia parameters of a rigid body in their several forms. Only this file knows the parameter order.

Letters (paper: Wensing, Kim & Slotine, arXiv 1701.04395):

- pi = [m, h_x, h_y, h_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], shape (..., 10): mass [kg], first moment h = m c
  [kg·m] and rotational inertia about the origin of the body's frame [kg·m²];
- J, shape (..., 4, 4): the pseudo-inertia [[Sigma, h], [hᵀ, m]] with Sigma = ½ Tr(I) 1 − I, the density-weighted
  second moment of the body's points [x; 1] (Thm 3);
- c [m] centre of mass, I_c [kg·m²] rotational inertia about it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from idtool.common.arrays import Array

PARAMETER_NAMES = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
#: Names in reports, where they differ.
PARAMETER_WORDS = {"m": "mass", "mc_x": "m·c_x", "mc_y": "m·c_y", "mc_z": "m·c_z"}
PARAMETER_UNITS = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)
PI_SIZE = len(PARAMETER_NAMES)
#: Powers of length in the parameters' units.
LENGTH_POWERS = np.repeat([0.0, 1.0, 2.0], [1, 3, 6])

WRITTEN_DIGITS = 12  # in files: a body 1e-9 inside its set stays there, and more are not known

# Row and column of the rotational inertia's entries, in the order of pi.
_ROW = np.array([0, 0, 1, 0, 1, 2])
_COLUMN = np.array([0, 1, 1, 2, 2, 2])


def skew(x: ArrayLike) -> Array:
    """S(x) with S(x) y = x × y, shape (3, 3)."""
    a, b, c = np.asarray(x, dtype=float)
    return np.array([[0, -c, b], [c, 0, -a], [-b, a, 0.0]])


def symmetric_matrix(entries: ArrayLike) -> Array:
    """Symmetric matrices, shape (..., 3, 3), from their entries [xx, xy, yy, xz, yz, zz], shape (..., 6)."""
    entries = np.asarray(entries, dtype=float)
    matrix = np.empty((*entries.shape[:-1], 3, 3))
    matrix[..., _ROW, _COLUMN] = entries
    matrix[..., _COLUMN, _ROW] = entries
    return matrix


def symmetric_entries(matrix: ArrayLike) -> Array:
    """Entries [xx, xy, yy, xz, yz, zz], shape (..., 6), of symmetric matrices, shape (..., 3, 3)."""
    return np.asarray(matrix, dtype=float)[..., _ROW, _COLUMN]


def pseudo_inertia(pi: ArrayLike) -> Array:
    """J(pi), shape (..., 4, 4), linear in pi (Thm 3)."""
    pi = np.asarray(pi, dtype=float)
    inertia = symmetric_matrix(pi[..., 4:])
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    J = np.empty((*pi.shape[:-1], 4, 4))
    J[..., :3, :3] = 0.5 * trace * np.eye(3) - inertia
    J[..., :3, 3] = pi[..., 1:4]
    J[..., 3, :3] = pi[..., 1:4]
    J[..., 3, 3] = pi[..., 0]
    return J


def from_pseudo_inertia(J: ArrayLike) -> Array:
    """Parameters pi of a pseudo-inertia, shape (..., 10): the inverse of `pseudo_inertia`."""
    J = np.asarray(J, dtype=float)
    sigma = J[..., :3, :3]
    trace = np.trace(sigma, axis1=-2, axis2=-1)[..., None, None]
    inertia = trace * np.eye(3) - sigma
    return np.concatenate([J[..., 3:, 3], J[..., :3, 3], symmetric_entries(inertia)], axis=-1)


def smallest_eigenvalue(pi: ArrayLike) -> Array:
    """Smallest eigenvalue of J(pi), shape (...); positive if and only if a mass density has these moments (Thm 3)."""
    return np.asarray(np.linalg.eigvalsh(pseudo_inertia(pi))[..., 0])


def is_realizable(pi: ArrayLike) -> bool:
    """True if J(pi) ≻ 0: full physical consistency of one body, bounds on its extent aside (Thm 3)."""
    return bool(smallest_eigenvalue(pi) > 0)


#: J(pi) = Σ_k pi_k BASIS[k], shape (10, 4, 4).
J_BASIS = pseudo_inertia(np.eye(PI_SIZE))


def spatial_inertia(pi: ArrayLike) -> Array:
    """The 6×6 spatial inertia [[I, S(h)], [S(h)ᵀ, m 1]] in the order (angular, linear), shape (..., 6, 6) (Thm 1)."""
    pi = np.asarray(pi, dtype=float)
    spatial = np.zeros((*pi.shape[:-1], 6, 6))
    spatial[..., :3, :3] = symmetric_matrix(pi[..., 4:])
    generators = np.array([skew(axis) for axis in np.eye(3)])
    skew_h = np.einsum("kij,...k->...ij", generators, pi[..., 1:4])
    spatial[..., :3, 3:] = skew_h
    spatial[..., 3:, :3] = -skew_h
    spatial[..., 3:, 3:] = pi[..., 0, None, None] * np.eye(3)
    return spatial


def from_mass_com_inertia(mass: float, com: ArrayLike, inertia_com: ArrayLike) -> Array:
    """Parameters pi of mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg·m²], parallel axes (12)."""
    com = np.asarray(com, dtype=float)
    S = skew(com)
    inertia = np.asarray(inertia_com) + mass * S @ S.T
    return np.concatenate([[mass], mass * com, symmetric_entries(inertia)])


def mass_com_inertia(pi: ArrayLike) -> tuple[float, Array, Array]:
    """Mass [kg], centre of mass [m] (3,) and inertia about it [kg·m²] (3, 3) of one body.

    A body without mass has its centre at the origin.
    """
    pi = np.asarray(pi, dtype=float)
    mass = float(pi[0])
    com = pi[1:4] / mass if mass else np.zeros(3)
    S = skew(com)
    return mass, com, symmetric_matrix(pi[4:]) - mass * S @ S.T


def round_to_digits(values: ArrayLike, digits: int = WRITTEN_DIGITS) -> Array:
    """Numbers of one unit, shape (...), rounded to so many significant digits of the largest of them."""
    values = np.asarray(values, dtype=float)
    largest = float(np.abs(values).max(initial=0.0))
    if not 0 < largest < np.inf:
        return values
    decimals = digits - 1 - int(np.floor(np.log10(largest)))
    return np.asarray(np.round(values, decimals) + 0.0)  # no −0


def rounded_inertial(pi: ArrayLike) -> tuple[float, Array, Array]:
    """`mass_com_inertia` to the digits that are written to files: a centre of mass next to the origin is the origin."""
    mass, com, inertia = mass_com_inertia(pi)
    gyration = np.sqrt(abs(np.trace(inertia) / (2 * mass))) if mass else 0.0
    return float(round_to_digits(mass)), round_to_digits([*com, gyration])[:3], round_to_digits(inertia)


def parameter_transform(R: ArrayLike, p: ArrayLike) -> Array:
    """The 10×10 matrix that takes pi from a frame B to a frame A, in which B has rotation R and position p [m].

    J_A = T J_B Tᵀ with T = [[R, p], [0, 1]].
    """
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = p
    return from_pseudo_inertia(T @ J_BASIS @ T.T).T


def parameter_reflection(signs: ArrayLike) -> Array:
    """The 10×10 matrix that takes pi to that of the mirrored body, x, y and z times these signs, shape (3,)."""
    T = np.append(np.asarray(signs, dtype=float), 1.0)
    return from_pseudo_inertia(T[:, None] * J_BASIS * T).T

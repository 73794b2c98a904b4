"""Proof that a body is realizable, four point masses in its ellipsoid, and the reasons why another is not.

Letters: m, c, Sigma_C mass, centre of mass and second moment about it, mu (3,) eigenvalues of Sigma_C / m [m²];
J, Q the pseudo-inertia and the homogeneous matrix of the ellipsoid S (paper, Thm 4).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.linear_algebra import reproducible_eigh
from idtool.common.number_text import short_number
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import REALIZABLE, Inequality
from idtool.robot.inertia import J_BASIS, from_pseudo_inertia, mass_com_inertia, pseudo_inertia
from idtool.robot.rotation import rotation_of_axes

_TOLERANCE = 1e-9  # of the body's own spread, and of its ellipsoid
_ROUNDING = 16 * np.finfo(float).eps  # of moments about the origin, in those about the centre of mass
_EQUAL_MOMENT_GAP = 1e-10  # of moments about the origin, by which equal ones about the centre of mass may differ
_MIN_POINT_MASS = 1e-14  # of the body's mass: the position of a lighter point is rounding error
_MIN_AXIS_RATIO = 1e-4  # of the longest semi-axis, for the ellipsoid of a flat body
_MIN_SEMI_AXIS = 1e-6  # m, for the ellipsoid of a body that is a point

_PAIR = np.array([[1.0, 1.0], [1.0, -1.0]])
_HADAMARD = np.kron(_PAIR, _PAIR)
# Tr(B_k D_l) = 1 for k = l, else 0, with B_k the basis of pseudo-inertias.
_DUAL = np.tensordot(np.linalg.inv(np.einsum("kij,lji->kl", J_BASIS, J_BASIS)), J_BASIS, axes=1)


@dataclass(frozen=True)
class Witness:
    """Four point masses with the parameters of a body.

    Attributes
    ----------
    masses
        Not negative [kg], shape (4,).
    points
        Positions in the body's frame [m], shape (4, 3).
    """

    masses: Array
    points: Array

    @property
    def pi(self) -> Array:
        """The parameters of the four together, shape (10,)."""
        lifted = np.column_stack([self.points, np.ones(4)])
        return from_pseudo_inertia(lifted.T @ (lifted * self.masses[:, None]))


@dataclass(frozen=True)
class Violation:
    """An inequality that a body does not fulfil.

    Attributes
    ----------
    label
        The condition in words.
    amount
        By how much it fails, in units of the body's mass and length.
    text
        The same in words and SI units.
    """

    label: str
    amount: float
    text: str


@dataclass(frozen=True)
class _MassDistribution:
    """Mass, centre of mass and principal second moments of a body with a positive mass.

    Attributes
    ----------
    mass, com
        Mass [kg] and centre of mass [m].
    mu, axes
        Eigenvalues of Sigma_C / m, ascending [m²], and its eigenvectors as columns.
    error
        How far below zero mu may be for a flat body [m²].
    equal_gap
        Difference up to which mu count as equal [m²].
    """

    mass: float
    com: Array
    mu: Array
    axes: Array
    error: float
    equal_gap: float

    @classmethod
    def from_parameters(cls, pi: Array) -> _MassDistribution:
        mass, com, inertia = mass_com_inertia(pi)
        Sigma_C = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        about_origin = float(com @ com + np.abs(pi[4:]).max() / mass)
        equal_gap = _EQUAL_MOMENT_GAP * about_origin
        mu, axes = reproducible_eigh(Sigma_C / mass, equal_gap)
        rounding = _ROUNDING * about_origin
        mu = np.where(np.abs(mu) <= rounding, 0.0, mu)
        error = float(_TOLERANCE * np.abs(mu).max() + rounding)
        return cls(mass, com, mu, axes, error, equal_gap)


def find_witness(pi: ArrayLike, ellipsoid: Ellipsoid | None = None) -> Witness:
    """Four point masses inside a body's ellipsoid that have its parameters (Thm 4).

    Let J = L Lᵀ and Lᵀ Q L = V diag(l) Vᵀ. With H the 4×4 Hadamard matrix, U = V H/2 is orthogonal, and every diagonal
    entry of Uᵀ (Lᵀ Q L) U is the mean of l, Tr(JQ)/4 ≥ 0. So J is the sum of z_k z_kᵀ over the columns z_k of L U, and
    each z_kᵀ Q z_k ≥ 0: with m_k = z_k[3]², the point x_k = z_k[:3] / z_k[3] lies in S. All this in coordinates in
    which S is the unit ball. Without an ellipsoid Q = diag(0, 0, 0, 1), which makes the masses equal.

    Parameters
    ----------
    pi
        Parameters of the body, shape (10,).
    ellipsoid
        S, in the body's frame; None: the points may be anywhere.

    Returns
    -------
    The point masses. Those of a body without volume (a plate, a rod, a point) may coincide.

    Raises
    ------
    ValueError
        If no mass density in the ellipsoid has these parameters; the message says why.
    """
    pi = np.asarray(pi, dtype=float)
    if reasons := unrealizable_reasons(pi, ellipsoid):
        raise ValueError(f"no mass density has these parameters: {'; '.join(reasons)}")
    body = _MassDistribution.from_parameters(pi)
    # L is a square root of J / m, block by block: no digits are lost on a body that is small or far from the origin.
    L = np.eye(4)
    if ellipsoid is None:
        L[:3, :3] = body.axes * np.sqrt(np.maximum(body.mu, 0))
        Z = L @ _HADAMARD / 2
        return Witness(body.mass * Z[3] ** 2, body.com + (Z[:3] / Z[3]).T)
    to_ball = ellipsoid.rotation.T / np.asarray(ellipsoid.semi_axes)[:, None]
    L[:3, :3] = to_ball @ body.axes * np.sqrt(np.maximum(body.mu, 0))
    L[:3, 3] = to_ball @ (body.com - ellipsoid.center)
    Q_ball = np.diag([-1.0, -1.0, -1.0, 1.0])
    equal_gap = body.equal_gap / min(ellipsoid.semi_axes) ** 2
    _, V = reproducible_eigh(L.T @ Q_ball @ L, equal_gap)
    Z = L @ V @ _HADAMARD / 2
    is_massless = Z[3] ** 2 <= _MIN_POINT_MASS
    u = np.where(is_massless, L[:3, 3:], Z[:3] / np.where(is_massless, 1.0, Z[3]))  # points in the unit ball, (3, 4)
    u /= np.maximum(1.0, np.linalg.norm(u, axis=0))  # rounding may put a point of the surface beyond it
    points = ellipsoid.center + (u.T * ellipsoid.semi_axes) @ ellipsoid.rotation.T
    return Witness(body.mass * Z[3] ** 2, points)


def required_ellipsoid_scale(pi: ArrayLike, ellipsoid: Ellipsoid) -> float:
    """Factor by which the ellipsoid must grow, about its centre, for the body to be realizable on it.

    √(1 − Tr(JQ)/m), the root of the mean over the body's mass of the squared distance from the ellipsoid's centre in
    semi-axes: some mass is at least as far as this. Beyond 1 the condition (25) is violated.

    Parameters
    ----------
    pi
        Parameters of a body with a positive mass, shape (10,).
    ellipsoid
        S, in the body's frame.

    Returns
    -------
    The factor, 0 or more.
    """
    pi = np.asarray(pi, dtype=float)
    body = _MassDistribution.from_parameters(pi)
    to_ball = ellipsoid.rotation.T / np.asarray(ellipsoid.semi_axes)[:, None]
    com = to_ball @ (body.com - ellipsoid.center)
    variance = np.square(to_ball @ body.axes).sum(axis=0) @ body.mu
    return float(np.sqrt(max(com @ com + variance, 0.0)))


def unrealizable_reasons(pi: ArrayLike, ellipsoid: Ellipsoid | None = None) -> list[str]:
    """Reasons why no mass density, or none within an ellipsoid, has these parameters.

    Parameters
    ----------
    pi
        Parameters of the body, shape (10,).
    ellipsoid
        Bound of its mass, in the body's frame; None: unbounded.

    Returns
    -------
    Each reason in words and SI units (Def. 4, (13), Thm 4); none for a realizable body, the boundary cases (plate, rod,
    point mass) included. Principal moments are about the centre of mass, I1 ≤ I2 ≤ I3.
    """
    pi = np.asarray(pi, dtype=float)
    if not np.isfinite(pi).all():
        return ["parameters are not finite"]
    if pi[0] <= 0:
        return [f"mass is not positive: {short_number(pi[0])} kg"]
    reasons = _principal_moment_reasons(_MassDistribution.from_parameters(pi))
    if ellipsoid is not None:
        factor = required_ellipsoid_scale(pi, ellipsoid)
        far = np.linalg.norm(ellipsoid.center) / min(ellipsoid.semi_axes)
        if factor**2 - 1 > _TOLERANCE + _ROUNDING * far**2:
            reasons.append(f"{_mass_outside(factor, 'ellipsoid')} (Tr(JQ)/m = {short_number(1 - factor**2)})")
    return reasons


def violations(
    pi: ArrayLike, inequalities: Iterable[Inequality], mass: float, length: float, tolerance: float = _TOLERANCE
) -> list[Violation]:
    """The inequalities that a body does not fulfil, and by how much.

    Parameters
    ----------
    pi
        Parameters of the body, shape (10,).
    inequalities
        On pi itself, as those of a constraint set.
    mass
        A mass typical of the body [kg].
    length
        A length typical of it [m].
    tolerance
        Violation that is ignored, in units of these: a plate is on the boundary, and rounding takes it beyond.
    """
    pi = np.asarray(pi, dtype=float)
    violated = []
    for inequality in inequalities:
        margin = inequality.margin(pi, mass, length)
        if not margin >= -tolerance:
            violated.append(Violation(inequality.label, -margin, _violation_text(pi, inequality, -margin)))
    return violated


def deviation_ellipsoid(pi: ArrayLike) -> Ellipsoid:
    """The standard-deviation ellipsoid of a body's mass, E = {x : (x − c)ᵀ (Sigma_C / m)⁻¹ (x − c) = 1}.

    Some of the mass lies on or beyond it. Semi-axes that are zero, or whose square is negative in a body that cannot
    exist, are given a small length.

    Parameters
    ----------
    pi
        Parameters of a body with a positive mass, shape (10,).

    Raises
    ------
    ValueError
        If the mass is not positive or a parameter not finite.
    """
    pi = np.asarray(pi, dtype=float)
    if not np.isfinite(pi).all() or pi[0] <= 0:
        raise ValueError(f"this body has no standard-deviation ellipsoid: {unrealizable_reasons(pi)[0]}")
    body = _MassDistribution.from_parameters(pi)
    semi_axes = np.sqrt(np.maximum(body.mu, 0))
    shortest = max(_MIN_AXIS_RATIO * semi_axes.max(), _MIN_SEMI_AXIS)
    return Ellipsoid.from_axes(body.com, np.maximum(semi_axes, shortest), rotation_of_axes(body.axes))


def _principal_moment_reasons(body: _MassDistribution) -> list[str]:
    """Principal moments that are negative, or the violated triangle inequality: of sorted ones, only I1 + I2 < I3."""
    if body.mu[0] >= -body.error:
        return []
    # I_i + I_j − I_k = 2 m mu_k (21), so that the least mu belongs to the greatest moment.
    moments = body.mass * (body.mu.sum() - body.mu)[::-1]
    negative = [i for i in range(3) if moments[i] < -body.mass * body.error]
    if negative:
        return [f"principal moment I{i + 1} is negative: {short_number(moments[i])} kg·m²" for i in negative]
    short = 100 * (1 - (moments[0] + moments[1]) / moments[2])
    digits = next(d for d in range(3, 18) if _shows_violation(moments, d))
    first, second, third = (f"{moment:.{digits}g}" for moment in moments)
    return [f"I1 + I2 < I3: {first} + {second} < {third} kg·m² (by {short_number(short, 2)} %)"]


def _shows_violation(moments: Array, digits: int) -> bool:
    """True if the three moments, rounded to so many digits, still show I1 + I2 < I3."""
    first, second, third = (float(f"{moment:.{digits}g}") for moment in moments)
    return first + second < third or digits == 17


def _mass_outside(factor: float, shape: str) -> str:
    """Message on the mass outside a shape that would have to grow by a factor."""
    farther = f"{short_number(100 * (factor - 1))} %"
    return f"some mass lies beyond its {shape}, at least {farther} farther from the centre than the surface"


def _violation_text(pi: Array, inequality: Inequality, amount: float) -> str:
    """A violated inequality in words and SI units."""
    if inequality is REALIZABLE and (reasons := unrealizable_reasons(pi)):
        return "; ".join(reasons)
    if inequality.G.ndim == 2 and pi[0] > 0:
        Q = np.tensordot(inequality.G.T, _DUAL, axes=1)
        mean = np.einsum("nij,ji->n", Q, pseudo_inertia(pi)) / pi[0]
        worst = int(np.argmin(mean))
        factor = _required_scale(Q[worst], float(mean[worst]))
        if factor is not None:
            return f"{_mass_outside(factor, 'bounding shape')} (Tr(JQ)/m = {short_number(mean[worst])})"
    return f"{inequality.label}: violated by {short_number(amount)} in units of the body's mass and length"


def _required_scale(Q: Array, mean: float) -> float | None:
    """Factor by which {x : [x; 1]ᵀ Q [x; 1] ≥ 0} must grow about its centre for the form's mean to be zero.

    None for a shape without centre, such as a half-space.
    """
    A = -Q[:3, :3]
    b = Q[:3, 3]
    center = np.linalg.pinv(A, hermitian=True) @ b
    value_at_center = Q[3, 3] + b @ center
    is_convex = np.linalg.eigvalsh(A)[0] >= -_TOLERANCE * np.abs(A).max()
    has_center = A.any() and is_convex and np.allclose(A @ center, b)
    if not has_center or value_at_center <= 0:
        return None
    return float(np.sqrt(1 - mean / value_at_center))

"""Distances between bodies, and the nearest realizable body.

A metric is a matrix M, shape (10, 10), with ‖delta‖² = deltaᵀ M delta for a deviation delta = pi − pî of parameters.

Letters: pî, Ĵ the reference's parameters and pseudo-inertia, F Fᵀ = Ĵ; X = F⁻¹ J F⁻ᵀ a pseudo-inertia in the
reference's units, in which the reference is the identity; Q the homogeneous matrix of a shape that bounds the mass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from idtool.common.arrays import Array
from idtool.robot.inertia import J_BASIS, LENGTH_POWERS, PI_SIZE, from_pseudo_inertia, pseudo_inertia

FLOOR = 1e-6  # how far inside the set a projection ends, in units of the reference: survives rounding
_ROUNDING = 1e-12  # of the multiplier's equation
_SINGULAR = 1e-13  # of a pivot: less may be rounding
_MAX_ITERATIONS = 200  # that bisection alone would need


def euclidean_metric(mass: float, length: float) -> Array:
    """The metric of relative deviations, ‖(pi − pî) / (mass · length^POWERS)‖², shape (10, 10).

    Parameters
    ----------
    mass
        A mass typical of the body [kg].
    length
        A length typical of it [m].
    """
    return np.asarray(np.diag((mass * length**LENGTH_POWERS) ** -2.0))


def pullback_metric(reference: ArrayLike) -> Array:
    """The metric ½ Tr(Ĵ⁻¹ dJ Ĵ⁻¹ dJ) of positive definite matrices at a reference, the same in all units and frames.

    M_kl = ½ Tr(Ĵ⁻¹ B_k Ĵ⁻¹ B_l) with J = Σ pi_k B_k (Lee, Wensing & Park, "Geometric robot dynamic identification: a
    convex programming approach", IEEE T-RO 2020). Half the Hessian of `entropic_divergence` there.

    Parameters
    ----------
    reference
        Parameters of a body with a positive definite pseudo-inertia, or of several, shape (..., 10).

    Returns
    -------
    Shape (..., 10, 10).

    Raises
    ------
    ValueError
        If a reference's pseudo-inertia is not positive definite.
    """
    F_inverse = np.linalg.inv(_cholesky(np.asarray(reference, dtype=float)))[..., None, :, :]
    whitened = F_inverse @ J_BASIS @ F_inverse.swapaxes(-1, -2)
    rows = whitened.reshape(*F_inverse.shape[:-3], PI_SIZE, 16)
    return np.asarray(0.5 * rows @ rows.swapaxes(-1, -2))


def entropic_divergence(pi: ArrayLike, reference: ArrayLike) -> float:
    """The log-det divergence d(J‖Ĵ) = −log det J + log det Ĵ + Tr(Ĵ⁻¹ J) − 4, the same in all units and frames.

    Twice the Kullback-Leibler divergence between the normal distributions of covariance Ĵ and J (Lee, Wensing & Park
    2020). Not negative, 0 at the reference alone, infinite where J is not positive definite.

    Parameters
    ----------
    pi, reference
        Parameters of one body each, shape (10,).

    Raises
    ------
    ValueError
        If the reference's pseudo-inertia is not positive definite.
    """
    F_inverse = np.linalg.inv(_cholesky(np.asarray(reference, dtype=float)))
    X = F_inverse @ pseudo_inertia(pi) @ F_inverse.T
    deviations = np.linalg.eigvalsh(X) - 1
    if deviations[0] <= -1:
        return float(np.inf)
    return float(np.sum(deviations - np.log1p(deviations)))


def entropic_gradient(pi: ArrayLike, reference: ArrayLike) -> Array:
    """The gradient of `entropic_divergence` with respect to pi, Tr((Ĵ⁻¹ − J⁻¹) B_k), shape (10,).

    Raises
    ------
    ValueError
        If one of the two pseudo-inertias is not positive definite.
    """
    F_inverse = np.linalg.inv(_cholesky(np.asarray(pi, dtype=float)))
    F_inverse_reference = np.linalg.inv(_cholesky(np.asarray(reference, dtype=float)))
    difference = F_inverse_reference.T @ F_inverse_reference - F_inverse.T @ F_inverse  # of J⁻¹
    return np.asarray(np.einsum("ij,kji->k", difference, J_BASIS))


def nearest_realizable(pi: ArrayLike, reference: ArrayLike, Q: ArrayLike | None = None, floor: float = FLOOR) -> Array:
    """The projection onto P* or P*_S in the reference's pull-back metric: the nearest realizable body.

    With X = F⁻¹ J F⁻ᵀ and B = Fᵀ Q F, the metric is ½ ‖X − X₀‖² (Frobenius) and Tr(J Q) = Tr(X B), so that

        min ½ ‖X − X₀‖²  subject to  X ⪰ f 1,  Tr(X B) ≥ b.

    With multipliers Z ⪰ 0 and mu ≥ 0, stationarity is X = X₀ + mu B + Z, and Z (X − f 1) = 0: X − f 1 and −Z are the
    positive and the negative part of X₀ + mu B − f 1. So X(mu) is X₀ + mu B with its eigenvalues clipped at f, and mu
    is 0 if Tr(X(0) B) ≥ b, else a root of Tr(X(mu) B) = b. Its left side does not fall, being the derivative of the
    convex ½ ‖(X₀ + mu B − f 1)₊‖² + mu f Tr(B), and grows without bound as Q has a positive eigenvalue.

    Parameters
    ----------
    pi
        Parameters of one body or of several, shape (..., 10); any finite numbers.
    reference
        Parameters of bodies with a positive definite pseudo-inertia, that broadcast with pi.
    Q
        Homogeneous matrices of shapes, [x; 1]ᵀ Q [x; 1] ≥ 0 inside, that broadcast with pi as shape (..., 4, 4). A
        body without one among others that have one is given diag(0, 0, 0, 1), which demands a positive mass.
    floor
        f; J ⪰ f Ĵ and Tr(JQ) ≥ b = f m̂ are kept, in all units and frames alike. The default is above rounding as long
        as pi deviates from the reference by less than a million times the reference.

    Returns
    -------
    Parameters of the nearest bodies, shape (..., 10); pi itself where it fulfils the inequalities.

    Raises
    ------
    ValueError
        If pi is not finite, or if a reference's pseudo-inertia is not positive definite.
    """
    pi, reference = np.asarray(pi, dtype=float), np.asarray(reference, dtype=float)
    if not np.isfinite(pi).all():
        raise ValueError("the parameters must be finite to compute the nearest body")
    F = _cholesky(reference)
    F_inverse = np.linalg.inv(F)
    X = F_inverse @ pseudo_inertia(pi) @ F_inverse.swapaxes(-1, -2)
    shift = np.zeros_like(X)
    if Q is not None:
        B = F.swapaxes(-1, -2) @ np.asarray(Q, dtype=float) @ F
        norm = np.linalg.norm(B, axis=(-2, -1), keepdims=True)
        bound = floor * reference[..., 0] / norm[..., 0, 0]
        mu = _multiplier(X, B / norm, bound, floor)
        shift = mu[..., None, None] * B / norm
    values, axes = np.linalg.eigh(X + shift)
    clipped = (axes * np.maximum(values, floor)[..., None, :]) @ axes.swapaxes(-1, -2)
    nearest = from_pseudo_inertia(F @ clipped @ F.swapaxes(-1, -2))
    unchanged = (values[..., 0] >= floor) & ~shift.any(axis=(-2, -1))
    return np.where(unchanged[..., None], pi, nearest)


def _cholesky(reference: Array) -> Array:
    """F with F Fᵀ = Ĵ, shape (..., 4, 4)."""
    J = pseudo_inertia(reference)
    try:
        F = np.asarray(np.linalg.cholesky(J))
    except np.linalg.LinAlgError:
        F = np.zeros_like(J)
    pivots = np.square(np.diagonal(F, axis1=-2, axis2=-1))
    if not (pivots > _SINGULAR * np.diagonal(J, axis1=-2, axis2=-1)).all():
        raise ValueError("the metric needs a positive definite pseudo-inertia")
    return F


def _multiplier(X: Array, B: Array, bound: Array, floor: float) -> Array:
    """The smallest mu ≥ 0 with Tr(X(mu) B) ≥ bound, shape (...).

    Newton's method within a bracket, on all bodies at once. It solves for slightly more than the bound, so that the
    rounding error is on the feasible side.
    """
    shape = np.broadcast_shapes(X.shape, B.shape)
    X = np.broadcast_to(X, shape)
    B = np.broadcast_to(B, shape)
    size = np.maximum(1.0, np.linalg.norm(X, axis=(-2, -1)))
    error = _ROUNDING * size
    mu = np.zeros(shape[:-2])
    low = np.zeros(shape[:-2])
    high = np.full(shape[:-2], np.inf)
    for _ in range(_MAX_ITERATIONS):
        value, slope = _clipped_trace(X + mu[..., None, None] * B, B, floor)
        value -= bound + error
        low = np.where(value < 0, mu, low)
        high = np.where(value < 0, high, mu)
        done = (np.abs(value) <= error) | (high * (1 - _ROUNDING) <= low)  # or both are 0: the inequality holds
        if done.all():
            break
        with np.errstate(divide="ignore", invalid="ignore"):  # where the slope is zero, or a body is done
            newton = mu - value / slope
            bisection = np.where(np.isinf(high), 2 * low + size, 0.5 * (low + high))
        inside = (newton > low) & (newton < high) & np.isfinite(newton)
        mu = np.where(done, mu, np.where(inside, newton, bisection))
    return mu


def _clipped_trace(X: Array, B: Array, floor: float) -> tuple[Array, Array]:
    """Tr(clip(X) B), shape (...), and its derivative along B, by the divided differences of the clipped eigenvalues."""
    values, axes = np.linalg.eigh(X)
    clipped = np.maximum(values, floor)
    rotated_B = axes.swapaxes(-1, -2) @ B @ axes
    trace = np.einsum("...ii,...i->...", rotated_B, clipped)

    difference = values[..., :, None] - values[..., None, :]
    clipped_difference = clipped[..., :, None] - clipped[..., None, :]
    is_distinct = np.abs(difference) > 1e-14
    quotient = clipped_difference / np.where(is_distinct, difference, 1.0)
    divided_difference = np.where(is_distinct, quotient, (values > floor)[..., None, :])
    slope = (divided_difference * rotated_B * rotated_B).sum(axis=(-2, -1))
    return trace, np.asarray(slope)

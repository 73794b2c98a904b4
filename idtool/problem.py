"""The optimization problem (27) on R-factors, in units in which all unknowns are of order one.

    min over theta of f(theta) = (1/n) Σ_j ‖Y_j theta − tau_j‖² / sigma_j² + w Σ_bodies ‖(pi − pî) / scale‖²

subject to every body's inequalities and the coefficients' bounds. With y = theta / scale, f = ‖A y − b‖² + constant,
and A is triangular with p rows whatever the log's length. A body on a union of ellipsoids is the sum of its parts
(Cor. 2): y = S x.

Letters: p coefficients theta; m solver variables x; A (p, p), b (p,); sigma_j noise of joint j's torque [N·m or N].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.config import Regularization
from idtool.inertia import SIZE
from idtool.reduction import Factor, Reduction
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet, Inequality

Array = NDArray[np.float64]

INTERIOR = 1e-6  # how far inside its set a body is kept, in units of its own mass and size: survives rounding
_RANK = 1e-10  # of the largest singular value: what lies below is not determined
_WEIGHINGS = 2  # of the joints by their noise
_LEAST_NOISE = 1e-4  # of a joint's torque, so that data without noise have weights that the solver can bear
_LEAST_WEIGHT = 1e-8  # of the prior: where neither data nor regularization say anything, coefficients stay there


@dataclass(frozen=True)
class Part:
    """One of the parameter vectors that a body is the sum of.

    Attributes
    ----------
    body
        The body.
    first
        Index of its first coefficient in theta.
    scales
        Units of its ten parameters, shape (10,).
    inequalities
        What they must fulfil.
    """

    body: Body
    first: int
    scales: Array
    inequalities: tuple[Inequality, ...]


@dataclass(frozen=True)
class Matrix:
    """One matrix inequality on x: Σ_k x[first + k] G_k ⪰ INTERIOR · 1.

    Attributes
    ----------
    first
        Index in x of the first of the ten variables.
    G
        Symmetric matrices without unit, shape (10, n, n).
    label
        The body and what is demanded of it.
    """

    first: int
    G: Array
    label: str

    def value(self, x: Array) -> Array:
        """The matrix at x, shape (n, n)."""
        return np.asarray(np.tensordot(x[self.first : self.first + SIZE], self.G, axes=1))


@dataclass(frozen=True)
class Problem:
    """The optimization problem, apart from how it is solved.

    Attributes
    ----------
    A, b, constant
        f(theta) = ‖A (theta / scale) − b‖² + constant; shapes (p, p), of full rank, and (p,).
    scale
        Units of theta, shape (p,).
    parts
        The bodies' parts, in the order of x, ten variables each; then come the other coefficients.
    others
        Indices in theta of the coefficients that are no inertia parameters.
    lower
        Their lower bounds, in units of ``scale``.
    """

    A: Array
    b: Array
    constant: float
    scale: Array
    parts: tuple[Part, ...]
    others: NDArray[np.intp]
    lower: Array

    @cached_property
    def inequalities(self) -> tuple[Matrix, ...]:
        """All matrix inequalities on x."""
        return tuple(
            Matrix(SIZE * k, inequality.scaled(part.scales), f"{part.body.name}: {inequality.label}")
            for k, part in enumerate(self.parts)
            for inequality in part.inequalities
        )

    @property
    def bounded(self) -> NDArray[np.intp]:
        """Indices in x of the coefficients that have a lower bound."""
        return SIZE * len(self.parts) + np.flatnonzero(np.isfinite(self.lower))

    @property
    def bounds(self) -> Array:
        """Their lower bounds."""
        return self.lower[np.isfinite(self.lower)]

    @cached_property
    def S(self) -> Array:  # noqa: N802
        """Sum of parts: theta / scale = S x, shape (p, m)."""
        S = np.zeros((len(self.scale), SIZE * len(self.parts) + len(self.others)))
        for k, part in enumerate(self.parts):
            S[part.first : part.first + SIZE, SIZE * k : SIZE * (k + 1)] = np.eye(SIZE)
        S[self.others, SIZE * len(self.parts) + np.arange(len(self.others))] = 1
        return S

    def cost(self, y: Array) -> float:
        """The objective at theta = scale · y."""
        return float(np.square(self.A @ y - self.b).sum()) + self.constant


def build_problem(
    model: LinearModel,
    bodies: Sequence[Body],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    noise: Array,
) -> Problem:
    """State (27) on R-factors; see `identify` for the parameters, ``noise`` is sigma, shape (nv,)."""
    coefficients = model.coefficients
    rows = weighted_rows(model, reduction, noise)
    held = np.array([c.scale is not None for c in coefficients])
    size = np.linalg.norm(rows[:, :-1], axis=0)
    grown = _placeholder_factor(rows, np.where(held, model.prior, 0.0))
    scale = np.array(
        [grown * c.scale if c.scale is not None else 1 / (s or 1.0) for c, s in zip(coefficients, size, strict=True)]
    )
    rows[:, :-1] *= scale
    weight = held * (regularization.weight if regularization.kind == "euclidean" else 0.0)
    pull = np.sqrt(np.maximum(weight, _LEAST_WEIGHT))
    prior = np.column_stack([np.diag(pull), pull * model.prior / scale])
    R = np.asarray(np.linalg.qr(np.concatenate([rows, prior]), mode="r"))
    p = len(coefficients)
    parts = tuple(
        Part(body, SIZE * i, scale[SIZE * i : SIZE * (i + 1)], inequalities)
        for i, (body, kind) in enumerate(zip(bodies, sets, strict=True))
        for inequalities in kind.parts(body.ellipsoids)
    )
    others = np.arange(SIZE * len(bodies), p)
    lower = np.array([coefficients[i].lower for i in others]) / scale[others]
    return Problem(R[:p, :p], R[:p, p], float(np.square(R[p:, p]).sum()), scale, parts, others, lower)


def _placeholder_factor(rows: Array, prior: Array) -> float:
    """How much heavier than the prior the bodies are by the torque they take, at least 1.

    URDFs are often given with masses that only hold a place. Deviations from such a prior are no multiples of it.
    """
    measured, explained = np.linalg.norm(rows[:, -1]), np.linalg.norm(rows[:, :-1] @ prior)
    return max(float(measured / explained), 1.0) if explained > 0 else 1.0


def weighted_rows(model: LinearModel, reduction: Reduction, noise: Array) -> Array:
    """All joints' factors over all coefficients, in units of their noise and per sample; shape (rows, p + 1)."""
    samples = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    p = len(model.coefficients)
    rows = np.zeros((sum(len(factor.R) for factor in reduction), p + 1))
    first = 0
    for factor, columns, sigma in zip(reduction, model.active(), noise, strict=True):
        last = first + len(factor.R)
        rows[first:last, [*columns, p]] = factor.R / (sigma * np.sqrt(samples))
        first = last
    return rows


def _floor(factor: Factor) -> float:
    """The least noise that a joint's torque is believed to have."""
    tau = float(np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.rows, 1)))
    return _LEAST_NOISE * tau or 1.0


def residual_noise(factor: Factor, theta: Array, share: float = 1.0) -> float:
    """Residual noise of a joint; ``share`` of the samples' freedom is left after the fit."""
    return max(float(np.sqrt(factor.squares(theta) / max(factor.rows, 1) / share)), _floor(factor))


def freedom(reduction: Reduction, rank: int) -> float:
    """Share of the independent samples that are left when a fit has taken ``rank`` of them, at least a half."""
    independent = sum(factor.independent for factor in reduction)
    return max(1 - rank / max(independent, 1.0), 0.5)


def free_noise(model: LinearModel, reduction: Reduction) -> Array:
    """What least squares leaves of each joint's torque, nothing constrained; shape (nv,).

    All joints weigh the same at first, then as much as the fit before says, so that a joint of much noise does not pass
    for noise of the others: iterated weighted least squares (Gautier 1997 takes one step). With fewer than two
    independent samples for each parameter that they determine, the torques themselves are the weights.
    """
    sigma = np.ones(len(reduction))
    for _ in range(_WEIGHINGS):
        rows = weighted_rows(model, reduction, sigma)
        size = np.linalg.norm(rows[:, :-1], axis=0)
        size[size == 0] = 1.0
        theta, _, rank, _ = np.linalg.lstsq(rows[:, :-1] / size, rows[:, -1], rcond=_RANK)
        theta = theta / size if sum(factor.independent for factor in reduction) >= 2 * rank else np.zeros_like(theta)
        share = freedom(reduction, int(rank))
        residuals = zip(reduction, model.active(), strict=True)
        sigma = np.array([residual_noise(factor, theta[columns], share) for factor, columns in residuals])
    return sigma

"""Weights of the joints: their noise, which is what a fit without constraints leaves of the torque.

Letters: p coefficients theta; sigma_j noise of joint j's torque [N·m or N].
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.linear_algebra import compressed_rows, least_squares
from idtool.common.units import STANDARD_GRAVITY
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import WRENCH_SIZE, RobotModel

_RANK = 1e-10  # of the largest singular value: what lies below is not determined
_WEIGHINGS = 2  # of the joints by their noise
_GUESSED_SHARE = 0.02  # of a joint's torque, or of the weight: first guess of the noise
_GUESSED_ARM = 0.1  # m, at which the noise of a force acts
_LEAST_NOISE = 1e-4  # of a joint's torque, so that data without noise have weights that the solver can handle


def weighted_rows(model: LinearModel, reduction: Reduction, noise: Array) -> Array:
    """Rows [Y, tau] over all coefficients, in units of the noise and per sample, shape (rows, p + 1).

    They are those of all joints or, if these are far more than there are coefficients, the triangular factor of them.
    """
    samples = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    p = len(model.coefficients)
    parts = []
    for factor, columns, sigma in zip(reduction, model.active(), noise.tolist(), strict=True):
        parts.append((factor.R / (sigma * np.sqrt(samples)), np.append(columns, p)))
    return compressed_rows(parts, p + 1)


def without_rounding(Y: Array, equation: LinearModel, rounding: float) -> Array:
    """Rows with zeros in columns that are rounding beside the other columns of their body, shape (rows, p).

    Parameters
    ----------
    Y
        The regressor's rows or their triangular factor.
    equation
        The torque equation.
    rounding
        Effect of a parameter of typical size, relative to the body's largest, below which it is zero.
    """
    effect = np.linalg.norm(Y, axis=0) * [c.scale or 0.0 for c in equation.coefficients]
    by_body = effect[: len(effect) // PI_SIZE * PI_SIZE].reshape(-1, PI_SIZE)
    is_rounding = (by_body > 0) & (by_body < rounding * by_body.max(axis=1, keepdims=True))
    zeroed = np.zeros(len(effect), dtype=bool)
    zeroed[: by_body.size] = is_rounding.ravel()
    return np.where(zeroed, 0.0, Y)


def _noise_floor(factor: Factor) -> float:
    """Smallest noise that a joint's torque is taken to have [N·m or N]."""
    tau = float(np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.rows, 1)))
    return _LEAST_NOISE * tau or 1.0


def residual_noise(factor: Factor, theta: Array, share: float = 1.0) -> float:
    """Residual noise of a joint [N·m or N]; ``share`` of the samples' degrees of freedom is left after the fit."""
    noise = float(np.sqrt(factor.squared_error(theta) / max(factor.rows, 1) / share))
    return max(noise, _noise_floor(factor))


def freedom_left(reduction: Reduction, rank: int) -> float:
    """Share of the independent samples that are left when a fit has taken ``rank`` of them, at least a half."""
    independent = sum(factor.independent for factor in reduction)
    return max(1 - rank / max(independent, 1.0), 0.5)


@dataclass(frozen=True)
class FreeFit:
    """Least squares without constraints except that copies are equal.

    Attributes
    ----------
    theta
        The coefficients, shape (p,); 0 if there are too few samples for them.
    noise
        Residual noise of each joint, shape (nv,) [N·m or N].
    has_enough_samples
        False with fewer than two independent samples for each parameter that the data determine.
    """

    theta: Array
    noise: Array
    has_enough_samples: bool


def free_noise(model: LinearModel, reduction: Reduction, equalities: EqualityConstraints | None = None) -> Array:
    """Residual noise of each joint under `free_fit`, shape (nv,) [N·m or N]."""
    return free_fit(model, reduction, equalities).noise


def free_fit(model: LinearModel, reduction: Reduction, equalities: EqualityConstraints | None = None) -> FreeFit:
    """Least squares with the joints weighted by their noise, which is determined with the coefficients.

    All joints weigh the same at first, then as much as the fit before says, so that a joint of much noise does not pass
    for noise of the others: iterated weighted least squares (Gautier 1997 takes one step). With fewer than two
    independent samples for each parameter that they determine, the torques themselves are the weights.
    """
    equalities = equalities or EqualityConstraints.none(len(model.coefficients))
    sigma = np.ones(len(reduction))
    independent = sum(factor.independent for factor in reduction)
    theta, has_enough_samples = np.zeros(len(model.coefficients)), False
    for _ in range(_WEIGHINGS):
        rows = weighted_rows(model, reduction, sigma)
        Y = equalities.free_columns(without_rounding(rows[:, :-1], model, _RANK))
        size = np.linalg.norm(Y, axis=0)
        size[size == 0] = 1.0
        z, rank = least_squares(Y / size, rows[:, -1], _RANK)
        has_enough_samples = independent >= 2 * rank > 0
        theta = equalities.K @ (z / size) if has_enough_samples else np.zeros(len(model.coefficients))
        share = freedom_left(reduction, rank)
        joints = zip(reduction, model.active(), strict=True)
        sigma = np.array([residual_noise(factor, theta[columns], share) for factor, columns in joints])
    return FreeFit(theta, sigma, has_enough_samples)


def initial_row_noise(model: RobotModel, torque: Array) -> Array:
    """First guess of the noise of every row, shape (nv,) [N or N·m].

    Parameters
    ----------
    model
        The tree of bodies.
    torque
        RMS torque of the joints, shape (joints,) [N·m or N].
    """
    weight = STANDARD_GRAVITY * max(model.mass, 1.0)
    force = _GUESSED_SHARE * weight
    typical = float(np.median(torque)) or 1.0
    joints = _GUESSED_SHARE * np.maximum(torque, 0.1 * typical)
    wrench = np.concatenate([np.full(3, force), np.full(3, force * _GUESSED_ARM)])
    return np.concatenate([joints, np.tile(wrench, (len(model.joints) - model.joint_count) // WRENCH_SIZE)])

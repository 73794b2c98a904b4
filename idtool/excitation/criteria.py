"""Criteria of optimal experiment design for the base parameters, and expected standard errors.

With rows W in units of noise, M = Wᵀ W is the information and C = M⁻¹ the covariance. Base parameters are in
units of their scales. Of C, or its block of the favoured parameters, the others being nuisance parameters:

    D  det(C)^(1/2n)      geometric mean of the standard errors along C's axes
    A  (tr(C) / n)^(1/2)  root of the mean square of the standard errors
    E  λ_max(C)^(1/2)     the largest standard error of any combination
    condition  (λ_max / λ_min)^(1/2), the condition number of W

The literature's D, A and E are monotonic functions of these; so their logarithms can be compared with one another.

Letters: r base parameters, p coefficients; W (rows, r), M and C (r, r).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import right_svd
from idtool.common.names import suggestion
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.uncertainty.base_parameters import BaseParameters

Criterion = Literal["d", "a", "e", "condition"]
CRITERIA: tuple[Criterion, ...] = ("d", "a", "e", "condition")

_NORM_POWER = 12  # of the smooth norm in place of the largest eigenvalue while searching
_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_ROUNDING = 1e-6  # of a coefficient or of a combination: less is rounding


@dataclass(frozen=True)
class DesignCriterion:
    """A criterion, and which base parameters it is for.

    Attributes
    ----------
    kind
        D, A, E or condition number.
    favoured
        Indices into the base parameters, shape (n,); all, or those to favour.
    """

    kind: Criterion
    favoured: Indices

    def value(self, M: Array, criterion: Criterion | None = None) -> float:
        """The criterion, or another one, of an information matrix (r, r); infinite where that is singular."""
        C = self._covariance(M)[np.ix_(self.favoured, self.favoured)]
        kind = criterion or self.kind
        variances = np.diag(C)
        if not np.isfinite(C).all() or variances.min() <= 0:
            return np.inf
        if kind == "d":
            return _geometric_mean_deviation(C)
        if kind == "a":
            return float(np.sqrt(variances.mean()))
        eigenvalues = np.linalg.eigvalsh(C)
        smallest, largest = eigenvalues[0], eigenvalues[-1]
        if kind == "e":
            return float(np.sqrt(largest))
        return float(np.sqrt(largest / smallest)) if smallest > 0 else np.inf

    def smooth_log(self, M: Array) -> tuple[float, Array]:
        """A smooth approximation of the criterion's logarithm, and its derivative by M, shape (r, r)."""
        C = self._covariance(M)
        block = np.ix_(self.favoured, self.favoured)
        eigenvalues, V = np.linalg.eigh(C[block])
        eigenvalues = np.maximum(eigenvalues, np.finfo(float).tiny)
        value, by_eigenvalue = self._log_of_eigenvalues(eigenvalues)
        by_C = np.zeros_like(C)
        by_C[block] = (V * by_eigenvalue) @ V.T
        return value, -C @ by_C @ C

    def _log_of_eigenvalues(self, L: Array) -> tuple[float, Array]:
        """Logarithm of the criterion from the covariance's eigenvalues L, shape (n,), and its derivative by them."""
        if self.kind == "d":
            return float(np.log(L).mean() / 2), 1 / (2 * len(L) * L)
        if self.kind == "a":
            return float(np.log(L.mean()) / 2), np.full(len(L), 1 / (2 * L.sum()))
        log_largest, by_L = _log_norm(L)
        if self.kind == "e":
            return log_largest / 2, by_L / 2
        log_inverse, by_inverse = _log_norm(1 / L)
        return (log_largest + log_inverse) / 2, (by_L - by_inverse / L**2) / 2

    @staticmethod
    def _covariance(M: Array) -> Array:
        """Inverse of an information matrix (r, r), by columns of norm one; NaN where it is singular."""
        norms = np.sqrt(np.diag(M))
        if norms.min() <= 0:
            return np.full_like(M, np.nan)
        scale = np.outer(norms, norms)
        try:
            C = np.linalg.inv(M / scale) / scale
        except np.linalg.LinAlgError:
            return np.full_like(M, np.nan)
        return np.asarray((C + C.T) / 2)


def _geometric_mean_deviation(C: Array) -> float:
    """Square root of the geometric mean of a covariance's eigenvalues; infinite if it is not positive definite.

    By Cholesky factors of the correlation: the smallest eigenvalues of C may be below the rounding of the largest.
    """
    deviations = np.sqrt(np.diag(C))
    try:
        factor = np.linalg.cholesky(C / np.outer(deviations, deviations))
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.exp(np.log(deviations * np.diag(factor)).mean()))


def _log_norm(L: Array) -> tuple[float, Array]:
    """Logarithm of (Σ L^p)^(1/p), which is nearly the largest, and its derivative."""
    powers = (L / L.max()) ** _NORM_POWER
    value = float(np.log(L.max()) + np.log(powers.sum()) / _NORM_POWER)
    return value, powers / powers.sum() / L


class BaseColumns:
    """Map from the regressor's columns to those of the base parameters, joint by joint.

    Attributes
    ----------
    joint_columns
        Indices of the base parameters in each joint's equation, shape (r_j,) each.
    size
        Number of base parameters r.

    Parameters
    ----------
    equation
        The torque equation.
    base
        Its base parameters.
    equalities
        Constraints between coefficients: copies share their columns.
    """

    def __init__(self, equation: LinearModel, base: BaseParameters, equalities: EqualityConstraints) -> None:
        K = equalities.K[:, np.searchsorted(equalities.free, base.own)]  # (p, r)
        self.size = len(base)
        self.joint_columns: list[Indices] = []
        self._projections: list[Array] = []  # (r_j, m_j) per joint
        for active in equation.active():
            rows = K[active]
            columns = np.flatnonzero(rows.any(axis=0))
            self.joint_columns.append(columns)
            self._projections.append(np.ascontiguousarray(rows[:, columns].T))

    def project(self, joint: int, columns: Array) -> Array:
        """Columns of the base parameters in ``joint_columns[joint]``, (r_j, N), from the equation's own, (m_j, N)."""
        return self._projections[joint] @ columns

    def project_gradient(self, joint: int, by: Array) -> Array:
        """Derivatives by the equation's columns (m_j, N) from those by the base parameters' columns (r_j, N)."""
        return self._projections[joint].T @ by

    def rows(self, reduction: Reduction, noise: Array) -> Array:
        """The data's rows in units of noise, W (rows, r), weighted by their number of independent samples."""
        rows = []
        for j, (factor, sigma) in enumerate(zip(reduction, noise, strict=True)):
            weight = np.sqrt(factor.independent / max(factor.rows, 1)) / sigma
            W = np.zeros((len(factor.R), self.size))
            W[:, self.joint_columns[j]] = self.project(j, factor.R[:, :-1].T).T * weight
            rows.append(W)
        return np.concatenate(rows)


@dataclass(frozen=True)
class StandardErrors:
    """Standard errors of least squares on rows in units of noise.

    Attributes
    ----------
    base
        Of the base parameters, shape (r,), infinite where the rows do not determine them.
    coefficients
        Of the coefficients, shape (p,), infinite where no motion determines the coefficient by itself.
    """

    base: Array
    coefficients: Array


def expected_standard_errors(W: Array, base: BaseParameters) -> StandardErrors:
    """Standard errors from rows in units of noise.

    Parameters
    ----------
    W
        Shape (rows, r).
    base
        The base parameters. A coefficient that is a combination g of them has the standard error (gᵀ C g)^(1/2).
    """
    norms = np.linalg.norm(W, axis=0)
    norms[norms == 0] = 1.0
    s, Vt = right_svd(np.linalg.qr(W / norms, mode="r"))
    rank = int(np.count_nonzero(s > _RANK * s[0])) if len(s) else 0
    root = Vt[:rank].T / s[:rank] / norms[:, None]  # C = root rootᵀ
    is_undetermined = np.square(Vt[rank:]).sum(axis=0) > _RANK

    # Each coefficient as a combination of the base parameters, where it is one.
    G = np.linalg.lstsq(base.B.T, np.eye(base.B.shape[1]), rcond=None)[0].T  # (p, r)
    is_combination = np.abs(G @ base.B - np.eye(len(G))).max(axis=1) < _ROUNDING
    largest = np.abs(G).max(axis=1, initial=_ROUNDING, keepdims=True)
    G[np.abs(G) < _ROUNDING * largest] = 0.0
    depends_on_undetermined = (G[:, is_undetermined] != 0).any(axis=1)
    is_determined = is_combination & ~depends_on_undetermined
    return StandardErrors(
        base=np.where(is_undetermined, np.inf, np.linalg.norm(root, axis=1)),
        coefficients=np.where(is_determined, np.linalg.norm(G @ root, axis=1), np.inf),
    )


def base_parameter_scales(base: BaseParameters, equation: LinearModel, typical: Array) -> Array:
    """Units in which the base parameters are measured, shape (r,).

    Parameters
    ----------
    base
        The base parameters.
    equation
        The torque equation, whose coefficients have scales; for those that have none, the prior's magnitude counts.
    typical
        Scale where both are missing or zero, shape (p,).
    """
    scale = np.array([c.scale if c.scale is not None else abs(c.prior) for c in equation.coefficients])
    scale = np.where(scale > 0, scale, typical)
    return np.asarray(np.linalg.norm(base.B * scale, axis=1))


def favoured_indices(names: Sequence[str], base: BaseParameters, equation: LinearModel) -> Indices:
    """Indices of the base parameters that the names stand for; without a name, of all.

    Parameters
    ----------
    names
        Each a body, a joint (its friction and other terms), an effect of a joint as in ``hip.coulomb``, or a body's
        parameter as in ``thigh.mc_x``.
    base, equation
        The base parameters of a torque equation.

    Raises
    ------
    ConfigError
        If a name is unknown, or stands for nothing that any motion could determine.
    """
    if not names:
        return np.arange(len(base))
    coefficients_of: dict[str, list[int]] = {}
    for i, c in enumerate(equation.coefficients):
        coefficients_of.setdefault(c.owner, []).append(i)
        coefficients_of.setdefault(f"{c.owner}.{c.name}", []).append(i)
    is_favoured = np.zeros(len(base), dtype=bool)
    for name in names:
        if name not in coefficients_of:
            hint = suggestion(name, list(coefficients_of))
            raise ConfigError("--favour", f"{name} is not a body, joint or coefficient; {hint}")
        indices = coefficients_of[name]
        matches = np.isin(base.own, indices)  # base parameters with that name
        if not matches.any():
            matches = (base.B[:, indices] != 0).any(axis=1)  # that contain it
        if not matches.any():
            raise ConfigError("--favour", f"the torque does not depend on {name}: no motion can determine it")
        is_favoured |= matches
    return np.flatnonzero(is_favoured)

"""What a motion tells of the base parameters, as one number to be made small, and as standard errors.

With rows W in units of noise, M = Wᵀ W is the information and C = M⁻¹ the covariance. Base parameters are taken in
units of their sizes. Of C, or its part that belongs to the favoured ones, the others being nuisance:

    D  det(C)^(1/2n)      geometric mean of the standard errors along C's axes
    A  (tr(C) / n)^(1/2)  root of the mean square of the standard errors
    E  λ_max(C)^(1/2)     the largest standard error of any combination
    condition  (λ_max / λ_min)^(1/2), the condition number of W

The literature's D, A and E are monotonic functions of these; so their logarithms can be compared with one another.

Letters: r base parameters, p coefficients; W (rows, r), M and C (r, r).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import svd
from idtool.common.names import nearest
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.uncertainty.base_parameters import BaseParameters

Criterion = Literal["d", "a", "e", "condition"]
CRITERIA: tuple[Criterion, ...] = ("d", "a", "e", "condition")

_POWER = 12  # of the norm that stands in for the largest eigenvalue while searching
_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_ALONE = 1e-6  # of a coefficient: less of it, or of a combination, is rounding


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
        if not np.isfinite(C).all():
            return np.inf
        L = np.linalg.eigvalsh(C)
        if L[0] <= 0:
            return np.inf
        if kind == "d":
            return float(np.exp(np.log(L).mean() / 2))
        if kind == "a":
            return float(np.sqrt(L.mean()))
        return float(np.sqrt(L[-1] / (L[0] if kind == "condition" else 1.0)))

    def smooth_log(self, M: Array) -> tuple[float, Array]:
        """A smooth stand-in for the criterion's logarithm, and its derivative by M, shape (r, r)."""
        C = self._covariance(M)
        some = np.ix_(self.favoured, self.favoured)
        L, V = np.linalg.eigh(C[some])
        L = np.maximum(L, np.finfo(float).tiny)
        value, by_L = self._of_eigenvalues(L)
        F = np.zeros_like(C)
        F[some] = (V * by_L) @ V.T
        return value, -C @ F @ C

    def _of_eigenvalues(self, L: Array) -> tuple[float, Array]:
        if self.kind == "d":
            return float(np.log(L).mean() / 2), 1 / (2 * len(L) * L)
        if self.kind == "a":
            return float(np.log(L.mean()) / 2), np.full(len(L), 1 / (2 * L.sum()))
        value, by_L = _norm(L)
        if self.kind == "e":
            return value / 2, by_L / 2
        inverse, by_inverse = _norm(1 / L)
        return (value + inverse) / 2, (by_L - by_inverse / L**2) / 2

    @staticmethod
    def _covariance(M: Array) -> Array:
        try:
            C = np.linalg.inv(M)
        except np.linalg.LinAlgError:
            return np.full_like(M, np.nan)
        return np.asarray((C + C.T) / 2)


def _norm(L: Array) -> tuple[float, Array]:
    """Logarithm of (Σ L^p)^(1/p), which is nearly the largest, and its derivative."""
    share = (L / L.max()) ** _POWER
    return float(np.log(L.max()) + np.log(share.sum()) / _POWER), share / share.sum() / L


class BaseColumns:
    """From the regressor's columns to those of the base parameters, joint by joint.

    Parameters
    ----------
    equation
        The torque equation.
    base
        Its base parameters.
    equalities
        Whose copies share their columns.
    """

    def __init__(self, equation: LinearModel, base: BaseParameters, equalities: EqualityConstraints) -> None:
        place = np.searchsorted(equalities.free, base.own)
        K = equalities.K[:, place]  # (p, r)
        self.joint_columns: list[Indices] = []  # per joint, which of the r appear in its equation
        self._shares: list[Array] = []
        for active in equation.active():
            rows = K[active]
            self.joint_columns.append(np.flatnonzero(rows.any(axis=0)))
            self._shares.append(np.ascontiguousarray(rows[:, self.joint_columns[-1]].T))
        self.size = len(base)

    def project(self, joint: int, columns: Array) -> Array:
        """Columns (m_j, N) of a joint's equation → those of the base parameters in ``own[joint]``, (r_j, N)."""
        return self._shares[joint] @ columns

    def project_gradient(self, joint: int, by: Array) -> Array:
        """Derivatives by the base parameters' columns (r_j, N) → by the equation's columns (m_j, N)."""
        return self._shares[joint].T @ by

    def rows(self, reduction: Reduction, noise: Array) -> Array:
        """The data's rows in units of noise, W (rows, r), each worth one independent sample."""
        rows = []
        for j, (factor, sigma) in enumerate(zip(reduction, noise, strict=True)):
            W = np.zeros((len(factor.R), self.size))
            worth = np.sqrt(factor.independent / max(factor.rows, 1)) / sigma
            W[:, self.joint_columns[j]] = self.project(j, factor.R[:, :-1].T).T * worth
            rows.append(W)
        return np.concatenate(rows)


@dataclass(frozen=True)
class StandardErrors:
    """What least squares on rows in units of noise would be off by.

    Attributes
    ----------
    base
        Standard errors of the base parameters, shape (r,), infinite where the rows do not tell.
    coefficients
        Of the coefficients, shape (p,), infinite where no motion tells the coefficient by itself.
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
    size = np.linalg.norm(W, axis=0)
    size[size == 0] = 1.0
    _, s, Vt = svd(np.linalg.qr(W / size, mode="r"), full=True)
    rank = int(np.count_nonzero(s > _RANK * s[0])) if len(s) else 0
    root = Vt[:rank].T / s[:rank] / size[:, None]  # C = root rootᵀ
    unseen = np.square(Vt[rank:]).sum(axis=0) > _RANK
    G = np.linalg.lstsq(base.B.T, np.eye(base.B.shape[1]), rcond=None)[0].T  # (p, r)
    alone = np.abs(G @ base.B - np.eye(len(G))).max(axis=1) < _ALONE
    G[np.abs(G) < _ALONE * np.abs(G).max(axis=1, initial=_ALONE, keepdims=True)] = 0.0
    told = alone & ~(G[:, unseen] != 0).any(axis=1)
    return StandardErrors(
        base=np.where(unseen, np.inf, np.linalg.norm(root, axis=1)),
        coefficients=np.where(told, np.linalg.norm(G @ root, axis=1), np.inf),
    )


def base_parameter_scales(base: BaseParameters, equation: LinearModel, typical: Array) -> Array:
    """Units in which the base parameters are measured, shape (r,).

    Parameters
    ----------
    base
        The base parameters.
    equation
        Whose coefficients have scales, by the prior; of those that have none, the prior's value counts.
    typical
        What to take where the prior has neither, shape (p,).
    """
    coefficients = equation.coefficients
    scale = np.array([c.scale if c.scale is not None else abs(c.prior) for c in coefficients])
    scale = np.where(scale > 0, scale, typical)
    return np.asarray(np.linalg.norm(base.B * scale, axis=1))


def favoured_indices(names: Sequence[str], base: BaseParameters, equation: LinearModel) -> Indices:
    """Indices of the base parameters that are meant; all without a name.

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
        If a name means nothing, or nothing that any motion could tell.
    """
    if not names:
        return np.arange(len(base))
    means: dict[str, list[int]] = {}
    for i, c in enumerate(equation.coefficients):
        for label in (c.owner, f"{c.owner}.{c.name}"):
            means.setdefault(label, []).append(i)
    chosen = np.zeros(len(base), dtype=bool)
    for name in names:
        if name not in means:
            raise ConfigError("--favour", f"{name} is no body, joint or coefficient; {nearest(name, list(means))}")
        called = np.isin(base.own, means[name])
        with_any = called if called.any() else base.B[:, means[name]].any(axis=1)
        if not with_any.any():
            raise ConfigError("--favour", f"the torque does not depend on {name}: no motion could tell it")
        chosen |= with_any
    return np.flatnonzero(chosen)

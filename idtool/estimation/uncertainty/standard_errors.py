"""Standard errors of the coefficients, and which of them the data determine at all.

Letters: p coefficients theta, p' of them free; r directions that the data determine, theta = observable y +
unobservable u, such that the information of all rows on y, in units of the joints' noise, is 1.
"""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.linear_algebra import null_space, right_svd
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows, without_rounding

_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_LEAST_EFFECT = 1e-4  # of a coefficient of typical size on all rows together, in units of their noise
_UNOBSERVABLE_SHARE = 1e-6  # of a coefficient, squared, that may lie in unobservable directions
CONFIDENCE = 0.95  # of intervals


@dataclass(frozen=True)
class Directions:
    """Observable and unobservable directions of the coefficients.

    Attributes
    ----------
    observable
        Changes of theta by unit steps of y, shape (p, r).
    unobservable
        Changes of theta that change no row, shape (p, p' − r).
    singular_values
        Of the rows with columns scaled to norm one, shape (r,).
    soft
        Information of measured constraints on y, shape (r, r).
    independent_per_row
        Number of independent rows that a row is worth, mean over the joints.
    independent
        Number of independent rows, mean over the joints.
    """

    observable: Array
    unobservable: Array
    singular_values: Array
    soft: Array
    independent_per_row: float
    independent: float

    def determines(self, rows: Array) -> Mask:
        """True for combinations of the coefficients that the data determine, shape (k, p) to (k,)."""
        seen = np.square(rows @ self.observable * self.singular_values).sum(axis=1)
        unseen = np.square(rows @ self.unobservable).sum(axis=1)
        return np.asarray((unseen <= _UNOBSERVABLE_SHARE * (seen + unseen)) & (seen > 0))


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the coefficients from the data alone, without prior and inequalities.

    Attributes
    ----------
    directions
        Observable and unobservable directions.
    identifiable
        True for coefficients that the data determine, shape (p,).
    covariance_y
        Covariance of the errors of y, shape (r, r).
    cluster_information
        Information on y of each of the B clusters of samples that the covariance was estimated from, shape (B, r, r);
        none where it follows from the number of independent rows alone.
    """

    directions: Directions
    identifiable: Mask
    covariance_y: Array
    cluster_information: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @cached_property
    def standard_error(self) -> Array:
        """Shape (p,), SI; infinite where the data do not determine the coefficient."""
        return np.where(self.identifiable, self._errors(self.directions.observable), np.inf)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of theta, shape (p, p), SI; infinite on the diagonal where the data do not determine it."""
        observable = self.directions.observable
        covariance = observable @ self.covariance_y @ observable.T
        covariance[~self.identifiable, ~self.identifiable] = np.inf
        return np.asarray(covariance)

    def with_common_error(self, change: Array) -> Uncertainty:
        """The uncertainty with one more, independent error, by which all coefficients change together.

        Parameters
        ----------
        change
            By one standard error of it, shape (p,).
        """
        singular_values = self.directions.singular_values
        directions = np.column_stack([self.directions.observable * singular_values, self.directions.unobservable])
        size = np.abs(directions).max(axis=1, initial=np.finfo(float).tiny)
        steps = np.linalg.lstsq(directions / size[:, None], change / size, rcond=None)[0]
        y = steps[: len(singular_values)] * singular_values
        return replace(self, covariance_y=self.covariance_y + np.outer(y, y))

    def of_combinations(self, M: Array) -> Uncertainty:
        """The uncertainty of combinations M theta of the coefficients, M (k, p)."""
        directions = replace(
            self.directions, observable=M @ self.directions.observable, unobservable=M @ self.directions.unobservable
        )
        is_determined = ~((M != 0) @ ~self.identifiable)
        return replace(self, directions=directions, identifiable=is_determined)

    def of(self, rows: Array) -> Array:
        """Standard errors of combinations of the coefficients.

        Parameters
        ----------
        rows
            The combinations, shape (k, p).

        Returns
        -------
        Shape (k,); infinite where the data do not determine the combination.
        """
        errors = self._errors(rows @ self.directions.observable)
        return np.where(self.directions.determines(rows), errors, np.inf)

    def degrees_of_freedom(self, rows: Array) -> Array:
        """Degrees of freedom of the standard errors of combinations, shape (k, p) to (k,).

        They are Satterthwaite's, at least 1 (Bell & McCaffrey 2002). They are fewer if some clusters hold most of the
        information on a combination. They are more if measured constraints, whose errors are given, hold part of it.
        Infinite where the covariance was not estimated from clusters.
        """
        if not len(self.cluster_information):
            return np.full(len(rows), np.inf)
        in_y = rows @ self.directions.observable
        columns = [_quadratic_form(in_y, information) for information in self.cluster_information]
        by_cluster = np.column_stack(columns)
        cluster_information = by_cluster.sum(axis=1)
        constraint_information = _quadratic_form(in_y, self.directions.soft)
        total = cluster_information + constraint_information
        sum_of_squares = np.square(by_cluster).sum(axis=1)
        effective_clusters = np.square(cluster_information) / np.where(sum_of_squares > 0, sum_of_squares, 1.0)
        of_clusters_alone = np.maximum(effective_clusters - 1, 1.0)
        cluster_share = np.divide(cluster_information, total, out=np.ones_like(total), where=total > 0)
        with np.errstate(divide="ignore"):  # infinite where constraints, of known variance, hold all information
            return np.asarray(of_clusters_alone / np.square(cluster_share))

    def coverage_factor(self, rows: Array) -> Array:
        """Half the width of the 95 % interval of combinations in standard errors, by Student's t; (k, p) to (k,)."""
        return np.asarray(stdtrit(self.degrees_of_freedom(rows), 0.5 + CONFIDENCE / 2))

    def _errors(self, in_y: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", in_y, self.covariance_y, in_y, optimize=True)))


def _quadratic_form(x: Array, A: Array) -> Array:
    """xᵀ A x of each row x, shape (k, r) to (k,)."""
    return np.asarray(np.einsum("ki,ki->k", x @ A, x))


def observable_directions(
    model: LinearModel, reduction: Reduction, noise: Array, equalities: EqualityConstraints
) -> Directions:
    """Directions of the coefficients that the data and the equality constraints determine, and the others.

    Parameters
    ----------
    model
        The torque equation.
    reduction
        The data.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    equalities
        The equality constraints.
    """
    p = len(model.coefficients)
    rows = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    independent = sum(factor.independent for factor in reduction) / len(reduction)
    independent_per_row = independent / rows if independent else 1.0

    soft = equalities.soft_rows()[:, :p] / np.sqrt(independent_per_row)  # each is one independent row
    measured = without_rounding(whitened_rows(model, reduction, noise), model, _RANK)
    measured = _without_negligible(measured, model)
    W = equalities.free_columns(np.concatenate([soft, measured]))
    size = np.linalg.norm(W, axis=0)
    size[size == 0] = 1.0

    exact = np.array([constraint.row @ equalities.K / size for constraint in equalities.hard]).reshape(-1, len(size))
    N = null_space(exact)
    s, Vt = right_svd(W / size @ N)
    rank = int(np.count_nonzero(s > _RANK * s[0])) if len(s) else 0

    directions = equalities.K @ (Vt @ N.T / size).T
    observable = directions[:, :rank] / s[:rank]
    soft_in_y = soft @ observable
    return Directions(
        observable, directions[:, rank:], s[:rank], soft_in_y.T @ soft_in_y, independent_per_row, independent
    )


def _without_negligible(whitened: Array, model: LinearModel) -> Array:
    """Whitened rows with zeros in columns that are far below the noise, shape (rows, p).

    Unknown contact forces that explain a column leave the rounding of their elimination of it.
    """
    scale = np.array([c.scale or 0.0 for c in model.coefficients])
    effect = np.linalg.norm(whitened, axis=0) * scale
    is_negligible = (effect < _LEAST_EFFECT) & (scale > 0)
    return np.where(is_negligible, 0.0, whitened)


def whitened_rows(model: LinearModel, reduction: Reduction, noise: Array) -> Array:
    """Regressor rows of all joints over all coefficients in units of the noise, without torque, shape (rows, p).

    As many as `weighted_rows` gives.
    """
    samples = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    return np.asarray(weighted_rows(model, reduction, noise)[:, :-1] * np.sqrt(samples))


def identifiable(directions: Directions, equalities: EqualityConstraints) -> Mask:
    """True for coefficients that the data or exact constraints determine, shape (p,); copies as their originals."""
    undetermined = ~directions.determines(np.eye(len(equalities.K))[equalities.free])
    undetermined &= ~_known_exactly(equalities)
    return np.asarray(~((equalities.K != 0) @ undetermined))


def _known_exactly(equalities: EqualityConstraints) -> Mask:
    """True for free coefficients that exact constraints fix, shape (p',)."""
    if not equalities.hard:
        return np.zeros(len(equalities.free), dtype=bool)
    exact = np.array([constraint.row @ equalities.K for constraint in equalities.hard])
    exact = exact / np.linalg.norm(exact, axis=1, keepdims=True)
    return np.asarray(np.square(null_space(exact)).sum(axis=1) < _UNOBSERVABLE_SHARE)


def least_squares_uncertainty(
    model: LinearModel, reduction: Reduction, noise: Array, equalities: EqualityConstraints | None = None
) -> Uncertainty:
    """Uncertainty of weighted least squares with equality constraints, without prior and inequalities.

    Filtered samples repeat each other, so rows count by how many independent ones they are worth. That holds where the
    residual is white noise that went through the filter; `cluster_robust_estimate` takes its standard errors from the
    residual itself.

    Parameters
    ----------
    model
        The torque equation.
    reduction
        The data.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    equalities
        The equality constraints; default: none.
    """
    equalities = equalities or EqualityConstraints.none(len(model.coefficients))
    directions = observable_directions(model, reduction, noise, equalities)
    covariance_y = np.eye(len(directions.singular_values)) / directions.independent_per_row
    return Uncertainty(directions, identifiable(directions, equalities), covariance_y)

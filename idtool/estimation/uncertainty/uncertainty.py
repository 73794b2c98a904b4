"""What the data say of each coefficient: whether they determine it, and how far it may be off.

Letters: p coefficients theta, p' of them free; r directions that the data see, theta = visible y + hidden u, such that
the information of all rows on y, in units of the joints' noise, is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.linalg import null_space

from idtool.common.arrays import Array, Mask
from idtool.common.linear_algebra import svd
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.uncertainty.base import felt

_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_SHARE = 1e-6  # of a coefficient may lie in the directions that the data do not see
CONFIDENCE = 0.95  # of intervals


@dataclass(frozen=True)
class Directions:
    """What the data see and what they do not.

    Attributes
    ----------
    visible
        Changes of theta by unit steps of y, shape (p, r).
    hidden
        Changes of theta that the data do not see, shape (p, p' − r).
    gain
        By how much a unit step of y is smaller than one in units of the columns' sizes, shape (r,).
    soft
        Information on y of what is known with a standard error, shape (r, r).
    worth
        Of how many independent rows a row is worth, one joint with another.
    independent
        How many independent rows there are, one joint with another.
    """

    visible: Array
    hidden: Array
    gain: Array
    soft: Array
    worth: float
    independent: float

    def sees(self, rows: Array) -> Mask:
        """Whether the data determine combinations of the coefficients, shape (k, p) to (k,)."""
        seen = np.square(rows @ self.visible * self.gain).sum(axis=1)
        unseen = np.square(rows @ self.hidden).sum(axis=1)
        return np.asarray((unseen <= _SHARE * (seen + unseen)) & (seen > 0))


@dataclass(frozen=True)
class Uncertainty:
    """How far the data alone, without prior and inequalities, determine each coefficient.

    Attributes
    ----------
    directions
        What they see.
    identifiable
        Whether they determine the coefficient, shape (p,).
    spread
        Covariance of the errors of y, shape (r, r).
    shares
        Information on y of each block of time that the spread was estimated from, shape (B, r, r); none where it
        follows from the number of independent rows alone.
    """

    directions: Directions
    identifiable: Mask
    spread: Array
    shares: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @property
    def standard_error(self) -> Array:
        """Shape (p,), SI; infinite where the data do not determine the coefficient."""
        return np.where(self.identifiable, self._errors(self.directions.visible), np.inf)

    @property
    def covariance(self) -> Array:
        """Of the errors, shape (p, p), SI; infinite on the diagonal where the data do not determine the coefficient."""
        visible = self.directions.visible
        covariance = visible @ self.spread @ visible.T
        covariance[~self.identifiable, ~self.identifiable] = np.inf
        return np.asarray(covariance)

    def with_error(self, change: Array) -> Uncertainty:
        """The same with an error by which all coefficients change together.

        Parameters
        ----------
        change
            By one standard error of it, shape (p,).
        """
        seen = self.directions
        ways = np.column_stack([seen.visible * seen.gain, seen.hidden])
        size = np.abs(ways).max(axis=1, initial=np.finfo(float).tiny)
        steps = np.linalg.lstsq(ways / size[:, None], change / size, rcond=None)[0]
        y = steps[: len(seen.gain)] * seen.gain
        return replace(self, spread=self.spread + np.outer(y, y))

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
        return np.where(self.directions.sees(rows), self._errors(rows @ self.directions.visible), np.inf)

    def freedom(self, rows: Array) -> Array:
        """Degrees of freedom of the standard errors of combinations, shape (k, p) to (k,).

        Blocks are few, and fewer where some of them hold most of what is known of a combination: Satterthwaite's, at
        least 1 (Bell & McCaffrey 2002). Infinite where the spread was not estimated from blocks.
        """
        if not len(self.shares):
            return np.full(len(rows), np.inf)
        seen = rows @ self.directions.visible
        held = np.column_stack([np.einsum("ki,ki->k", seen @ share, seen) for share in self.shares])
        squares = np.square(held).sum(axis=1)
        return np.asarray(np.maximum(np.square(held.sum(axis=1)) / np.where(squares > 0, squares, 1.0) - 1, 1.0))

    def reach(self, rows: Array) -> Array:
        """Half the width of the 95 % interval of combinations in standard errors, by Student's t; (k, p) to (k,)."""
        return np.asarray(stats.t.ppf(0.5 + CONFIDENCE / 2, self.freedom(rows)))

    def _errors(self, seen: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", seen, self.spread, seen, optimize=True)))


def directions(model: LinearModel, reduction: Reduction, noise: Array, known: Knowledge) -> Directions:
    """What the data and what is known otherwise see.

    Parameters
    ----------
    model
        The torque equation.
    reduction
        The data.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    known
        What is known otherwise.
    """
    p = len(model.coefficients)
    rows = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    independent = sum(factor.independent for factor in reduction) / len(reduction)
    worth = independent / rows if independent else 1.0
    soft = known.soft_rows()[:, :p] / np.sqrt(worth)  # of which each is one
    measured = felt(np.concatenate(weighed(model, reduction, noise)), model, _RANK)
    W = np.concatenate([soft, measured]) @ known.K
    size = np.linalg.norm(W, axis=0)
    size[size == 0] = 1.0
    exact = np.array([fact.row @ known.K / size for fact in known.hard]).reshape(-1, len(size))
    N = null_space(exact) if len(exact) else np.eye(len(size))
    _, s, Vt = svd(W / size @ N, full=True)
    rank = int(np.count_nonzero(s > _RANK * s[0])) if len(s) else 0
    ways = known.K @ (Vt @ N.T / size).T
    visible = ways[:, :rank] / s[:rank]
    told = soft @ visible
    return Directions(visible, ways[:, rank:], s[:rank], told.T @ told, worth, independent)


def weighed(model: LinearModel, reduction: Reduction, noise: Array) -> list[Array]:
    """Each joint's rows over all coefficients in units of its noise, the torque not among them; shape (n_j, p) each."""
    found = []
    for factor, columns, sigma in zip(reduction, model.active(), noise, strict=True):
        rows = np.zeros((len(factor.R), len(model.coefficients)))
        rows[:, columns] = factor.R[:, :-1] / sigma
        found.append(rows)
    return found


def identifiable(seen: Directions, known: Knowledge) -> Mask:
    """Whether the data determine each coefficient or it is known exactly, shape (p,); copies are as originals."""
    doubtful = ~seen.sees(np.eye(len(known.K))[known.free])
    fixed = _fixed(known)
    return np.asarray(~((known.K != 0) @ (doubtful & ~fixed)))


def _fixed(known: Knowledge) -> Mask:
    """Which free coefficients are known exactly, shape (p',)."""
    if not known.hard:
        return np.zeros(len(known.free), dtype=bool)
    exact = np.array([fact.row @ known.K for fact in known.hard])
    exact = exact / np.linalg.norm(exact, axis=1, keepdims=True)
    return np.asarray(np.square(null_space(exact)).sum(axis=1) < _SHARE)


def uncertainty(model: LinearModel, reduction: Reduction, noise: Array, known: Knowledge | None = None) -> Uncertainty:
    """Standard errors of weighted least squares with what is known otherwise, without prior and inequalities.

    Filtered samples repeat each other, so rows count by how many independent ones they are worth. That holds where the
    residual is white noise that went through the filter; `scatter` asks the residual itself.

    Parameters
    ----------
    model
        The torque equation.
    reduction
        The data.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    known
        What is known otherwise; default: nothing.
    """
    known = known or Knowledge.none(len(model.coefficients))
    seen = directions(model, reduction, noise, known)
    return Uncertainty(seen, identifiable(seen, known), np.eye(len(seen.gain)) / seen.worth)

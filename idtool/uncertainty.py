"""What the data say of each coefficient: standard errors, and whether the data determine it at all.

Letters: p coefficients; W (rows, p) the R-factors of all joints in units of noise, worth one row an independent sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from idtool.knowledge import Knowledge
from idtool.reduction import Reduction
from idtool.regressor import LinearModel

Array = NDArray[np.float64]

_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_SHARE = 1e-6  # of a coefficient may lie in the directions that the data do not see


@dataclass(frozen=True)
class Uncertainty:
    """How far the data alone determine each coefficient.

    Attributes
    ----------
    standard_error
        Shape (p,), SI; infinite where the data do not determine the coefficient.
    identifiable
        Whether they do, shape (p,).
    covariance
        Of their errors, shape (p, p), SI; infinite on the diagonal where the data do not determine the coefficient.
    """

    standard_error: Array
    identifiable: NDArray[np.bool_]
    covariance: Array


def uncertainty(model: LinearModel, reduction: Reduction, noise: Array, known: Knowledge | None = None) -> Uncertainty:
    """Standard errors of weighted least squares with what is known otherwise, without prior and inequalities.

    Filtered samples repeat each other, so rows count by how many independent ones they are worth.

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
    p = len(model.coefficients)
    known = known or Knowledge.none(p)
    rows = [known.soft_rows()[:, :p]]
    for factor, columns, sigma in zip(reduction, model.active(), noise, strict=True):
        W = np.zeros((len(factor.R), p))
        W[:, columns] = factor.R[:, :-1] * np.sqrt(factor.independent / max(factor.rows, 1)) / sigma
        rows.append(W)
    W = np.concatenate(rows) @ known.K
    size = np.linalg.norm(W, axis=0)
    seen = size > 0
    size[~seen] = 1.0
    exact = np.array([fact.row @ known.K / size for fact in known.hard]).reshape(-1, len(size))
    N = null_space(exact) if len(exact) else np.eye(len(size))
    _, s, Vt = np.linalg.svd(W / size @ N, full_matrices=True)
    rank = int(np.count_nonzero(s > _RANK * s[0])) if len(s) else 0
    directions = Vt @ N.T
    unseen = np.square(directions[rank:]).sum(axis=0)
    fixed = np.square(N).sum(axis=1) < _SHARE
    doubtful = ~((unseen < _SHARE) & (seen | fixed))
    identifiable = ~((known.K != 0) @ doubtful)  # a copy is what its original is
    root = known.K @ (directions[:rank] / s[:rank, None] / size).T
    covariance = root @ root.T
    covariance[~identifiable, ~identifiable] = np.inf
    return Uncertainty(np.sqrt(np.diag(covariance)), identifiable, covariance)

"""What the data say of each coefficient: standard errors, and whether the data determine it at all.

Letters: p coefficients; W (rows, p) the R-factors of all joints in units of noise, worth one row an independent sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    """

    standard_error: Array
    identifiable: NDArray[np.bool_]


def uncertainty(model: LinearModel, reduction: Reduction, noise: Array) -> Uncertainty:
    """Standard errors of weighted least squares, without prior and constraints.

    Filtered samples repeat each other, so rows count by how many independent ones they are worth.

    Parameters
    ----------
    model
        The torque equation.
    reduction
        The data.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    """
    p = len(model.coefficients)
    rows = []
    for factor, columns, sigma in zip(reduction, model.active(), noise, strict=True):
        W = np.zeros((len(factor.R), p))
        W[:, columns] = factor.R[:, :-1] * np.sqrt(factor.independent / max(factor.rows, 1)) / sigma
        rows.append(W)
    W = np.concatenate(rows)
    size = np.linalg.norm(W, axis=0)
    size[size == 0] = 1.0
    _, s, Vt = np.linalg.svd(W / size, full_matrices=True)
    rank = int(np.count_nonzero(s > _RANK * s[0])) if len(s) else 0
    unseen = np.square(Vt[rank:]).sum(axis=0)
    identifiable = (unseen < _SHARE) & (np.linalg.norm(W, axis=0) > 0)
    error = np.sqrt(np.square(Vt[:rank] / s[:rank, None]).sum(axis=0)) / size
    return Uncertainty(np.where(identifiable, error, np.inf), identifiable)

"""How good a solution is, computed from it and its dual variables and not taken from the solver's word.

Letters as in `problem`; Z the dual matrices of the inequalities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.inertia import SIZE
from idtool.problem import INTERIOR, Problem

Array = NDArray[np.float64]

GAP = 1e-6  # relative duality gap above which a solution is refused


@dataclass(frozen=True)
class Certificate:
    """The check of a solution.

    Attributes
    ----------
    name, status, iterations, seconds
        The solver, what it said, and what it took.
    objective
        f at the solution.
    duality_gap
        f less the dual function at the solver's dual variables, relative to f, or to the noise, 1, where f is less: no
        parameters at all can have a cost lower than f by more than this.
    violation
        Largest violation of an inequality, in units of the body; at most 0 where all hold.
    where
        The body and inequality of that.
    """

    name: str
    status: str
    objective: float
    duality_gap: float
    iterations: int
    seconds: float
    violation: float
    where: str

    @property
    def holds(self) -> bool:
        """Whether every inequality holds and the cost is certified to be the least."""
        return self.violation <= 0 and abs(self.duality_gap) <= GAP


def violation(problem: Problem, x: Array) -> tuple[float, str]:
    """The largest violation of a matrix inequality at x, in units of the body, and whose it is."""
    margins = [float(np.linalg.eigvalsh(matrix.value(x))[0]) for matrix in problem.inequalities]
    if not margins:
        return 0.0, ""
    worst = int(np.argmin(margins))
    return -margins[worst], problem.inequalities[worst].label


def duality_gap(problem: Problem, x: Array, duals: Sequence[Array], multipliers: Array) -> float:
    """Relative duality gap at x and the solver's dual variables, these first made feasible.

    With slope_l = Σ over a part's inequalities of ⟨G, Z⟩ the dual function is the minimum over y of f(y) − slope · y
    plus the interior's share, a least-squares problem in y. The parts of one body must have the same slope; how far the
    solver's differ is charged to the gap.

    Parameters
    ----------
    problem
        The problem.
    x
        Shape (m,).
    duals
        Z of every matrix inequality, shape (n, n) each.
    multipliers
        Of the lower bounds.
    """
    multipliers = np.maximum(multipliers, 0)
    slope = np.zeros_like(x)
    slope[problem.bounded] = multipliers
    interior = float(multipliers @ problem.bounds)
    for matrix, returned in zip(problem.inequalities, duals, strict=True):
        values, vectors = np.linalg.eigh(0.5 * (returned + returned.T))
        Z = (vectors * np.maximum(values, 0)) @ vectors.T
        slope[matrix.first : matrix.first + SIZE] += np.einsum("kij,ij->k", matrix.G, Z)
        interior += INTERIOR * float(np.trace(Z))
    S = problem.S
    mean = (S @ slope) / S.sum(axis=1)  # over the parts of a body
    mismatch = float(np.abs((slope - S.T @ mean) * x).sum())
    primal = problem.cost(S @ x)
    # min over y of ‖A y − b‖² − mean · y is where A y is ½ A⁻ᵀ mean and what A reaches of b.
    half = 0.5 * np.linalg.lstsq(problem.A.T, mean, rcond=None)[0]
    unreached = float(np.abs((problem.A.T @ half - 0.5 * mean) * (S @ x)).sum())
    beyond = problem.A @ np.linalg.lstsq(problem.A, problem.b, rcond=None)[0] - problem.b
    dual = problem.constant + float(beyond @ beyond - half @ (half + 2 * problem.b)) + interior
    return (primal - dual + mismatch + unreached) / max(primal, 1.0)

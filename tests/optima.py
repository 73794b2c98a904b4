"""Optima of a problem with their dual variables, by a program of the tests' own."""

from __future__ import annotations

from collections.abc import Sequence

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from idtool.certificate import lower_bound
from idtool.problem import Problem

Array = NDArray[np.float64]


def solved_with_duals(problem: Problem) -> tuple[Array, list[Array], Array]:
    """A solution x, the dual variables of its inequalities and those of its lower bounds."""
    x = cp.Variable(problem.variables)
    limits = []
    for m in problem.inequalities:
        value = sum(x[m.first + i] * G for i, G in enumerate(m.G))
        matrix = m.G.ndim == 3
        limits.append(value - m.interior * np.eye(m.G.shape[-1]) >> 0 if matrix else value >= m.interior)
    lower = x[problem.bounded] >= problem.bounds
    z = problem.S @ x
    exact = [problem.E @ z == problem.e] if len(problem.e) else []
    cost = cp.sum_squares(problem.A @ z - problem.b)
    for term in problem.log_dets:
        X = sum(z[term.first + i] * G for i, G in enumerate(term.G))
        cost += term.weight * (cp.trace(X) - cp.log_det(X))
    program = cp.Problem(cp.Minimize(cost), [*limits, lower, *exact])
    program.solve(solver=cp.CLARABEL, tol_gap_rel=1e-9, tol_feas=1e-9, equilibrate_enable=False)
    return np.asarray(x.value), [np.asarray(c.dual_value) for c in limits], np.asarray(lower.dual_value)


def duality_gap(problem: Problem, x: Array, duals: Sequence[Array], multipliers: Array) -> float:
    """How far the cost may be above the least, relative to it."""
    cost = problem.cost(problem.S @ x)
    return (cost - lower_bound(problem, x, duals, multipliers)) / max(cost, 1.0)

"""Optima of a problem with their dual variables, by a program of the tests' own."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from idtool.estimation.problem.certificate import lower_bound
from idtool.estimation.problem.problem import Problem

Array = NDArray[np.float64]

AGREED = 5e-7  # of a body's mass and size
ACCURATE = {
    "tol_gap_abs": 1e-14,
    "tol_gap_rel": 1e-12,
    "tol_feas": 1e-12,
    "equilibrate_enable": False,
    "max_iter": 300,
}


def solved_with_duals(problem: Problem) -> tuple[Array, list[Array], Array]:
    """A solution x, the dual variables of its inequalities and those of its lower bounds."""
    x, limits, lower, program = _stated(problem)
    with warnings.catch_warnings(action="ignore"):  # that it may be inaccurate: any dual variables give a bound
        program.solve(solver=cp.CLARABEL, equilibrate_enable=False)
    return np.asarray(x.value), [np.asarray(c.dual_value) for c in limits], np.asarray(lower.dual_value)


def _solved(problem: Problem, multiple: float, **settings: Any) -> Array:
    x, _, _, program = _stated(problem, multiple)
    program.solve(solver=cp.CLARABEL, **settings)
    return np.asarray(x.value)


def _stated(problem: Problem, multiple: float = 1.0) -> tuple[Any, list[Any], Any, Any]:
    """x, its inequalities, its lower bounds and the programme, the cost multiplied."""
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
    return x, limits, lower, cp.Problem(cp.Minimize(multiple * cost), [*limits, lower, *exact])


def agreed_optimum(problem: Problem) -> Array:
    """z at the optimum, to `AGREED`, shape (p',): what two solutions at tolerances of 1e-12 have in common.

    Where the cost is flat its tolerances leave much open. So it is multiplied, by more until the last two agree; where
    they do not, rounding has the last word, and nothing can be said.
    """
    found: list[Array] = []
    for multiple in (1e7, 1e6, 3e6, 3e7, 1e5):
        with warnings.catch_warnings(action="ignore"):  # of what may be inaccurate: that is what is looked into here
            try:
                x = _solved(problem, multiple, **ACCURATE)
            except cp.SolverError:
                continue
        z = problem.S @ x
        if any(np.abs(z - other).max() < AGREED for other in found):
            return np.asarray(z)
        found.append(z)
    raise AssertionError("cvxpy's solutions do not agree with each other")


def duality_gap(problem: Problem, x: Array, duals: Sequence[Array], multipliers: Array) -> float:
    """How far the cost may be above the least, relative to it."""
    cost = problem.cost(problem.S @ x)
    return (cost - lower_bound(problem, x, duals, multipliers)) / max(cost, 1.0)

"""The optimization problem as cvxpy takes it, for every solver that cvxpy has installed.

cvxpy is imported where it is needed, for it takes a second.
"""

from __future__ import annotations

import warnings
from types import ModuleType
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import SolverError
from idtool.estimation.problem.conic import SOLVER_INTERIOR, Solution, infeasible
from idtool.estimation.problem.problem import Problem
from idtool.estimation.problem.variables import ConicInequality

MATRIX_SOLVERS = ("CLARABEL", "SCS", "MOSEK", "CVXOPT", "COPT", "SDPA")  # cvxpy's that take matrix inequalities
# Of all others, cvxpy's own.
_SETTINGS: dict[str, dict[str, float]] = {
    "CLARABEL": {"max_threads": 1},  # a copy of this process would wait for further ones forever
    "SCS": {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iters": 20_000},  # a first-order method: refined from there
}


def check_backend(name: str) -> None:
    """Raise a `SolverError` if cvxpy has no solver of that name, which names those it has."""
    installed = _cvxpy().installed_solvers()
    if name not in installed:
        raise SolverError("solver.backend", f"{name} is not installed; use one of {', '.join(installed)}")


def solve_by_cvxpy(problem: Problem, start: Array, backend: str) -> Solution:
    """Solve by one of cvxpy's solvers, from a start near which the step is small.

    Parameters
    ----------
    problem
        From `problem.build_problem`.
    start
        Any x, shape (m,); see `conic.solve_conic`.
    backend
        The solver, as cvxpy names it.

    Raises
    ------
    SolverError
        If the problem is infeasible, or the solver is none for it or gives up.
    """
    if not all(np.isfinite(numbers).all() for numbers in (problem.A, problem.b, problem.E, problem.e, start)):
        raise SolverError("solver", "was given numbers that are not finite; check units and magnitudes")
    cp = _cvxpy()
    check_backend(backend)
    step = cp.Variable(problem.variables)
    x = start + step
    z = problem.S @ x
    residual = problem.A @ problem.S @ step + (problem.A @ problem.S @ start - problem.b)
    cost = cp.sum_squares(residual)
    for term in problem.log_dets:
        X = _matrix(cp, term.G, z[term.z_slice])
        cost += term.weight * (cp.trace(X) - cp.log_det(X))
    inequalities = [_inequality(cp, inequality, x) for inequality in problem.inequalities]
    bounds = [x[problem.bounded] >= problem.bounds] if len(problem.bounded) else []
    equations = [problem.E @ z == problem.e] if len(problem.e) else []
    program = cp.Problem(cp.Minimize(cost), [*inequalities, *bounds, *equations])
    _run(cp, program, backend)
    if "infeasible" in program.status:
        raise infeasible(problem)
    if step.value is None:
        raise SolverError("solver.backend", f"{backend} found no solution ({program.status}); use another solver")
    duals = [np.asarray(inequality.dual_value, dtype=np.float64) for inequality in inequalities]
    multipliers = np.asarray(bounds[0].dual_value, dtype=np.float64) if bounds else np.zeros(0)
    iterations = program.solver_stats.num_iters or 0
    return Solution(start + np.asarray(step.value), duals, multipliers, str(program.status), int(iterations))


def _run(cp: ModuleType, program: Any, backend: str) -> None:
    with warnings.catch_warnings(action="ignore"):  # of inaccurate solutions: they are refined and checked
        try:
            program.solve(solver=backend, **_SETTINGS.get(backend, {}))
        except cp.error.SolverError as error:
            if backend in MATRIX_SOLVERS:
                raise SolverError("solver.backend", f"{backend} failed ({error}); use another solver") from None
            able = [name for name in cp.installed_solvers() if name in MATRIX_SOLVERS]
            what = f"{backend} does not support matrix inequalities; use one of {', '.join(able)}"
            raise SolverError("solver.backend", what) from None


def _inequality(cp: ModuleType, inequality: ConicInequality, x: Any) -> Any:
    interior = max(inequality.interior, SOLVER_INTERIOR) if inequality.interior else 0.0
    if inequality.G.ndim == 2:
        return inequality.G.T @ x[inequality.x_slice] >= interior
    return _matrix(cp, inequality.G, x[inequality.x_slice]) >> interior * np.eye(inequality.G.shape[-1])


def _matrix(cp: ModuleType, G: Array, x: Any) -> Any:
    """Σ_k x_k G_k."""
    return cp.reshape(G.reshape(len(G), -1).T @ x, G.shape[1:], order="C")


def _cvxpy() -> ModuleType:
    with warnings.catch_warnings(action="ignore"):  # of solvers that are installed, and broken
        import cvxpy
    module: ModuleType = cvxpy
    return module

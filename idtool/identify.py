"""The identification: the problem (27) solved to the global optimum by cvxpy and Clarabel, and checked."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.certificate import GAP, Certificate, lower_bound, violation
from idtool.config import Regularization
from idtool.exceptions import SolverError
from idtool.knowledge import Knowledge
from idtool.problem import Matrix, Problem, build_problem
from idtool.reduction import Reduction
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet
from idtool.weights import free_noise, freedom, residual_noise, weighted_rows

Array = NDArray[np.float64]

_SETTINGS = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-7, "tol_feas": 1e-8, "equilibrate_enable": False}


@dataclass(frozen=True)
class Estimate:
    """Identified coefficients.

    Attributes
    ----------
    theta
        The p coefficients, SI.
    parts
        Per body, the parameter vectors that it is the sum of, shape (parts, 10).
    noise
        Per joint, rms of the residual torque in the band with the degrees of freedom taken off [N·m or N].
    certificate
        The check of the solution.
    """

    theta: Array
    parts: tuple[Array, ...]
    noise: Array
    certificate: Certificate

    def is_feasible(self, tolerance: float = 0.0) -> bool:
        """Whether every body lies in its set."""
        return self.certificate.violation <= tolerance

    def is_optimal(self, tolerance: float = GAP) -> bool:
        """Whether the cost is certified to be the least possible, relative to it."""
        return abs(self.certificate.duality_gap) <= tolerance


def identify(
    model: LinearModel,
    bodies: Sequence[Body],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    known: Knowledge | None = None,
) -> Estimate:
    """The identification with the joints weighted by their residual noise.

    Parameters
    ----------
    model
        The torque equation; its first coefficients are the bodies' parameters.
    bodies
        The bodies.
    reduction
        The data.
    sets
        One set a body.
    regularization
        The prior's kind and weight.
    known
        What is known otherwise; default: nothing.

    Raises
    ------
    SolverError
        If the problem is infeasible or was not solved to a relative gap of 1e-6; the message names the worst body.
    """
    known = known or Knowledge.none(len(model.coefficients))
    noise = free_noise(model, reduction, known)
    problem = build_problem(model, bodies, reduction, sets, regularization, noise, known)
    x, certificate = solve(problem)
    return estimate(model, reduction, problem, x, certificate)


def estimate(
    model: LinearModel, reduction: Reduction, problem: Problem, x: Array, certificate: Certificate
) -> Estimate:
    """The coefficients of a solution x, shape (m,), and the noise that they leave."""
    theta = problem.theta(problem.S @ x)
    share = freedom(reduction, int(np.linalg.matrix_rank(weighted_rows(model, reduction, np.ones(len(reduction))))))
    pairs = zip(reduction, model.active(), strict=True)
    noise = np.array([residual_noise(factor, theta[columns], share) for factor, columns in pairs])
    pieces = problem.pieces(x)
    parts = tuple(np.array([pi for body, pi in pieces if body == i]) for i in range(len(problem.labels)))
    return Estimate(theta, parts, noise, certificate)


def solve(problem: Problem, **options: float) -> tuple[Array, Certificate]:
    """Solve, and check the result.

    Parameters
    ----------
    problem
        From `build_problem`.
    options
        Settings of Clarabel.

    Returns
    -------
    x, shape (m,), and its certificate.

    Raises
    ------
    SolverError
        If the problem is infeasible or was not solved to a relative gap of 1e-6; the message names the worst body.
    """
    try:
        return _attempt(problem, {**_SETTINGS, **options})
    except SolverError:  # a problem in units of order one loses accuracy by being scaled again, but for a few
        return _attempt(problem, {**_SETTINGS, "equilibrate_enable": True, **options})


def _attempt(problem: Problem, settings: Mapping[str, float]) -> tuple[Array, Certificate]:
    started = time.perf_counter()
    free = np.linalg.solve(problem.A, problem.b)  # the optimum without constraints: from there, b takes no digits
    start = np.linalg.lstsq(problem.S, free, rcond=None)[0]
    step = cp.Variable(len(start))
    limits = [_limit(step, inequality, start) for inequality in problem.inequalities]
    rows = np.eye(len(start))[problem.bounded]
    bounds = [rows @ step >= problem.bounds - rows @ start] if len(rows) else []
    exact = [(problem.E @ problem.S) @ step == problem.e - problem.E @ (problem.S @ start)] if len(problem.e) else []
    cost = cp.sum_squares((problem.A @ problem.S) @ step + (problem.A @ problem.S @ start - problem.b))
    program = cp.Problem(cp.Minimize(cost + _log_dets(problem, step, start)), [*limits, *bounds, *exact])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of inaccuracy, which the certificate judges
            program.solve(solver=cp.CLARABEL, **settings)
    except cp.SolverError as error:
        raise SolverError("solver", f"gave up: {error}") from None
    if step.value is None:
        raise SolverError("solver", f"found the problem {program.status}; loosen constraints or add a prior")
    x = _polished(problem, start + step.value)
    duals = [np.asarray(limit.dual_value) for limit in limits]
    multipliers = np.atleast_1d(bounds[0].dual_value) if bounds else np.zeros(0)
    certificate = certify(problem, x, program, lower_bound(problem, x, duals, multipliers), started)
    if not certificate.holds:
        gap, violated = certificate.duality_gap, certificate.violation
        what = f"not solved well enough: relative duality gap {gap:.1e}, violation {violated:.1e}"
        raise SolverError(certificate.where or "solver", what)
    return x, certificate


def certify(problem: Problem, x: Array, program: cp.Problem, bound: float, started: float) -> Certificate:
    """The check of x against a cost that nothing can be below."""
    largest, where = violation(problem, x)
    cost = problem.cost(problem.S @ x)
    return Certificate(
        name="clarabel",
        status=program.status,
        objective=cost,
        duality_gap=(cost - bound) / max(cost, 1.0),
        iterations=int(program.solver_stats.num_iters or 0),
        seconds=time.perf_counter() - started,
        violation=largest,
        where=where,
    )


def _polished(problem: Problem, x: Array) -> Array:
    """The same with what is exact met to the last digit, where the solver comes within its tolerance."""
    rows = problem.E @ problem.S
    x = x + np.linalg.lstsq(rows, problem.e - rows @ x, rcond=None)[0] if len(rows) else x
    x[problem.bounded] = np.maximum(x[problem.bounded], problem.bounds)
    for inequality in (i for i in problem.inequalities if not i.interior):  # point masses, each its own variable
        x[inequality.own] = np.maximum(x[inequality.own], 0)
    return x


def _limit(step: cp.Variable, inequality: Matrix, start: Array) -> cp.Constraint:
    """One inequality at start + step in the solver's terms."""
    n = inequality.G.shape[-1]
    rows = np.zeros((inequality.G[0].size, len(start)))
    rows[:, inequality.own] = inequality.G.reshape(len(inequality.G), -1).T
    value = inequality.value(start)
    if value.ndim == 1:
        return rows @ step >= inequality.interior - value
    return cp.reshape(rows @ step, (n, n), order="C") >> inequality.interior * np.eye(n) - value


def _log_dets(problem: Problem, step: cp.Variable, start: Array) -> cp.Expression:
    """The divergences at start + step but for a constant."""
    total: cp.Expression = 0.0
    for term in problem.log_dets:
        rows = np.zeros((term.G[0].size, len(start)))
        rows[:] = term.G.reshape(len(term.G), -1).T @ problem.S[term.own]
        X = cp.reshape(rows @ step + rows @ start, term.G.shape[1:], order="C")
        total = total + term.weight * (cp.trace(X) - cp.log_det(X))
    return total

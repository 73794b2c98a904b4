"""The estimate of the coefficients: the problem (27) solved to the global optimum, and the solution checked."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import InfeasibleError, SolverError
from idtool.common.names import join_names
from idtool.common.number_text import short_number
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise, freedom_left, residual_noise, weighted_rows
from idtool.estimation.problem.backends import solve_by_cvxpy
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.certificate import Certificate, cost_of_margin, lower_bound, violation
from idtool.estimation.problem.conic import SOLVER_INTERIOR, Solution, infeasible, solve_conic
from idtool.estimation.problem.local import LOCAL
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.problem.refinement import refine
from idtool.estimation.problem.variables import INTERIOR
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.sets import ConstraintSet

_AT_LIMIT = 1e-3  # of an inequality, in units of the body
# A problem in units of order one loses accuracy by being scaled again, but for a few.
_ATTEMPTS: tuple[dict[str, float | bool], ...] = (
    {},
    {"tol_feas": 1e-10},
    {"tol_feas": 1e-9, "tol_gap_rel": 1e-9},
    {"equilibrate_enable": True},
)
PARAMETER_TOLERANCE = 1e-6  # in units of the body: parameters with a larger error are not at the optimum
_BACKEND = "CLARABEL"  # of cvxpy, also where Clarabel fails on the problem as it is stated here
_SETTINGS = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-7, "tol_feas": 1e-8, "equilibrate_enable": False}


@dataclass(frozen=True)
class Estimate:
    """Estimated coefficients.

    Attributes
    ----------
    theta
        The p coefficients, SI.
    pieces
        Per body, the parameter vectors that it is the sum of, shape (pieces, 10).
    noise
        Per joint, rms of the residual torque in the band with the degrees of freedom taken off [N·m or N].
    certificate
        The check of the solution.
    problem, x
        The problem and its optimum, shape (m,).
    """

    theta: Array
    pieces: tuple[Array, ...]
    noise: Array
    certificate: Certificate
    problem: Problem
    x: Array


def estimate(
    model: LinearModel,
    bodies: Sequence[Body],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    equalities: EqualityConstraints | None = None,
    solver: str = "clarabel",
    noise: Array | None = None,
    backend: str | None = None,
    rows: Array | None = None,
) -> Estimate:
    """Estimate the coefficients, the joints weighted by their residual noise.

    Parameters
    ----------
    model
        The torque equation; its first coefficients are the bodies' parameters.
    bodies
        The bodies.
    reduction
        The data.
    sets
        One set per body.
    regularization
        The prior's kind and weight.
    equalities
        The equality constraints; default: none.
    solver
        ``clarabel``, ``cvxpy``, or a local one of `local`.
    noise
        The joints' residual noise, shape (nv,) [N·m or N]; default: that of a fit without constraints.
    backend
        The solver that cvxpy takes; default: Clarabel.
    rows
        The `weighted_rows` at that noise, if they are known.

    Raises
    ------
    SolverError
        If the problem is infeasible or was not solved to a relative gap of 1e-6; the message names the worst body.
    """
    equalities = equalities or EqualityConstraints.none(len(model.coefficients))
    noise = free_noise(model, reduction, equalities) if noise is None else noise
    rows = weighted_rows(model, reduction, noise) if rows is None else rows
    problem = build_problem(model, bodies, reduction, sets, regularization, noise, equalities, rows)
    if solver == "clarabel":
        x, certificate = _solve_with_fallback(problem)
    elif solver == "cvxpy":
        x, certificate = solve_with_backend(problem, backend or _BACKEND)
    else:
        x, certificate = solve_locally(problem, solver, model.prior[equalities.free] / problem.scale)
    theta = problem.theta(problem.S @ x)
    rank = int(np.linalg.matrix_rank(rows[:, :-1] @ problem.K))
    share = freedom_left(reduction, rank)
    joints = zip(reduction, model.active(), strict=True)
    noise = np.array([residual_noise(factor, theta[columns], share) for factor, columns in joints])
    parameters = problem.piece_parameters(x)
    pieces = []
    for i in range(len(problem.body_names)):
        pieces.append(np.array([pi for body, pi in parameters if body == i]))
    return Estimate(theta, tuple(pieces), noise, certificate, problem, x)


def solve(problem: Problem, **options: float | bool) -> tuple[Array, Certificate]:
    """Solve by Clarabel, and check the result.

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
    best: tuple[Array, Certificate] | None = None
    least_error = np.inf
    failures: list[SolverError] = []
    for settings in _ATTEMPTS:
        try:
            x, certificate = _attempt(problem, {**_SETTINGS, **settings, **options})
        except SolverError as failure:
            failures.append(failure)
            continue
        error = np.inf if certificate.parameter_error is None else certificate.parameter_error
        if best is None or error < least_error:
            best = x, certificate
            least_error = error
        if error <= PARAMETER_TOLERANCE:
            break
    if best is not None:
        return best
    # Where one attempt proves the problem infeasible and the last merely gives up, that is the reason.
    proofs = [failure for failure in failures if isinstance(failure, InfeasibleError)]
    if not proofs and problem.equality_labels and not _has_interior(problem):
        raise infeasible(problem)
    raise (proofs or failures)[-1]


def solve_with_backend(problem: Problem, backend: str) -> tuple[Array, Certificate]:
    """Solve by one of cvxpy's solvers, and check the result.

    Parameters
    ----------
    problem
        From `build_problem`.
    backend
        The solver, as cvxpy names it.

    Returns
    -------
    x, shape (m,), and its certificate.

    Raises
    ------
    SolverError
        If the solver is not installed, or as `solve` does.
    """
    started = time.perf_counter()
    solution = solve_by_cvxpy(problem, _unconstrained_optimum(problem), backend)
    return _refine_and_check(problem, solution, f"cvxpy ({backend})", started)


def _has_interior(problem: Problem) -> bool:
    """True if some parameters fulfil everything with room to spare; not checked where numbers are not finite."""
    m = problem.variables
    for numbers in (problem.E, problem.e, problem.bounds):
        if not np.isfinite(numbers).all():
            return True  # the solver has said what is wrong
    try:
        Barrier(problem, np.eye(m), np.zeros(m), gap=1.0)
    except SolverError:
        return False
    return True


def _solve_with_fallback(problem: Problem) -> tuple[Array, Certificate]:
    """Solve by Clarabel, and by cvxpy where that fails."""
    try:
        return solve(problem)
    except InfeasibleError:
        raise
    except SolverError:
        with suppress(SolverError):
            return solve_with_backend(problem, _BACKEND)
        raise


def solve_locally(problem: Problem, name: str, start: Array) -> tuple[Array, Certificate]:
    """Solve on a manifold of realizable bodies, and check the result against the global optimum.

    Parameters
    ----------
    problem
        From `build_problem`, every body in the set ``full``.
    name
        One of `local.LOCAL`.
    start
        z to start from, shape (p',).

    Returns
    -------
    x, shape (m,), and its certificate: the gap is that to the dual of the convex problem, so that it shows where the
    solver got stuck.

    Raises
    ------
    SolverError
        If the problem holds what a local solver does not know.
    """
    local = LOCAL[name](problem, start)
    _, best = solve(problem)
    bound = best.objective - best.duality_gap * max(best.objective, 1.0)
    certificate = certify(problem, local.x, bound, name, local.status, local.iterations, started=0.0)
    return local.x, replace(certificate, seconds=local.seconds)


def stuck_note(certificate: Certificate) -> str:
    """Message about a cost that is not certified to be the least; empty if it is."""
    if certificate.certified:
        return ""
    if certificate.holds:
        return (
            f"keeping the bodies inside their sets by a margin of {INTERIOR:g} of their mass and size increases the "
            f"cost by a relative amount of up to {certificate.margin:.1e}: the data favour bodies far outside them"
        )
    at = f", with {certificate.where} at its limit" if -certificate.violation < _AT_LIMIT else ""
    return (
        f"{certificate.name} stopped after {certificate.iterations} iterations at a cost that may exceed "
        f"the global optimum by a relative amount of {certificate.duality_gap:.1e}{at}"
    )


def unfinished_note(certificate: Certificate) -> str:
    """Message about a convex solver's optimum whose parameters are not at it; empty if they are."""
    error = certificate.parameter_error
    if certificate.name in LOCAL or (error is not None and error <= PARAMETER_TOLERANCE):
        return ""
    far = "an unknown fraction" if error is None else short_number(error, 1)
    return (
        "the cost is optimal, but some parameters are not exact: those that only the prior determines may be off "
        f"by {far} of their body's mass and size"
    )


def _attempt(problem: Problem, settings: Mapping[str, float | bool]) -> tuple[Array, Certificate]:
    started = time.perf_counter()
    solution = solve_conic(problem, _unconstrained_optimum(problem), settings)
    return _refine_and_check(problem, solution, "clarabel", started)


def _unconstrained_optimum(problem: Problem) -> Array:
    """The optimum without constraints, x (m,): from there, b takes no digits."""
    z = np.linalg.solve(problem.A, problem.b)
    return np.asarray(np.linalg.lstsq(problem.S, z, rcond=None)[0])


def _refine_and_check(problem: Problem, solution: Solution, name: str, started: float) -> tuple[Array, Certificate]:
    """A solver's optimum, refined where that makes it better, and its certificate."""
    solution = replace(solution, x=_with_exact_constraints(problem, solution.x))
    if not np.isfinite(problem.cost(problem.S @ solution.x)):
        _, where = violation(problem, solution.x)
        raise _unsolved_error(problem, where, name, f"no admissible parameters were found ({solution.status})")
    refined = refine(problem, solution)
    if refined:
        refined_solution = replace(refined.solution, x=_with_exact_constraints(problem, refined.solution.x))
        refined_certificate = replace(
            _certify_solution(problem, refined_solution, 0.0, name, started),
            parameter_error=refined.error,
            status="optimal" if refined.error <= PARAMETER_TOLERANCE else solution.status,
        )
        if refined_certificate.holds:
            return refined_solution.x, refined_certificate
    certificate = _certify_solution(problem, solution, SOLVER_INTERIOR, name, started)
    if certificate.holds:
        return solution.x, certificate
    if refined:
        certificate = refined_certificate
    gap, violated = certificate.duality_gap, certificate.violation
    reason = f"relative duality gap {gap:.1e}, violation {violated:.1e}"
    raise _unsolved_error(problem, certificate.where, name, reason)


def _unsolved_error(problem: Problem, where: str, name: str, reason: str) -> SolverError:
    """The error that a solver found no good enough solution."""
    by = "" if name == "clarabel" else f" by {name}"
    labels = f" of {join_names(problem.equality_labels)}" if problem.equality_labels else ""
    return SolverError(
        where or "solver",
        f"the problem was not solved accurately enough{by}: {reason}; check units and magnitudes{labels}",
    )


def _certify_solution(problem: Problem, solution: Solution, margin: float, name: str, started: float) -> Certificate:
    """The check of a solution whose bodies are kept inside of their sets by a margin."""
    bound = lower_bound(problem, solution.x, solution.duals, solution.multipliers)
    check = certify(problem, solution.x, bound, name, solution.status, solution.iterations, started)
    return replace(check, margin=cost_of_margin(problem, solution.duals, margin) / max(check.objective, 1.0))


def certify(
    problem: Problem, x: Array, bound: float, name: str, status: str, iterations: int, started: float
) -> Certificate:
    """The check of x against a lower bound of the cost."""
    largest, where = violation(problem, x)
    cost = problem.cost(problem.S @ x)
    return Certificate(
        name=name,
        status=status,
        objective=cost,
        duality_gap=(cost - bound) / max(cost, 1.0),
        iterations=iterations,
        seconds=time.perf_counter() - started,
        violation=largest,
        where=where,
    )


def _with_exact_constraints(problem: Problem, x: Array) -> Array:
    """X with equations and bounds met to the last digit, which the solver meets to its tolerance."""
    rows = problem.E @ problem.S
    if len(rows):
        x = x + np.linalg.lstsq(rows, problem.e - rows @ x, rcond=None)[0]
    x[problem.bounded] = np.maximum(x[problem.bounded], problem.bounds)
    for inequality in problem.inequalities:
        if not inequality.interior:  # point masses, each its own variable
            x[inequality.x_slice] = np.maximum(x[inequality.x_slice], 0)
    return x

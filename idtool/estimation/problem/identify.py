"""The identification: the problem (27) solved to the global optimum, and checked."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import InfeasibleError, SolverError
from idtool.common.names import some
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise, freedom, residual_noise, weighted_rows
from idtool.estimation.problem.backends import solve_by_cvxpy
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.certificate import GAP, Certificate, cost_of_margin, lower_bound, violation
from idtool.estimation.problem.conic import APART, Solution, infeasible, solve_conic
from idtool.estimation.problem.local import LOCAL
from idtool.estimation.problem.parts import INTERIOR
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.problem.refinement import refine
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.sets import ConstraintSet

_CLOSE = 1e-3  # to the limit of an inequality, in units of the body
# A problem in units of order one loses accuracy by being scaled again, but for a few.
_ATTEMPTS: tuple[dict[str, float | bool], ...] = (
    {},
    {"tol_feas": 1e-10},
    {"tol_feas": 1e-9, "tol_gap_rel": 1e-9},
    {"equilibrate_enable": True},
)
ENOUGH = 1e-6  # error of the parameters, in units of the body, above which they are not at the optimum
_BACKEND = "CLARABEL"  # of cvxpy, also where Clarabel fails on the problem as it is stated here
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
    problem, x
        What was solved, and its optimum, shape (m,).
    """

    theta: Array
    parts: tuple[Array, ...]
    noise: Array
    certificate: Certificate
    problem: Problem
    x: Array

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
    solver: str = "clarabel",
    noise: Array | None = None,
    backend: str | None = None,
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
    solver
        ``clarabel``, ``cvxpy``, or a local one of `local`.
    noise
        The joints' residual noise, shape (nv,) [N·m or N]; default: what a fit without constraints leaves.
    backend
        The solver that cvxpy takes; default: Clarabel.

    Raises
    ------
    SolverError
        If the problem is infeasible or was not solved to a relative gap of 1e-6; the message names the worst body.
    """
    known = known or Knowledge.none(len(model.coefficients))
    noise = free_noise(model, reduction, known) if noise is None else noise
    problem = build_problem(model, bodies, reduction, sets, regularization, noise, known)
    if solver == "clarabel":
        x, certificate = _solve_with_fallback(problem)
    elif solver == "cvxpy":
        x, certificate = solve_with_backend(problem, backend or _BACKEND)
    else:
        x, certificate = solve_locally(problem, solver, model.prior[known.free] / problem.scale)
    return estimate(model, reduction, problem, x, certificate)


def estimate(
    model: LinearModel, reduction: Reduction, problem: Problem, x: Array, certificate: Certificate
) -> Estimate:
    """The coefficients of a solution x, shape (m,), and the noise that they leave."""
    theta = problem.theta(problem.S @ x)
    Y = weighted_rows(model, reduction, np.ones(len(reduction)))[:, :-1]
    share = freedom(reduction, int(np.linalg.matrix_rank(Y @ problem.K)))
    pairs = zip(reduction, model.active(), strict=True)
    noise = np.array([residual_noise(factor, theta[columns], share) for factor, columns in pairs])
    pieces = problem.pieces(x)
    parts = tuple(np.array([pi for body, pi in pieces if body == i]) for i in range(len(problem.labels)))
    return Estimate(theta, parts, noise, certificate, problem, x)


def solve(problem: Problem, **options: float | bool) -> tuple[Array, Certificate]:
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
    solved: list[tuple[float, Array, Certificate]] = []
    errors: list[SolverError] = []
    for other in _ATTEMPTS:
        try:
            x, certificate = _attempt(problem, {**_SETTINGS, **other, **options})
        except SolverError as error:
            errors.append(error)
            continue
        solved.append((np.inf if certificate.parameter_error is None else certificate.parameter_error, x, certificate))
        if solved[-1][0] <= ENOUGH:
            break
    if not solved:  # where one attempt proves the problem infeasible and the last merely gives up, that is the reason
        proofs = [error for error in errors if isinstance(error, InfeasibleError)]
        if not proofs and problem.facts and not _has_interior(problem):
            raise infeasible(problem)
        raise (proofs or errors)[-1]
    _, x, certificate = min(solved, key=lambda one: one[0])
    return x, certificate


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
    solution = solve_by_cvxpy(problem, _free(problem), backend)
    return _finished(problem, solution, f"cvxpy ({backend})", started)


def _has_interior(problem: Problem) -> bool:
    """Whether some parameters fulfil everything with room to spare."""
    m = problem.variables
    numbers = (problem.E, problem.e, problem.bounds)
    if not all(np.isfinite(x).all() for x in numbers):
        return True  # which the solver has said
    try:
        Barrier(problem, np.eye(m), np.zeros(m), gap=1.0)
    except SolverError:
        return False
    return True


def _solve_with_fallback(problem: Problem) -> tuple[Array, Certificate]:
    """`solve`, or where that fails what cvxpy makes of the problem."""
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
    found = LOCAL[name](problem, start)
    _, best = solve(problem)
    bound = best.objective - best.duality_gap * max(best.objective, 1.0)
    certificate = certify(problem, found.x, bound, name, found.status, found.iterations, 0.0)
    return found.x, replace(certificate, seconds=found.seconds)


def stuck_note(certificate: Certificate) -> str:
    """What to say of a cost that is not certified to be the least; nothing of one that is."""
    if certificate.certified:
        return ""
    if certificate.holds:
        return (
            f"keeping every body inside its set, by {INTERIOR:g} of its mass and size, raises the cost by up to "
            f"{certificate.margin:.1e} of it: the data ask for bodies far outside of their sets"
        )
    at = f", with {certificate.where} at its limit" if -certificate.violation < _CLOSE else ""
    return (
        f"{certificate.name} stopped after {certificate.iterations} iterations at a cost up to "
        f"{certificate.duality_gap:.1e} above the global optimum, relative to it{at}"
    )


def unfinished_note(certificate: Certificate) -> str:
    """What to say of a convex solver's optimum whose parameters are not at it; nothing of one whose are."""
    if certificate.name in LOCAL or (certificate.parameter_error is not None and certificate.parameter_error <= ENOUGH):
        return ""
    far = "an unknown share" if certificate.parameter_error is None else f"{certificate.parameter_error:.1g}"
    return (
        "the cost is the least, but not all parameters are at the optimum: those that the prior alone holds may be off "
        f"by {far} of their body's mass and size; a larger regularization.weight holds them better"
    )


def _attempt(problem: Problem, settings: Mapping[str, float | bool]) -> tuple[Array, Certificate]:
    started = time.perf_counter()
    solution = solve_conic(problem, _free(problem), settings)
    return _finished(problem, solution, "clarabel", started)


def _free(problem: Problem) -> Array:
    """The optimum without constraints, x (m,): from there, b takes no digits."""
    z = np.linalg.solve(problem.A, problem.b)
    return np.asarray(np.linalg.lstsq(problem.S, z, rcond=None)[0])


def _finished(problem: Problem, solution: Solution, name: str, started: float) -> tuple[Array, Certificate]:
    """A solver's optimum refined and checked, or as it is where refining makes it no better."""
    solution = replace(solution, x=_polished(problem, solution.x))
    if not np.isfinite(problem.cost(problem.S @ solution.x)):
        _, where = violation(problem, solution.x)
        raise _unsolved(problem, where, name, f"no body found ({solution.status})")
    certificate = _certified(problem, solution, APART, name, started)
    if refined := refine(problem, solution):
        better = replace(refined.solution, x=_polished(problem, refined.solution.x))
        status = "optimal" if refined.error <= ENOUGH else solution.status
        check = replace(_certified(problem, better, 0.0, name, started), parameter_error=refined.error, status=status)
        if check.holds or not certificate.holds:
            solution, certificate = better, check
    if not certificate.holds:
        gap, violated = certificate.duality_gap, certificate.violation
        reason = f"relative duality gap {gap:.1e}, violation {violated:.1e}"
        raise _unsolved(problem, certificate.where, name, reason)
    return solution.x, certificate


def _unsolved(problem: Problem, where: str, name: str, reason: str) -> SolverError:
    """What to say of a problem that a solver leaves without a solution."""
    by = "" if name == "clarabel" else f" by {name}"
    known = f" of {some(problem.facts)}" if problem.facts else ""
    return SolverError(where or "solver", f"not solved well enough{by}: {reason}; check units and magnitudes{known}")


def _certified(problem: Problem, solution: Solution, margin: float, name: str, started: float) -> Certificate:
    """The check of a solution whose bodies are kept inside of their sets by a margin."""
    bound = lower_bound(problem, solution.x, solution.duals, solution.multipliers)
    check = certify(problem, solution.x, bound, name, solution.status, solution.iterations, started)
    return replace(check, margin=cost_of_margin(problem, solution.duals, margin) / max(check.objective, 1.0))


def certify(
    problem: Problem, x: Array, bound: float, name: str, status: str, iterations: int, started: float
) -> Certificate:
    """The check of x against a cost that nothing can be below."""
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


def _polished(problem: Problem, x: Array) -> Array:
    """The same with what is exact met to the last digit, where the solver comes within its tolerance."""
    rows = problem.E @ problem.S
    x = x + np.linalg.lstsq(rows, problem.e - rows @ x, rcond=None)[0] if len(rows) else x
    x[problem.bounded] = np.maximum(x[problem.bounded], problem.bounds)
    for inequality in (i for i in problem.inequalities if not i.interior):  # point masses, each its own variable
        x[inequality.own] = np.maximum(x[inequality.own], 0)
    return x

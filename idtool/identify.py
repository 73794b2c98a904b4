"""The identification: the problem (27) solved to the global optimum, and checked."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.certificate import GAP, Certificate, lower_bound, violation
from idtool.config import Regularization
from idtool.conic import solve_conic
from idtool.exceptions import SolverError
from idtool.knowledge import Knowledge
from idtool.local import LOCAL
from idtool.problem import Problem, build_problem
from idtool.reduction import Reduction
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet
from idtool.weights import free_noise, freedom, residual_noise, weighted_rows

Array = NDArray[np.float64]

_CLOSE = 1e-3  # to the limit of an inequality, in units of the body
# A problem in units of order one loses accuracy by being scaled again, but for a few.
_ATTEMPTS: tuple[dict[str, float | bool], ...] = (
    {},
    {"tol_feas": 1e-10},
    {"tol_feas": 1e-9, "tol_gap_rel": 1e-9},
    {"equilibrate_enable": True},
)
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
        ``clarabel``, or a local one of `local`.
    noise
        The joints' residual noise, shape (nv,) [N·m or N]; default: what a fit without constraints leaves.

    Raises
    ------
    SolverError
        If the problem is infeasible or was not solved to a relative gap of 1e-6; the message names the worst body.
    """
    known = known or Knowledge.none(len(model.coefficients))
    noise = free_noise(model, reduction, known) if noise is None else noise
    problem = build_problem(model, bodies, reduction, sets, regularization, noise, known)
    if solver == "clarabel":
        x, certificate = solve(problem)
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
    for other in _ATTEMPTS[:-1]:
        with suppress(SolverError):
            return _attempt(problem, {**_SETTINGS, **other, **options})
    return _attempt(problem, {**_SETTINGS, **_ATTEMPTS[-1], **options})


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
    """What to say of a local solver that did not reach the global optimum; nothing of one that did."""
    if certificate.duality_gap <= GAP:
        return ""
    at = f", with {certificate.where} at its limit" if -certificate.violation < _CLOSE else ""
    return (
        f"{certificate.name} stopped after {certificate.iterations} iterations at a cost "
        f"{certificate.duality_gap:.1e} above the global optimum, relative to it{at}"
    )


def _attempt(problem: Problem, settings: Mapping[str, float | bool]) -> tuple[Array, Certificate]:
    started = time.perf_counter()
    free = np.linalg.solve(problem.A, problem.b)  # the optimum without constraints: from there, b takes no digits
    solution = solve_conic(problem, np.linalg.lstsq(problem.S, free, rcond=None)[0], settings)
    x = _polished(problem, solution.x)
    bound = lower_bound(problem, x, solution.duals, solution.multipliers)
    certificate = certify(problem, x, bound, "clarabel", solution.status, solution.iterations, started)
    if not certificate.holds:
        gap, violated = certificate.duality_gap, certificate.violation
        what = f"not solved well enough: relative duality gap {gap:.1e}, violation {violated:.1e}"
        raise SolverError(certificate.where or "solver", what)
    return x, certificate


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

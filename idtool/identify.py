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
from idtool.certificate import GAP, Certificate, duality_gap, violation
from idtool.config import Regularization
from idtool.exceptions import SolverError
from idtool.inertia import SIZE
from idtool.problem import INTERIOR, Matrix, Problem, build_problem, free_noise, freedom, residual_noise, weighted_rows
from idtool.reduction import Reduction
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet

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

    Raises
    ------
    SolverError
        If the problem is infeasible or was not solved to a relative gap of 1e-6; the message names the worst body.
    """
    active = model.active()
    problem = build_problem(model, bodies, reduction, sets, regularization, free_noise(model, reduction))
    x, certificate = solve(problem)
    theta = problem.scale * (problem.S @ x)
    share = freedom(reduction, int(np.linalg.matrix_rank(weighted_rows(model, reduction, np.ones(len(reduction))))))
    noise = np.array([residual_noise(f, theta[columns], share) for f, columns in zip(reduction, active, strict=True)])
    by_part = [(part.body.name, part.scales * x[SIZE * k : SIZE * (k + 1)]) for k, part in enumerate(problem.parts)]
    parts = tuple(np.array([pi for name, pi in by_part if name == body.name]) for body in bodies)
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
    start = problem.S.T @ (free / problem.S.sum(axis=1))
    step = cp.Variable(len(start))
    matrices = [_semidefinite(step, matrix, start) for matrix in problem.inequalities if matrix.G.shape[-1] > 1]
    rows, least = _linear(problem)
    limits = [rows @ step >= least - rows @ start] if len(least) else []
    program = cp.Problem(cp.Minimize(cp.sum_squares((problem.A @ problem.S) @ step)), [*matrices, *limits])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of inaccuracy, which the certificate judges
            program.solve(solver=cp.CLARABEL, **settings)
    except cp.SolverError as error:
        raise SolverError("solver", f"gave up: {error}") from None
    if step.value is None:
        raise SolverError("solver", f"found the problem {program.status}; loosen constraints or add a prior")
    x = start + step.value
    x[problem.bounded] = np.maximum(x[problem.bounded], problem.bounds)  # a bound is met to the last digit
    certificate = _certify(problem, x, program, matrices, limits, time.perf_counter() - started)
    if not certificate.holds:
        gap, violated = certificate.duality_gap, certificate.violation
        what = f"not solved well enough: relative duality gap {gap:.1e}, violation {violated:.1e}"
        raise SolverError(certificate.where or "solver", what)
    return x, certificate


def _certify(
    problem: Problem,
    x: Array,
    program: cp.Problem,
    matrices: Sequence[cp.Constraint],
    limits: Sequence[cp.Constraint],
    seconds: float,
) -> Certificate:
    """The check of x with the solver's dual variables."""
    linear = np.atleast_1d(limits[0].dual_value) if limits else np.zeros(0)
    scalar = [matrix.G.shape[-1] == 1 for matrix in problem.inequalities]
    of_scalars, of_matrices = iter(linear), iter(matrices)
    duals = [np.atleast_2d(next(of_scalars) if one else next(of_matrices).dual_value) for one in scalar]
    largest, where = violation(problem, x)
    return Certificate(
        name="clarabel",
        status=program.status,
        objective=problem.cost(problem.S @ x),
        duality_gap=duality_gap(problem, x, duals, linear[sum(scalar) :]),
        iterations=int(program.solver_stats.num_iters or 0),
        seconds=seconds,
        violation=largest,
        where=where,
    )


def _semidefinite(step: cp.Variable, matrix: Matrix, start: Array) -> cp.Constraint:
    """One matrix inequality at start + step in the solver's terms."""
    n = matrix.G.shape[-1]
    rows = np.zeros((n * n, len(start)))
    rows[:, matrix.first : matrix.first + SIZE] = matrix.G.reshape(SIZE, -1).T
    return cp.reshape(rows @ step, (n, n), order="C") >> INTERIOR * np.eye(n) - matrix.value(start)


def _linear(problem: Problem) -> tuple[Array, Array]:
    """The scalar inequalities, then the lower bounds: rows · x ≥ least."""
    scalars = [matrix for matrix in problem.inequalities if matrix.G.shape[-1] == 1]
    rows = np.zeros((len(scalars) + len(problem.bounds), problem.S.shape[1]))
    for row, matrix in zip(rows, scalars, strict=False):
        row[matrix.first : matrix.first + SIZE] = matrix.G.ravel()
    rows[np.arange(len(scalars), len(rows)), problem.bounded] = 1.0
    return rows, np.concatenate([np.full(len(scalars), INTERIOR), problem.bounds])

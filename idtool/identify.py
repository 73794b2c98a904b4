"""The identification (27): least squares with a prior over the sets of realizable bodies, solved to the global optimum.

    min over theta of f(theta) = (1/n) Σ_j ‖Y_j theta − tau_j‖² / sigma_j² + w Σ_bodies ‖(pi − pî) / scale‖²

subject to every body's inequalities and the coefficients' bounds. It is stated in units in which all unknowns are of
order one, x = theta / scale, and in R-factors: A is upper triangular with p rows whatever the log's length, and the
solver never sees a sample. A body on a union of ellipsoids is the sum of its parts (Cor. 2): theta = S x.

Letters: p coefficients theta; m solver variables x; A (p, p), b (p,) with f = ‖A S x − b‖² + constant; sigma_j noise of
joint j's torque [N·m or N]; Z the dual matrices of the inequalities.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.config import Regularization
from idtool.exceptions import SolverError
from idtool.inertia import SIZE
from idtool.reduction import Factor, Reduction
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet, Inequality

Array = NDArray[np.float64]

_INTERIOR = 1e-7  # how far inside its set a body is kept, in units of its own mass and size: survives rounding
_GAP = 1e-6  # relative duality gap above which a solution is refused
_RANK = 1e-10  # of the largest singular value: what lies below is not determined
_LEAST_NOISE = 1e-6  # of a joint's torque, so that data without noise have finite weights


@dataclass(frozen=True)
class Part:
    """One of the parameter vectors that a body is the sum of.

    Attributes
    ----------
    body
        The body.
    first
        Index of its first coefficient in theta.
    scales
        Units of its ten parameters, shape (10,).
    inequalities
        What they must fulfil.
    """

    body: Body
    first: int
    scales: Array
    inequalities: tuple[Inequality, ...]


@dataclass(frozen=True)
class Problem:
    """The optimization problem, apart from how it is solved.

    Attributes
    ----------
    A, b, constant
        f(theta) = ‖A (theta / scale) − b‖² + constant; shapes (r, p), (r,), with r at most p + 1.
    scale
        Units of theta, shape (p,).
    parts
        The bodies' parts, in the order of x, ten variables each; then come the other coefficients.
    others
        Indices in theta of the coefficients that are no inertia parameters.
    lower
        Their lower bounds, in units of ``scale``.
    """

    A: Array
    b: Array
    constant: float
    scale: Array
    parts: tuple[Part, ...]
    others: NDArray[np.intp]
    lower: Array

    @cached_property
    def S(self) -> Array:  # noqa: N802
        """Sum of parts: theta / scale = S x, shape (p, m)."""
        S = np.zeros((len(self.scale), SIZE * len(self.parts) + len(self.others)))
        for k, part in enumerate(self.parts):
            S[part.first : part.first + SIZE, SIZE * k : SIZE * (k + 1)] = np.eye(SIZE)
        S[self.others, SIZE * len(self.parts) + np.arange(len(self.others))] = 1
        return S

    def cost(self, y: Array) -> float:
        """The objective at theta = scale · y."""
        return float(np.square(self.A @ y - self.b).sum()) + self.constant


@dataclass(frozen=True)
class Certificate:
    """How good a solution is, computed from it and its dual variables and not taken from the solver's word.

    Attributes
    ----------
    name, status, iterations, seconds
        The solver, what it said, and what it took.
    objective
        f at the solution.
    duality_gap
        f less the dual function at the solver's dual variables, relative to f: no parameters at all can have a cost
        lower than (1 − gap) f.
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

    def is_optimal(self, tolerance: float = _GAP) -> bool:
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
    noise = np.array([_noise(f, theta[columns], share) for f, columns in zip(reduction, active, strict=True)])
    by_part = [(part.body.name, part.scales * x[SIZE * k : SIZE * (k + 1)]) for k, part in enumerate(problem.parts)]
    parts = tuple(np.array([pi for name, pi in by_part if name == body.name]) for body in bodies)
    return Estimate(theta, parts, noise, certificate)


def _floor(factor: Factor) -> float:
    """The least noise that a joint's torque is believed to have."""
    tau = float(np.linalg.norm(factor.R[:, -1]) / np.sqrt(max(factor.rows, 1)))
    return _LEAST_NOISE * tau or 1.0


def _noise(factor: Factor, theta: Array, share: float = 1.0) -> float:
    """Residual noise of a joint; ``share`` of the samples' freedom is left after the fit."""
    return max(float(np.sqrt(factor.squares(theta) / max(factor.rows, 1) / share)), _floor(factor))


def freedom(reduction: Reduction, rank: int) -> float:
    """Share of the independent samples that are left when a fit has taken ``rank`` of them, at least a half."""
    independent = sum(factor.independent for factor in reduction)
    return max(1 - rank / max(independent, 1.0), 0.5)


def free_noise(model: LinearModel, reduction: Reduction) -> Array:
    """What plain least squares leaves of each joint's torque, all joints alike and nothing constrained; shape (nv,).

    Weights from a first fit without weights, as in the two-step weighted least squares that is usual in robot
    identification (Gautier 1997). With fewer than two independent samples for each parameter that they determine, the
    torques themselves are the weights.
    """
    rows = weighted_rows(model, reduction, np.ones(len(reduction)))
    size = np.linalg.norm(rows[:, :-1], axis=0)
    size[size == 0] = 1.0
    theta, _, rank, _ = np.linalg.lstsq(rows[:, :-1] / size, rows[:, -1], rcond=_RANK)
    theta = theta / size if sum(factor.independent for factor in reduction) >= 2 * rank else np.zeros_like(theta)
    share = freedom(reduction, int(rank))
    return np.array([_noise(f, theta[columns], share) for f, columns in zip(reduction, model.active(), strict=True)])


def build_problem(
    model: LinearModel,
    bodies: Sequence[Body],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    noise: Array,
) -> Problem:
    """State (27) on R-factors; see `identify` for the parameters, ``noise`` is sigma, shape (nv,)."""
    coefficients = model.coefficients
    rows = weighted_rows(model, reduction, noise)
    held = np.array([c.scale is not None for c in coefficients])
    size = np.linalg.norm(rows[:, :-1], axis=0)
    scale = np.array(
        [c.scale if c.scale is not None else 1 / (s or 1.0) for c, s in zip(coefficients, size, strict=True)]
    )
    rows[:, :-1] *= scale
    weight = np.sqrt(regularization.weight) if regularization.kind == "euclidean" else 0.0
    prior = np.column_stack([np.diag(weight * held), weight * held * model.prior / scale])
    R = np.asarray(np.linalg.qr(np.concatenate([rows, prior]), mode="r"))
    p = len(coefficients)
    parts = tuple(
        Part(body, SIZE * i, scale[SIZE * i : SIZE * (i + 1)], inequalities)
        for i, (body, kind) in enumerate(zip(bodies, sets, strict=True))
        for inequalities in kind.parts(body.ellipsoids)
    )
    others = np.arange(SIZE * len(bodies), p)
    lower = np.array([coefficients[i].lower for i in others]) / scale[others]
    return Problem(R[:p, :p], R[:p, p], float(np.square(R[p:, p]).sum()), scale, parts, others, lower)


def weighted_rows(model: LinearModel, reduction: Reduction, noise: Array) -> Array:
    """All joints' factors over all coefficients, in units of their noise and per sample; shape (rows, p + 1)."""
    samples = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    p = len(model.coefficients)
    rows = np.zeros((sum(len(factor.R) for factor in reduction), p + 1))
    first = 0
    for factor, columns, sigma in zip(reduction, model.active(), noise, strict=True):
        last = first + len(factor.R)
        rows[first:last, [*columns, p]] = factor.R / (sigma * np.sqrt(samples))
        first = last
    return rows


def solve(problem: Problem, **options: float) -> tuple[Array, Certificate]:
    """Solve with Clarabel through cvxpy, and check the result.

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
        If the problem is infeasible or was not solved to a relative gap of 1e-6.
    """
    x = cp.Variable(problem.S.shape[1])
    constraints: list[cp.Constraint] = []
    labels: list[tuple[int, Array, str]] = []  # variable, matrices, words; one a matrix inequality
    for k, part in enumerate(problem.parts):
        pi = x[SIZE * k : SIZE * (k + 1)]
        for inequality in part.inequalities:
            G = inequality.scaled(part.scales)
            n = G.shape[-1]
            value = cp.reshape(G.reshape(SIZE, -1).T @ pi, (n, n), order="C") - _INTERIOR * np.eye(n)
            constraints.append(value >> 0 if n > 1 else value[0, 0] >= 0)
            labels.append((SIZE * k, G, f"{part.body.name}: {inequality.label}"))
    bounded = np.flatnonzero(np.isfinite(problem.lower))
    first = SIZE * len(problem.parts)
    if len(bounded):
        constraints.append(x[first + bounded] >= problem.lower[bounded])
    program = cp.Problem(cp.Minimize(cp.sum_squares(problem.A @ (problem.S @ x) - problem.b)), constraints)
    # The problem comes in units of order one; scaling it again costs accuracy.
    settings = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-7, "tol_feas": 1e-8, "equilibrate_enable": False, **options}
    started = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of inaccuracy, which the certificate judges
            program.solve(solver=cp.CLARABEL, **settings)
    except cp.SolverError as error:
        raise SolverError("solver", f"gave up: {error}") from None
    seconds = time.perf_counter() - started
    if x.value is None:
        raise SolverError("solver", f"found the problem {program.status}; loosen constraints or add a prior")
    value = np.asarray(x.value)
    duals = [np.atleast_2d(constraint.dual_value) for constraint in constraints[: len(labels)]]
    friction = np.zeros(len(value))
    if len(bounded):
        friction[first + bounded] = np.maximum(constraints[-1].dual_value, 0)
    margins = [_least(G, value[k : k + SIZE]) for k, G, _ in labels]
    worst = int(np.argmin(margins)) if margins else -1
    gap = _gap(problem, value, labels, duals, friction)
    certificate = Certificate(
        name="clarabel",
        status=program.status,
        objective=problem.cost(problem.S @ value),
        duality_gap=gap,
        iterations=int(program.solver_stats.num_iters or 0),
        seconds=seconds,
        violation=-margins[worst] if margins else 0.0,
        where=labels[worst][2] if labels else "",
    )
    if not abs(gap) <= _GAP or certificate.violation > 0:
        raise SolverError(
            certificate.where or "solver",
            f"not solved well enough: relative duality gap {gap:.1e}, worst violation {certificate.violation:.1e}",
        )
    return value, certificate


def _least(G: Array, pi: Array) -> float:
    return float(np.linalg.eigvalsh(np.tensordot(pi, G, axes=1))[0])


def _gap(
    problem: Problem, x: Array, labels: list[tuple[int, Array, str]], duals: list[Array], friction: Array
) -> float:
    """Relative duality gap from the solver's dual variables, these first made feasible.

    With slope_l = Σ over a part's inequalities of ⟨G, Z⟩ the dual function is the minimum over y of f(y) − slope · y
    plus the interior's share, a least-squares problem in y; parts of one body must have the same slope, and how far the
    solver's differ is charged to the gap.
    """
    slope = friction.copy()
    interior = float(friction[SIZE * len(problem.parts) :] @ np.nan_to_num(problem.lower, neginf=0.0))
    for (k, G, _), returned in zip(labels, duals, strict=True):
        values, vectors = np.linalg.eigh(0.5 * (returned + returned.T))
        Z = (vectors * np.maximum(values, 0)) @ vectors.T
        slope[k : k + SIZE] += np.einsum("kij,ij->k", G, Z)
        interior += _INTERIOR * float(np.trace(Z))
    S = problem.S
    mean = (S @ slope) / S.sum(axis=1)  # over the parts of a body
    mismatch = float(np.abs((slope - S.T @ mean) * x).sum())
    primal = problem.cost(S @ x)
    # min over y of ‖A y − b‖² − mean · y is at A y = b + ½ A⁻ᵀ mean.
    half = 0.5 * np.linalg.lstsq(problem.A.T, mean, rcond=None)[0]
    unreached = float(np.abs((problem.A.T @ half - 0.5 * mean) * (S @ x)).sum())
    dual = problem.constant - float(half @ (half + 2 * problem.b)) + interior
    return (primal - dual + mismatch + unreached) / max(primal, float(np.finfo(float).tiny))

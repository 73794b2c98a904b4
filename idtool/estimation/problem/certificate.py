"""Certificate of a solution, computed from it and its dual variables and not taken from the solver's word.

Letters as in `problem`; Z the dual matrices of the inequalities.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.estimation.problem.problem import Problem
from idtool.robot.inequality import smallest_value
from idtool.robot.inertia import J_BASIS, PI_SIZE

_TRACE = np.trace(J_BASIS, axis1=1, axis2=2)  # of J per unit of each parameter, in units of the body
_MOST_STEPS = 50  # of Newton's method
_LAST_DECREMENT = 1e-9  # Newton decrement, of a self-concordant function, at which the step was the last
GAP = 1e-6  # relative duality gap above which a solution is refused
ROUNDING = 1e-12  # of the cost: no gap is known more closely


@dataclass(frozen=True)
class Certificate:
    """The check of a solution.

    Attributes
    ----------
    name, status, iterations, seconds
        The solver, the status it returned, and its effort.
    objective
        f at the solution.
    duality_gap
        f less the dual function at the solver's dual variables, relative to f, or to the noise, 1, where f is less: no
        parameters in the sets, their boundaries included, can have a cost lower than f by more than this.
    violation
        Largest violation of an inequality, in units of the body; at most 0 if all hold.
    where
        The body and inequality of that.
    margin
        The part of ``duality_gap`` that comes from keeping the bodies a little inside of their sets.
    parameter_error
        Distance of the parameters from the optimum, in units of the body, if the optimum was refined; else None.
    """

    name: str
    status: str
    objective: float
    duality_gap: float
    iterations: int
    seconds: float
    violation: float
    where: str
    margin: float = 0.0
    parameter_error: float | None = None

    @property
    def holds(self) -> bool:
        """True if every inequality holds and the duality gap, but for the margin's part, is closed."""
        return self.violation <= 0 and abs(self.duality_gap - self.margin) <= GAP

    @property
    def certified(self) -> bool:
        """True if every inequality holds and the whole duality gap is closed: the cost is the least possible."""
        return self.violation <= 0 and abs(self.duality_gap) <= GAP


def violation(problem: Problem, x: Array) -> tuple[float, str]:
    """The largest violation of an inequality at x beyond rounding, in units of the body, and the inequality's label."""
    margins = [smallest_value(inequality.value(x)) for inequality in problem.inequalities]
    if not margins:
        return 0.0, ""
    worst = int(np.argmin(margins))
    return -margins[worst], problem.inequalities[worst].label


def lower_bound(problem: Problem, x: Array, duals: Sequence[Array], multipliers: Array) -> float:
    """Lower bound of the cost in the sets, from the solver's dual variables, these first made feasible.

    With g the slope Σ ⟨G, Z⟩ of the inequalities in z and mu the multipliers of exact constraints, the dual
    function is the minimum over z of f(z) − (g + Eᵀ mu) · z, plus mu · e and the lower bounds' share. f is replaced by
    its quadratic part and a tangent of its convex rest, which lies below it: a least-squares problem.

    Parameters
    ----------
    problem
        The problem.
    x
        Solution at which the bound is to be tight, shape (m,).
    duals
        Z of every inequality, shape (n, n) or (n,) each.
    multipliers
        Dual variables of the lower bounds.
    """
    multipliers = np.maximum(multipliers, 0)
    duals = [_nonnegative(Z) for Z in duals]
    slope = _slope(problem, duals)
    slope[problem.other_coefficients[np.isfinite(problem.lower)]] += multipliers
    z = problem.S @ x
    downhill = 2 * problem.A.T @ (problem.A @ z - problem.b) + _tangent(problem, z) - slope
    mu = np.linalg.lstsq(problem.E.T, downhill, rcond=None)[0]
    slope += problem.E.T @ mu
    tangent_points = [z]
    if problem.log_dets:
        tangent_points.append(_minimizer(problem, slope, z))
    minimum = max(_tangent_minimum(problem, slope, point) for point in tangent_points)
    return float(minimum + multipliers @ problem.bounds + mu @ problem.e)


def cost_of_margin(problem: Problem, duals: Sequence[Array], margin: float) -> float:
    """Increase of the cost because bodies are kept inside of their sets by a margin, to first order.

    Parameters
    ----------
    problem
        The problem.
    duals
        Z of every inequality, shape (n, n) or (n,) each.
    margin
        Distance from the boundary, in units of the body; the problem's own where that is more.
    """
    cost = 0.0
    for inequality, Z in zip(problem.inequalities, duals, strict=True):
        if inequality.interior:
            trace = float(np.trace(Z) if Z.ndim == 2 else Z.sum())
            cost += max(inequality.interior, margin) * trace
    return cost


def _tangent_minimum(problem: Problem, slope: Array, point: Array) -> float:
    """Minimum over z of f(z) − slope · z, the log-dets replaced by their tangent at a point."""
    tangent = _tangent(problem, point)
    rest = sum(term.value(point) for term in problem.log_dets) - tangent @ point
    # min over z of ‖A z − b‖² − g · z is where A z − b is ½ A⁻ᵀ g.
    half = 0.5 * np.linalg.solve(problem.A.T, slope - tangent)
    return problem.constant + float(rest - half @ (half + 2 * problem.b))


def _tangent(problem: Problem, z: Array) -> Array:
    """Slope at z of the part of f that is not quadratic, shape (p',)."""
    tangent = np.zeros_like(z)
    for term in problem.log_dets:
        tangent[term.z_slice] += term.gradient(z)
    return tangent


def _minimizer(problem: Problem, slope: Array, z: Array) -> Array:
    """Minimizer of f(z) − slope · z, from a z nearby: Newton's method on a self-concordant function."""
    for _ in range(_MOST_STEPS):
        roots = [np.sqrt(2) * problem.A]
        for term in problem.log_dets:
            root = np.zeros((term.G[0].size, len(z)))
            root[:, term.z_slice] = term.root(z)
            roots.append(root)
        downhill = slope - 2 * problem.A.T @ (problem.A @ z - problem.b) - _tangent(problem, z)
        R = np.linalg.qr(np.concatenate(roots), mode="r")  # Rᵀ R is the Hessian
        scaled = solve_triangular(R, downhill, trans=1)
        step = solve_triangular(R, scaled)
        # Of a damped step: f / weight is self-concordant (Nesterov & Nemirovski), so that it descends and stays inside.
        size = float(np.sqrt(scaled @ scaled / min(term.weight for term in problem.log_dets)))
        z = z + step / (1 + size)
        if size < _LAST_DECREMENT:
            break
    return z


def _nonnegative(Z: Array) -> Array:
    """The nearest positive semidefinite matrix, or nonnegative vector."""
    if Z.ndim == 1:
        return np.maximum(Z, 0)
    values, vectors = np.linalg.eigh(0.5 * (Z + Z.T))
    return np.asarray((vectors * np.maximum(values, 0)) @ vectors.T)


def _slope(problem: Problem, duals: Sequence[Array]) -> Array:
    """Σ ⟨G, Z⟩ in z, shape (p',), not counting the lower bounds.

    A body of several pieces needs one slope g with basisᵀ g − Σ ⟨G, Z⟩ in the dual cone of every piece. The solver's
    agree but for its tolerance, so their mean is raised, along the slope of Tr J, until it is above them all.
    """
    in_x = np.zeros(problem.variables)
    for inequality, Z in zip(problem.inequalities, duals, strict=True):
        in_x[inequality.x_slice] += np.tensordot(inequality.G, Z, axes=Z.ndim)
    slope = np.zeros(len(problem.scale))
    for body in dict.fromkeys(piece.body for piece in problem.pieces):
        pieces = [piece for piece in problem.pieces if piece.body == body]
        bases = np.concatenate([piece.basis.T for piece in pieces])
        slopes = np.concatenate([in_x[piece.x_slice] for piece in pieces])
        g = np.linalg.lstsq(bases, slopes, rcond=None)[0]
        if len(slopes) > PI_SIZE:
            shortfalls = [_shortfall(piece.basis, piece.basis.T @ g - in_x[piece.x_slice]) for piece in pieces]
            g = g + _TRACE * max(shortfalls)
        slope[pieces[0].z_slice] = g
    return slope


def _shortfall(basis: Array, rest: Array) -> float:
    """Multiple of the slope of Tr J that brings ``rest``, shape (K,), into the dual cone of a piece."""
    if len(rest) > PI_SIZE:  # point masses
        return max(float(np.max(-rest / (basis.T @ _TRACE))), 0.0)
    rows = J_BASIS.reshape(PI_SIZE, -1)
    W = np.asarray(np.linalg.lstsq(rows, rest, rcond=None)[0], dtype=float)  # ⟨BASIS_k, W⟩ = rest_k, symmetric
    return max(-smallest_value(W.reshape(4, 4)), 0.0)

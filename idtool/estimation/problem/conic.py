"""The optimization problem as Clarabel takes it: minimize ½ vᵀ P v + qᵀ v subject to A v + s = b, s in a cone.

v = (d, r, Z): the step d of x from a start, the residual r = A S d + r₀ whose square is minimized, so that no normal
equations are formed, and for every log-det the triangle Z of a matrix with

    [[diag Z, Zᵀ], [Z, X]] ⪰ 0,  t_i ≤ log Z_ii,  Σ t_i ≤ log det X,

equal at the optimum (Ben-Tal & Nemirovski, Lectures on Modern Convex Optimization, section 4.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from functools import cache
from typing import Any

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import InfeasibleError, SolverError
from idtool.common.names import join_names
from idtool.estimation.problem.prior import LogDet
from idtool.estimation.problem.problem import Problem
from idtool.estimation.problem.variables import ConicInequality

SOLVER_INTERIOR = 1e-7  # how far inside its set a body is kept at least, that no tolerance of the solver's takes it out


@dataclass(frozen=True)
class Solution:
    """Solution of a solver.

    Attributes
    ----------
    x
        The optimum, shape (m,).
    duals
        Dual variable of every inequality, shape (n, n) or (n,).
    multipliers
        Dual variables of the lower bounds.
    status
        Status that the solver returned.
    iterations
        Number of iterations.
    """

    x: Array
    duals: list[Array]
    multipliers: Array
    status: str
    iterations: int


@dataclass
class _ConeRows:
    """Blocks of rows A v + s = b with their cones."""

    width: int
    places: list[Indices] = field(default_factory=list)  # row and column of every entry of A, shape (2, k)
    entries: list[Array] = field(default_factory=list)
    b: list[Array] = field(default_factory=list)
    cones: list[Any] = field(default_factory=list)

    def add(self, columns: slice, M: Array, b: Array, cone: Any) -> int:
        """Rows M on some columns of v; returns their place among the blocks."""
        row, column = np.nonzero(M)
        first_row = sum(map(len, self.b))
        self.places.append(np.array([first_row + row, (columns.start or 0) + column]))
        self.entries.append(M[row, column])
        self.b.append(b)
        self.cones.append(cone)
        return len(self.b) - 1


def solve_conic(problem: Problem, start: Array, settings: Mapping[str, Any]) -> Solution:
    """Solve, from a start near which the step is small.

    Parameters
    ----------
    problem
        From `problem.build_problem`.
    start
        Any x, shape (m,); at the optimum without inequalities, b takes no digits.
    settings
        Settings of Clarabel.

    Raises
    ------
    InfeasibleError
        If nothing fulfils the constraints.
    SolverError
        If the solver gives up.
    """
    rows, q, places = _conic_form(problem, start)
    m, p = problem.variables, len(problem.b)
    P = sparse.diags(np.repeat([0.0, 2.0, 0.0], [m, p, rows.width - m - p]), format="csc")
    answer = _run(P, q, rows, settings)
    if "Infeasible" in str(answer.status):
        raise infeasible(problem)
    z = np.split(np.asarray(answer.z), np.cumsum([len(b) for b in rows.b])[:-1])
    duals = []
    for inequality, place in zip(problem.inequalities, places, strict=False):
        is_vector = inequality.G.ndim == 2
        duals.append(z[place] if is_vector else smat(z[place], inequality.G.shape[-1]))
    multipliers = z[places[-1]] if len(problem.bounded) else np.zeros(0)
    status = "optimal" if answer.status == clarabel.SolverStatus.Solved else str(answer.status)
    return Solution(start + np.asarray(answer.x)[:m], duals, multipliers, status, int(answer.iterations))


def infeasible(problem: Problem) -> InfeasibleError:
    """The error that no parameters fulfil a problem's constraints."""
    what = f" and the exactly known values ({join_names(problem.equality_labels)})" if problem.equality_labels else ""
    return InfeasibleError(
        "solver", f"found no parameters that satisfy the constraints{what}; relax one of them, or check its unit"
    )


def _conic_form(problem: Problem, start: Array) -> tuple[_ConeRows, Array, list[int]]:
    """Constraints, linear cost of the log-dets, and the places of the inequalities and, last, of the lower bounds."""
    m, p = problem.variables, len(problem.b)
    places_of_terms = np.cumsum([m + p, *(_extra_variables(term) for term in problem.log_dets)])
    rows = _ConeRows(int(places_of_terms[-1]))
    q = np.zeros(rows.width)
    AS = problem.A @ problem.S
    step, whole = slice(0, m), slice(0, m + p)
    rows.add(whole, np.hstack([-AS, np.eye(p)]), AS @ start - problem.b, clarabel.ZeroConeT(p))
    if len(problem.e):
        ES = problem.E @ problem.S
        rows.add(step, ES, problem.e - ES @ start, clarabel.ZeroConeT(len(ES)))
    places = [_add_inequality(rows, inequality, start) for inequality in problem.inequalities]
    bounded = problem.bounded
    if len(bounded):
        cone = clarabel.NonnegativeConeT(len(bounded))
        places.append(rows.add(step, -np.eye(m)[bounded], start[bounded] - problem.bounds, cone))
    for term, first in zip(problem.log_dets, places_of_terms, strict=False):
        _add_log_det(rows, q, term, problem, start, int(first))
    return rows, q, places


def _add_inequality(rows: _ConeRows, inequality: ConicInequality, start: Array) -> int:
    """The cone of one inequality; returns its place among the blocks."""
    value = inequality.value(start)
    n = len(value)
    interior = max(inequality.interior, SOLVER_INTERIOR) if inequality.interior else 0.0
    if value.ndim == 1:
        inside, cone = value - interior, clarabel.NonnegativeConeT(n)
        return rows.add(inequality.x_slice, -inequality.G.T, inside, cone)
    inside = svec(value - interior * np.eye(n))
    return rows.add(inequality.x_slice, -svec(inequality.G).T, inside, clarabel.PSDTriangleConeT(n))


def _extra_variables(term: LogDet) -> int:
    """Number of variables that a log-det adds: the triangle Z and the logarithms t."""
    n = len(term.G[0])
    return n * (n + 1) // 2 + n


def _add_log_det(rows: _ConeRows, q: Array, term: LogDet, problem: Problem, start: Array, first: int) -> None:
    """The variables and cones of one log-det, and its share of the cost."""
    n = term.G.shape[-1]
    lower = np.tril_indices(n)
    k = len(lower[0])
    S = problem.S[term.z_slice]
    q[: problem.variables] += term.slope @ S
    q[first + k : first + k + n] = -term.weight
    G = np.zeros((rows.width, 2 * n, 2 * n))
    G[: problem.variables, n:, n:] = np.tensordot(S.T, term.G, axes=1)
    for place, (i, j) in enumerate(np.transpose(lower).tolist()):
        G[first + place, n + i, j] = G[first + place, j, n + i] = 1
        if i == j:
            G[first + place, i, i] = 1
    offset = np.zeros((2 * n, 2 * n))
    offset[n:, n:] = np.tensordot(S @ start, term.G, axes=1)
    rows.add(slice(None), -svec(G).T, svec(offset), clarabel.PSDTriangleConeT(2 * n))
    diagonal = np.flatnonzero(lower[0] == lower[1])
    for i in range(n):
        exponential = np.zeros((3, rows.width))
        exponential[0, first + k + i] = exponential[2, first + diagonal[i]] = -1
        rows.add(slice(None), exponential, np.array([0.0, 1.0, 0.0]), clarabel.ExponentialConeT())


def svec(matrices: Array) -> Array:
    """Upper triangles column by column, off the diagonal times √2; shape (..., n, n) to (..., n (n + 1) / 2)."""
    row, column, factor = _upper_triangle(matrices.shape[-1])
    return np.asarray(matrices[..., row, column] * factor)


def smat(vector: Array, n: int) -> Array:
    """The symmetric matrix of `svec`, shape (n, n)."""
    row, column, factor = _upper_triangle(n)
    matrix = np.empty((n, n))
    matrix[row, column] = matrix[column, row] = vector / factor
    return matrix


@cache
def _upper_triangle(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Rows and columns of an upper triangle's entries, column by column, and their factors in `svec`."""
    column, row = np.tril_indices(n)
    return row, column, np.where(row == column, 1.0, np.sqrt(2))


def _run(P: Any, q: Array, rows: _ConeRows, settings: Mapping[str, Any]) -> Any:
    """The solver's answer; a `SolverError` if it breaks down."""
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.max_threads = 1  # a copy of this process has none of the solver's threads, and would wait for them forever
    for name, value in settings.items():
        setattr(options, name, value)
    b = np.concatenate(rows.b)
    entries, places = np.concatenate(rows.entries), np.concatenate(rows.places, axis=1)
    A = sparse.csc_matrix((entries, places), shape=(len(b), rows.width))
    if not (np.isfinite(A.data).all() and np.isfinite(b).all()):
        raise SolverError("solver", "was given numbers that are not finite; check units and magnitudes")
    try:
        answer = clarabel.DefaultSolver(P, q, A, b, rows.cones, options).solve()
    except BaseException as error:  # a panic of the solver's own is no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit | MemoryError):
            raise
        raise SolverError("solver", f"failed on these numbers ({error}); check units and magnitudes") from None
    return answer

"""Range of a coefficient in which the fit is not visibly worse.

It is the range over all that the constraints allow and whose cost is at most 1 % above the least, by two conic
programmes.

Letters as in `problem`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import SolverError
from idtool.common.processes import Progress, shared_among_processes
from idtool.estimation.problem.conic import extreme_conic
from idtool.estimation.problem.problem import Problem
from idtool.estimation.problem.variables import PieceVariables

ABOVE = 0.01  # of the least cost, by which a fit may be worse
_FAR = 100.0  # units of a coefficient, beyond which it is as good as free
_COUPLED = 1e-9  # correlation of two coefficients' columns below which it is rounding
_SETTINGS = {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-5, "tol_feas": 1e-7, "equilibrate_enable": False}
_ATTEMPTS: tuple[dict[str, float | bool], ...] = (_SETTINGS, {**_SETTINGS, "equilibrate_enable": True})


def ranges(problem: Problem, x: Array, wanted: Indices, progress: Callable[[float], None]) -> Array:
    """Ranges of coefficients.

    Parameters
    ----------
    problem
        From `build_problem`.
    x
        Its optimum, shape (m,).
    wanted
        Indices in z of the coefficients.
    progress
        Callback for the share that is done.

    Returns
    -------
    The least and the greatest value, SI, shape (k, 2); infinite where there is none, NaN where the solver gave up.
    """
    level = problem.cost(problem.S @ x) * (1 + ABOVE)
    place = {int(k): i for i, k in enumerate(wanted)}
    searches: list[_Search] = []
    for component in _components(problem):
        in_component = [int(k) for k in component if int(k) in place]
        if not in_component:
            continue
        restricted, start = _restricted(problem, x, component)
        for k in in_component:
            row = np.where(component == k, 1.0, 0.0)
            searches.append(_Search(len(searches), k, restricted, start, row))

    def limits_of(search: _Search, tell: Progress) -> tuple[float, float]:
        lowest = _least(search.problem, search.start, search.row, level)
        highest = -_least(search.problem, search.start, -search.row, level)
        tell("", (search.number + 1) / len(searches))
        return lowest, highest

    found = shared_among_processes(limits_of, searches, lambda stage, share: progress(share))
    limits = np.full((len(wanted), 2), np.nan)
    for search, ends in zip(searches, found, strict=True):
        limits[place[search.coefficient]] = problem.scale[search.coefficient] * np.array(ends)
    progress(1.0)
    return limits


class _Search(NamedTuple):
    """Search for the range of one coefficient z.

    Attributes
    ----------
    number
        Its number among the searches.
    coefficient
        Index of the coefficient in z.
    problem, start
        The problem in the coefficients that are coupled with it, and its optimum.
    row
        What picks the coefficient from those of the problem.
    """

    number: int
    coefficient: int
    problem: Problem
    start: Array
    row: Array


def free_spread(problem: Problem, x: Array) -> Array:
    """Half of the range of every z without any constraint, SI, shape (p',)."""
    roots = [problem.A]
    z = problem.S @ x
    for term in problem.log_dets:  # to second order
        root = np.zeros((term.G[0].size, len(z)))
        root[:, term.z_slice] = term.root(z) / np.sqrt(2)
        roots.append(root)
    R = np.linalg.qr(np.concatenate(roots), mode="r")
    deviation = np.linalg.norm(np.linalg.inv(R), axis=1)
    return np.asarray(problem.scale * np.sqrt(ABOVE * problem.cost(z)) * deviation)


def _least(problem: Problem, start: Array, row: Array, level: float) -> float:
    """Minimum of row · z; −∞ where it is as good as free, NaN where the solver gave up."""
    for settings in _ATTEMPTS:
        try:
            x = extreme_conic(problem, start, row, level, settings)
        except SolverError:
            continue
        least = -np.inf if x is None else float(row @ (problem.S @ x))
        return least if least > -_FAR else -np.inf
    return np.nan


def _components(problem: Problem) -> list[Indices]:
    """Indices in z of coefficients that are coupled with each other only: the legs of a robot on a stand, for one."""
    from scipy.sparse.csgraph import connected_components

    size = np.linalg.norm(problem.A, axis=0)
    coupled = np.abs(problem.A.T @ problem.A) > _COUPLED * np.outer(size, size)
    for row in problem.E:
        coupled |= np.outer(row, row) != 0
    for piece in problem.pieces:
        coupled[piece.z_slice, piece.z_slice] = True
    count, label = connected_components(sparse.csr_matrix(coupled.astype(int)), directed=False)
    return [np.flatnonzero(label == i) for i in range(count)]


def _restricted(problem: Problem, x: Array, kept: Indices) -> tuple[Problem, Array]:
    """The problem in some of the coefficients z, the others at their optimum, and its own optimum."""
    place = {int(k): i for i, k in enumerate(kept)}
    pieces: list[PieceVariables] = []
    variables = []  # in x
    for piece in problem.pieces:
        if piece.first in place:
            variables.append(np.arange(piece.start, piece.stop))
            pieces.append(replace(piece, first=place[piece.first], start=pieces[-1].stop if pieces else 0))
    is_kept = np.array([k in place for k in problem.other_coefficients.tolist()], dtype=bool)
    first_other = problem.variables - len(problem.other_coefficients)
    variables.append(first_other + np.flatnonzero(is_kept))

    Q, R = np.linalg.qr(problem.A[:, kept])
    is_constrained = problem.E[:, kept].any(axis=1)
    restricted = replace(
        problem,
        A=R,
        b=Q.T @ problem.b,
        constant=0.0,
        scale=problem.scale[kept],
        K=problem.K[:, kept],
        pieces=tuple(pieces),
        other_coefficients=np.array([place[int(k)] for k in problem.other_coefficients[is_kept]], dtype=np.intp),
        lower=problem.lower[is_kept],
        E=problem.E[np.ix_(is_constrained, kept)],
        e=problem.e[is_constrained],
        log_dets=tuple(replace(term, first=place[term.first]) for term in problem.log_dets if term.first in place),
    )
    start = x[np.concatenate(variables)]
    rest = problem.cost(problem.S @ x) - restricted.cost(restricted.S @ start)
    return replace(restricted, constant=rest), start

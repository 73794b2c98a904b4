"""Range of a coefficient in which the fit is not visibly worse.

It is the range over all that the constraints allow and whose cost is at most 1 % above the least.

Letters as in `problem`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import SolverError
from idtool.common.processes import Progress, shared_among_processes
from idtool.estimation.problem.extremes import LevelSet
from idtool.estimation.problem.problem import Problem
from idtool.estimation.problem.variables import PieceVariables

ABOVE = 0.01  # of the least cost, by which a fit may be worse
_FAR = 100.0  # units of a coefficient from its optimum, beyond which it is as good as free
_COUPLED = 1e-9  # correlation of two coefficients' columns below which it is rounding


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
    The least and the greatest value, SI, shape (k, 2); infinite where there is none, NaN where the search gave up.
    """
    level = problem.cost(problem.S @ x) * (1 + ABOVE)
    searches = [
        search for component in _components(problem) for search in _searches(problem, x, component, wanted, level)
    ]

    def limits_of(number: int, tell: Progress) -> Array:
        limits = searches[number].limits()
        tell("", (number + 1) / len(searches))
        return limits

    found = shared_among_processes(limits_of, range(len(searches)), lambda stage, share: progress(share))
    limits = np.full((len(problem.scale), 2), np.nan)
    for search, own_limits in zip(searches, found, strict=True):
        limits[search.coefficients] = own_limits
    progress(1.0)
    return np.asarray(problem.scale[wanted, None] * limits[wanted])


class _Search(NamedTuple):
    """Search for the ranges of some coefficients z.

    Attributes
    ----------
    coefficients
        Their indices in z, shape (k,).
    level_set
        What the data and constraints allow of all coefficients that are coupled with them.
    rows
        What picks each of them from these, shape (k, p').
    best
        Their values at the optimum, shape (k,).
    """

    coefficients: Indices
    level_set: LevelSet
    rows: Array
    best: Array

    def limits(self) -> Array:
        """The least and the greatest z, shape (k, 2)."""
        out_of_sight = np.concatenate([self.best, -self.best]) - _FAR
        least = self.level_set.least(np.concatenate([self.rows, -self.rows]), out_of_sight)
        least[least < out_of_sight] = -np.inf
        lowest, highest = np.split(least, 2)
        return np.column_stack([lowest, -highest])


def _searches(problem: Problem, x: Array, component: Indices, wanted: Indices, level: float) -> Iterator[_Search]:
    """Searches for the wanted ones of coefficients that are coupled with each other; none if there is no interior."""
    places = np.flatnonzero(np.isin(component, wanted))
    if not len(places):
        return
    restricted, start = _restricted(problem, x, component)
    try:
        level_set = LevelSet(restricted, start, level)
    except SolverError:
        return
    rows, best = np.eye(len(component)), restricted.S @ start
    together = max(level_set.batch_size // 2, 1)  # two rows for each coefficient
    for first in range(0, len(places), together):
        chosen = places[first : first + together]
        yield _Search(component[chosen], level_set, rows[chosen], best[chosen])


def free_spread(problem: Problem, x: Array) -> Array:
    """Half of the range of every z if the optimum were the one without constraints, SI, shape (p',)."""
    roots = [problem.A]
    z = problem.S @ x
    for term in problem.log_dets:  # to second order
        root = np.zeros((term.G[0].size, len(z)))
        root[:, term.z_slice] = term.root(z) / np.sqrt(2)
        roots.append(root)
    R = np.linalg.qr(np.concatenate(roots), mode="r")
    deviation = np.linalg.norm(np.linalg.inv(R), axis=1)
    return np.asarray(problem.scale * np.sqrt(ABOVE * problem.cost(z)) * deviation)


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

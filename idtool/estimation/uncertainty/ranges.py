"""How far a coefficient can go before the fit is visibly worse.

Its range over all that the constraints allow and whose cost is at most 1 % above the least, by two conic programmes.

Letters as in `problem`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import SolverError
from idtool.estimation.problem.conic import extreme_conic
from idtool.estimation.problem.parts import Part
from idtool.estimation.problem.problem import Problem
from idtool.robot.inertia import SIZE

ABOVE = 0.01  # of the least cost, by which a fit may be worse
_FAR = 100.0  # units of a coefficient, beyond which it is as good as free
_COUPLED = 1e-9  # correlation of two coefficients' columns below which it is rounding
_ACCURATE = {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-5, "tol_feas": 1e-7, "equilibrate_enable": False}
_ATTEMPTS: tuple[dict[str, float | bool], ...] = (_ACCURATE, {**_ACCURATE, "equilibrate_enable": True})


def ranges(problem: Problem, x: Array, wanted: Indices, tell: Callable[[float], None]) -> Array:
    """Ranges of coefficients.

    Parameters
    ----------
    problem
        From `build_problem`.
    x
        Its optimum, shape (m,).
    wanted
        Indices in z of the coefficients.
    tell
        Told the share that is done.

    Returns
    -------
    The least and the greatest value, SI, shape (k, 2); infinite where there is none, NaN where the solver gave up.
    """
    level = problem.cost(problem.S @ x) * (1 + ABOVE)
    found = np.full((len(wanted), 2), np.nan)
    place = {int(k): i for i, k in enumerate(wanted)}
    done = 0
    for own in _components(problem):
        here = [int(k) for k in own if int(k) in place]
        part, start = _restricted(problem, x, own) if here else (problem, x)
        for k in here:
            row = np.where(own == k, 1.0, 0.0)
            found[place[k]] = problem.scale[k] * np.array(
                [s * _least(part, start, s * row, level) for s in (1.0, -1.0)]
            )
            done += 1
            tell(done / len(wanted))
    return found


def free_spread(problem: Problem, x: Array) -> Array:
    """Half of the same range without any constraint, of all of z, SI, shape (p',)."""
    roots = [problem.A]
    z = problem.S @ x
    for term in problem.log_dets:  # to second order
        root = np.zeros((term.G[0].size, len(z)))
        root[:, term.own] = term.root(z) / np.sqrt(2)
        roots.append(root)
    R = np.linalg.qr(np.concatenate(roots), mode="r")
    deviation = np.linalg.norm(np.linalg.inv(R), axis=1)
    return np.asarray(problem.scale * np.sqrt(ABOVE * problem.cost(z)) * deviation)


def _least(problem: Problem, start: Array, row: Array, level: float) -> float:
    """The least of row · z; −∞ where it is as good as free, NaN where the solver gave up."""
    for settings in _ATTEMPTS:
        try:
            x = extreme_conic(problem, start, row, level, settings)
        except SolverError:
            continue
        least = -np.inf if x is None else float(row @ (problem.S @ x))
        return least if least > -_FAR else -np.inf
    return np.nan


def _components(problem: Problem) -> list[Indices]:
    """Indices in z of what has nothing to do with the rest: the legs of a robot on a stand, for one."""
    size = np.linalg.norm(problem.A, axis=0)
    coupled = np.abs(problem.A.T @ problem.A) > _COUPLED * np.outer(size, size)
    for row in problem.E:
        coupled |= np.outer(row, row) != 0
    for part in problem.parts:
        coupled[part.first : part.first + SIZE, part.first : part.first + SIZE] = True
    count, label = connected_components(sparse.csr_matrix(coupled.astype(int)), directed=False)
    return [np.flatnonzero(label == i) for i in range(count)]


def _restricted(problem: Problem, x: Array, own: Indices) -> tuple[Problem, Array]:
    """The problem in some coefficients, the others at their optimum, and the optimum."""
    place = {int(k): i for i, k in enumerate(own)}
    parts: list[Part] = []
    kept = []
    for part in (part for part in problem.parts if part.first in place):
        kept.append(np.arange(part.start, part.stop))
        parts.append(replace(part, first=place[part.first], start=parts[-1].stop if parts else 0))
    chosen = np.array([k in place for k in problem.others.tolist()], dtype=bool)
    kept.append(problem.variables - len(problem.others) + np.flatnonzero(chosen))
    Q, R = np.linalg.qr(problem.A[:, own])
    terms = tuple(replace(term, first=place[term.first]) for term in problem.log_dets if term.first in place)
    facts = problem.E[:, own].any(axis=1)
    part_of = replace(
        problem,
        A=R,
        b=Q.T @ problem.b,
        constant=0.0,
        scale=problem.scale[own],
        K=problem.K[:, own],
        parts=tuple(parts),
        others=np.array([place[int(k)] for k in problem.others[chosen]], dtype=np.intp),
        lower=problem.lower[chosen],
        E=problem.E[np.ix_(facts, own)],
        e=problem.e[facts],
        log_dets=terms,
    )
    start = x[np.concatenate(kept)]
    rest = problem.cost(problem.S @ x) - part_of.cost(part_of.S @ start)
    return replace(part_of, constant=rest), start

"""Projection: the nearest parameters of a set (Remark 5).

Letters: pi (10,) parameters; z = pi in units of the body's own mass and size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import SolverError
from idtool.dynamics.effects.rigid_body import parameter_scales
from idtool.estimation.problem.identify import solve
from idtool.estimation.problem.parts import parts_of
from idtool.estimation.problem.prior import reference
from idtool.estimation.problem.problem import Problem
from idtool.robot.body import Body
from idtool.robot.inertia import SIZE
from idtool.robot.metric import FLOOR, nearest_realizable, pullback
from idtool.robot.sets import ConstraintSet

Metric = Literal["euclidean", "pullback"]

_PASSES = 6
_COARSE, _FINER = 0.1, 1e-5  # cost from which the gap is small against it; of the last unit, the least next one
_NO_DISTANCE = 1e-6  # squared


@dataclass(frozen=True)
class Projection:
    """The nearest parameters of a set.

    Attributes
    ----------
    pi
        Shape (10,).
    pieces
        What they are the sum of (Cor. 2), shape (pieces, 10).
    distance
        From the parameters projected, in units of the body's mass and size or of the pull-back metric.
    """

    pi: Array
    pieces: Array
    distance: float


def project(pi: Array, chosen: ConstraintSet, body: Body, metric: Metric = "euclidean") -> Projection:
    """The nearest parameters of a set.

    Parameters
    ----------
    pi
        Any finite parameters, shape (10,).
    chosen
        The set.
    body
        Whose bounds the set takes, and whose size the Euclidean metric is relative to.
    metric
        ``euclidean``: relative deviations; ``pullback``: ½ Tr(Ĵ⁻¹ dJ Ĵ⁻¹ dJ) at pi or, where pi is not well inside the
        realizable parameters, at what is next to it there. The latter does not depend on units and frames.

    Raises
    ------
    SolverError
        If the problem could not be solved.
    """
    pi = np.asarray(pi, dtype=float)
    unit = parameter_scales(body, abs(float(pi[0])) or 1.0)
    at = reference(pi, unit)
    M = np.eye(SIZE) if metric == "euclidean" else unit[:, None] * pullback(at) * unit
    if metric == "pullback" and chosen.name in ("full", "ellipsoid") and len(body.ellipsoids) < 2 and not body.com:
        bounded = chosen.name == "ellipsoid" and body.ellipsoids
        nearest = nearest_realizable(pi, at, body.ellipsoids[0].Q if bounded else None)
        off = (nearest - pi) / unit
        return Projection(nearest, nearest[None], float(np.sqrt(off @ M @ off)))
    return _solved(pi, chosen, body, M, unit)


def _solved(pi: Array, chosen: ConstraintSet, body: Body, M: Array, unit: Array) -> Projection:
    """The projection by the solver, whose gap is relative to a cost of one: again with the distance as its unit."""
    size, found = float(np.linalg.norm(M)), None
    for _ in range(_PASSES):
        problem = nearest_problem(pi, chosen, body, np.asarray(np.linalg.cholesky(M / size).T), unit)
        try:
            x, certificate = solve(problem)
        except SolverError:
            if found is None:
                raise
            break
        squared = size * max(certificate.objective, 0.0)
        pieces = np.array([piece for _, piece in problem.pieces(x)])
        found = Projection(problem.theta(problem.S @ x), pieces, float(np.sqrt(squared)))
        if certificate.objective > _COARSE or size < _NO_DISTANCE:
            break
        size *= max(certificate.objective, _FINER)
    if found is None:
        raise AssertionError  # the first pass gives it or an error
    return found


def nearest_problem(pi: Array, chosen: ConstraintSet, body: Body, A: Array, unit: Array) -> Problem:
    """The problem min ‖A (z − pi / unit)‖² over a set.

    Parameters
    ----------
    pi, chosen, body
        As in `project`.
    A
        Square root of the metric in these units, shape (10, 10).
    unit
        Units of the parameters, shape (10,).
    """
    known = np.array([[-c, *np.eye(3)[k], *np.zeros(6)] for k, c in enumerate(body.com or ())]).reshape(-1, SIZE)
    E = known * unit / np.linalg.norm(known * unit, axis=1, keepdims=True)
    none = np.zeros(0)
    parts = parts_of([body], [chosen], np.arange(SIZE))
    others = none.astype(np.intp)
    facts = E, np.zeros(len(E))
    return Problem(
        A, A @ (pi / unit), 0.0, unit, np.eye(SIZE), parts, (body.name,), others, none, *facts, interior=FLOOR
    )

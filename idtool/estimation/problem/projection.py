"""Projection: the nearest parameters of a set (Remark 5).

Letters: pi (10,) parameters; z = pi in units of the body's own mass and size.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import SolverError
from idtool.dynamics.effects.rigid_body import parameter_scales
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.prior import realizable_prior
from idtool.estimation.problem.problem import Problem
from idtool.estimation.problem.variables import piece_variables
from idtool.robot.body import Body
from idtool.robot.inertia import PI_SIZE
from idtool.robot.metric import FLOOR, nearest_realizable, pullback_metric
from idtool.robot.sets import ConstraintSet

Metric = Literal["euclidean", "pullback"]

_PASSES = 6
_ACCURATE_COST = 0.1  # in the unit of cost, from which the gap is small against it
_LEAST_STEP = 1e-5  # of the unit of cost from one pass to the next
_ZERO_DISTANCE = 1e-6  # squared


@dataclass(frozen=True)
class Projection:
    """The nearest parameters of a set.

    Attributes
    ----------
    pi
        Shape (10,).
    pieces
        Parameters of its pieces, whose sum they are (Cor. 2), shape (pieces, 10).
    distance
        Distance from the original parameters, in units of the body's mass and size or of the pull-back metric.
    """

    pi: Array
    pieces: Array
    distance: float


def project(pi: Array, constraint_set: ConstraintSet, body: Body, metric: Metric = "euclidean") -> Projection:
    """The nearest parameters of a set.

    Parameters
    ----------
    pi
        Any finite parameters, shape (10,).
    constraint_set
        The set.
    body
        The set is within its bounds, and the Euclidean metric is relative to its size.
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
    if metric == "euclidean":
        return _project_by_solver(pi, constraint_set, body, np.eye(PI_SIZE), unit)
    center = realizable_prior(pi, unit)
    M = unit[:, None] * pullback_metric(center) * unit
    has_closed_form = constraint_set.name in ("full", "ellipsoid") and len(body.ellipsoids) < 2 and not body.com
    if not has_closed_form:
        return _project_by_solver(pi, constraint_set, body, M, unit)
    Q = body.ellipsoids[0].Q if constraint_set.name == "ellipsoid" and body.ellipsoids else None
    nearest = nearest_realizable(pi, center, Q)
    difference = (nearest - pi) / unit
    return Projection(nearest, nearest[None], float(np.sqrt(difference @ M @ difference)))


def _project_by_solver(pi: Array, constraint_set: ConstraintSet, body: Body, M: Array, unit: Array) -> Projection:
    """Projection by the solver, whose gap is relative to a cost of one: again with the distance as its unit."""
    unit_cost = float(np.linalg.norm(M))
    projection = None
    for _ in range(_PASSES):
        A = np.asarray(np.linalg.cholesky(M / unit_cost).T)
        problem = nearest_problem(pi, constraint_set, body, A, unit)
        try:
            x, certificate = solve(problem)
        except SolverError:
            if projection is None:
                raise
            break
        squared = unit_cost * max(certificate.objective, 0.0)
        pieces = np.array([parameters for _, parameters in problem.piece_parameters(x)])
        projection = Projection(problem.theta(problem.S @ x), pieces, float(np.sqrt(squared)))
        if certificate.objective > _ACCURATE_COST or unit_cost < _ZERO_DISTANCE:
            break
        unit_cost *= max(certificate.objective, _LEAST_STEP)
    if projection is None:
        raise AssertionError  # the first pass gives it or an error
    return projection


def nearest_problem(pi: Array, constraint_set: ConstraintSet, body: Body, A: Array, unit: Array) -> Problem:
    """The problem min ‖A (z − pi / unit)‖² over a set.

    Parameters
    ----------
    pi, constraint_set, body
        As in `project`.
    A
        Square root of the metric in these units, shape (10, 10).
    unit
        Units of the parameters, shape (10,).
    """
    com = body.com or ()
    E = np.zeros((len(com), PI_SIZE))  # h − m c = 0
    for axis, c in enumerate(com):
        E[axis, 0] = -c
        E[axis, 1 + axis] = 1.0
    E = E * unit / np.linalg.norm(E * unit, axis=1, keepdims=True)
    return Problem(
        A=A,
        b=A @ (pi / unit),
        constant=0.0,
        scale=unit,
        K=np.eye(PI_SIZE),
        pieces=piece_variables([body], [constraint_set], np.arange(PI_SIZE)),
        body_names=(body.name,),
        other_coefficients=np.zeros(0, dtype=np.intp),
        lower=np.zeros(0),
        E=E,
        e=np.zeros(len(E)),
        interior=FLOOR,
    )

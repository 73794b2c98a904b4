"""Realizability check of a body within its bounds, with a proof: point masses, or the inequality that fails.

Letters: pi (10,) parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.number_text import short_number
from idtool.dynamics.effects.rigid_body import typical_length
from idtool.estimation.problem.conic import solve_conic
from idtool.estimation.problem.projection import nearest_problem
from idtool.robot.body import Body
from idtool.robot.inequality import Piece
from idtool.robot.inertia import LENGTH_POWERS, PI_SIZE
from idtool.robot.sets import ConstraintSet, choose_set
from idtool.robot.witness import find_witness, unrealizable_reasons, violations

_ROUNDING = 1e-9  # by which an inequality may fail, in units of the body
_NEAR = 1e-5  # distance, in units of the body, below which a body counts as in a set: the solver's tolerance
_ACCURATE = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
# Equilibrated, it loses accuracy, but does not stall on some unions.
_ATTEMPTS = ({**_ACCURATE, "equilibrate_enable": False}, {**_ACCURATE, "equilibrate_enable": True})


@dataclass(frozen=True)
class RealizabilityCheck:
    """Result of a realizability check.

    Attributes
    ----------
    violations
        Reasons why the body is not realizable within its bounds, a plain sentence each; none if it is.
    pieces
        Parameters of its pieces where its bounds are a union, shape (pieces, 10), else None.
    masses, points
        Point masses within the bounds that have its parameters exactly, shapes (n,) [kg] and (n, 3) [m] (Thm 4); none
        where it is not realizable, or where its bounds have only necessary conditions.
    """

    violations: tuple[str, ...]
    pieces: Array | None
    masses: Array
    points: Array


def check_realizability(body: Body, pi: Array, pieces: Array | None = None) -> RealizabilityCheck:
    """Check if some mass distribution within a body's bounds has given parameters.

    Parameters
    ----------
    body
        The body.
    pi
        The parameters, shape (10,).
    pieces
        Parameters that they are the sum of, if that is known, shape (pieces, 10).
    """
    if reasons := unrealizable_reasons(pi):
        return _unrealizable(*reasons)
    constraint_set = choose_set(body)
    demanded = constraint_set.pieces(body)
    mass, unit = float(pi[0]), typical_length(body)
    if len(demanded) == 1:
        violated = violations(pi, demanded[0].inequalities, mass, unit, tolerance=_ROUNDING)
        if violated:
            return _unrealizable(*(violation.text for violation in violated))
        return RealizabilityCheck((), None, *_point_masses(body, pi[None]))
    if pieces is None or not _fulfil(pieces, demanded, mass, unit):
        pieces, distance = _split(pi, constraint_set, body)
        if distance > _NEAR:
            what = f"no density on the union of its {len(demanded)} bounding shapes has these parameters"
            return _unrealizable(
                f"{what}; the nearest are {short_number(distance, 2)} away, in units of its mass and size"
            )
        heaviest = int(np.argmax(pieces[:, 0]))
        pieces[heaviest] += pi - pieces.sum(axis=0)  # the rest that the solver's tolerance leaves
    return RealizabilityCheck((), pieces, *_point_masses(body, pieces))


def _split(pi: Array, constraint_set: ConstraintSet, body: Body) -> tuple[Array, float]:
    """Pieces, shape (pieces, 10), whose sum is as near to pi as possible, and its distance in units of the body.

    The sets here are closed, unlike those of `project`: a piece may be a plate, a rod or a point, or without mass.
    """
    problem = nearest_problem(pi, constraint_set, body, np.eye(PI_SIZE), pi[0] * typical_length(body) ** LENGTH_POWERS)
    closed = tuple(replace(variables, piece=_closed(variables.piece)) for variables in problem.pieces)
    problem = replace(problem, pieces=closed)
    start = np.asarray(np.linalg.lstsq(problem.S, problem.b, rcond=None)[0], dtype=np.float64)
    x, distance = start, np.inf
    for settings in _ATTEMPTS:
        solution = solve_conic(problem, start, settings)
        solution_distance = float(np.linalg.norm(problem.S @ solution.x - problem.b))
        if solution_distance < distance:
            x, distance = solution.x, solution_distance
        if distance <= _NEAR or solution.status == "optimal":
            break
    return np.array([parameters for _, parameters in problem.piece_parameters(x)]), distance


def _closed(piece: Piece) -> Piece:
    """The piece with its boundary."""
    return replace(piece, inequalities=tuple(replace(inequality, strict=False) for inequality in piece.inequalities))


def _fulfil(pieces: Array, demanded: Sequence[Piece], mass: float, unit: float) -> bool:
    """True if given pieces, which may be of another set, fulfil all that is demanded of them."""
    if len(pieces) != len(demanded):
        return False
    for pi, piece in zip(pieces, demanded, strict=True):
        if violations(pi, piece.inequalities, mass, unit, tolerance=_ROUNDING):
            return False
    return True


def _unrealizable(*reasons: str) -> RealizabilityCheck:
    return RealizabilityCheck(reasons, None, np.zeros(0), np.zeros((0, 3)))


def _point_masses(body: Body, pieces: Array) -> tuple[Array, Array]:
    """Point masses with the pieces' parameters; none where a piece's bounds are only necessary conditions."""
    masses, points = [np.zeros(0)], [np.zeros((0, 3))]
    for ellipsoid, pi in zip(body.ellipsoids or (None,), pieces, strict=not body.shapes):
        if body.shapes or unrealizable_reasons(pi, ellipsoid):
            return masses[0], points[0]
        cloud = find_witness(pi, ellipsoid)
        has_mass = cloud.masses > 0
        masses.append(cloud.masses[has_mass])
        points.append(cloud.points[has_mass])
    return np.concatenate(masses), np.concatenate(points)

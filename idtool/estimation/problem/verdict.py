"""Whether a body can be, within its bounds, and what shows it: point masses, or the inequality that fails.

Letters: pi (10,) parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.effects.rigid_body import typical_length
from idtool.estimation.problem.conic import solve_conic
from idtool.estimation.problem.projection import nearest_problem
from idtool.robot.body import Body
from idtool.robot.inequality import Piece
from idtool.robot.inertia import POWERS, SIZE
from idtool.robot.sets import ConstraintSet, choose_set
from idtool.robot.witness import explain, violations, witness

_ROUNDING = 1e-9  # by which an inequality may fail, in units of the body
_NEAR = 1e-5  # distance, in units of the body, below which a body counts as in a set: the solver's tolerance
_ACCURATE = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-10, "tol_feas": 1e-10, "equilibrate_enable": False}


@dataclass(frozen=True)
class Verdict:
    """Whether a body can be, within its bounds.

    Attributes
    ----------
    violations
        Why not, a plain sentence each; none for a body that can.
    pieces
        What its parameters are the sum of where its bounds are a union, shape (pieces, 10), else None.
    masses, points
        Point masses within the bounds that have its parameters exactly, shapes (n,) [kg] and (n, 3) [m] (Thm 4); none
        where it cannot be, or where its bounds have only necessary conditions.
    """

    violations: tuple[str, ...]
    pieces: Array | None
    masses: Array
    points: Array


def judge(body: Body, pi: Array, pieces: Array | None = None) -> Verdict:
    """Whether a body can have parameters within its bounds, and what shows it.

    Parameters
    ----------
    body
        The body.
    pi
        The parameters, shape (10,).
    pieces
        What they are the sum of, if that is known, shape (pieces, 10).
    """
    if reasons := explain(pi):
        return _refused(*reasons)
    chosen = choose_set(body)
    demanded = chosen.pieces(body)
    if len(demanded) == 1:
        found = violations(pi, demanded[0].inequalities, float(pi[0]), typical_length(body), tolerance=_ROUNDING)
        if found:
            return _refused(*(violation.text for violation in found))
        return Verdict((), None, *_shown(body, pi[None]))
    if pieces is None or not _fulfil(pieces, demanded, float(pi[0]), typical_length(body)):
        pieces, distance = _split(pi, chosen, body)
        if distance > _NEAR:
            what = f"no density on the union of its {len(demanded)} bounding shapes has these parameters"
            return _refused(f"{what}; the nearest are {distance:.2g} away, in units of its mass and size")
        pieces[int(np.argmax(pieces[:, 0]))] += pi - pieces.sum(axis=0)  # what the solver's tolerance leaves
    return Verdict((), pieces, *_shown(body, pieces))


def _split(pi: Array, chosen: ConstraintSet, body: Body) -> tuple[Array, float]:
    """Pieces, shape (pieces, 10), whose sum is as near to pi as may be, and how far it is in units of the body.

    The sets here are closed, unlike those of `project`: a piece may be a plate, a rod or a point, or without mass.
    """
    problem = nearest_problem(pi, chosen, body, np.eye(SIZE), pi[0] * typical_length(body) ** POWERS)
    closed = [replace(part, piece=_closed(part.piece)) for part in problem.parts]
    problem = replace(problem, parts=tuple(closed))
    start = np.asarray(np.linalg.lstsq(problem.S, problem.b, rcond=None)[0], dtype=np.float64)
    x = solve_conic(problem, start, _ACCURATE).x
    return np.array([piece for _, piece in problem.pieces(x)]), float(np.linalg.norm(problem.S @ x - problem.b))


def _closed(piece: Piece) -> Piece:
    return replace(piece, inequalities=tuple(replace(i, strict=False) for i in piece.inequalities))


def _fulfil(pieces: Array, demanded: Sequence[Piece], mass: float, unit: float) -> bool:
    """Whether pieces that were found for some set fulfil what is demanded."""
    return len(pieces) == len(demanded) and not any(
        violations(pi, piece.inequalities, mass, unit, tolerance=_ROUNDING)
        for pi, piece in zip(pieces, demanded, strict=True)
    )


def _refused(*reasons: str) -> Verdict:
    return Verdict(reasons, None, np.zeros(0), np.zeros((0, 3)))


def _shown(body: Body, parts: Array) -> tuple[Array, Array]:
    """Point masses that are the parts; none where a part's bounds are only necessary conditions."""
    masses, points = [np.zeros(0)], [np.zeros((0, 3))]
    for ellipsoid, part in zip(body.ellipsoids or (None,), parts, strict=not body.shapes):
        if body.shapes or explain(part, ellipsoid):
            return masses[0], points[0]
        found = witness(part, ellipsoid)
        masses.append(found.masses[found.masses > 0])
        points.append(found.points[found.masses > 0])
    return np.concatenate(masses), np.concatenate(points)

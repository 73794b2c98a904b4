"""Projection: the nearest parameters of a set (Remark 5), and whether a body can be.

Letters: pi (10,) parameters; z = pi in units of the body's own mass and size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from idtool.body import Body
from idtool.conic import solve_conic
from idtool.effects.rigid_body import length, scales
from idtool.exceptions import SolverError
from idtool.identify import solve
from idtool.inequality import Piece
from idtool.inertia import POWERS, SIZE, transformation
from idtool.metric import nearest_realizable, pullback
from idtool.parts import parts_of
from idtool.prior import reference
from idtool.problem import Problem
from idtool.sets import ConstraintSet, choose_set
from idtool.witness import explain, violations, witness

Array = NDArray[np.float64]

Metric = Literal["euclidean", "pullback"]

_ROUNDING = 1e-9  # by which an inequality may fail, in units of the body
_NEAR = 1e-5  # distance, in units of the body, below which a body counts as in a set: the solver's tolerance
_PASSES = 6
_COARSE, _FINER = 0.1, 1e-5  # cost from which the gap is small against it; of the last unit, the least next one
_NO_DISTANCE = 1e-6  # squared
_ACCURATE = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-10, "tol_feas": 1e-10, "equilibrate_enable": False}


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
    unit = scales(body, abs(float(pi[0])) or 1.0)
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
        problem = _nearest(pi, chosen, body, np.asarray(np.linalg.cholesky(M / size).T), unit)
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


def _nearest(pi: Array, chosen: ConstraintSet, body: Body, A: Array, unit: Array) -> Problem:
    """The problem min ‖A (z − pi / unit)‖² over a set."""
    known = np.array([[-c, *np.eye(3)[k], *np.zeros(6)] for k, c in enumerate(body.com or ())]).reshape(-1, SIZE)
    E = known * unit / np.linalg.norm(known * unit, axis=1, keepdims=True)
    none = np.zeros(0)
    parts = parts_of([body], [chosen], np.arange(SIZE))
    others = none.astype(np.intp)
    return Problem(A, A @ (pi / unit), 0.0, unit, np.eye(SIZE), parts, (body.name,), others, none, E, np.zeros(len(E)))


def _split(pi: Array, chosen: ConstraintSet, body: Body) -> tuple[Array, float]:
    """Pieces, shape (pieces, 10), whose sum is as near to pi as may be, and how far it is in units of the body.

    The sets here are closed, unlike those of `project`: a piece may be a plate, a rod or a point, or without mass.
    """
    problem = _nearest(pi, chosen, body, np.eye(SIZE), pi[0] * length(body) ** POWERS)
    closed = [replace(part, piece=_closed(part.piece)) for part in problem.parts]
    problem = replace(problem, parts=tuple(closed))
    start = np.asarray(np.linalg.lstsq(problem.S, problem.b, rcond=None)[0], dtype=np.float64)
    x = solve_conic(problem, start, _ACCURATE).x
    return np.array([piece for _, piece in problem.pieces(x)]), float(np.linalg.norm(problem.S @ x - problem.b))


def _closed(piece: Piece) -> Piece:
    return replace(piece, inequalities=tuple(replace(i, strict=False) for i in piece.inequalities))


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
    split = None
    if len(demanded) > 1:
        if pieces is None or len(pieces) != len(demanded):
            pieces, distance = _split(pi, chosen, body)
            if distance > _NEAR:
                what = f"no density on the union of its {len(demanded)} bounding shapes has these parameters"
                return _refused(f"{what}; the nearest are {distance:.2g} away, in units of its mass and size")
            pieces = _completed(pieces, demanded, pi)
        split = pieces
    elif len(demanded[0].powers) == SIZE:
        found = violations(pi, demanded[0].inequalities, float(pi[0]), length(body), tolerance=_ROUNDING)
        if found:
            return _refused(*(violation.text for violation in found))
    elif (rest := _point_masses(demanded[0], pi, length(body))[1]) > _NEAR:
        return _refused(f"point masses at the vertices and inside of its hull leave {rest:.2g} of these parameters")
    parts = pi[None] if split is None else split
    return Verdict((), split, *_shown(body, demanded, parts))


def _completed(pieces: Array, demanded: Sequence[Piece], pi: Array) -> Array:
    """The pieces with what the solver's tolerance leaves of pi given to the heaviest whose unknowns are its own."""
    free = np.array([len(piece.powers) == SIZE for piece in demanded])
    heaviest = int(np.argmax(np.where(free, pieces[:, 0], -1.0)))
    completed = pieces.copy()
    completed[heaviest] += pi - pieces.sum(axis=0)
    return completed


def _refused(*reasons: str) -> Verdict:
    return Verdict(reasons, None, np.zeros(0), np.zeros((0, 3)))


def _shown(body: Body, demanded: Sequence[Piece], parts: Array) -> tuple[Array, Array]:
    """Point masses that are the parts; none where a part's bounds are only necessary conditions."""
    masses, points = [np.zeros(0)], [np.zeros((0, 3))]
    for i, (piece, part) in enumerate(zip(demanded, parts, strict=True)):
        ellipsoid = body.ellipsoids[i] if i < len(body.ellipsoids) else None
        if len(piece.powers) != SIZE:
            own, _ = _point_masses(piece, part, length(body))
            places = piece.basis[1:4].T
        elif (ellipsoid is None and body.shapes) or explain(part, ellipsoid):
            return masses[0], points[0]
        else:
            found = witness(part, ellipsoid)
            own, places = found.masses, found.points
        masses.append(own[own > 0])
        points.append(places[own > 0])
    return np.concatenate(masses), np.concatenate(points)


def _point_masses(piece: Piece, pi: Array, unit: float) -> tuple[Array, float]:
    """Masses at a piece's places that come nearest to pi about their middle, shape (K,), and what they leave of it."""
    relative = transformation(np.eye(3), -piece.basis[1:4].mean(axis=1)) / (pi[0] * unit**POWERS)[:, None]
    masses, rest = nnls(relative @ piece.basis, relative @ pi)
    return np.asarray(masses), float(rest)

"""Random bounding shapes, points in them, bodies of point masses, and the margins of a shape's inequalities."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from idtool.robot.ellipsoid import minimum_volume_ellipsoid
from idtool.robot.inequality import Piece
from idtool.robot.inertia import J_BASIS, from_pseudo_inertia
from idtool.robot.shapes import Hull, Shape
from idtool.robot.shapes.box import Box
from idtool.robot.shapes.capsule import Capsule
from idtool.robot.shapes.cylinder import Cylinder

Array = NDArray[np.float64]

_UPPER = np.triu_indices(4)

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
KINDS = ("box", "cylinder", "capsule", "hull")
kinds = st.sampled_from(KINDS)
one_piece = st.sampled_from(("box", "cylinder"))


def random_shape(rng: np.random.Generator, kind: str) -> Shape:
    """A shape at a random pose, some ten centimetres large."""
    a, b, c = rng.uniform(0.03, 0.4, 3).tolist()
    x, y, z = rng.normal(size=3).tolist()
    place, rpy = (x, y, z), (float(rng.uniform(-3, 3)), float(rng.uniform(-1.5, 1.5)), float(rng.uniform(-3, 3)))
    if kind == "box":
        return Box(place, (a, b, c), rpy)
    if kind == "cylinder":
        return Cylinder(place, a, b, rpy)
    if kind == "capsule":
        return Capsule(place, a, b, rpy)
    return Hull.around(rng.normal(size=(rng.integers(4, 60), 3)) * [a, b, c] + place)


def to_body_frame(shape: Box | Cylinder | Capsule, local: Array) -> Array:
    """Points of a shape's own frame in the body's."""
    return np.asarray(local @ Rotation.from_euler("xyz", shape.rpy).as_matrix().T + shape.center)


def on_ball(rng: np.random.Generator, count: int, dimension: int) -> Array:
    x = rng.normal(size=(count, dimension))
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


def inside(rng: np.random.Generator, shape: Shape, count: int, reach: float = 1.0) -> Array:
    """Points in a shape, half of them on its surface, scaled by ``reach``; shape (count, 3)."""
    share = np.where(np.arange(count) % 2 == 0, 1.0, rng.random(count))[:, None] * reach
    if isinstance(shape, Box):
        x = rng.uniform(-1, 1, (count, 3))
        return to_body_frame(shape, share * x / np.abs(x).max(axis=1, keepdims=True) * np.divide(shape.sides, 2))
    if isinstance(shape, Cylinder):
        height = rng.choice([-1, 1, rng.uniform(-1, 1)], (count, 1)) * shape.length / 2
        return to_body_frame(shape, np.column_stack([on_ball(rng, count, 2) * shape.radius * share, height]))
    if isinstance(shape, Capsule):
        spine = np.column_stack([np.zeros((count, 2)), rng.uniform(-0.5, 0.5, count) * shape.length])
        return to_body_frame(shape, spine + on_ball(rng, count, 3) * shape.radius * share)
    assert isinstance(shape, Hull)
    corners = np.array(shape.vertices)
    x = rng.dirichlet(np.full(len(corners), 0.3), count) @ corners
    return np.asarray(np.where(np.arange(count)[:, None] % 2, x, corners[rng.integers(len(corners), size=count)]))


def body(masses: Array, places: Array) -> Array:
    """Parameters pi of a body of point masses."""
    lifted = np.column_stack([places, np.ones(len(masses))])
    return from_pseudo_inertia(lifted.T @ (lifted * masses[:, None]))


def margins(piece: Piece, pi: Array, length: float) -> list[float]:
    """Margins of the inequalities of a piece whose unknowns are pi itself."""
    np.testing.assert_array_equal(piece.basis, np.eye(10))
    return [inequality.margin(pi, pi[0], length, piece.powers) for inequality in piece.inequalities]


def margin(shape: Shape, pi: Array) -> float:
    (piece,) = shape.pieces()
    return min(margins(piece, pi, shape.size))


class Problem:
    """The least W · pi of a body of mass 1 kg that a shape's pieces admit."""

    def __init__(self, shape: Shape) -> None:
        self.cost = cp.Parameter(10)
        pieces = shape.pieces()
        x = [cp.Variable(piece.basis.shape[1]) for piece in pieces]
        pi = sum(piece.basis @ part for piece, part in zip(pieces, x, strict=True))
        demands = [pi[0] == 1]
        for piece, part in zip(pieces, x, strict=True):
            for inequality in piece.inequalities:
                G = inequality.G
                value = sum(part[k] * G[k] for k in range(len(G)))
                demands.append(value >= 0 if G.ndim == 2 else 0.5 * (value + value.T) >> 0)
        self.problem = cp.Problem(cp.Minimize(self.cost @ pi), demands)

    def least(self, W: Array) -> float:
        """The least Tr(J W)."""
        self.cost.value = np.einsum("kij,ij->k", J_BASIS, W)
        tolerances = {"tol_gap_abs": 1e-7, "tol_gap_rel": 1e-7, "tol_feas": 1e-7}
        return float(self.problem.solve(solver="CLARABEL", **tolerances))


class Largest:
    """Largest size of a body with a given centre of mass and shape that a condition on bodies in a hull admits.

    Parameters
    ----------
    hull
        The hull.
    form
        ``conditions``: its own; ``ellipsoid``: of its least ellipsoid; ``corners``: a second moment within that of
        masses at its corners.
    """

    def __init__(self, hull: Hull, form: str) -> None:
        self.com = cp.Parameter(3)
        self.about_com, self.spread = (cp.Parameter((3, 3), symmetric=True) for _ in range(2))
        share, pi = cp.Variable(), cp.Variable(10)
        J = sum(pi[k] * J_BASIS[k] for k in range(10))
        second = self.about_com + share * self.spread
        demands = [pi[0] == 1, pi[1:4] == self.com, J[:3, :3] == second, 0.5 * (J + J.T) >> 0]
        corners = np.array(hull.vertices)
        if form == "conditions":
            (piece,) = hull.pieces()
            demands.append(piece.inequalities[1].G.T @ pi >= 0)
        elif form == "ellipsoid":
            demands.append(cp.trace(J @ minimum_volume_ellipsoid(corners).Q) >= 0)
        else:
            masses = cp.Variable(len(corners), nonneg=True)
            most = corners.T @ cp.diag(masses) @ corners
            demands += [cp.sum(masses) == 1, corners.T @ masses == self.com, 0.5 * (most + most.T) - second >> 0]
        self.problem = cp.Problem(cp.Maximize(share), demands)

    def size(self, com: Array, spread: Array) -> float:
        """The largest s such that a body of 1 kg has Sigma_C = s² spread."""
        self.com.value, self.about_com.value, self.spread.value = com, np.outer(com, com), spread
        return float(np.sqrt(self.problem.solve(solver="CLARABEL")))


def largest_on_grid(places: Array, com: Array, spread: Array) -> float:
    """The largest s of point masses at given points, shape (n, 3), by a linear program; 0 if there is no such body."""
    lifted = np.column_stack([places, np.ones(len(places))])
    moments = np.array([np.outer(x, x)[_UPPER] for x in lifted]).T
    centred, more = np.outer(np.append(com, 1), np.append(com, 1)), np.zeros((4, 4))
    more[:3, :3] = spread
    answer = linprog(
        np.append(np.zeros(len(places)), -1),
        A_eq=np.column_stack([moments, -more[_UPPER]]),
        b_eq=centred[_UPPER],
        bounds=[(0, None)] * len(places) + [(None, None)],
    )
    return float(np.sqrt(max(-answer.fun, 0))) if answer.status == 0 else 0.0

"""Problems for the local estimators, and charts of their bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, synthetic

from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.local import Chart, LogCholesky, Manifold
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.problem.variables import PieceVariables
from idtool.robot.config import Regularization
from idtool.robot.inequality import REALIZABLE, Piece
from idtool.robot.inertia import (
    PI_SIZE,
)
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
State = Callable[..., tuple[Problem, Array]]

CHARTS: dict[str, type[Chart]] = {"log_cholesky": LogCholesky, "manifold": Manifold}
FRICTION = {"friction": {"viscous": True, "coulomb": True}}
MIRROR = {"mirror": [{"body": "link3", "of": "link2", "plane": "xz"}]}
TIGHT = {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13}


def definite(rng: np.random.Generator, count: int, spread: float = 1.0) -> Array:
    """Positive definite matrices, eigenvalues over as many powers of e either way."""
    Q = np.linalg.qr(rng.normal(size=(count, 4, 4)))[0]
    return np.asarray((Q * np.exp(rng.uniform(-spread, spread, (count, 1, 4)))) @ Q.swapaxes(-1, -2))


def laid(kind: type[Chart], J: Array) -> Chart:
    return kind(J, np.zeros_like(J))


def difference(function: Callable[[Array], Array], at: Array, h: float = 1e-6) -> Array:
    """Central differences along every entry of a vector, the entry last."""
    steps = h * np.eye(len(at))
    return np.stack([(function(at + step) - function(at - step)) / (2 * h) for step in steps], axis=-1)


def random_problem(
    robot_of: Callable[[str], Robot], kind: Any, weight: float, seed: int = 0, share: float = 3.0, **config: Any
) -> tuple[Problem, Array]:
    """A problem of three links, every body fully consistent, and its prior."""
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    return stated(synthetic(rng, robot, 60, config), "full", Regularization(kind=kind, weight=weight), share)


def stated(s: Synthetic, name: str, regularization: Regularization, share: float) -> tuple[Problem, Array]:
    reduction = s.reduction(s.noisy(share))
    sets = [choose_set(body, name) for body in s.model.bodies]
    noise = free_noise(s.linear, reduction, s.equalities)
    problem = build_problem(s.linear, s.model.bodies, reduction, sets, regularization, noise, s.equalities)
    return problem, s.linear.prior[s.equalities.free] / problem.scale


def one_body(A: Array, b: Array) -> Problem:
    """‖A z − b‖² over one body."""
    part = PieceVariables(0, 0, 0, Piece((REALIZABLE,)), 1.0)
    none = np.zeros(0)
    nothing = np.zeros((0, PI_SIZE)), none
    return Problem(
        A, b, 0.0, np.ones(PI_SIZE), np.eye(PI_SIZE), (part,), ("body",), none.astype(np.intp), none, *nothing
    )

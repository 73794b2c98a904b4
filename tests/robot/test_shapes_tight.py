"""How much more the shapes' conditions admit than a density inside can have."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from robots import rotation
from scipy.optimize import nnls
from solids import (
    KINDS,
    Array,
    Problem,
    body,
    margin,
    on_ball,
)

from idtool.robot.inertia import from_mass_com_inertia
from idtool.robot.shapes import Hull, Shape
from idtool.robot.shapes.box import Box
from idtool.robot.shapes.capsule import Capsule
from idtool.robot.shapes.cylinder import Cylinder


def form(W: Array, x: Array) -> Array:
    """[x; 1]ᵀ W [x; 1] for points, shape (n, 3)."""
    lifted = np.column_stack([x, np.ones(len(x))])
    return np.asarray(np.einsum("ni,ij,nj->n", lifted, W, lifted))


def least_on_box(W: Array) -> float:
    """The least of [x; 1]ᵀ W [x; 1] on |x_i| ≤ 1: at a stationary point of one of its faces, edges or corners."""
    A, b, least = W[:3, :3], W[:3, 3], np.inf
    for sides in product((-1.0, 0.0, 1.0), repeat=3):
        x = np.array(sides)
        free = np.flatnonzero(x == 0)
        x[free] = np.linalg.solve(A[np.ix_(free, free)], -(A[free] @ x + b[free]))
        if np.abs(x).max() <= 1:
            least = min(least, float(form(W, x[None])[0]))
    return least


@pytest.mark.parametrize("kind", KINDS)
def test_the_centre_of_mass_reaches_the_surface_and_no_farther(kind: str, rng: np.random.Generator) -> None:
    """The farthest centre of mass along a direction n is the solid's own extent along it, in closed form."""
    for _ in range(4):
        R, n = rotation(rng), on_ball(rng, 1, 3)[0]
        across, along = np.linalg.norm((R.T @ n)[:2]), abs((R.T @ n)[2])
        solids: dict[str, tuple[Shape, float]] = {
            "box": (Box((0, 0, 0), (2, 1, 3)), np.abs(R.T @ n) @ [1, 0.5, 1.5]),
            "cylinder": (Cylinder((0, 0, 0), 0.7, 3), 0.7 * across + 1.5 * along),
            "capsule": (Capsule((0, 0, 0), 0.7, 3), 0.7 + 1.5 * along),
            "hull": (Hull.around([[1, 0, 0], [0, 1, 0], [0, 0, 2], [-1, -1, -1]]), 0.0),
        }
        shape, extent = solids[kind]
        shape = shape.transformed(R, np.array([0.1, 0.2, -0.3]))
        if isinstance(shape, Hull):
            extent = (np.array(shape.vertices) @ n).max()
        else:
            extent += np.array([0.1, 0.2, -0.3]) @ n
        W = np.zeros((4, 4))
        W[:3, 3] = W[3, :3] = -0.5 * n
        assert Problem(shape).least(W) == pytest.approx(-extent, abs=1e-4)


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_whatever_a_fine_grid_of_masses_admits_is_admitted(kind: str, rng: np.random.Generator) -> None:
    """And what is admitted lies on the grid after a step of a fifth towards a body spread over the whole solid."""
    shape = Box((0, 0, 0), (2, 2, 2)) if kind == "box" else Cylinder((0, 0, 0), 1.0, 2.0)
    grid = np.array([body(np.ones(1), x[None]) for x in shape.grid(1000)]).T
    both, neither = 0, 0
    for _ in range(60):
        c, A = rng.uniform(-0.7, 0.7, 3), rng.normal(size=(3, 3))
        sigma = A @ A.T
        sigma *= rng.uniform(0.3, 1.3) * ((1 - c**2) / np.diag(sigma)).min()
        pi = from_mass_com_inertia(1.0, c, np.trace(sigma) * np.eye(3) - sigma)
        on_grid, admitted = nnls(grid, pi)[1] < 1e-9, margin(shape, pi) >= 0
        assert admitted or not on_grid
        if admitted:
            assert nnls(grid, 0.8 * pi + 0.2 * grid.mean(axis=1))[1] < 1e-9
        both, neither = both + (on_grid and admitted), neither + (not on_grid and not admitted)
    assert min(both, neither) > 5


def test_the_cylinder_s_conditions_suffice(rng: np.random.Generator) -> None:
    """The least Tr(J W) they admit is the least of the quadratic form itself, whatever W: no body more."""
    problem, places = Problem(Cylinder((0, 0, 0), 1.0, 2.0)), Cylinder((0, 0, 0), 1.0, 2.0).grid(60_000)
    for _ in range(12):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        values = form(W, places)
        assert problem.least(W) == pytest.approx(values.min(), abs=3e-3 * float(np.ptp(values)))
        assert problem.least(W) <= values.min() + 1e-5


def test_the_capsule_s_conditions_suffice(rng: np.random.Generator) -> None:
    shape = Capsule((0, 0, 0), 1.0, 2.0)
    problem, places = Problem(shape), shape.grid(60_000)
    for _ in range(6):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        values = form(W, places)
        assert problem.least(W) == pytest.approx(values.min(), abs=5e-3 * float(np.ptp(values)))


def test_the_box_s_conditions_all_but_suffice(rng: np.random.Generator) -> None:
    problem = Problem(Box((0, 0, 0), (2, 2, 2)))
    for _ in range(40):
        W = rng.normal(size=(4, 4))
        W = W + W.T
        least = least_on_box(W)
        assert least - 5e-3 * float(np.linalg.norm(W)) <= problem.least(W) <= least + 1e-5

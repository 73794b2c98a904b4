"""The barrier's tracker against Clarabel's optimum, and its promise to stay inside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import bounds, synthetic

from idtool.common.exceptions import SolverError
from idtool.estimation.dataset.reduction import empty
from idtool.estimation.problem.barrier import Barrier, _newton
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.config import Regularization
from idtool.robot.inequality import smallest_value
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Stated = Callable[..., Problem]

GAP = 0.1
SETS = ["semi", "full", "com_ellipsoid", "ellipsoid", "points"]


@pytest.fixture
def stated(rng: np.random.Generator, robot_of: Callable[[str], Robot]) -> Stated:
    """A problem without data under a set and a configuration, the prior as its objective."""

    def state(name: str, each: int = 1, **config: Any) -> Problem:
        robot = robot_of(random_urdf(rng, 3, ["revolute", "prismatic"], mimic=0, massless=0))
        found = synthetic(rng, robot, 1, {**bounds(rng, robot, each), **config})
        sets = [choose_set(body, name) for body in found.model.bodies]
        nothing, ones = empty(found.linear.active()), np.ones(len(found.linear.joints))
        prior = Regularization(kind="euclidean", weight=1.0)
        return build_problem(found.linear, found.model.bodies, nothing, sets, prior, ones, found.equalities)

    return state


def with_data(problem: Problem, rng: np.random.Generator, errors: float) -> Problem:
    """The problem with data in place of the prior: seen sharply and hardly, by direction, and wrong by ``errors``."""
    n = len(problem.scale)
    A = np.geomspace(0.1, 300, n)[:, None] * np.linalg.qr(rng.normal(size=(n, n)))[0]
    truth, *_ = np.linalg.lstsq(problem.A, problem.b, rcond=None)
    return replace(problem, A=A, b=A @ truth * rng.uniform(0.3, 3) + errors * rng.normal(size=n), constant=0.0)


def normal(problem: Problem) -> tuple[Array, Array]:
    rows = problem.A @ problem.S
    return rows.T @ rows, rows.T @ problem.b


def half_cost(problem: Problem, x: Array) -> float:
    return 0.5 * float(np.square(problem.A @ problem.S @ x - problem.b).sum())


def inside(problem: Problem, x: Array) -> None:
    for inequality in problem.inequalities:
        assert smallest_value(inequality.value(x)) > inequality.interior, inequality.label
    assert (x[problem.bounded] > problem.bounds).all()


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("each", [1, 2])
def test_it_costs_at_most_the_gap_more_than_the_optimum(
    stated: Stated, rng: np.random.Generator, name: str, each: int
) -> None:
    problem = stated_problem = stated(name, each)
    barrier = Barrier(problem, *normal(problem), GAP)
    inside(problem, barrier.x)
    for errors in (1.0, 10.0, 3.0):
        problem = with_data(stated_problem, rng, errors)
        x = barrier.move(*normal(problem))
        inside(problem, x)
        best = half_cost(problem, solve(problem, tol_feas=1e-10)[0])
        assert -1e-6 * best < half_cost(problem, x) - best < 1.01 * GAP + 1e-6 * best


def test_without_inequalities_it_is_least_squares(stated: Stated, rng: np.random.Generator) -> None:
    problem = with_data(stated("none", friction={"viscous": False, "coulomb": False}), rng, 1.0)
    barrier = Barrier(problem, *normal(problem), GAP)
    np.testing.assert_allclose(problem.S @ barrier.x, np.linalg.solve(problem.A, problem.b), rtol=1e-6)


def test_what_is_known_exactly_holds_exactly(stated: Stated, rng: np.random.Generator) -> None:
    known = {"mass": {"link1": 0.7}, "total_mass": 4.2}
    problem = stated("full", known=known, mirror=[{"body": "link2", "of": "link3", "plane": "xz"}])
    barrier = Barrier(problem, *normal(problem), GAP)
    empty_handed = problem
    for _ in range(50):
        problem = with_data(empty_handed, rng, 3.0)
        barrier.move(*normal(problem))
    theta = problem.theta(problem.S @ barrier.x)
    assert theta[0] == pytest.approx(0.7, abs=1e-12)
    assert theta[:30:10].sum() == pytest.approx(4.2, abs=1e-12)
    assert theta[10] == theta[20]
    inside(problem, barrier.x)
    best = half_cost(problem, solve(problem)[0])
    assert half_cost(problem, barrier.x) - best < 1.01 * GAP + 1e-6 * best


def test_what_is_known_exactly_holds_beside_large_errors(stated: Stated, rng: np.random.Generator) -> None:
    """All bodies, by data that are wrong by far more than anything that is known."""
    problem = with_data(stated("none"), rng, 1e4)
    bodies = np.delete(np.eye(len(problem.scale)), problem.other_coefficients, axis=0)
    values = rng.normal(size=len(bodies))
    problem = replace(problem, E=bodies, e=values)
    best = half_cost(problem, solve(problem)[0])
    barrier = Barrier(problem, *normal(problem), gap=1e-4 * best)
    np.testing.assert_allclose(bodies @ problem.S @ barrier.x, values, atol=1e-10)
    inside(problem, barrier.x)
    assert half_cost(problem, barrier.x) - best < 1.01e-4 * best


def test_without_convergence_the_minimum_with_a_larger_weight_counts(
    stated: Stated, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    from idtool.estimation.problem import barrier as module

    problem = with_data(stated("ellipsoid"), rng, 10.0)
    P, q = normal(problem)
    minimise = module._minimise
    least_weight = GAP / Barrier(problem, P, q, GAP).nu

    def fail_at_least_weight(groups: Any, P_by_weight: Array, *others: Any) -> tuple[Array, bool]:
        x, is_minimum = minimise(groups, P_by_weight, *others)
        is_least = P_by_weight.diagonal().max() > 0.5 * P.diagonal().max() / least_weight
        return x, is_minimum and not is_least

    monkeypatch.setattr(module, "_minimise", fail_at_least_weight)
    monkeypatch.setattr(module, "_MOST_WEIGHTS", 7)  # the last of them is the least
    barrier = Barrier(problem, P, q, GAP)
    inside(problem, barrier.x)
    best = half_cost(problem, solve(problem, tol_feas=1e-10)[0])
    assert GAP < half_cost(problem, barrier.x) - best < 1.01 * 10 * GAP + 1e-6 * best


def test_where_rounding_leaves_nothing_there_is_no_step() -> None:
    """No error of LAPACK's; along a part of the directions there is one."""
    second = np.array([[0.0], [1.0]])
    step = _newton(np.eye(2), np.ones(2), second)
    assert step is not None
    np.testing.assert_allclose(step, [0, -1], atol=1e-15)
    assert _newton(np.array([[1.0, 1.0], [1.0, 1.0]]), np.ones(2), np.eye(2)) is None
    np.testing.assert_array_equal(_newton(np.eye(2), np.ones(2), np.zeros((2, 0))), 0)


def test_what_cannot_be_is_refused(stated: Stated) -> None:
    problem = stated("full", known={"mass": {"link1": 3.0}, "total_mass": 2.0})
    with pytest.raises(SolverError, match="relax one"):
        Barrier(problem, *normal(problem), GAP)


def test_a_small_change_takes_two_steps_at_the_most(
    stated: Stated, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    from idtool.estimation.problem import barrier as module

    problem = with_data(stated("ellipsoid"), rng, 10.0)
    P, q = normal(problem)
    barrier = Barrier(problem, P, q, GAP)
    steps: list[int] = []
    newton = module._newton

    def counted(*given: Array) -> Array | None:
        steps.append(1)
        return newton(*given)

    monkeypatch.setattr(module, "_newton", counted)
    row = rng.normal(size=len(q))
    barrier.move(P + np.outer(row, row), q + row * (row @ barrier.x + 1.0))
    assert len(steps) <= 2

"""The certificate's bound is one: whatever the problem and the dual variables, no feasible point costs less."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from optima import solved_with_duals
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic

from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.certificate import GAP, lower_bound
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.config import Regularization
from idtool.robot.inequality import smallest_value
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
State = Callable[..., Problem]

ROUNDING = 1e-11  # of the cost
BOX = {"link2": [{"kind": "box", "center": [0.3, 0.1, 0.0], "size": [0.2, 0.3, 0.1]}]}

CASES: dict[str, dict[str, Any]] = {
    "one ellipsoid": {"set": "ellipsoid"},
    "two ellipsoids": {"set": "ellipsoid", "each": 2},
    "three ellipsoids": {"set": "ellipsoid", "each": 3},
    "centre in one of two ellipsoids": {"set": "com_ellipsoid", "each": 2},
    "ellipsoid and box": {"set": "shape", "bounding_shapes": BOX},
    "point masses": {"set": "points"},
    "point masses in two ellipsoids": {"set": "points", "each": 2},
    "known centres of mass": {"set": "known_com", "known_com": {"link1": "inside", "link3": "inside"}},
    "known centre in a union": {"set": "ellipsoid", "each": 2, "known_com": {"link1": "inside"}},
    "exact masses": {"set": "ellipsoid", "known": {"mass": {"link1": 1.3, "link3": 0.4}}},
    "exact mass and total of unions": {
        "set": "ellipsoid",
        "each": 2,
        "known": {"mass": {"link2": 1}, "total_mass": 4},
    },
    "mirrored": {"set": "ellipsoid", "each": 2, "mirror": [{"body": "link3", "of": "link2", "plane": "xz"}]},
    "entropic": {"set": "full", "prior": ("entropic", 1e-2)},
    "entropic in unions": {"set": "ellipsoid", "each": 2, "prior": ("entropic", 1e-2)},
    "entropic with an exact mass": {"set": "full", "prior": ("entropic", 1e-3), "known": {"mass": {"link2": 1}}},
    "pullback": {"set": "ellipsoid", "each": 2, "prior": ("pullback", 1e-3)},
}


@pytest.fixture
def state(robot_of: Callable[[str], Robot]) -> State:
    """A case's problem with torques that are mostly noise, so that the inequalities bite."""

    def make(case: str, seed: int = 1) -> Problem:
        options = dict(CASES[case])
        rng = np.random.default_rng(seed)
        robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
        limits = bounds(rng, robot, options.pop("each", 1))
        for link in options.get("known_com", {}):
            ends = [bound["center"] for bound in limits["bounding_ellipsoids"][link]]
            options["known_com"] = options["known_com"] | {link: np.mean(ends, axis=0).tolist()}
        kind, weight = options.pop("prior", ("euclidean", 1e-6))
        name = options.pop("set")
        return stated(synthetic(rng, robot, 60, {**limits, **options}), name, Regularization(kind=kind, weight=weight))

    return make


def stated(s: Synthetic, name: str, regularization: Regularization) -> Problem:
    bodies, reduction = s.model.bodies, s.reduction(s.noisy(3.0))
    sets = [choose_set(body, name) for body in bodies]
    assert name in {chosen.name for chosen in sets}
    noise = free_noise(s.linear, reduction, s.equalities)
    return build_problem(s.linear, bodies, reduction, sets, regularization, noise, s.equalities)


def check_feasible(problem: Problem, x: Array) -> None:
    """In the sets, above the bounds, and what is exact met."""
    assert np.abs(problem.E @ (problem.S @ x) - problem.e).max(initial=0) < 1e-9
    assert (x[problem.bounded] >= problem.bounds).all()
    assert min(smallest_value(i.value(x)) for i in problem.inequalities) >= 0


@pytest.mark.parametrize("case", CASES)
def test_a_solution_comes_with_a_bound_next_to_its_cost(state: State, case: str) -> None:
    for seed in (1, 2, 3):
        problem = state(case, seed)
        x, certificate = solve(problem)
        assert abs(certificate.duality_gap) < GAP
        check_feasible(problem, x)
        assert certificate.objective == problem.cost(problem.S @ x)


@pytest.mark.parametrize("case", CASES)
def test_no_feasible_point_costs_less_than_the_bound(state: State, case: str) -> None:
    """Solutions of problems with another b are feasible, and so is what lies between them and the optimum."""
    rng = np.random.default_rng(0)
    problem = state(case)
    best, duals, multipliers = solved_with_duals(problem)
    bound = lower_bound(problem, best, duals, multipliers)
    x, _ = solve(problem)
    excess = []
    for _ in range(4):
        other, _ = solve(replace(problem, b=problem.b + 0.3 * rng.normal(size=len(problem.b))))
        for share in (1e-6, 1e-3, 0.1, 1.0):
            between = x + share * (other - x)
            check_feasible(problem, between)
            excess.append(problem.cost(problem.S @ between) - bound)
    assert min(excess) > -ROUNDING * bound
    assert max(excess) > 1e-3 * bound


@pytest.mark.parametrize("case", CASES)
def test_a_bound_from_any_dual_variables_is_one(state: State, case: str) -> None:
    """Those of the optimum with errors of any size; the tangent of what is not quadratic taken anywhere."""
    rng = np.random.default_rng(0)
    problem = state(case)
    best, duals, multipliers = solved_with_duals(problem)
    x, _ = solve(problem)
    cost = problem.cost(problem.S @ x)
    other, _ = solve(replace(problem, b=problem.b + 0.3 * rng.normal(size=len(problem.b))))
    for spread in (1e-9, 1e-6, 1e-3, 1.0, 1e3):
        for at in (best, x, other):
            spoilt = [Z + spread * max(np.abs(Z).max(), 1e-9) * rng.normal(size=Z.shape) for Z in duals]
            bound = lower_bound(problem, at, spoilt, multipliers + spread * rng.normal(size=multipliers.shape))
            assert bound <= cost * (1 + ROUNDING)
    nothing = lower_bound(problem, x, [0 * Z for Z in duals], 0 * multipliers)
    assert nothing < cost


@pytest.mark.parametrize("case", ["one ellipsoid", "two ellipsoids", "exact masses", "entropic in unions", "pullback"])
def test_the_bound_is_that_of_the_sets_with_their_boundaries(state: State, case: str) -> None:
    """Bodies kept farther inside cost more by the margin that is said, and the bound stays below those kept less."""
    problem = state(case)
    _, closest = solve(replace(problem, interior=1e-12))
    for interior in (1e-6, 1e-5):
        _, certificate = solve(replace(problem, interior=interior))
        bound = certificate.objective * (1 - certificate.duality_gap)
        assert bound <= closest.objective * (1 + ROUNDING)
        assert certificate.margin == pytest.approx(certificate.duality_gap, abs=GAP)
        more = certificate.objective / closest.objective - 1
        assert more == pytest.approx(certificate.margin, rel=0.1, abs=1e-8)
        assert certificate.holds
        assert certificate.certified == (abs(certificate.duality_gap) <= GAP)

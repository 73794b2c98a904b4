"""How far a coefficient can go, against the same two programmes stated anew for cvxpy, and against closed forms."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from legs import LENGTH, copies, image, legs, of_body
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic

from idtool.common.exceptions import SolverError
from idtool.estimation.dataset.equality_constraints import EqualityConstraints, with_equal_bounds
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.extremes import LevelSet
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.uncertainty.ranges import free_spread, ranges
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Robots = Callable[[str], Robot]

ABOVE = 0.01
WIDE = 100.0  # units of a coefficient that pass for no end
ACCURATE = {"tol_gap_rel": 1e-7, "tol_gap_abs": 1e-7, "tol_feas": 1e-7, "equilibrate_enable": False}
NEAR = 1e-4  # units of a coefficient: the programmes end within 1e-5 of theirs
EUCLIDEAN = Regularization(kind="euclidean", weight=1e-3)


@dataclass(frozen=True)
class Case:
    """A set, a prior and what is known; the weight of the prior keeps all within sight."""

    set: str = "full"
    prior: Regularization = EUCLIDEAN
    each: int = 1
    config: Any = None


CASES = {
    "full": Case(),
    "semi": Case("semi"),
    "ellipsoid": Case("ellipsoid"),
    "com_ellipsoid": Case("com_ellipsoid"),
    "a union of two": Case("ellipsoid", each=2),
    "an exact mass": Case("ellipsoid", config={"known": {"mass": {"link1": 1.3}}}),
    "an exact total": Case("full", config={"known": {"total_mass": 2.5}}),
    "a soft mass": Case("ellipsoid", config={"known": {"mass": {"link2": {"value": 0.7, "standard_error": 0.02}}}}),
    "entropic": Case("full", Regularization(kind="entropic", weight=1e-2)),
    "entropic, a union": Case("ellipsoid", Regularization(kind="entropic", weight=1e-2), 2),
    "pullback": Case("full", Regularization(kind="pullback", weight=1e-2)),
}


def stated(robot_of: Robots, case: Case, seed: int = 1, noise: float = 1.0) -> tuple[Synthetic, Problem, Array]:
    """Two bodies' problem and its optimum; the torque is half noise, so that inequalities bite."""
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=2, kinds=("revolute",), mimic=0, massless=0))
    s = synthetic(rng, robot, 60, {**bounds(rng, robot, case.each), **(case.config or {})})
    tau, sigma = s.noisy(noise, seed), noise * s.tau.std(axis=1)
    sets = [choose_set(body, case.set) for body in s.model.bodies]
    problem = build_problem(s.linear, s.model.bodies, s.reduction(tau), sets, case.prior, sigma, s.equalities)
    return s, problem, solve(problem)[0]


def asked(problem: Problem, x: Array, wanted: Any = None) -> Array:
    """All ranges, or some."""
    which = np.arange(len(problem.scale)) if wanted is None else np.array(wanted)
    return ranges(problem, x, which, lambda share: None)


class Reference:
    """The two programmes on all of the problem, for any coefficient; infinite where the end is out of sight."""

    def __init__(self, problem: Problem, cost: float) -> None:
        x = cp.Variable(problem.variables)
        self.problem, self.row = problem, cp.Parameter(len(problem.scale))
        self.z = problem.S @ x
        limits: list[Any] = [self._cost() <= cost * (1 + ABOVE), x[problem.bounded] >= problem.bounds]
        for m in problem.inequalities:
            value = sum(x[m.first + i] * G for i, G in enumerate(m.G))
            matrix = m.G.ndim == 3
            limits.append(value - m.interior * np.eye(m.G.shape[-1]) >> 0 if matrix else value >= m.interior)
        if len(problem.e):
            limits.append(problem.E @ self.z == problem.e)
        self.program = cp.Problem(cp.Minimize(self.row @ self.z), limits)

    def _cost(self) -> Any:
        cost = cp.sum_squares(self.problem.A @ self.z - self.problem.b) + self.problem.constant
        for term in self.problem.log_dets:
            X = sum(self.z[term.first + i] * G for i, G in enumerate(term.G))
            cost += term.weight * (cp.trace(X) - cp.log_det(X) - term.G.shape[-1])
        return cost

    def range(self, k: int) -> Array:
        """SI, shape (2,)."""
        ends = []
        for sign in (1.0, -1.0):
            self.row.value = sign * np.eye(len(self.problem.scale))[k]
            least = self.program.solve(solver=cp.CLARABEL, **ACCURATE)
            ends.append(sign * least if abs(least) < WIDE else -sign * np.inf)
        return np.array(ends) * self.problem.scale[k]


def assert_as_by_cvxpy(problem: Problem, x: Array, wanted: list[int]) -> Array:
    reference = Reference(problem, problem.cost(problem.S @ x))
    expected = np.array([reference.range(k) for k in wanted])
    found = asked(problem, x, wanted)
    np.testing.assert_array_equal(np.isinf(found), np.isinf(expected))
    finite = np.isfinite(expected)
    units = np.repeat(problem.scale[wanted, None], 2, axis=1)
    np.testing.assert_allclose((found / units)[finite], (expected / units)[finite], rtol=1e-3, atol=1e-3)
    return found


@pytest.mark.parametrize("case", CASES)
def test_ranges_are_what_cvxpy_finds(robot_of: Robots, case: str) -> None:
    """Of some parameters of each body and of every friction coefficient."""
    s, problem, x = stated(robot_of, CASES[case])
    wanted = [0, 3, 6, PI_SIZE, PI_SIZE + 5, *problem.other_coefficients.tolist()]
    found = assert_as_by_cvxpy(problem, x, wanted)
    inner = free_spread(problem, x)[wanted] / problem.scale[wanted]
    widths = np.diff(found, axis=1)[:, 0] / 2 / problem.scale[wanted]
    assert (widths < 0.9 * inner).any() or problem.log_dets  # constraints bite
    theta = problem.theta(problem.S @ x)[s.equalities.free][wanted]
    near = NEAR * problem.scale[wanted]  # an exact mass is both ends of its range
    assert (found[:, 0] <= theta + near).all()
    assert (theta <= found[:, 1] + near).all()


def test_friction_that_is_held_at_zero_goes_up_alone(robot_of: Robots) -> None:
    """In truth there is none. Its lower end is its bound, and the others feel it."""
    rng = np.random.default_rng(1)
    robot = robot_of(random_urdf(rng, size=2, kinds=("revolute",), mimic=0, massless=0))
    s = synthetic(rng, robot, 60, bounds(rng, robot))
    theta = s.theta.copy()
    theta[2 * PI_SIZE :] = 0.0
    s = replace(s, theta=theta)
    sets = [choose_set(body, "ellipsoid") for body in s.model.bodies]
    tau, sigma = s.noisy(1.0, 1), s.tau.std(axis=1)
    problem = build_problem(s.linear, s.model.bodies, s.reduction(tau), sets, EUCLIDEAN, sigma, s.equalities)
    x = solve(problem)[0]
    others = problem.other_coefficients.tolist()
    found = assert_as_by_cvxpy(problem, x, [1, 4, *others])
    at_zero = np.isclose(found[2:, 0] / problem.scale[others], 0, atol=1e-4)
    assert at_zero.any()
    assert (found[2:, 0] >= -NEAR * problem.scale[others]).all()
    assert (found[2:, 1] > 1e-3 * problem.scale[others]).all()


def curvature(problem: Problem, z: Array) -> Array:
    """Second derivative of the cost, by differences."""
    n, h = len(z), 1e-5
    H = np.zeros((n, n))
    units = h * np.eye(n)
    for i in range(n):
        for j in range(i + 1):
            a, b = units[i], units[j]
            H[i, j] = H[j, i] = (
                problem.cost(z + a + b) - problem.cost(z + a - b) - problem.cost(z - a + b) + problem.cost(z - a - b)
            ) / (4 * h * h)
    return H


def test_without_constraints_it_is_the_ellipsoids_half_width(robot_of: Robots) -> None:
    """√(0.01 f (AᵀA)⁻¹_kk) with all rows written out; `free_spread` tells it without a programme."""
    s, problem, _ = stated(robot_of, Case("none", EUCLIDEAN))
    problem = replace(problem, lower=np.full_like(problem.lower, -np.inf))
    sigma = s.tau.std(axis=1)
    scale, prior = problem.scale, s.linear.prior
    rows = (s.Y / sigma[:, None, None] / np.sqrt(60)).reshape(-1, len(scale)) * scale
    right = (s.noisy(1.0, 1) / sigma[:, None] / np.sqrt(60)).ravel()
    pull = np.sqrt(np.where(np.arange(len(scale)) < 2 * PI_SIZE, 1e-3 + 1e-8, 1e-8))
    W, b = np.concatenate([rows, np.diag(pull)]), np.concatenate([right, pull * prior / scale])
    z, (least,), _, _ = np.linalg.lstsq(W, b, rcond=None)
    half = scale * np.sqrt(ABOVE * least * np.diag(np.linalg.inv(W.T @ W)))
    start = np.linalg.lstsq(problem.S, z, rcond=None)[0]
    np.testing.assert_allclose(free_spread(problem, start), half, rtol=1e-6)
    found = asked(problem, start)
    np.testing.assert_allclose(found / scale[:, None], (z * scale + [[-1], [1]] * half).T / scale[:, None], atol=2e-4)


def test_the_half_width_of_a_divergence_is_that_of_its_curvature(robot_of: Robots) -> None:
    """√(0.01 f · 2 H⁻¹_kk), H by differences of the cost."""
    for each in (1, 2):
        _, problem, x = stated(robot_of, Case("full", Regularization(kind="entropic", weight=0.1), each), noise=0.05)
        z = problem.S @ x
        H = curvature(problem, z)
        half = problem.scale * np.sqrt(2 * ABOVE * problem.cost(z) * np.diag(np.linalg.inv(H)))
        np.testing.assert_allclose(free_spread(problem, x), half, rtol=1e-3)


def test_a_robots_legs_are_ranged_as_if_together(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    """cvxpy takes both legs at once; `ranges` does not, and the level is that of both."""
    s = legs(robot_of, ("FL", "FR"), count=40, friction={"offset": False})
    sizes = spied_sizes(monkeypatch)
    problem, x = of_legs(s, s.equalities)
    wanted = [0, 7, PI_SIZE + 1, 2 * PI_SIZE, 3 * PI_SIZE + 4, problem.other_coefficients[0]]
    assert_as_by_cvxpy(problem, x, wanted)
    assert set(sizes) == {problem.variables // 2}


def of_legs(s: Synthetic, known: EqualityConstraints, kind: str = "ellipsoid") -> tuple[Problem, Array]:
    bodies = with_equal_bounds(s.model, known).bodies
    sets = [choose_set(body, kind) for body in bodies]
    tau, sigma = s.noisy(1.0), s.tau.std(axis=1)
    problem = build_problem(s.linear, bodies, s.reduction(tau), sets, EUCLIDEAN, sigma, known)
    return problem, solve(problem)[0]


def spied_sizes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many variables each search has."""
    from idtool.estimation.uncertainty import ranges as module

    sizes, real = [], module.LevelSet

    def spy(problem: Problem, *rest: Any) -> LevelSet:
        sizes.append(problem.variables)
        return real(problem, *rest)

    monkeypatch.setattr(module, "LevelSet", spy)
    return sizes


@pytest.mark.parametrize("tie", ["copies", "total mass"])
def test_what_ties_legs_together_is_minded(robot_of: Robots, monkeypatch: pytest.MonkeyPatch, tie: str) -> None:
    """Mirrored legs are one leg; a known total makes one programme of both."""
    names = ("FL", "FR")
    config: dict[str, Any] = {"mirror": copies(names)} if tie == "copies" else {"known": {"total_mass": 3.0}}
    s = legs(robot_of, names, count=40, friction={"offset": False}, **config)
    sizes = spied_sizes(monkeypatch)
    problem, x = of_legs(s, s.equalities)
    wanted = [0, 7, PI_SIZE, PI_SIZE + 2, len(problem.scale) - 1]
    assert_as_by_cvxpy(problem, x, wanted)
    assert set(sizes) == {problem.variables}


@pytest.mark.parametrize(
    "prior", [EUCLIDEAN, pytest.param(Regularization(kind="entropic", weight=1e-2), marks=pytest.mark.slow)]
)
def test_a_long_chain_has_all_its_ranges(robot_of: Robots, prior: Regularization) -> None:
    """Of some hundred rows of inequalities, the cost's level is one."""
    rng = np.random.default_rng(1)
    robot = robot_of(random_urdf(rng, size=14, kinds=("revolute",), mimic=0, massless=0))
    s = synthetic(rng, robot, 40, bounds(rng, robot))
    tau, sigma = s.noisy(1.0, 1), s.tau.std(axis=1)
    sets = [choose_set(body, "ellipsoid") for body in s.model.bodies]
    problem = build_problem(s.linear, s.model.bodies, s.reduction(tau), sets, prior, sigma, s.equalities)
    x = solve(problem)[0]
    found = asked(problem, x)
    assert not np.isnan(found).any()
    z = problem.S @ x
    assert (found[:, 0] <= problem.scale * (z + NEAR)).all()
    assert (problem.scale * (z - NEAR) <= found[:, 1]).all()
    assert_as_by_cvxpy(problem, x, [7 * PI_SIZE, 13 * PI_SIZE + 4, problem.other_coefficients[3]])


def test_an_unseen_coefficient_has_no_end(robot_of: Robots) -> None:
    """Without prior: none without a set; with one, a mass and what is positive with it ends below, at zero or more."""
    weak = Regularization(kind="none")
    s, problem, x = stated(robot_of, Case("none", weak))
    Y = s.Y.reshape(-1, s.Y.shape[-1])
    felt = np.linalg.norm(Y[:, : 2 * PI_SIZE], axis=0) > 1e-9
    assert not felt[0]  # the first body's mass, on a joint that turns about its origin
    found = asked(problem, x)
    assert np.isinf(found[:PI_SIZE][~felt[:PI_SIZE]]).all()
    W = Y / np.where(np.append(felt, [True] * 4), np.linalg.norm(Y, axis=0), np.inf)
    rank = np.linalg.matrix_rank(W)
    adds = [np.linalg.matrix_rank(np.delete(W, k, axis=1)) < rank for k in range(W.shape[1])]
    assert sum(adds) >= 4
    assert np.isfinite(found[adds]).all()
    assert np.isinf(found[~np.array(adds)]).all(axis=1).sum() > PI_SIZE
    _, problem, x = stated(robot_of, Case("full", weak))
    found = asked(problem, x, [0])
    assert 0 <= found[0, 0] < np.inf
    assert found[0, 1] == np.inf


def test_the_higher_the_level_the_wider(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    _, problem, x = stated(robot_of, CASES["ellipsoid"])
    wanted = [0, 4, PI_SIZE, PI_SIZE + 3, PI_SIZE + 9]
    widths = []
    for above in (1e-3, 1e-2, 1e-1):
        monkeypatch.setattr("idtool.estimation.uncertainty.ranges.ABOVE", above)
        widths.append(asked(problem, x, wanted) / problem.scale[wanted, None])
    for narrow, wide in itertools.pairwise(widths):
        assert (wide[:, 0] <= narrow[:, 0] + 1e-4).all()
        assert (narrow[:, 1] <= wide[:, 1] + 1e-4).all()
    assert (np.diff(widths[2]) > np.diff(widths[0]) + 1e-3).all()


def test_the_tighter_the_set_the_narrower(robot_of: Robots) -> None:
    """At one level, which is the cost of a point in the tightest set."""
    wanted = [0, 1, 4, PI_SIZE, PI_SIZE + 3, PI_SIZE + 9]
    x = stated(robot_of, Case("ellipsoid"))[2]
    found = {}
    for name in ("none", "semi", "full", "com_ellipsoid", "ellipsoid"):
        problem = stated(robot_of, Case(name))[1]
        found[name] = asked(problem, x, wanted) / problem.scale[wanted, None]
    chains = [("none", "semi"), ("semi", "full"), ("full", "com_ellipsoid"), ("com_ellipsoid", "ellipsoid")]
    for loose, tight in chains:
        assert (found[loose][:, 0] <= found[tight][:, 0] + 1e-3).all()
        assert (found[tight][:, 1] <= found[loose][:, 1] + 1e-3).all()
    assert (np.diff(found["ellipsoid"]) < 0.9 * np.diff(found["none"])).any()


def test_a_static_moment_ends_where_the_ellipsoid_does(robot_of: Robots) -> None:
    """m (c_k ± √(Q_s)_kk), the mass known, of a body of which the data say nothing."""
    case = Case("ellipsoid", Regularization(kind="none"), config={"known": {"mass": {"link1": 1.3}}})
    s = stated(robot_of, case)[0]
    Y = s.Y.copy()
    Y[:, :, :PI_SIZE] = 0.0
    nothing = replace(s, Y=Y)
    sets = [choose_set(body, "ellipsoid") for body in s.model.bodies]
    tau = nothing.noisy(1.0)
    data = nothing.reduction(tau)
    problem = build_problem(s.linear, s.model.bodies, data, sets, case.prior, tau.std(axis=1), s.equalities)
    x = solve(problem)[0]
    ellipsoid = s.model.bodies[0].ellipsoids[0]
    reach = np.sqrt(np.diag(ellipsoid.Q_s))
    expected = 1.3 * np.column_stack([ellipsoid.center - reach, ellipsoid.center + reach])
    np.testing.assert_allclose(asked(problem, x, [1, 2, 3]), expected, atol=2e-3 * 1.3 * reach.max())
    np.testing.assert_allclose(asked(problem, x, [0]), [[1.3, 1.3]], rtol=1e-5)


def test_a_copys_range_is_its_originals(robot_of: Robots) -> None:
    """The original's programme holds both legs' rows: its range in the image is that of the other leg as original."""
    names = ("FL", "FR")
    s = legs(robot_of, names, count=40, friction={"offset": False}, mirror=copies(names))
    problem, x = of_legs(s, s.equalities)
    theta = problem.theta(problem.S @ x)
    found = asked(problem, x, np.arange(LENGTH * PI_SIZE))
    for i in range(1, LENGTH + 1):
        own, copy = of_body(s, f"FL_link{i}"), of_body(s, f"FR_link{i}")
        ends = image(found[own].T, (1, -1, 1))
        near = NEAR * problem.scale[own]
        assert (ends.min(axis=0) <= theta[copy] + near).all()
        assert (theta[copy] <= ends.max(axis=0) + near).all()


def test_objectives_in_parts_have_the_same_values(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    _, problem, x = stated(robot_of, CASES["entropic"])
    together = asked(problem, x)
    monkeypatch.setattr("idtool.estimation.problem.extremes._BATCH_ENTRIES", 1)
    np.testing.assert_allclose(asked(problem, x), together, rtol=1e-6)


def test_a_level_at_the_least_cost_has_no_interior(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    _, problem, x = stated(robot_of, CASES["full"])
    cost = problem.cost(problem.S @ x)
    for level in (cost, np.nan):
        with pytest.raises(SolverError, match="not above the least cost"):
            LevelSet(problem, x, level)
    monkeypatch.setattr("idtool.estimation.uncertainty.ranges.ABOVE", 0.0)
    assert np.isnan(asked(problem, x, [0, 5])).all()


def test_one_path_that_cannot_be_followed_leaves_the_others(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    _, problem, x = stated(robot_of, CASES["full"])
    level_set = LevelSet(problem, x, problem.cost(problem.S @ x) * (1 + ABOVE))
    objectives, sufficient = np.eye(len(problem.scale))[:7], np.full(7, -np.inf)
    expected = level_set.least(objectives, sufficient)
    real = LevelSet._least

    def fails_with_the_fourth(self: LevelSet, objectives: Array, sufficient: Array) -> Array:
        if objectives[:, 3].any():
            raise np.linalg.LinAlgError
        return real(self, objectives, sufficient)

    monkeypatch.setattr(LevelSet, "_least", fails_with_the_fourth)
    expected[3] = np.nan
    np.testing.assert_allclose(level_set.least(objectives, sufficient), expected, rtol=1e-6)


def test_a_coefficient_far_from_zero_has_a_range(robot_of: Robots) -> None:
    """What is out of sight is far from the optimum."""
    _, problem, _ = stated(robot_of, CASES["full"])
    k = int(problem.other_coefficients[0])
    moved = replace(problem, b=problem.b + 300 * problem.A[:, k], lower=np.full_like(problem.lower, -np.inf))
    at_origin = replace(problem, lower=moved.lower)
    expected = asked(at_origin, solve(at_origin)[0], [k])
    found = asked(moved, solve(moved)[0], [k])
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found - 300 * problem.scale[k], expected, atol=1e-3 * problem.scale[k])


def test_where_the_solver_gives_up_there_is_no_number(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    def gives_up(*_: Any) -> LevelSet:
        raise SolverError("solver", "no")

    _, problem, x = stated(robot_of, CASES["full"])
    monkeypatch.setattr("idtool.estimation.uncertainty.ranges.LevelSet", gives_up)
    assert np.isnan(asked(problem, x, [0, 5])).all()


def test_ranges_come_in_the_order_asked_and_tell_how_far_they_are(robot_of: Robots) -> None:
    _, problem, x = stated(robot_of, CASES["full"])
    told: list[float] = []
    wanted = [PI_SIZE + 2, 3, 0]
    found = ranges(problem, x, np.array(wanted), told.append)
    np.testing.assert_allclose(found, asked(problem, x, sorted(wanted))[::-1], rtol=1e-6)
    assert told == sorted(told)  # a copy of the process tells nothing of its share
    assert told[-1] == 1.0

"""The optimum: certified, in its place among the sets, and that of a problem stated in another way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from optima import duality_gap, solved_with_duals
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic
from units import in_units

from idtool.common.exceptions import SolverError
from idtool.estimation.problem.certificate import GAP
from idtool.estimation.problem.conic import Solution, solve_conic
from idtool.estimation.problem.estimate import estimate, solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.problem.refinement import Refined
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE, from_mass_com_inertia
from idtool.robot.sets import constraint_sets
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]

SETS = constraint_sets()
ORDER = ("none", "semi", "full", "com_ellipsoid", "ellipsoid")
PRIOR = Regularization(kind="euclidean", weight=1e-6)
HELD = 1e-8  # of the distance, with any prior, so that nothing is left undetermined


def random_data(folder: Path, seed: int, count: int = 60, each: int = 1) -> tuple[Synthetic, Array]:
    """A random robot of three joints, and its torque with three times as much noise, so that constraints bite."""
    rng = np.random.default_rng(seed)
    path = folder / f"{seed}.urdf"
    path.write_text(random_urdf(rng, size=3, kinds=("revolute", "prismatic"), mimic=0, massless=0))
    robot = read_robot(path)
    s = synthetic(rng, robot, count, bounds(rng, robot, each))
    return s, s.tau + 3 * s.tau.std(axis=1, keepdims=True) * rng.normal(size=s.tau.shape)


def sigma(s: Synthetic) -> Array:
    """The noise of the joints [N·m or N], shape (nv,)."""
    return np.asarray(3 * s.tau.std(axis=1))


def stated(s: Synthetic, tau: Array, kind: str, regularization: Regularization = PRIOR) -> Problem:
    bodies = s.model.bodies
    return build_problem(s.linear, bodies, s.reduction(tau), [SETS[kind]] * len(bodies), regularization, sigma(s))


@pytest.mark.parametrize("each", [1, 2])
@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_every_set_is_solved_to_a_certified_optimum_and_a_tighter_one_costs_more(
    tmp_path: Path, seed: int, each: int
) -> None:
    s, tau = random_data(tmp_path, seed, each=each)
    costs = []
    for kind in ORDER:
        _, certificate = solve(stated(s, tau, kind))
        assert abs(certificate.duality_gap) < 1e-6
        assert certificate.violation <= 0
        costs.append(certificate.objective)
    assert (np.diff(costs) > -2e-6 * costs[-1]).all(), costs
    assert costs[-1] > costs[0] + 1e-5 * costs[-1]


@pytest.mark.parametrize("kind", ORDER)
@pytest.mark.parametrize("each", [1, 2])
def test_another_statement_of_the_problem_has_the_same_optimum(tmp_path: Path, kind: str, each: int) -> None:
    """All rows as they are, SI units, and the sets written out from the paper's matrices."""
    s, tau = random_data(tmp_path, 7, each=each)
    problem = stated(s, tau, kind)
    x, certificate = solve(problem)
    theta, objective = by_rows(s, tau, kind, problem.scale)
    assert certificate.objective == pytest.approx(objective, rel=1e-5)
    np.testing.assert_allclose(
        (s.Y @ (problem.scale * (problem.S @ x))).T / sigma(s), (s.Y @ theta).T / sigma(s), atol=5e-3
    )


def by_rows(s: Synthetic, tau: Array, kind: str, scale: Array) -> tuple[Array, float]:
    """The optimum of (27), theta and cost; deviations of bodies from the prior are measured by ``scale``."""
    bodies = s.model.bodies
    others = cp.Variable(s.Y.shape[-1] - PI_SIZE * len(bodies), nonneg=True)
    constraints: list[cp.Constraint] = []
    whole = []
    for body in bodies:
        parts = list(body.ellipsoids) if kind in ("com_ellipsoid", "ellipsoid") else [None]
        pis = [cp.Variable(PI_SIZE) for _ in parts]
        for pi, ellipsoid in zip(pis, parts, strict=True):
            constraints += members_of(kind, pi, ellipsoid)
        whole.append(sum(pis))
    theta = cp.hstack([*whole, others])
    rows = (s.Y / sigma(s)[:, None, None]).reshape(-1, s.Y.shape[-1])
    held = PI_SIZE * len(bodies)
    deviation = (theta[:held] - s.linear.prior[:held]) / scale[:held]
    n = s.Y.shape[1]
    misfit = cp.sum_squares(rows @ theta - (tau / sigma(s)[:, None]).ravel()) / n
    program = cp.Problem(cp.Minimize(misfit + (PRIOR.weight + HELD) * cp.sum_squares(deviation)), constraints)
    program.solve(solver=cp.CLARABEL)
    return np.asarray(theta.value), float(program.value)


def members_of(kind: str, pi: cp.Variable, ellipsoid: Any) -> list[cp.Constraint]:
    """The representations in the paper's section III, entry by entry."""
    m, h = pi[0], pi[1:4]
    I = cp.bmat([[pi[4], pi[5], pi[7]], [pi[5], pi[6], pi[8]], [pi[7], pi[8], pi[9]]])  # noqa: E741
    J = cp.bmat([[0.5 * cp.trace(I) * np.eye(3) - I, h[:, None]], [h[None, :], cp.reshape(m, (1, 1), order="C")]])
    if kind == "none":
        return []
    if kind == "semi":
        S = cp.bmat([[0, -h[2], h[1]], [h[2], 0, -h[0]], [-h[1], h[0], 0]])
        return [cp.bmat([[I, S], [S.T, m * np.eye(3)]]) >> 0]
    if kind == "com_ellipsoid":
        d = h - m * np.array(ellipsoid.center)
        C = cp.bmat([[cp.reshape(m, (1, 1), order="C"), d[None, :]], [d[:, None], m * ellipsoid.Q_s]])
        return [J >> 0, C >> 0]
    return [J >> 0, *([cp.trace(J @ ellipsoid.Q) >= 0] if kind == "ellipsoid" else [])]


@pytest.mark.parametrize("kind", ["semi", "full", "com_ellipsoid", "ellipsoid"])
def test_the_gap_of_a_solution_is_how_much_its_cost_is_above_the_optimum(tmp_path: Path, kind: str) -> None:
    """With the optimal dual variables the gap of any feasible x is its excess in cost, as near as may be."""
    s, tau = random_data(tmp_path, 3)
    problem = stated(s, tau, kind)
    x, duals, multipliers = solved_with_duals(problem)
    best = problem.cost(problem.S @ x)
    assert abs(duality_gap(problem, x, duals, multipliers)) < GAP
    bodies = [middle(body, problem.scale[PI_SIZE * i :][:PI_SIZE]) for i, body in enumerate(s.model.bodies)]
    inside = np.concatenate([*bodies, x[PI_SIZE * len(bodies) :]])
    gaps = []
    for share in (1e-3, 3e-3, 1e-2, 0.1, 1.0):
        other = x + share * (inside - x)
        cost = problem.cost(problem.S @ other)
        gaps.append(duality_gap(problem, other, duals, multipliers))
        assert gaps[-1] == pytest.approx((cost - best) / max(cost, 1), rel=1e-4, abs=2e-6)
    assert gaps == sorted(gaps)
    assert gaps[1] > GAP


def middle(body: Body, units: Array) -> Array:
    """A small ball in the middle of a body's ellipsoid, in these units: a member of every set."""
    (S,) = body.ellipsoids
    inertia = 0.4 * (0.2 * min(S.semi_axes)) ** 2 * np.eye(3)
    return np.asarray(from_mass_com_inertia(units[0], S.center, units[0] * inertia) / units)


@pytest.mark.parametrize("kind", ["semi", "full", "com_ellipsoid", "ellipsoid"])
def test_no_dual_variables_whatever_certify_what_is_not_optimal(tmp_path: Path, kind: str) -> None:
    """Weak duality: the gap is never less than the excess in cost, whatever a solver might return."""
    rng = np.random.default_rng(0)
    problem = stated(*random_data(tmp_path, 3), kind)
    x, duals, multipliers = solved_with_duals(problem)
    best = problem.cost(problem.S @ x)
    for spread in (1e-6, 1e-3, 1.0, 1e3):
        for _ in range(5):
            spoilt = [Z + spread * np.abs(Z).max() * rng.normal(size=Z.shape) for Z in duals]
            gap = duality_gap(problem, x, spoilt, multipliers + spread * rng.normal(size=multipliers.shape))
            assert gap > -GAP
            assert spread < 1 or gap > 100 * GAP
    free = np.asarray(np.linalg.solve(problem.A, problem.b), dtype=np.float64)
    assert problem.cost(free) < best
    assert duality_gap(problem, x, [0 * Z for Z in duals], 0 * multipliers) == pytest.approx(
        (best - problem.cost(free)) / best, rel=1e-5, abs=1e-6
    )


def test_dual_matrices_with_negative_eigenvalues_certify_nothing(tmp_path: Path) -> None:
    """Were they let through, these would prove that no body has a lower cost than none at all."""
    problem = stated(*random_data(tmp_path, 3), "full")
    x, _, _ = solved_with_duals(problem)
    slope = problem.S.T @ (-2 * problem.A.T @ problem.b)  # of the cost where all coefficients are zero
    duals = []
    for matrix in problem.inequalities:
        G, wanted = matrix.G.reshape(PI_SIZE, -1), slope[matrix.first : matrix.first + PI_SIZE]
        duals.append(np.asarray(np.linalg.lstsq(G, wanted, rcond=None)[0], dtype=np.float64).reshape(4, 4))
    assert min(np.linalg.eigvalsh(Z)[0] for Z in duals) < 0
    nothing = problem.cost(np.zeros(len(problem.scale)))
    assert nothing > 1.01 * problem.cost(problem.S @ x)
    friction = np.maximum(slope[problem.bounded], 0)
    assert duality_gap(problem, x, duals, friction) > GAP


@pytest.mark.parametrize("kind", ["semi", "full", "ellipsoid"])
def test_a_solve_cut_short_is_refused_and_names_a_body(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """Where refining does not help either."""
    monkeypatch.setattr("idtool.estimation.problem.estimate.refine", lambda problem, solution: None)
    s, tau = random_data(tmp_path, 2)
    with pytest.raises(
        SolverError, match=r"link\d: .*: the problem was not solved accurately enough: relative duality gap \d"
    ):
        solve(stated(s, tau, kind), max_iter=3)


def test_what_the_solver_says_is_not_believed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A solver that returns something a little off with the word optimal, and a refinement that leaves it so."""
    s, tau = random_data(tmp_path, 2)
    problem = stated(s, tau, "ellipsoid")
    _, honest = solve(problem)

    def spoilt(*arguments: Any) -> Solution:
        solution = solve_conic(*arguments)
        return replace(solution, x=solution.x + 0.01)

    monkeypatch.setattr("idtool.estimation.problem.estimate.solve_conic", spoilt)
    monkeypatch.setattr("idtool.estimation.problem.estimate.refine", lambda problem, solution: Refined(solution, 0.0))
    assert honest.status == "optimal"
    with pytest.raises(SolverError, match="not solved accurately enough"):
        solve(problem)


@pytest.mark.parametrize("kind", ["full", "ellipsoid"])
def test_the_estimate_is_the_same_body_in_other_units(robot_of: Callable[[str], Robot], kind: str) -> None:
    """In millimetres and grams the numbers are others, and the bodies the same."""
    estimates = []
    mm, g = 1e3, 1e3
    for length, mass in ((1.0, 1.0), (mm, g)):
        rng = np.random.default_rng(11)
        text = random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0)
        robot = robot_of(in_units(text, length, mass))
        limits = bounds(rng, robot)
        for (bound,) in limits["bounding_ellipsoids"].values():
            for key in ("center", "semi_axes"):
                bound[key] = (length * np.array(bound[key])).tolist()
        config = {**limits, "gravity": [0.0, 0.0, -9.81 * length]}
        s = synthetic(rng, robot, 150, config)
        units = np.concatenate(
            [np.tile(mass * length ** np.repeat([0, 1, 2], [1, 3, 6]), 3), np.full(6, mass * length**2)]
        )
        if length == 1:
            truth = s.theta
            noise = 0.3 * s.tau.std(axis=1, keepdims=True) * rng.normal(size=s.tau.shape)
        tau = s.Y @ (truth * units) + noise * mass * length**2
        sets = [SETS[kind]] * 3
        estimates.append(estimate(s.linear, s.model.bodies, s.reduction(tau), sets, PRIOR).theta / units)
    np.testing.assert_allclose(estimates[1], estimates[0], rtol=1e-4, atol=1e-6)

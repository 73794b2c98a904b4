"""The solver against the same problem stated anew for cvxpy: the paper's matrices on all rows, without R-factors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import clarabel
import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic

from idtool.common.exceptions import InfeasibleError, SolverError
from idtool.estimation.problem.certificate import GAP, lower_bound
from idtool.estimation.problem.conic import SOLVER_INTERIOR, Solution, smat, solve_conic, svec
from idtool.estimation.problem.estimate import solve, solve_with_backend
from idtool.estimation.problem.prior import moved_priors
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import PI_SIZE, pseudo_inertia
from idtool.robot.sets import choose_set, constraint_sets
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

HELD = 1e-8  # least weight of the distance from the prior, with any regularization
SETTINGS = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-7, "tol_feas": 1e-8, "equilibrate_enable": False}
COSTS_ALIKE = 1e-6
# A tenth of what costs may differ by; the residual of `points in a union` comes no lower than 1e-9 in double precision.
ACCURATE = {"tol_gap_abs": 1e-7, "tol_gap_rel": 1e-7, "tol_feas": 1e-7, "equilibrate_enable": False}

Case = dict[str, Any]

CASES: dict[str, Case] = {
    **{name: {"set": name} for name in constraint_sets() if name not in ("known_com", "shape")},
    "com_ellipsoid of a union": {"set": "com_ellipsoid", "each": 2},
    "union of two": {"set": "ellipsoid", "each": 2},
    "union of three": {"set": "ellipsoid", "each": 3},
    "points in a union": {"set": "points", "each": 2},
    "known_com": {"set": "known_com", "known_com": {"link1": [0.1, 0, 0.05], "link3": [0, 0.02, 0]}},
    "exact masses": {"set": "ellipsoid", "known": {"mass": {"link1": 1.3, "link3": 0.4}}},
    "exact total of unions": {"set": "ellipsoid", "each": 2, "known": {"total_mass": 2.5}},
    "entropic": {"set": "full", "prior": ("entropic", 1e-2)},
    "entropic in unions": {"set": "ellipsoid", "each": 2, "prior": ("entropic", 1e-3)},
    "entropic with an exact mass": {"set": "ellipsoid", "prior": ("entropic", 1e-2), "known": {"mass": {"link2": 1}}},
    "pullback": {"set": "full", "prior": ("pullback", 1e-2)},
}


@dataclass(frozen=True)
class Stated:
    """A problem, and what it was stated from; the torque is mostly noise, so that the inequalities bite."""

    s: Synthetic
    tau: Array
    sigma: Array
    set: str
    prior: Regularization
    problem: Problem


State = Callable[..., Stated]


@pytest.fixture
def state(robot_of: Callable[[str], Robot]) -> State:
    """A case's problem for one of several random robots."""

    def make(case: Case, seed: int = 1) -> Stated:
        options = dict(case)
        rng = np.random.default_rng(seed)
        robot = robot_of(random_urdf(rng, size=3, kinds=("revolute", "prismatic"), mimic=0, massless=0))
        limits = bounds(rng, robot, options.pop("each", 1))
        (kind, weight), name = options.pop("prior", ("euclidean", 1e-6)), options.pop("set")
        s = synthetic(rng, robot, 60, {**limits, **options})
        tau, sigma = s.noisy(3.0, seed), 3 * s.tau.std(axis=1)
        prior = Regularization(kind=kind, weight=weight)
        assert not moved_priors(s.linear, s.model.bodies, prior)
        sets = [choose_set(body, name) for body in s.model.bodies]
        problem = build_problem(s.linear, s.model.bodies, s.reduction(tau), sets, prior, sigma, s.equalities)
        return Stated(s, tau, sigma, name, prior, problem)

    return make


def cost_by_cvxpy(stated: Stated) -> float:
    """The least cost of (27), each body in units of its own mass and size."""
    s, scale = stated.s, stated.problem.scale
    inertial = PI_SIZE * len(s.model.bodies)
    others = cp.Variable(len(scale) - inertial, nonneg=True)
    demands: list[Any] = []
    wholes = []
    for i, body in enumerate(s.model.bodies):
        pi, own = whole_of(stated.set, body, float(scale[PI_SIZE * i + 1] / scale[PI_SIZE * i]))
        demands += own
        wholes.append(pi)
    theta = cp.multiply(cp.hstack([*wholes, others]), scale)
    demands += facts(stated, theta)
    rows = (s.Y / stated.sigma[:, None, None]).reshape(-1, len(scale)) * scale
    n = s.Y.shape[1]
    z = cp.hstack([*wholes, others])
    cost = cp.sum_squares(rows @ z - (stated.tau / stated.sigma[:, None]).ravel()) / n
    cost += HELD * cp.sum_squares(z - s.linear.prior / scale)
    for i, pi in enumerate(wholes):
        cost += stated.prior.weight * distance(stated.prior.kind, pi, (s.linear.prior / scale)[PI_SIZE * i :][:PI_SIZE])
    program = cp.Problem(cp.Minimize(cost), demands)
    return float(program.solve(solver=cp.CLARABEL, **ACCURATE))


def facts(stated: Stated, theta: Any) -> list[Any]:
    """What the configuration knows exactly."""
    config, names = stated.s.config, [body.name for body in stated.s.model.bodies]
    demands = [theta[PI_SIZE * names.index(name)] == mass.value for name, mass in config.known.mass.items()]
    if config.known.total_mass is not None:
        demands.append(cp.sum(theta[: PI_SIZE * len(names) : PI_SIZE]) == config.known.total_mass.value)
    for name, center in config.known_com.items():
        first = PI_SIZE * names.index(name)
        demands += [theta[first + 1 + k] == theta[first] * c for k, c in enumerate(center)]
    return demands


def distance(kind: str, pi: Any, prior: Array) -> Any:
    """The prior's distance in any units; F Fᵀ = Ĵ, X = F⁻¹ J F⁻ᵀ."""
    if kind == "euclidean":
        return cp.sum_squares(pi - prior)
    inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(prior)))
    X = inverse @ J_of(pi) @ inverse.T
    if kind == "pullback":
        return 0.5 * cp.sum_squares(X - np.eye(4))
    return cp.trace(X) - cp.log_det(X) - 4


def whole_of(name: str, body: Body, unit: float) -> tuple[Any, list[Any]]:
    """A body's parameters in its own units, and what its set demands of them there."""
    bounds = [
        Ellipsoid.from_axes(np.divide(e.center, unit), np.divide(e.semi_axes, unit), e.rotation)
        for e in body.ellipsoids
    ]
    if name == "points":
        places = np.concatenate([e.grid(120 // len(bounds)) for e in bounds])
        masses = cp.Variable(len(places), nonneg=True)
        x, y, z = places.T
        moments = [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
        pi = np.array([np.ones_like(x), x, y, z, *moments]) @ masses
        return pi, [inside(J_of(pi))]
    parts: list[Any] = [cp.Variable(PI_SIZE) for _ in (bounds if "ellipsoid" in name else [None])]
    demands = []
    for pi, ellipsoid in zip(parts, bounds, strict=False):
        center = None if body.com is None else np.divide(body.com, unit)
        demands += members_of(name if name != "known_com" or body.com else "full", pi, ellipsoid, center)
    return sum(parts[1:], parts[0]), demands


def inside(matrix: Any) -> Any:
    return 0.5 * (matrix + matrix.T) >> SOLVER_INTERIOR * np.eye(matrix.shape[0])


def inertia_of(pi: Any) -> Any:
    return cp.bmat([[pi[4], pi[5], pi[7]], [pi[5], pi[6], pi[8]], [pi[7], pi[8], pi[9]]])


def J_of(pi: Any) -> Any:  # noqa: N802
    """Thm 3."""
    I, h = inertia_of(pi), pi[1:4]  # noqa: E741
    return cp.bmat([[0.5 * cp.trace(I) * np.eye(3) - I, h[:, None]], [h[None, :], pi[:1][None, :]]])


def members_of(name: str, pi: Any, ellipsoid: Ellipsoid, center: Array | None) -> list[Any]:
    """The representations in the paper's section III, entry by entry."""
    m, h, I = pi[0], pi[1:4], inertia_of(pi)  # noqa: E741
    if name == "none":
        return []
    if name == "semi":
        S = cp.bmat([[0, -h[2], h[1]], [h[2], 0, -h[0]], [-h[1], h[0], 0]])
        return [inside(cp.bmat([[I, S], [S.T, m * np.eye(3)]]))]
    if name == "known_com":
        assert center is not None
        about = I - m * (center @ center * np.eye(3) - np.outer(center, center))
        return [inside(0.5 * cp.trace(about) * np.eye(3) - about), m >= SOLVER_INTERIOR]
    demands = [inside(J_of(pi))]
    if name == "com_ellipsoid":
        d = h - m * np.array(ellipsoid.center)
        demands.append(inside(cp.bmat([[pi[:1][None, :], d[None, :]], [d[:, None], m * ellipsoid.Q_s]])))
    if name == "ellipsoid":
        demands.append(cp.trace(J_of(pi) @ ellipsoid.Q) >= SOLVER_INTERIOR)
    return demands


@pytest.mark.parametrize("case", CASES)
def test_the_optimum_costs_what_cvxpys_does(state: State, case: str) -> None:
    for seed in (1, 2):
        stated = state(CASES[case], seed)
        x, certificate = solve(stated.problem)
        expected = cost_by_cvxpy(stated)
        assert certificate.objective == pytest.approx(expected, rel=COSTS_ALIKE)
        cost = stated.problem.cost(stated.problem.S @ x)
        assert cost == certificate.objective
        if case != "none":  # else this would be a test of least squares alone
            assert cost > free_cost(stated) + 100 * COSTS_ALIKE * cost


def free_cost(stated: Stated) -> float:
    """The least cost that there is without inequalities and facts; of what is quadratic alone."""
    problem = replace(stated.problem, log_dets=())
    return problem.cost(np.asarray(np.linalg.solve(problem.A, problem.b), dtype=np.float64))


def solved(problem: Problem, start: Array | None = None) -> Solution:
    free = np.linalg.lstsq(problem.S, np.linalg.solve(problem.A, problem.b), rcond=None)[0]
    return solve_conic(problem, free if start is None else start, SETTINGS)


def slope_of_cost(problem: Problem, x: Array) -> Array:
    """Of f in x, shape (m,)."""
    z = problem.S @ x
    slope = 2 * problem.A.T @ (problem.A @ z - problem.b)
    for term in problem.log_dets:
        slope[term.z_slice] += term.gradient(z)
    return np.asarray(problem.S.T @ slope)


@pytest.mark.parametrize("case", CASES)
def test_the_dual_variables_are_those_of_the_optimum(state: State, case: str) -> None:
    """They are in the cones, vanish where an inequality is not at its limit, and balance the cost's slope."""
    problem = state(CASES[case]).problem
    solution = solved(problem)
    assert solution.status == "optimal"
    balance = slope_of_cost(problem, solution.x)
    scale = max(float(np.abs(balance).max()), 1e-2)
    for inequality, Z in zip(problem.inequalities, solution.duals, strict=True):
        assert Z.shape == inequality.G.shape[1:]
        slack = inequality.value(solution.x) - inequality.interior * (np.eye(len(Z)) if Z.ndim == 2 else 1.0)
        for value in (Z, slack):
            assert (np.linalg.eigvalsh(value) if Z.ndim == 2 else value).min() > -1e-6 * scale
        assert abs(np.sum(Z * slack)) < 1e-6 * scale
        balance[inequality.x_slice] -= np.tensordot(inequality.G, Z, axes=Z.ndim)
    balance[problem.bounded] -= solution.multipliers
    assert (solution.multipliers > -1e-9).all()
    ES = problem.E @ problem.S
    if len(ES):
        balance -= ES.T @ np.linalg.lstsq(ES.T, balance, rcond=None)[0]
    np.testing.assert_allclose(balance, 0, atol=2e-3 * scale)


@pytest.mark.parametrize("case", CASES)
def test_the_dual_variables_give_the_gap(state: State, case: str) -> None:
    stated = state(CASES[case], 2)
    solution = solved(stated.problem)
    bound = lower_bound(stated.problem, solution.x, solution.duals, solution.multipliers)
    assert bound == pytest.approx(cost_by_cvxpy(stated), rel=GAP)


def test_a_multiplier_is_what_a_lower_bound_costs(state: State) -> None:
    """By the cost of the same problem with the bounds moved."""
    problem = state({"set": "full"}, 3).problem
    assert len(problem.bounded)
    problem = replace(problem, lower=problem.lower + 0.5)  # above what friction would be
    multipliers = solved(problem).multipliers
    assert np.count_nonzero(multipliers > 1e-3) > 1
    step = 1e-3
    for k, moved in enumerate(step * np.eye(len(problem.lower))):
        more, less = (solve(replace(problem, lower=problem.lower + sign * moved))[1] for sign in (1, -1))
        slope = (more.objective - less.objective) / (2 * step)
        assert multipliers[k] == pytest.approx(slope, rel=1e-2, abs=2e-4)


def test_the_start_does_not_matter(state: State, rng: np.random.Generator) -> None:
    problem = state({"set": "ellipsoid", "each": 2}).problem
    cost = problem.cost(problem.S @ solved(problem).x)
    for start in (np.zeros(problem.variables), rng.normal(size=problem.variables)):
        x = solved(problem, start).x
        assert problem.cost(problem.S @ x) == pytest.approx(cost, rel=COSTS_ALIKE)


squares = st.tuples(st.integers(1, 8), st.integers(0, 2**32 - 1))


@given(squares)
def test_svec_keeps_inner_products_and_smat_undoes_it(given: tuple[int, int]) -> None:
    n, seed = given
    A, B = np.random.default_rng(seed).normal(size=(2, n, n))
    A, B = A + A.T, B + B.T
    assert svec(A) @ svec(B) == pytest.approx(np.trace(A @ B), rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(smat(svec(A), n), A, rtol=1e-15)
    np.testing.assert_array_equal(svec(np.stack([A, B])), [svec(A), svec(B)])


def test_svec_is_in_the_order_that_clarabel_says() -> None:
    """Upper triangle, column by column."""
    A = np.array([[1.0, 2, 4], [2, 3, 5], [4, 5, 6]])
    r = np.sqrt(2)
    np.testing.assert_allclose(svec(A), [1, 2 * r, 3, 4 * r, 5 * r, 6], rtol=1e-15)


IMPOSSIBLE: dict[str, Case] = {
    "masses beyond their total": {"known": {"mass": {"link1": 3, "link2": 2}, "total_mass": 4}},
    "a centre outside its ellipsoid": {"known_com": {"link2": [9, 0, 0]}},
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
@pytest.mark.parametrize("prior", [("euclidean", 1e-6), ("entropic", 1e-3)], ids=["euclidean", "entropic"])
def test_what_no_parameters_fulfil_is_said_in_one_line(state: State, case: str, prior: tuple[str, float]) -> None:
    problem = state({"set": "ellipsoid", "prior": prior, **IMPOSSIBLE[case]}).problem
    with pytest.raises(SolverError) as caught:
        solve(problem)
    said = str(caught.value)
    assert said.startswith(
        "solver: found no parameters that satisfy the constraints and the exactly known values (known"
    )
    assert "\n" not in said


ABSURD: dict[str, Callable[[Problem], Problem]] = {
    "not a number": lambda p: replace(p, b=np.full_like(p.b, np.nan)),
    "infinite": lambda p: replace(p, b=np.where(np.arange(len(p.b)) == 3, np.inf, p.b)),
    "a matrix that is not a number": lambda p: replace(p, A=np.nan * p.A),
    "huge": lambda p: replace(p, b=1e200 * p.b),
    "huge columns": lambda p: replace(p, A=1e155 * p.A),
    "a bound at the end of the world": lambda p: replace(p, lower=p.lower + 1e300),
    "facts that are not numbers": lambda p: replace(p, E=np.eye(1, len(p.scale)), e=np.array([np.nan])),
}


@pytest.mark.parametrize("case", ABSURD)
@pytest.mark.parametrize("prior", [("euclidean", 1e-6), ("entropic", 1e-3)], ids=["euclidean", "entropic"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_absurd_numbers_are_an_error_and_no_crash(state: State, case: str, prior: tuple[str, float]) -> None:
    problem = ABSURD[case](state({"set": "ellipsoid", "prior": prior}).problem)
    with pytest.raises(SolverError) as caught:
        solve(problem)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 250


def test_an_attempt_that_gives_up_hides_no_proof_that_nothing_fulfils_the_constraints(
    state: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = clarabel.DefaultSolver

    def giving_up(*statement: Any) -> Any:
        if statement[-1].equilibrate_enable:  # the last attempt
            raise RuntimeError("no progress")
        return real(*statement)

    problem = state({"set": "ellipsoid", **IMPOSSIBLE["masses beyond their total"]}).problem
    monkeypatch.setattr("idtool.estimation.problem.conic.clarabel.DefaultSolver", giving_up)
    with pytest.raises(InfeasibleError):
        solve(problem)


@pytest.mark.parametrize("by_cvxpy", [False, True])
def test_the_solver_has_no_threads_of_its_own(state: State, monkeypatch: pytest.MonkeyPatch, by_cvxpy: bool) -> None:
    """A copy of the process has none of them: on a quadruped, a diagnosis waited for them forever."""
    threads = []
    inner = clarabel.DefaultSolver

    def solver(P: Any, q: Any, A: Any, b: Any, cones: Any, settings: Any) -> Any:
        threads.append(settings.max_threads)
        return inner(P, q, A, b, cones, settings)

    problem = state({"set": "full"}).problem
    monkeypatch.setattr("clarabel.DefaultSolver", solver)
    if by_cvxpy:
        solve_with_backend(problem, "CLARABEL")
    else:
        solve(problem)
    assert set(threads) == {1}


def test_an_interrupt_is_not_taken_for_a_breakdown(state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    problem = state({"set": "full"}).problem
    monkeypatch.setattr("idtool.estimation.problem.conic.clarabel.DefaultSolver", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solve(problem)


def test_a_breakdown_of_the_solvers_own_is_an_error(state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is written in another language, whose panics are no `Exception`."""

    class Panic(BaseException):
        pass

    def panicking(*_: object) -> None:
        raise Panic("index out of bounds")

    problem = state({"set": "full"}).problem
    monkeypatch.setattr("idtool.estimation.problem.conic.clarabel.DefaultSolver", panicking)
    with pytest.raises(SolverError, match=r"^solver: failed on these numbers \(index out of bounds\); check units"):
        solve(problem)

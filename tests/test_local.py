"""The local estimators: what they describe, their derivatives, and how they compare with the global optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import SAMPLES
from numpy.typing import NDArray
from robots import random_urdf, rotation
from scipy.spatial.transform import Rotation
from synthetic import Synthetic, bounds, synthetic

from idtool.certificate import GAP, violation
from idtool.config import Regularization, read_config
from idtool.exceptions import SolverError
from idtool.experiment import prepare
from idtool.identify import solve, solve_locally, stuck_note
from idtool.inequality import DENSITY, Piece
from idtool.inertia import (
    POWERS,
    SIZE,
    from_mass_com_inertia,
    from_pseudo_inertia,
    pseudo_inertia,
    transformation,
    triangle_margin,
)
from idtool.local import LOCAL, Chart, LogCholesky, Manifold, Residuals, manifold, spectral
from idtool.parts import INTERIOR, Part
from idtool.prior import LogDet
from idtool.problem import Problem, build_problem
from idtool.robot import Robot, read_robot
from idtool.sets import choose_set
from idtool.weights import free_noise

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


@pytest.fixture
def state(robot_of: Callable[[str], Robot]) -> State:
    """A problem of three links, every body fully consistent, and its prior."""

    def make(kind: Any, weight: float, seed: int = 0, share: float = 3.0, **config: Any) -> tuple[Problem, Array]:
        rng = np.random.default_rng(seed)
        robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
        return stated(synthetic(rng, robot, 60, config), "full", Regularization(kind=kind, weight=weight), share)

    return make


def stated(s: Synthetic, name: str, regularization: Regularization, share: float) -> tuple[Problem, Array]:
    reduction = s.reduction(s.noisy(share))
    sets = [choose_set(body, name) for body in s.model.bodies]
    noise = free_noise(s.linear, reduction, s.known)
    problem = build_problem(s.linear, s.model.bodies, reduction, sets, regularization, noise, s.known)
    return problem, s.linear.prior[s.known.free] / problem.scale


def one_body(A: Array, b: Array) -> Problem:
    """‖A z − b‖² over one body."""
    part = Part(0, 0, 0, Piece((DENSITY,)), 1.0)
    none = np.zeros(0)
    nothing = np.zeros((0, SIZE)), none
    return Problem(A, b, 0.0, np.ones(SIZE), np.eye(SIZE), (part,), ("body",), none.astype(np.intp), none, *nothing)


# ---- what is described


def test_log_cholesky_is_that_of_pinocchio(rng: np.random.Generator) -> None:
    """Rucker & Wensing's closed form of pi and its Jacobian, as Pinocchio has them."""
    y = rng.normal(size=(20, SIZE))
    chart = laid(LogCholesky, definite(rng, 20))
    theirs = [pin.LogCholeskyParameters(row) for row in y]
    pi = from_pseudo_inertia(chart.pseudo_inertias(y))
    np.testing.assert_allclose(pi, [p.toDynamicParameters() for p in theirs], rtol=1e-12, atol=1e-12)
    jacobians = from_pseudo_inertia(chart.derivatives(y)).swapaxes(-1, -2)
    np.testing.assert_allclose(jacobians, [p.calculateJacobian() for p in theirs], rtol=1e-12, atol=1e-12)


def test_the_manifold_is_that_of_theorem_2(rng: np.random.Generator) -> None:
    """pi of mass, centre, axes and principal moments, these the sums of two mu each (21)."""
    J = definite(rng, 10)
    chart = laid(Manifold, J)
    for y, body in zip(chart.y, from_pseudo_inertia(J), strict=True):
        mass, c, mu, w = np.split(y, [1, 4, 7])
        assert not w.any()
        turn = rng.normal(size=3)
        mu = rng.uniform(0.1, 1, 3)
        moved = np.concatenate([mass, c, mu, np.tan(np.linalg.norm(turn) / 2) * turn / np.linalg.norm(turn)])
        alone = Manifold(pseudo_inertia(body)[None], np.zeros((1, 4, 4)))
        assert np.linalg.det(alone.R[0]) == pytest.approx(1)
        R = alone.R[0] @ Rotation.from_rotvec(turn).as_matrix()
        inertia = R @ np.diag(mu.sum() - mu) @ R.T
        found = from_pseudo_inertia(alone.pseudo_inertias(moved[None]))[0]
        np.testing.assert_allclose(found, from_mass_com_inertia(float(mass[0]), c, inertia), atol=1e-12)


@pytest.mark.parametrize("kind", CHARTS.values())
@pytest.mark.parametrize("spread", [0.0, 1.0, 6.0])
def test_every_body_is_described(kind: type[Chart], spread: float, rng: np.random.Generator) -> None:
    J = definite(rng, 50, spread)
    chart = laid(kind, J)
    np.testing.assert_allclose(chart.pseudo_inertias(chart.y), J, atol=1e-12 * np.abs(J).max())


def test_only_bodies_are_described(rng: np.random.Generator) -> None:
    y = 2 * rng.normal(size=(200, SIZE))
    for kind in CHARTS.values():
        chart = laid(kind, definite(rng, 200))
        J = chart.pseudo_inertias(np.maximum(y, chart.lower + 1e-6))
        assert (np.linalg.eigvalsh(J)[:, 0] >= -1e-12 * np.abs(J).max(axis=(1, 2))).all()
        assert min(triangle_margin(pi) / np.abs(pi).max() for pi in from_pseudo_inertia(J)) > -1e-9


def test_frames(rng: np.random.Generator) -> None:
    """In another frame the manifold's m and mu stay and c and R go along; moved, log-Cholesky's t alone changes."""
    J = definite(rng, 5)
    R, p = rotation(rng), rng.normal(size=3)
    seen = pseudo_inertia(from_pseudo_inertia(J) @ transformation(R, p).T)
    here, there = laid(Manifold, J), laid(Manifold, seen)
    np.testing.assert_allclose(there.y[:, [0, 4, 5, 6]], here.y[:, [0, 4, 5, 6]], rtol=1e-10)
    np.testing.assert_allclose(there.y[:, 1:4], here.y[:, 1:4] @ R.T + p, atol=1e-10)
    moved = pseudo_inertia(from_pseudo_inertia(J) @ transformation(np.eye(3), p).T)
    y, z = laid(LogCholesky, J).y, laid(LogCholesky, moved).y
    np.testing.assert_allclose(z, y + np.append(np.zeros(7), p), rtol=1e-8, atol=1e-10)


# ---- derivatives


@pytest.mark.parametrize("kind", CHARTS.values())
def test_derivatives_of_the_pseudo_inertia(kind: type[Chart], rng: np.random.Generator) -> None:
    chart = laid(kind, definite(rng, 3))
    y = chart.y + 0.3 * np.abs(rng.normal(size=chart.y.shape))
    ours = chart.derivatives(y)
    for body in range(3):

        def moved(row: Array, body: int = body) -> Array:
            return np.asarray(chart.pseudo_inertias(np.concatenate([y[:body], row[None], y[body + 1 :]]))[body])

        np.testing.assert_allclose(np.moveaxis(ours[body], 0, -1), difference(moved, y[body]), atol=1e-8)


@pytest.mark.parametrize("name", CHARTS)
@pytest.mark.parametrize("prior", [("euclidean", 1e-2), ("entropic", 0.5)])
def test_residuals_are_the_cost_and_their_jacobian_its_derivative(state: State, name: str, prior: Any) -> None:
    problem, start = state(*prior, **FRICTION, **MIRROR)
    residuals = Residuals(problem)
    chart = laid(CHARTS[name], pseudo_inertia(start[residuals.own]))
    others = np.random.default_rng(0).uniform(0.1, 1, len(problem.others))
    v = np.concatenate([(chart.y + 0.1).ravel(), others])
    z = residuals.z(chart, v)
    assert np.square(residuals.value(v, chart)).sum() + problem.constant == pytest.approx(problem.cost(z), rel=1e-12)
    ours = residuals.jacobian(v, chart)
    numeric = difference(lambda v: residuals.value(v, chart), v)
    np.testing.assert_allclose(ours, numeric, atol=1e-7 * np.abs(ours).max())
    for body, slope in zip(residuals.own, residuals.slope(z), strict=True):

        def cost(pi: Array, body: Array = body) -> Array:
            moved = z.copy()
            moved[body] = pi
            return np.array([problem.cost(moved)])

        along = np.einsum("kij,ij->k", pseudo_inertia(np.eye(SIZE)), slope)
        np.testing.assert_allclose(along, difference(cost, z[body])[0], rtol=1e-5, atol=1e-5 * np.abs(along).max())


@pytest.mark.parametrize("spread", [0.0, 1e-7, 1e-3, 1e-2, 1.0, 5.0])
def test_a_log_det_is_a_sum_of_squares(spread: float, rng: np.random.Generator) -> None:
    """At eigenvalues that are far apart, nearly one, nearly equal, and equal."""
    G = pseudo_inertia(np.eye(SIZE))
    term = LogDet(0, G, 0.7)
    for J in definite(rng, 10, spread):
        z = from_pseudo_inertia(J)
        value, derivative = spectral(term, z)
        values = np.linalg.eigvalsh(J)
        e = values - 1
        expected = 0.7 * np.where(np.abs(e) < 1e-4, e**2 / 2 - e**3 / 3, e - np.log(values)).sum()
        assert np.square(value).sum() == pytest.approx(expected, rel=1e-6, abs=1e-30)
        numeric = difference(lambda z: spectral(term, z)[0], z, 1e-6 * values[0])
        np.testing.assert_allclose(derivative, numeric, atol=1e-6 * np.abs(derivative).max())
    same = 3.0 * np.eye(4)
    numeric = difference(lambda z: spectral(term, z)[0], from_pseudo_inertia(same))
    np.testing.assert_allclose(spectral(term, from_pseudo_inertia(same))[1], numeric, atol=1e-8)


# ---- optima

INNER: dict[str, tuple[str, float, dict[str, Any]]] = {
    "pullback": ("pullback", 1.0, {}),
    "pullback with friction": ("pullback", 1.0, FRICTION),
    "pullback with copies": ("pullback", 1.0, MIRROR),
    "euclidean": ("euclidean", 1.0, {}),
}


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("case", INNER)
def test_an_inner_optimum_is_the_global_one(state: State, name: str, case: str) -> None:
    """Where no inequality is active and the prior makes the optimum unique: the same cost and the same parameters."""
    kind, weight, config = INNER[case]
    problem, start = state(kind, weight, **config)
    x, certificate = solve(problem, **TIGHT)
    assert -certificate.violation > 1e2 * INTERIOR
    found = LOCAL[name](problem, start)
    assert problem.cost(problem.S @ found.x) == pytest.approx(certificate.objective, rel=1e-9)
    np.testing.assert_allclose(found.x, x, atol=1e-6 * np.abs(x).max())
    assert found.iterations < 150
    assert "termination condition is satisfied" in found.status
    assert found.seconds > 0


@pytest.mark.parametrize("config", [{}, FRICTION, MIRROR], ids=["plain", "friction", "copies"])
def test_with_the_entropic_prior_the_slope_vanishes(state: State, config: dict[str, Any]) -> None:
    """Both ways lead to one place, where J may go nowhere cheaper: the optimum of a convex cost, as Clarabel has it."""
    problem, start = state("entropic", 0.5, **config)
    x = {name: LOCAL[name](problem, start).x for name in LOCAL}
    np.testing.assert_allclose(x["log_cholesky"], x["manifold"], atol=1e-4)
    _, best = solve(problem)
    for found in x.values():
        assert problem.cost(problem.S @ found) == pytest.approx(best.objective, rel=GAP)
        assert violation(problem, found)[0] < -INTERIOR
        r, D = Residuals(problem).at(problem.S @ found)
        free = np.setdiff1d(np.arange(problem.variables), problem.bounded[found[problem.bounded] < 1e-6])
        size = np.linalg.norm(D, axis=0) * np.linalg.norm(r)
        assert (np.abs(r @ D) / size)[free].max() < 1e-5


ACTIVE = [("euclidean", 1e-2), ("pullback", 1e-3)]


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize(("kind", "weight"), ACTIVE)
def test_an_optimum_on_the_boundary_is_approached_from_above(state: State, name: str, kind: str, weight: float) -> None:
    for seed in (1, 2):
        problem, start = state(kind, weight, seed)
        _, best = solve(problem)
        x, certificate = solve_locally(problem, name, start)
        assert -best.violation < 1.5 * INTERIOR  # an inequality is active
        assert certificate.violation <= 0
        assert (x[problem.bounded] >= problem.bounds).all()
        assert certificate.objective == problem.cost(problem.S @ x)
        assert certificate.objective >= best.objective - best.duality_gap * max(best.objective, 1.0)
        assert certificate.objective < problem.cost(start)
        assert certificate.duality_gap > -1e-11


def test_log_cholesky_is_found_far_from_an_optimum_on_the_boundary(state: State) -> None:
    """The cost is flat there: scipy stops, whatever it says, and the gap tells. The manifold reaches the boundary."""
    problem, start = state("euclidean", 1e-2, seed=2)
    _, stuck = solve_locally(problem, "log_cholesky", start)
    assert stuck.duality_gap > 10 * GAP
    assert not stuck.holds
    assert "log_cholesky" in stuck_note(stuck)
    _, arrived = solve_locally(problem, "manifold", start)
    assert arrived.holds
    assert not stuck_note(arrived)


def test_coinciding_moments_are_no_trap(rng: np.random.Generator) -> None:
    """From a ball, any turn changes nothing; the cost's slope shows which axes lead on."""
    target = from_pseudo_inertia(np.diag([1.0, 1, 1, 2]) + 0.3 * np.eye(4)[[1, 0, 2, 3]] * [1, 1, 0, 0])
    ball = from_pseudo_inertia(np.diag([1.0, 1, 1, 2]))
    problem = one_body(np.eye(SIZE), target)
    blind = laid(Manifold, pseudo_inertia(ball)[None])
    v = blind.y.ravel()
    residuals = Residuals(problem)
    assert np.abs(residuals.value(v, blind) @ residuals.jacobian(v, blind)).max() < 1e-5  # stationary, and no optimum
    np.testing.assert_allclose(manifold(problem, ball).x, target, atol=1e-8)


@pytest.mark.parametrize("seed", [26, 55])
def test_a_chart_laid_anew_leads_on(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """To an optimum on the boundary, that one run of scipy does not come near."""
    rng = np.random.default_rng(seed)
    A = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0] * np.exp(rng.uniform(-2, 2, SIZE))
    J = rng.normal(size=(4, 4))
    problem, ball = one_body(A, A @ from_pseudo_inertia(J + J.T)), from_pseudo_inertia(np.diag([1.0, 1, 1, 2]))
    often = solve_locally(problem, "manifold", ball)[1].duality_gap
    monkeypatch.setattr(Manifold, "runs", 1)
    assert often < 1e-2 * solve_locally(problem, "manifold", ball)[1].duality_gap


def test_a_body_without_mass_can_be_described() -> None:
    """A rank-one J up to rounding, its centre anywhere; with the cost's slope, where it pays to have mass."""
    J = np.diag([1.0, 0, 0, 0])[None]
    J[0, 3, 3] = -1e-17
    chart = laid(Manifold, J)
    assert (chart.y >= chart.lower).all()
    np.testing.assert_allclose(chart.pseudo_inertias(chart.y), J, atol=1e-11)
    ray = np.array([0, 0.6, 0, 0.8])
    led = Manifold(J, -np.outer(ray, ray)[None])
    np.testing.assert_allclose(led.y[0, 1:4], [0, 0.75, 0], atol=1e-6)


@pytest.mark.parametrize("name", LOCAL)
def test_another_frame_leads_to_the_same_body(state: State, name: str, rng: np.random.Generator) -> None:
    problem, start = state("pullback", 1.0)
    T = np.eye(problem.variables)
    for part in problem.parts:
        own = slice(part.first, part.first + SIZE)
        T[own, own] = transformation(rotation(rng), 0.5 * rng.normal(size=3))
    elsewhere = replace(problem, A=problem.A @ np.linalg.inv(T))
    np.testing.assert_allclose(LOCAL[name](elsewhere, T @ start).x, T @ LOCAL[name](problem, start).x, atol=1e-5)


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("start", ["nothing", "negative mass", "point masses", "friction below its bound"])
def test_a_start_that_no_body_can_have(state: State, name: str, start: str) -> None:
    problem, prior = state("pullback", 1.0, **FRICTION)
    x = LOCAL[name](problem, prior).x
    z = prior.copy()
    bodies = Residuals(problem).own
    if start == "nothing":
        z[:] = 0
    elif start == "negative mass":
        z[bodies] *= -1
    elif start == "point masses":
        z[bodies] = POWERS == 0
    else:
        z[problem.others] = -1
    np.testing.assert_allclose(LOCAL[name](problem, z).x, x, atol=1e-5)


@pytest.mark.parametrize("weight", [0.0, 1e-12])
def test_a_step_beyond_all_numbers_is_taken_back(weight: float) -> None:
    """A body far off that is to be 10⁴ times as heavy: the first step is e^10⁴ times."""
    far = np.array([500.0, 0, 0])
    A = np.diag([1.0] + [1e-4] * 9)
    target, start = (from_mass_com_inertia(m, far, m * np.eye(3)) for m in (1e4, 1.0))
    term = LogDet(0, pseudo_inertia(np.eye(SIZE)), weight)
    problem = replace(one_body(A, A @ target), log_dets=(term,))
    chart = laid(LogCholesky, pseudo_inertia(start)[None])
    beyond = chart.y.ravel() + 1e4 * (np.arange(SIZE) == 0)
    with np.errstate(all="ignore"):
        assert not np.isfinite(Residuals(problem).value(beyond, chart)).any()
    x = LOCAL["log_cholesky"](problem, start).x
    assert problem.cost(x) < 1e-3 * problem.cost(start)


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("kind", ["none", "semi", "com_ellipsoid", "ellipsoid", "points"])
def test_other_sets_are_refused(robot_of: Callable[[str], Robot], name: str, kind: str) -> None:
    rng = np.random.default_rng(0)
    robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    problem, start = stated(synthetic(rng, robot, 60, bounds(rng, robot)), kind, Regularization(), 1.0)
    with pytest.raises(SolverError, match=rf"^solver\.name: {name} knows only constraints: full, and link\d has"):
        LOCAL[name](problem, start)


def test_exact_facts_are_refused_and_others_are_not(state: State) -> None:
    problem, start = state("pullback", 1.0, known={"mass": {"link2": 1}})
    with pytest.raises(SolverError, match=r"^solver\.name: manifold cannot hold known .* standard_error"):
        manifold(problem, start)
    soft = {"mass": {"link2": {"value": 1, "standard_error": 0.1}}}
    problem, start = state("pullback", 1.0, known=soft)
    assert solve_locally(problem, "log_cholesky", start)[1].holds


@pytest.mark.parametrize("name", LOCAL)
def test_the_leg_from_its_prior(name: str) -> None:
    """With the pull-back of its prior the sample leg's optimum is inside: both find it, and certified."""
    config = read_config(SAMPLES / "leg.yaml")
    experiment = prepare(read_robot(SAMPLES / "leg.urdf"), config, [SAMPLES / "leg_train.mcap"], holdout=0.0)
    equation, bodies = experiment.equation, experiment.model.bodies
    reduction = experiment.reduce(lambda *_: None)
    sets = [choose_set(body, "full") for body in bodies]
    noise = free_noise(equation, reduction)
    problem = build_problem(equation, bodies, reduction, sets, Regularization(kind="pullback", weight=1e-3), noise)
    x, best = solve(problem, **TIGHT)
    found, certificate = solve_locally(problem, name, equation.prior / problem.scale)
    assert certificate.holds
    assert certificate.objective == pytest.approx(best.objective, rel=1e-8)
    np.testing.assert_allclose(found, x, atol=1e-4)

"""The local estimators: what they describe, their derivatives, and how they compare with the global optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from charts import (
    FRICTION,
    MIRROR,
    TIGHT,
    State,
    laid,
    one_body,
    random_problem,
    stated,
)
from commands import SAMPLES
from robots import random_urdf, rotation
from synthetic import bounds, synthetic

from idtool.common.exceptions import SolverError
from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.certificate import GAP, violation
from idtool.estimation.problem.estimate import solve, solve_locally, stuck_note
from idtool.estimation.problem.local import LOCAL, LogCholesky, Manifold, Residuals, manifold
from idtool.estimation.problem.prior import LogDet
from idtool.estimation.problem.problem import build_problem
from idtool.estimation.problem.variables import INTERIOR
from idtool.robot.config import WEAK_PRIOR, Regularization, read_config
from idtool.robot.inertia import (
    LENGTH_POWERS,
    PI_SIZE,
    from_mass_com_inertia,
    from_pseudo_inertia,
    parameter_transform,
    pseudo_inertia,
)
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot, read_robot


@pytest.fixture
def state(robot_of: Callable[[str], Robot]) -> State:
    """See `random_problem`."""
    return partial(random_problem, robot_of)


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
        bound = best.objective - best.duality_gap * max(best.objective, 1.0)
        assert certificate.objective >= bound * (1 - 1e-11)
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
    problem = one_body(np.eye(PI_SIZE), target)
    blind = laid(Manifold, pseudo_inertia(ball)[None])
    v = blind.y.ravel()
    residuals = Residuals(problem)
    assert np.abs(residuals.value(v, blind) @ residuals.jacobian(v, blind)).max() < 1e-5  # stationary, and no optimum
    np.testing.assert_allclose(manifold(problem, ball).x, target, atol=1e-8)


@pytest.mark.parametrize("seed", [26, 55])
def test_a_chart_laid_anew_leads_on(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """To an optimum on the boundary, that one run of scipy does not come near."""
    rng = np.random.default_rng(seed)
    A = np.linalg.qr(rng.normal(size=(PI_SIZE, PI_SIZE)))[0] * np.exp(rng.uniform(-2, 2, PI_SIZE))
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
    for part in problem.pieces:
        own = slice(part.first, part.first + PI_SIZE)
        T[own, own] = parameter_transform(rotation(rng), 0.5 * rng.normal(size=3))
    elsewhere = replace(problem, A=problem.A @ np.linalg.inv(T))
    np.testing.assert_allclose(LOCAL[name](elsewhere, T @ start).x, T @ LOCAL[name](problem, start).x, atol=1e-5)


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("start", ["nothing", "negative mass", "point masses", "friction below its bound"])
def test_a_start_that_no_body_can_have(state: State, name: str, start: str) -> None:
    problem, prior = state("pullback", 1.0, **FRICTION)
    x = LOCAL[name](problem, prior).x
    z = prior.copy()
    bodies = Residuals(problem).bodies
    if start == "nothing":
        z[:] = 0
    elif start == "negative mass":
        z[bodies] *= -1
    elif start == "point masses":
        z[bodies] = LENGTH_POWERS == 0
    else:
        z[problem.other_coefficients] = -1
    np.testing.assert_allclose(LOCAL[name](problem, z).x, x, atol=1e-5)


@pytest.mark.parametrize("weight", [0.0, 1e-12])
def test_a_step_beyond_all_numbers_is_taken_back(weight: float) -> None:
    """A body far off that is to be 10⁴ times as heavy: the first step is e^10⁴ times."""
    far = np.array([500.0, 0, 0])
    A = np.diag([1.0] + [1e-4] * 9)
    target, start = (from_mass_com_inertia(m, far, m * np.eye(3)) for m in (1e4, 1.0))
    term = LogDet(0, pseudo_inertia(np.eye(PI_SIZE)), weight)
    problem = replace(one_body(A, A @ target), log_dets=(term,))
    chart = laid(LogCholesky, pseudo_inertia(start)[None])
    beyond = chart.y.ravel() + 1e4 * (np.arange(PI_SIZE) == 0)
    with np.errstate(all="ignore"):
        assert not np.isfinite(Residuals(problem).value(beyond, chart)).any()
    x = LOCAL["log_cholesky"](problem, start).x
    assert problem.cost(x) < 1e-3 * problem.cost(start)


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("kind", ["none", "semi", "com_ellipsoid", "ellipsoid", "points"])
def test_other_sets_are_refused(robot_of: Callable[[str], Robot], name: str, kind: str) -> None:
    rng = np.random.default_rng(0)
    robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    problem, start = stated(synthetic(rng, robot, 60, bounds(rng, robot)), kind, WEAK_PRIOR, 1.0)
    with pytest.raises(SolverError, match=rf"^solver\.name: {name} supports only constraints: full, but link\d has"):
        LOCAL[name](problem, start)


def test_exact_facts_are_refused_and_others_are_not(state: State) -> None:
    problem, start = state("pullback", 1.0, known={"mass": {"link2": 1}})
    with pytest.raises(SolverError, match=r"^solver\.name: manifold cannot keep known .* standard_error"):
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

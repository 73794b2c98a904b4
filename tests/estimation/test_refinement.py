"""The parameters at the optimum: against cvxpy's at tolerances of 1e-12, and whatever the refinement starts from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from commands import LEG, TRAIN
from numpy.typing import NDArray
from optima import agreed_optimum
from robots import random_urdf
from synthetic import bounds, synthetic

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.conic import Solution, solve_conic
from idtool.estimation.problem.estimate import PARAMETER_TOLERANCE, solve, solve_with_backend, unfinished_note
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.problem.refinement import refine
from idtool.robot.config import Regularization, read_config
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]
Prior = tuple[str, float]
Leg = Callable[[str, Prior], Problem]
Random = Callable[[str], Problem]

SETS = ("none", "semi", "full", "com_ellipsoid", "ellipsoid")
PRIORS: tuple[Prior, ...] = (
    ("euclidean", 1e-6),
    ("euclidean", 1e-3),
    ("euclidean", 1e-2),
    ("pullback", 1e-4),
    ("entropic", 1e-5),
    ("entropic", 1e-2),
)

RANDOM: dict[str, dict[str, Any]] = {
    "centre in one of two ellipsoids": {"set": "com_ellipsoid", "each": 2},
    "union of two": {"set": "ellipsoid", "each": 2, "prior": ("euclidean", 1e-5)},
    "union of two, a firm prior": {"set": "ellipsoid", "each": 2, "prior": ("euclidean", 1e-2)},
    "known centres of mass": {"set": "known_com", "known_com": {"link1": [0.1, 0, 0.05], "link3": [0, 0.02, 0]}},
    "exact masses": {"set": "ellipsoid", "known": {"mass": {"link1": 1.3}}, "prior": ("euclidean", 1e-3)},
    "total mass of unions": {"set": "ellipsoid", "each": 2, "known": {"total_mass": 2.5}},
    "a mass with a standard error": {
        "set": "full",
        "known": {"mass": {"link2": {"value": 1, "standard_error": 0.05}}},
        "prior": ("euclidean", 1e-4),
    },
    "entropic with an exact mass": {"set": "ellipsoid", "prior": ("entropic", 1e-4), "known": {"mass": {"link2": 1}}},
    "pullback": {"set": "full", "prior": ("pullback", 1e-2)},
    "mirrored": {
        "set": "ellipsoid",
        "mirror": [{"body": "link3", "of": "link2", "plane": "xz"}],
        "prior": ("euclidean", 1e-3),
    },
}


@pytest.fixture(scope="module")
def sample() -> tuple[Experiment, Reduction]:
    """The sample leg and its training log."""
    experiment = prepare(read_robot(LEG), read_config(LEG.with_suffix(".yaml")), [TRAIN], holdout=0.0)
    return experiment, experiment.reduce(lambda stage, share: None)


@pytest.fixture
def leg(sample: tuple[Experiment, Reduction]) -> Leg:
    """The sample leg's problem with a set and a prior."""

    def make(name: str, prior: Prior) -> Problem:
        (experiment, reduction), (kind, weight) = sample, prior
        bodies, known = experiment.model.bodies, experiment.equalities
        sets = [choose_set(body, name) for body in bodies]
        noise = free_noise(experiment.equation, reduction, known)
        regularization = Regularization(kind=kind, weight=weight)
        return build_problem(experiment.equation, bodies, reduction, sets, regularization, noise, known)

    return make


@pytest.fixture
def random(robot_of: Callable[[str], Robot]) -> Random:
    """A case's problem of a random robot; the torque is mostly noise, so that the inequalities bite."""

    def make(case: str) -> Problem:
        options = dict(RANDOM[case])
        rng = np.random.default_rng(1)
        robot = robot_of(random_urdf(rng, size=3, kinds=("revolute", "prismatic"), mimic=0, massless=0))
        limits = bounds(rng, robot, options.pop("each", 1))
        name, (kind, weight) = options.pop("set"), options.pop("prior", ("euclidean", 1e-6))
        s = synthetic(rng, robot, 60, {**limits, **options})
        sets = [choose_set(body, name) for body in s.model.bodies]
        sigma, prior = 3 * s.tau.std(axis=1), Regularization(kind=kind, weight=weight)
        return build_problem(s.linear, s.model.bodies, s.reduction(s.noisy(3.0)), sets, prior, sigma, s.equalities)

    return make


def distance(problem: Problem, x: Array, z: Array) -> float:
    """Greatest difference of a parameter, in units of its body's mass and size."""
    return float(np.abs(problem.S @ x - z).max())


@pytest.mark.parametrize("prior", PRIORS, ids=lambda prior: f"{prior[0]} {prior[1]:g}")
@pytest.mark.parametrize("name", SETS)
def test_the_sample_legs_parameters_are_at_the_optimum(leg: Leg, name: str, prior: Prior) -> None:
    problem = leg(name, prior)
    x, certificate = solve(problem)
    assert distance(problem, x, agreed_optimum(problem)) < PARAMETER_TOLERANCE
    assert certificate.parameter_error is not None
    assert certificate.parameter_error < 0.1 * PARAMETER_TOLERANCE


@pytest.mark.parametrize("case", RANDOM)
def test_a_random_robots_parameters_are_at_the_optimum(random: Random, case: str) -> None:
    problem = random(case)
    x, certificate = solve(problem)
    assert distance(problem, x, agreed_optimum(problem)) < PARAMETER_TOLERANCE
    assert certificate.parameter_error is not None
    assert certificate.parameter_error < 0.1 * PARAMETER_TOLERANCE


def test_the_solver_alone_leaves_what_the_prior_holds_unfinished(leg: Leg) -> None:
    """The abad's mass is 1.557 kg at the optimum within the ellipsoids, and 1.501 kg within the semi-consistent set."""
    for name, mass, other in (("ellipsoid", 1.557, 1.579), ("semi", 1.501, 1.547)):
        problem = leg(name, ("euclidean", 1e-6))
        x, _ = solve(problem)
        assert problem.theta(problem.S @ x)[0] == pytest.approx(mass, abs=1e-3)
        alone = problem.theta(problem.S @ of_the_solver(problem).x)[0]
        assert abs(alone - mass) > 0.3 * abs(other - mass)


def of_the_solver(problem: Problem, **settings: Any) -> Solution:
    """What Clarabel returns from far away."""
    ordinary = {"tol_gap_rel": 1e-7, "tol_feas": 1e-8, "equilibrate_enable": False}
    return solve_conic(problem, np.zeros(problem.variables), {**ordinary, **settings})


@pytest.mark.parametrize("name", ["semi", "full", "ellipsoid"])
@pytest.mark.parametrize("prior", [("euclidean", 1e-4), ("entropic", 1e-3)], ids=["euclidean", "entropic"])
def test_a_rough_start_leads_to_the_same_optimum(leg: Leg, name: str, prior: Prior) -> None:
    """The solver cut short, or a first-order method in its place."""
    problem = leg(name, prior)
    z = problem.S @ solve(problem)[0]
    for solution in (of_the_solver(problem), of_the_solver(problem, tol_gap_rel=1e-3, tol_gap_abs=1e-3)):
        refined = refine(problem, solution)
        assert refined is not None
        assert distance(problem, refined.solution.x, z) < PARAMETER_TOLERANCE
    x, certificate = solve_with_backend(problem, "SCS")
    assert certificate.certified
    assert distance(problem, x, z) < PARAMETER_TOLERANCE


@pytest.mark.parametrize("name", ["semi", "ellipsoid"])
def test_bodies_stay_inside_their_sets_and_the_dual_variables_in_the_cones(leg: Leg, name: str) -> None:
    problem = leg(name, ("euclidean", 1e-5))
    refined = refine(problem, of_the_solver(problem))
    assert refined is not None
    solution = refined.solution
    active = 0
    for inequality, Z in zip(problem.inequalities, solution.duals, strict=True):
        assert Z.shape == inequality.G.shape[1:]
        values, duals = (np.linalg.eigvalsh(M) if M.ndim == 2 else M for M in (inequality.value(solution.x), Z))
        assert values.min() > 0.9 * inequality.interior
        assert duals.min() > -1e-15
        active += int(values.min() < 1.1 * inequality.interior)
    assert active > 0
    assert (solution.x[problem.bounded] >= problem.bounds - 1e-12).all()


def test_where_refining_fails_the_solvers_own_optimum_stays_and_it_is_said(
    leg: Leg, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = leg("ellipsoid", ("euclidean", 1e-6))
    _, refined = solve(problem)
    assert not unfinished_note(refined)
    monkeypatch.setattr("idtool.estimation.problem.estimate.refine", lambda problem, solution: None)
    _, certificate = solve(problem)
    assert certificate.certified
    assert certificate.parameter_error is None
    assert "but some parameters are not" in unfinished_note(certificate)


def test_a_method_that_breaks_down_returns_nothing(leg: Leg) -> None:
    problem = leg("full", ("euclidean", 1e-6))
    solution = of_the_solver(problem)
    assert refine(problem, replace(solution, x=np.full_like(solution.x, np.nan))) is None


def test_no_constraint_and_no_bound_leave_least_squares(leg: Leg) -> None:
    """Its closed form."""
    problem = leg("none", ("euclidean", 1e-6))
    problem = replace(problem, lower=np.full_like(problem.lower, -np.inf))
    x, certificate = solve(problem)
    z = np.linalg.lstsq(problem.A, problem.b, rcond=None)[0]
    assert len(z) > PI_SIZE
    np.testing.assert_allclose(problem.S @ x, z, atol=1e-9 * np.abs(z).max())
    assert certificate.certified

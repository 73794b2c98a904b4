"""Solvers by way of cvxpy: the same optimum, and what is said of those that cannot or are not there."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, TRAIN, config_with, idtool
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic

from idtool.common.exceptions import SolverError
from idtool.estimation.problem.certificate import GAP
from idtool.estimation.problem.conic import solve_conic
from idtool.estimation.problem.estimate import PARAMETER_TOLERANCE, Estimate, estimate, solve, solve_with_backend
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.config import Regularization
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Robots = Callable[[str], Robot]


def data(robot_of: Robots, **config: Any) -> Synthetic:
    rng = np.random.default_rng(5)
    robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    return synthetic(rng, robot, 80, {**bounds(rng, robot), **config})


def estimate_of(s: Synthetic, prior: tuple[str, float] = ("euclidean", 1e-4), **options: Any) -> Estimate:
    bodies, (kind, weight) = s.model.bodies, prior
    sets = [choose_set(body, "ellipsoid") for body in bodies]
    regularization = Regularization(kind=kind, weight=weight)
    return estimate(s.linear, bodies, s.reduction(s.noisy(1.0)), sets, regularization, s.equalities, **options)


def problem_of(s: Synthetic, name: str = "ellipsoid") -> Problem:
    bodies, regularization = s.model.bodies, Regularization(kind="euclidean", weight=1e-4)
    sets, sigma = [choose_set(body, name) for body in bodies], s.tau.std(axis=1)
    return build_problem(s.linear, bodies, s.reduction(s.noisy(1.0)), sets, regularization, sigma, s.equalities)


@pytest.mark.parametrize("backend", ["CLARABEL", "SCS"])
@pytest.mark.parametrize("prior", [("euclidean", 1e-4), ("entropic", 1e-2)], ids=["euclidean", "entropic"])
@pytest.mark.parametrize("known", [{}, {"mass": {"link1": 1.3}}], ids=["nothing known", "a mass known"])
def test_every_backend_ends_at_the_same_optimum(
    robot_of: Robots, backend: str, prior: tuple[str, float], known: dict[str, Any]
) -> None:
    s = data(robot_of, known=known)
    ours, theirs = estimate_of(s, prior), estimate_of(s, prior, solver="cvxpy", backend=backend)
    assert theirs.certificate.name == f"cvxpy ({backend})"
    assert theirs.certificate.certified
    scale = ours.problem.scale
    assert np.abs(theirs.theta - ours.theta).max() < 10 * PARAMETER_TOLERANCE * scale.max()
    np.testing.assert_allclose(theirs.problem.S @ theirs.x, ours.problem.S @ ours.x, rtol=0, atol=PARAMETER_TOLERANCE)


def test_a_backend_for_quadratic_programmes_solves_one(robot_of: Robots) -> None:
    """Without matrix inequalities."""
    problem = problem_of(data(robot_of), "none")
    x, certificate = solve_with_backend(problem, "OSQP")
    assert certificate.certified
    np.testing.assert_allclose(problem.S @ x, problem.S @ solve(problem)[0], rtol=0, atol=PARAMETER_TOLERANCE)


def test_a_backend_for_quadratic_programmes_only_is_named_with_those_that_can_more(robot_of: Robots) -> None:
    with pytest.raises(
        SolverError, match=r"^solver\.backend: OSQP does not support matrix inequalities; use .*CLARABEL"
    ):
        solve_with_backend(problem_of(data(robot_of)), "OSQP")


def test_a_first_order_method_that_stops_short_is_refused(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless it can be refined."""
    problem = problem_of(data(robot_of))
    monkeypatch.setattr("idtool.estimation.problem.backends._SETTINGS", {"SCS": {"max_iters": 20}})
    monkeypatch.setattr("idtool.estimation.problem.estimate.refine", lambda problem, solution: None)
    with pytest.raises(SolverError, match=r"not solved accurately enough by cvxpy \(SCS\): relative duality gap \d"):
        solve_with_backend(problem, "SCS")


def test_what_no_parameters_fulfil_is_said(robot_of: Robots) -> None:
    s = data(robot_of, known={"mass": {"link1": 3, "link2": 2}, "total_mass": 4})
    with pytest.raises(
        SolverError, match=r"^solver: found no parameters that satisfy the constraints and the exactly known"
    ):
        estimate_of(s, solver="cvxpy")


def test_numbers_that_are_none_are_refused(robot_of: Robots) -> None:
    problem = problem_of(data(robot_of))
    with pytest.raises(SolverError, match="not finite"):
        solve_with_backend(replace(problem, b=np.full_like(problem.b, np.nan)), "CLARABEL")


def test_where_clarabel_fails_cvxpy_takes_over(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    s = data(robot_of)
    ours = estimate_of(s)

    def fails(*_: Any) -> None:
        raise SolverError("solver", "failed on these numbers")

    monkeypatch.setattr("idtool.estimation.problem.estimate.solve_conic", fails)
    theirs = estimate_of(s)
    assert theirs.certificate.name == "cvxpy (CLARABEL)"
    assert abs(theirs.certificate.duality_gap) < GAP
    np.testing.assert_allclose(theirs.problem.S @ theirs.x, ours.problem.S @ ours.x, rtol=0, atol=PARAMETER_TOLERANCE)


def test_an_infeasible_problem_is_not_tried_again(robot_of: Robots, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr("idtool.estimation.problem.estimate.solve_with_backend", never)
    with pytest.raises(SolverError, match="found no parameters"):
        estimate_of(data(robot_of, known={"mass": {"link1": 3, "link2": 2}, "total_mass": 4}))


def test_a_fallback_is_said_in_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def fails(problem: Problem, start: Any, settings: Any) -> Any:
        calls.append(problem)
        if len(calls) <= 4:  # the attempts at the fit itself
            raise SolverError("solver", "failed on these numbers")
        return solve_conic(problem, start, settings)

    monkeypatch.setattr("idtool.estimation.problem.estimate.solve_conic", fails)
    done = idtool("fit", LEG, TRAIN, "--quick", "--no-simulation", "--out", tmp_path, "--json")
    assert done.code == 0
    assert done.json["solver"]["name"] == "cvxpy (CLARABEL)"
    assert any("Clarabel could not solve the problem" in warning for warning in done.json["warnings"])


@pytest.mark.parametrize("backend", ["MOSEK", "no such solver", "OSQP"])
def test_a_backend_that_cannot_be_used_is_one_line(tmp_path: Path, backend: str) -> None:
    solver = {"name": "cvxpy", "backend": backend}
    config = config_with(tmp_path / "leg.yaml", LEG.with_suffix(".yaml"), solver=solver)
    done = idtool("fit", LEG, TRAIN, "--config", config, "--out", tmp_path / "out", "--quiet")
    assert done.code == 2
    (said,) = done.err.splitlines()
    assert said.startswith("error: solver.backend: ")
    assert backend in said
    assert "CLARABEL" in said
    assert not (tmp_path / "out").exists()


def test_cvxpy_is_imported_where_it_is_asked_for() -> None:
    """It takes a second."""
    script = "import sys, idtool.estimation.fit, idtool.estimation.problem.backends; print('cvxpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"]

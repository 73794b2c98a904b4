"""Time of the ranges of all inertia parameters, compared with two programmes for each in cvxpy.

Run ``python benchmarks/parameter_ranges.py``. Both find the least and the greatest value of the sample leg's
parameters, with all bodies on their ellipsoids, among all that cost at most 1 % more than the optimum. cvxpy is asked
about every sixth parameter, and its time is multiplied by six; its programme is compiled once, before.
"""

from __future__ import annotations

import time

import cvxpy as cp
import numpy as np
import sample_leg
from comparison import Comparison, from_times, version_text
from numpy.typing import NDArray
from reduced_solve import reduced_log

from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.estimation.uncertainty.ranges import ABOVE, ranges
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE

Array = NDArray[np.float64]

REPETITIONS = 3
EVERY = 6  # how many parameters there are for one that cvxpy is asked about
PRIOR = Regularization(kind="entropic", weight=0.01)
SETTINGS = {"tol_gap_abs": 1e-6, "tol_gap_rel": 1e-5, "tol_feas": 1e-7}


class Programme:
    """Minimum of row · z among all z that the constraints allow at a cost up to a level."""

    def __init__(self, problem: Problem, level: float) -> None:
        x = cp.Variable(problem.variables)
        self.row = cp.Parameter(len(problem.scale))
        z = problem.S @ x
        cost = cp.sum_squares(problem.A @ z - problem.b) + problem.constant
        for term in problem.log_dets:
            X = sum(z[term.first + i] * G for i, G in enumerate(term.G))
            cost += term.weight * (cp.trace(X) - cp.log_det(X) - len(term.G[0]))
        limits = [cost <= level, x[problem.bounded] >= problem.bounds]
        for inequality in problem.inequalities:
            value = sum(x[inequality.first + i] * G for i, G in enumerate(inequality.G))
            is_matrix = inequality.G.ndim == 3
            limits.append(value >> 0 if is_matrix else value >= 0)
        self.programme = cp.Problem(cp.Minimize(self.row @ z), limits)

    def range(self, index: int) -> list[float]:
        """Least and greatest value of z[index]."""
        ends = []
        for sign in (1.0, -1.0):
            self.row.value = sign * np.eye(self.row.size)[index]
            ends.append(sign * float(self.programme.solve(solver=cp.CLARABEL, **SETTINGS)))
        return ends


def comparison() -> Comparison:
    """Find the ranges by turns, and compare those that both have found."""
    experiment = sample_leg.leg_experiment()
    equation, bodies = experiment.equation, experiment.model.bodies
    reduction = reduced_log(experiment)
    sets = choose_sets(bodies, "ellipsoid")
    problem = build_problem(equation, bodies, reduction, sets, PRIOR, free_noise(equation, reduction))
    x = solve(problem)[0]
    wanted = np.arange(PI_SIZE * len(bodies))
    programme = Programme(problem, problem.cost(problem.S @ x) * (1 + ABOVE))
    programme.range(0)

    pairs = []
    for _ in range(REPETITIONS):
        started = time.perf_counter()
        found = ranges(problem, x, wanted, lambda share: None) / problem.scale[wanted, None]
        ours = time.perf_counter() - started
        started = time.perf_counter()
        expected = np.array([programme.range(k) for k in wanted[::EVERY].tolist()])
        pairs.append((ours, EVERY * (time.perf_counter() - started)))
    deviation = np.abs(found[::EVERY] - expected) / np.diff(expected, axis=1)
    task = f"ranges of {len(wanted)} parameters of the leg's bodies"
    return from_times(
        task,
        version_text("cvxpy", "clarabel"),
        pairs,
        {"largest deviation, relative to the range": float(deviation.max())},
    )


if __name__ == "__main__":
    print(comparison())

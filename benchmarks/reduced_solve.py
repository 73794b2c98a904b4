"""Time of the identification from R-factors, compared with the same problem with every sample in the solver.

Run ``python benchmarks/reduced_solve.py``. Both are problem (27) of the leg with all bodies on their ellipsoids, in the
same variables and units, solved by Clarabel with the same settings. One has the rows of all samples, filtered and not
decimated, and is stated in cvxpy. The other, `estimate.solve`, has their triangular factor. The latter's time includes
its certificate and, in the last ratio, the reduction of the log to the factor; the former's starts from the rows.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import sample_leg
from numpy.typing import NDArray

from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.dataset.reduction import Factor, Reduction, empty, reduce_blocks
from idtool.estimation.dataset.weights import free_noise, weighted_rows
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.estimate import _SETTINGS, solve
from idtool.estimation.problem.prior import prior_rows
from idtool.estimation.problem.problem import _LEAST_WEIGHT, Problem, build_problem

Array = NDArray[np.float64]

REPETITIONS = 3


def blocks(experiment: Experiment) -> list[list[Array]]:
    """Filtered columns and torque at every sample, batch after batch and joint after joint."""
    (run,) = experiment.runs
    return [experiment.equation.block(batch) for batch in run.signals.batches(run.train, every_sample=True)]


def reduced_log(experiment: Experiment) -> Reduction:
    """R-factors of the log."""
    return reduce_blocks(blocks(experiment), empty(experiment.equation.active()))


def problem_and_rows(experiment: Experiment) -> tuple[Problem, Array, Array]:
    """The problem on R-factors, and A and b of the same cost ‖A S x − b‖² from the rows of all samples."""
    equation, bodies = experiment.equation, experiment.model.bodies
    regularization = experiment.config.regularization.fixed_or_weak()
    reduction = reduced_log(experiment)
    sets, _ = choose_sets(bodies, "ellipsoid")
    noise = free_noise(equation, reduction)
    problem = build_problem(equation, bodies, reduction, sets, regularization, noise)

    all_rows = []
    for joint_blocks in zip(*blocks(experiment), strict=True):
        joint_rows = np.concatenate(joint_blocks, axis=1).T
        all_rows.append(Factor(joint_rows, len(joint_rows), len(joint_rows)))
    sample_rows = weighted_rows(equation, tuple(all_rows), noise)
    inertial = np.flatnonzero([c.scale is not None for c in equation.coefficients])
    weak = np.sqrt(_LEAST_WEIGHT) * np.eye(len(problem.scale))[inertial] / problem.scale
    weak_prior = np.column_stack([weak, weak @ equation.prior])
    prior = prior_rows(equation, bodies, regularization, problem.scale)
    rows = np.concatenate([sample_rows, prior, weak_prior])
    return problem, rows[:, :-1] * problem.scale, rows[:, -1]


def solve_rows(problem: Problem, A: Array, b: Array) -> Array:
    """The optimum with the cost ‖A S x − b‖² in place of the problem's own."""
    x = cp.Variable(problem.variables)
    constraints = [x[problem.bounded] >= problem.bounds]
    for inequality in problem.inequalities:
        n = inequality.G.shape[-1]
        value = inequality.G.reshape(len(inequality.G), -1).T @ x[inequality.x_slice]
        if inequality.G.ndim == 2:
            constraints.append(value >= inequality.interior)
        else:
            constraints.append(cp.reshape(value, (n, n), order="C") - inequality.interior * np.eye(n) >> 0)
    program = cp.Problem(cp.Minimize(cp.sum_squares((A @ problem.S) @ x - b)), constraints)
    program.solve(solver=cp.CLARABEL, **_SETTINGS)
    return np.asarray(x.value)


def main() -> None:
    """Check that the optima are equal, solve in turn and print the ratios."""
    experiment = sample_leg.leg_experiment()
    problem, A, b = problem_and_rows(experiment)
    cost = problem.cost(problem.S @ solve(problem)[0])
    cost_from_rows = problem.cost(problem.S @ solve_rows(problem, A, b))
    assert abs(cost_from_rows / cost - 1) < 1e-5
    ours, theirs, reduction = sample_leg.median_times(
        REPETITIONS, lambda: solve(problem), lambda: solve_rows(problem, A, b), lambda: reduced_log(experiment)
    )
    print(
        f"{len(b)} rows {theirs:.2f} s, their factor {ours * 1e3:.1f} ms: ratio {theirs / ours:.0f}; "
        f"with the reduction of the log, {reduction * 1e3:.0f} ms: {theirs / (ours + reduction):.0f}"
    )


if __name__ == "__main__":
    main()

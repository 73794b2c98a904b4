"""The identification on R-factors against the same problem with every sample in the solver.

Run ``python benchmarks/reduced_solve.py``. Both are problem (27) of the leg with all bodies on their ellipsoids, in the
same variables and units, by Clarabel with the same settings. One has the rows of all samples, filtered and not
decimated, and is stated in cvxpy; the other, `estimate.solve`, has their triangular factor. The latter's time includes
its certificate, and in the last ratio the way from the log to the factor, of which the rows are spared.
"""

from __future__ import annotations

import cvxpy as cp
import leg
import numpy as np
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


def reduced(experiment: Experiment) -> Reduction:
    """The log's factors."""
    return reduce_blocks(blocks(experiment), empty(experiment.equation.active()))


def stated(experiment: Experiment) -> tuple[Problem, Array, Array]:
    """The problem on factors, and A and b of the same problem with all rows: the samples' and the prior's."""
    equation, bodies, regularization = experiment.equation, experiment.model.bodies, experiment.config.regularization
    factors = reduced(experiment)
    sets, _ = choose_sets(bodies, "ellipsoid")
    noise = free_noise(equation, factors)
    problem = build_problem(equation, bodies, factors, sets, regularization, noise)
    stacked = (np.concatenate(joint, axis=1).T for joint in zip(*blocks(experiment), strict=True))
    whole = tuple(Factor(rows, len(rows), len(rows)) for rows in stacked)
    held = np.flatnonzero([c.scale is not None for c in equation.coefficients])
    least = np.sqrt(_LEAST_WEIGHT) * np.eye(len(problem.scale))[held] / problem.scale
    pull = np.column_stack([least, least @ equation.prior])
    prior = prior_rows(equation, bodies, regularization, problem.scale)
    rows = np.concatenate([weighted_rows(equation, whole, noise), prior, pull])
    return problem, rows[:, :-1] * problem.scale, rows[:, -1]


def solve_rows(problem: Problem, A: Array, b: Array) -> Array:
    """The optimum with the cost ‖A S x − b‖² in place of the problem's own."""
    x = cp.Variable(problem.variables)
    constraints = [x[problem.bounded] >= problem.bounds]
    for limit in problem.inequalities:
        n = limit.G.shape[-1]
        value = limit.G.reshape(len(limit.G), -1).T @ x[limit.x_slice]
        if limit.G.ndim == 2:
            constraints.append(value >= limit.interior)
        else:
            constraints.append(cp.reshape(value, (n, n), order="C") - limit.interior * np.eye(n) >> 0)
    program = cp.Problem(cp.Minimize(cp.sum_squares((A @ problem.S) @ x - b)), constraints)
    program.solve(solver=cp.CLARABEL, **_SETTINGS)
    return np.asarray(x.value)


def main() -> None:
    """Check that the optima are equal, solve by turns and print the ratios."""
    experiment = leg.experiment()
    problem, A, b = stated(experiment)
    least, other = (problem.cost(problem.S @ x) for x in (solve(problem)[0], solve_rows(problem, A, b)))
    assert abs(other / least - 1) < 1e-5
    ours, theirs, reduction = leg.medians(
        REPETITIONS, lambda: solve(problem), lambda: solve_rows(problem, A, b), lambda: reduced(experiment)
    )
    print(
        f"{len(b)} rows {theirs:.2f} s, their factor {ours * 1e3:.1f} ms: ratio {theirs / ours:.0f}; "
        f"with the reduction of the log, {reduction * 1e3:.0f} ms: {theirs / (ours + reduction):.0f}"
    )


if __name__ == "__main__":
    main()

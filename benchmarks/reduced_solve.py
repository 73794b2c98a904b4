"""The identification on R-factors against the same problem with every sample in the solver.

Run ``python benchmarks/reduced_solve.py``. Both are problem (27) of the leg with all bodies on their ellipsoids, in the
same variables and units, by cvxpy and Clarabel with the same settings. One has the rows of all samples, filtered and
not decimated; the other, `identify.solve`, their triangular factor. The latter's time includes its certificate, and in
the last ratio the way from the log to the factor, of which the rows are spared.
"""

from __future__ import annotations

import cvxpy as cp
import leg
import numpy as np
from numpy.typing import NDArray

from idtool.experiment import Experiment
from idtool.fit import choose_sets
from idtool.identify import _SETTINGS, solve
from idtool.inertia import SIZE
from idtool.problem import INTERIOR, Problem, build_problem, free_noise, weighted_rows
from idtool.reduction import Factor, Reduction, empty, reduce_blocks

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
    equation, bodies = experiment.equation, experiment.model.bodies
    factors = reduced(experiment)
    sets, _ = choose_sets(bodies, "ellipsoid")
    noise = free_noise(equation, factors)
    problem, prior = (
        build_problem(equation, bodies, data, sets, experiment.config.regularization, noise)
        for data in (factors, empty(equation.active()))
    )
    stacked = (np.concatenate(joint, axis=1).T for joint in zip(*blocks(experiment), strict=True))
    whole = tuple(Factor(rows, len(rows), len(rows)) for rows in stacked)
    rows = weighted_rows(equation, whole, noise)
    A = np.concatenate([rows[:, :-1] * problem.scale, prior.A * (problem.scale / prior.scale)])
    return problem, A, np.concatenate([rows[:, -1], prior.b])


def solve_rows(problem: Problem, A: Array, b: Array) -> Array:
    """The optimum with the cost ‖A S x − b‖² in place of the problem's own."""
    x = cp.Variable(problem.S.shape[1])
    constraints = [x[problem.bounded] >= problem.bounds]
    for matrix in problem.inequalities:
        n = matrix.G.shape[-1]
        value = matrix.G.reshape(SIZE, -1).T @ x[matrix.first : matrix.first + SIZE]
        constraints.append(cp.reshape(value, (n, n), order="C") - INTERIOR * np.eye(n) >> 0)
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

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
from comparison import Comparison, compare, version_text
from motion_samples import optimum_difference
from numpy.typing import NDArray

from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.dataset.reduction import Reduction, empty, reduce_blocks
from idtool.estimation.dataset.weights import free_noise
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
    sets = choose_sets(bodies, "ellipsoid")
    noise = free_noise(equation, reduction)
    problem = build_problem(equation, bodies, reduction, sets, regularization, noise)

    p = len(equation.coefficients)
    samples = sum(factor.rows for factor in reduction) / len(reduction)
    sample_rows = []
    for sigma, active, *joint_blocks in zip(noise, equation.active(), *blocks(experiment), strict=True):
        columns = np.concatenate(joint_blocks, axis=1)
        joint_rows = np.zeros((columns.shape[1], p + 1))
        joint_rows[:, [*active, p]] = columns.T / (sigma * np.sqrt(samples))
        sample_rows.append(joint_rows)
    sample_rows.append(prior_of(experiment, problem.scale))
    rows = np.concatenate(sample_rows)
    return problem, rows[:, :-1] * problem.scale, rows[:, -1]


def prior_of(experiment: Experiment, units: Array) -> Array:
    """Rows of the weak prior, in which a problem of these units has the same cost; shape (rows, p + 1)."""
    equation, bodies = experiment.equation, experiment.model.bodies
    weak = np.diag(np.sqrt(_LEAST_WEIGHT) / units)
    regularization = experiment.config.regularization.fixed_or_weak()
    prior = prior_rows(equation, bodies, regularization, units)
    return np.concatenate([prior, np.column_stack([weak, weak @ equation.prior])])


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


def comparisons() -> list[Comparison]:
    """Check that the optima are equal, and solve by turns: from the factors, and from the log with its reduction."""
    experiment = sample_leg.leg_experiment()
    problem, A, b = problem_and_rows(experiment)
    x = solve(problem)[0]
    x_from_rows = solve_rows(problem, A, b)
    agreement = optimum_difference(problem, problem.S @ x_from_rows, problem.S @ x)
    assert abs(agreement["relative cost"]) < 1e-5
    peer = f"{version_text('cvxpy', 'clarabel')}, {len(b)} rows"

    def reduce_and_solve() -> None:
        reduced_log(experiment)
        solve(problem)

    from_factors = compare(
        "identification within ellipsoids from R-factors, leg of 6 bodies",
        peer,
        lambda: solve(problem),
        lambda: solve_rows(problem, A, b),
        REPETITIONS,
        agreement,
        "The time of idtool includes its certificate. It does not include the regressor and the R-factors.",
    )
    from_log = compare(
        "identification within ellipsoids from a log of 10 s, leg of 6 bodies",
        peer,
        reduce_and_solve,
        lambda: solve_rows(problem, A, b),
        REPETITIONS,
        agreement,
        "The time of idtool includes regressor, R-factors and certificate. That of cvxpy starts from the rows.",
    )
    return [from_factors, from_log]


def main() -> None:
    """Print the ratios."""
    for comparison in comparisons():
        print(comparison)


if __name__ == "__main__":
    main()

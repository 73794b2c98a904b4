"""The identification on R-factors against the same problem with every sample in the solver.

Run ``python benchmarks/reduced_solve.py``. Both are problem (27) of the leg with all bodies on their ellipsoids, in the
same variables and units, and go through `identify.solve`: cvxpy and Clarabel with the same settings. One has the rows
of all samples, filtered and not decimated; the other their triangular factor. Counted is cvxpy and the solver; for the
factor also its certificate, and in the last ratio the way from the log to the factor, of which the rows are spared.
"""

from __future__ import annotations

from dataclasses import replace

import leg
import numpy as np
from numpy.typing import NDArray

from idtool.experiment import Experiment
from idtool.fit import choose_sets
from idtool.identify import solve
from idtool.problem import Problem, build_problem, free_noise, weighted_rows
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


def problems(experiment: Experiment) -> tuple[Problem, Problem]:
    """The problem on factors, and the same with all rows."""
    equation, bodies = experiment.equation, experiment.model.bodies
    factors = reduced(experiment)
    sets, _ = choose_sets(bodies, "ellipsoid")
    noise = free_noise(equation, factors)
    small, prior = (
        build_problem(equation, bodies, data, sets, experiment.config.regularization, noise)
        for data in (factors, empty(equation.active()))
    )
    stacked = (np.concatenate(joint, axis=1).T for joint in zip(*blocks(experiment), strict=True))
    whole = tuple(Factor(rows, len(rows), len(rows)) for rows in stacked)
    rows = weighted_rows(equation, whole, noise)
    A = np.concatenate([rows[:, :-1] * small.scale, prior.A * (small.scale / prior.scale)])
    b = np.concatenate([rows[:, -1], prior.b])
    return small, replace(small, A=A, b=b, constant=prior.constant)


def main() -> None:
    """Solve both by turns and print the ratios."""
    experiment = leg.experiment()
    small, large = problems(experiment)
    solver: list[float] = []

    def solve_large() -> None:
        x, certificate = solve(large)
        solver.append(certificate.seconds)
        optimum = small.cost(small.S @ solve(small)[0])
        assert abs(large.cost(large.S @ x) / optimum - 1) < 1e-5

    ours, reduction, _ = leg.medians(REPETITIONS, lambda: solve(small), lambda: reduced(experiment), solve_large)
    theirs = float(np.median(solver))
    print(
        f"{len(large.b)} rows {theirs:.2f} s, their factor {ours * 1e3:.1f} ms: ratio {theirs / ours:.0f}; "
        f"with the reduction of the log, {reduction * 1e3:.0f} ms: {theirs / (ours + reduction):.0f}"
    )


if __name__ == "__main__":
    main()

"""The validation error against the number of training samples, for several constraint sets: the paper's Fig. 5.

Samples of all logs are in a pool of bounded size, and a draw of n samples is the R-factor of n of them, merged from
that of fewer. Samples are drawn, not blocks of time: neighbouring samples repeat each other, so that a block
would have to be very short for less data than parameters, where the sets differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import SolverError
from idtool.common.processes import shared_among_processes
from idtool.estimation.dataset.blocks import merge_reductions
from idtool.estimation.dataset.drawn_rows import DrawnRows, log_identity, row_keys
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
from idtool.estimation.dataset.reduced_logs import ReducedLog, drawn_training_rows, training_blocks
from idtool.estimation.dataset.reduction import Factor, Reduction, empty, merge
from idtool.estimation.evaluation.held_out_offsets import held_out_offsets, with_further_effects
from idtool.estimation.evaluation.torque_errors import overall_rms
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem
from idtool.robot.inertia import PI_SIZE, smallest_eigenvalue

_POOL = 4096  # samples that draws are made from, at random from all: a log of any length fits into memory
_POOL_NUMBERS = 1 << 25  # largest count of numbers in their rows: with contacts, every row has all columns
_FEW_SAMPLES_FACTOR = 4  # times as many draws of few samples
_STEPS = (1, 3)  # times a power of ten: the counts


@dataclass(frozen=True)
class StudyData:
    """The data of a study.

    Attributes
    ----------
    total
        R-factors of all training data.
    pool
        Samples of them to draw from.
    validation
        R-factors of the held-out data, every sample counting for every joint that is compared in its log.
    """

    total: Reduction
    pool: DrawnRows
    validation: Reduction


@dataclass(frozen=True)
class Curve:
    """Learning curve of a constraint set: figures for each count of samples, shape (counts,), over the draws.

    Attributes
    ----------
    median, lower, upper
        Median and quartiles of the RMS validation error over all joints [N·m or N].
    violation
        Median of the worst body's violation of realizability: the least eigenvalue of its pseudo-inertia, in units of
        its typical mass and size, where that is negative.
    advantage, advantage_error
        Mean over the draws of log(error of the first set / this set's), both from the same samples, and its standard
        error: pairs show what the spread of the draws hides. NaN where less than two draws were solved.
    unsolved
        Number of draws that the solver gave up on.
    """

    median: Array
    lower: Array
    upper: Array
    violation: Array
    advantage: Array
    advantage_error: Array
    unsolved: int


def read_data(experiment: Experiment, progress: Progress) -> StudyData:
    """The data of a study from logs that cannot be reduced once for all models; two passes over the logs.

    Raises
    ------
    LogError
        If nothing is left to fit a joint to.
    """
    total, pool = gather(experiment, progress)
    return StudyData(total, pool, held_out(experiment, progress))


def reduced_data(experiment: Experiment, logs: Sequence[ReducedLog]) -> StudyData:
    """The data of a study from reduced logs, from which rows were drawn.

    Raises
    ------
    LogError
        If nothing is left to fit a joint to.
    """
    total = merge_reductions([log.total for log in training_blocks(experiment, logs)])
    nothing = empty(experiment.equation.active())
    validation = nothing
    for log in logs:
        for part in log.held_out:
            compared = list(nothing)
            for joint in np.flatnonzero(part.is_compared):
                compared[joint] = part.comparison[joint].without_last_column()
            validation = merge(validation, tuple(compared))
    return StudyData(total, drawn_training_rows(experiment, logs), validation)


def gather(experiment: Experiment, progress: Progress) -> tuple[Reduction, DrawnRows]:
    """The training data as R-factors, and samples drawn from it at random; one pass over the logs.

    Raises
    ------
    LogError
        If nothing is left to fit a joint to.
    """
    active = experiment.equation.active()
    total = empty(active)
    pool = DrawnRows.empty(active)
    numbers_per_sample = sum(factor.R.shape[1] for factor in total)
    size = min(_POOL, max(_POOL_NUMBERS // numbers_per_sample, 1))
    for run in experiment.runs:
        name = run.signals.log.path.name
        identity = log_identity(run.signals.log)
        worth = 1 / run.signals.low_pass.redundancy
        row = 0
        for batch in tracked(run.signals.batches(run.train), run.train, progress, f"reading {name}"):
            rows, shares = experiment.equation.counted_rows(batch)
            count = rows[0].shape[1]
            pairs = zip(rows, shares, strict=True)
            factors = [Factor.from_shares(own, share.astype(float), 1 / worth) for own, share in pairs]
            total = merge(total, tuple(factors))
            pool = pool.with_rows(rows, shares, worth, row_keys(identity, row, count), size)
            row += count
    experiment.checked(total)
    return total, pool


def held_out(experiment: Experiment, progress: Progress) -> Reduction:
    """The held-out data as R-factors, every sample counting for every joint that is compared in its log."""
    equation = experiment.equation
    total = empty(equation.active())
    for run in experiment.runs:
        extended = with_further_effects(equation, held_out_offsets(experiment, run))
        of_log = empty(extended.active())
        is_compared = np.zeros(len(equation.joints), dtype=bool)
        for batch in tracked(run.signals.batches(run.held_out), run.held_out, progress, "reading held-out data"):
            row_filter = equation.row_filter(batch)
            blocks = extended.filtered_columns(batch, row_filter)
            of_log = merge(of_log, tuple(Factor.from_columns(block) for block in blocks))
            is_compared |= equation.compared_rows(batch, row_filter)
        further = [np.flatnonzero(active >= len(equation.coefficients)) for active in extended.active()]
        of_log = tuple(factor.without_columns(columns) for factor, columns in zip(of_log, further, strict=True))
        compared = list(empty(equation.active()))
        for row in np.flatnonzero(is_compared):
            compared[row] = of_log[row]
        total = merge(total, tuple(compared))
    return total


def counts(samples: int) -> list[int]:
    """Sample counts 1, 3, 10, 30, … up to the number of samples, and that number."""
    steps = []
    for power in range(len(str(samples))):
        steps += [step * 10**power for step in _STEPS]
    return [*(count for count in steps if count < samples), samples]


def learn(
    data: StudyData,
    active: Sequence[Indices],
    problem_of: dict[str, Callable[[Reduction], Problem]],
    draws: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[int], dict[str, Curve]]:
    """The curves of several constraint sets, all from the same draws.

    Parameters
    ----------
    data
        The data. Of a draw, the samples of a smaller count are among those of a larger one. A curve ends with all
        training data.
    active
        Per joint, its coefficients.
    problem_of
        By set, function that builds the problem from a reduction.
    draws
        Number of draws; four times as many where there are fewer samples than parameters, where errors spread widely.
    rng
        Source of the draws.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    The counts of samples, and a curve a set.
    """
    pool = data.pool
    steps = counts(len(pool))
    few = sum(count < int(np.max(np.concatenate(active))) for count in steps)
    total_draws = _FEW_SAMPLES_FACTOR * draws
    orders = [rng.permutation(steps[-1]) for _ in range(total_draws)]

    def outcomes(draw: int, progress: Progress) -> Array:
        """Outcomes of each set with more and more samples of a draw, shape (sets, counts, 2)."""
        results = np.full((len(problem_of), len(steps), 2), np.nan)
        drawn, first = empty(active), 0
        for k, count in enumerate(steps[: few if draw >= draws else None]):
            drawn, first = merge(drawn, pool.reduction(orders[draw][first:count])), count
            for result, build in zip(results, problem_of.values(), strict=True):
                result[k] = _outcome(build(drawn), data.validation, active)
        progress("drawing samples", (draw + 1) / total_draws)
        return results

    by_draw = np.stack(shared_among_processes(outcomes, range(total_draws), progress))
    curves = {}
    for i, name in enumerate(problem_of):
        curves[name] = [by_draw[: total_draws if k < few else draws, i, k] for k in range(len(steps))]
    if not pool.are_all:
        steps = [*steps, pool.drawn_from]
        for name, build in problem_of.items():
            curves[name].append(np.array([_outcome(build(data.total), data.validation, active)]))
    first_set = next(iter(curves.values()))
    return steps, {name: _curve(columns, first_set) for name, columns in curves.items()}


def _outcome(problem: Problem, validation: Reduction, active: Sequence[Indices]) -> tuple[float, float]:
    """RMS validation error over all joints, and the worst violation of realizability; NaN where not solved."""
    try:
        x, _ = solve(problem)
    except SolverError:
        return np.nan, np.nan
    z = problem.S @ x
    return rms(validation, active, problem.theta(z))[-1], violation(problem, z)


def rms(data: Reduction, active: Sequence[Indices], theta: Array) -> Array:
    """Root mean square of each joint's residual, and over all of them, shape (nv + 1,) [N·m or N].

    It is NaN for a joint without data, which is left out of the last one.
    """
    by_joint = []
    for factor, columns in zip(data, active, strict=True):
        mean_square = factor.squared_error(theta[columns]) / factor.rows if factor.rows else np.nan
        by_joint.append(float(np.sqrt(mean_square)))
    return np.array([*by_joint, overall_rms(by_joint)])


def violation(problem: Problem, z: Array) -> float:
    """Distance of the worst body from full consistency, in units of its typical mass and size; 0 if there is none."""
    inertial = np.setdiff1d(np.arange(len(z)), problem.other_coefficients)
    least = smallest_eigenvalue(z[inertial].reshape(-1, PI_SIZE))
    return max(-float(least.min()), 0.0)


def _curve(columns: Sequence[Array], first: Sequence[Array]) -> Curve:
    """The curve of errors and violations of a set beside those of the first one, shape (draws, 2) for each count."""
    solved = [column[~np.isnan(column[:, 0])] for column in columns]
    quartiles = [np.quantile(c[:, 0], [0.25, 0.5, 0.75]) if len(c) else np.full(3, np.nan) for c in solved]
    lower, median, upper = np.transpose(quartiles)
    worst = np.array([np.median(c[:, 1]) if len(c) else np.nan for c in solved])
    advantage, error = np.full((2, len(columns)), np.nan)
    for k, (own, other) in enumerate(zip(columns, first, strict=True)):
        ratio = np.log(other[:, 0] / own[:, 0])
        ratio = ratio[~np.isnan(ratio)]
        if len(ratio) > 1:
            advantage[k], error[k] = ratio.mean(), ratio.std(ddof=1) / np.sqrt(len(ratio))
    unsolved = sum(len(c) - len(s) for c, s in zip(columns, solved, strict=True))
    return Curve(median, lower, upper, worst, advantage, error, unsolved)

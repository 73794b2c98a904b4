"""The validation error against the number of training samples, for several constraint sets: the paper's Fig. 5.

The log is read once: its samples' rows go into a pool of bounded size, and a draw of n samples is the R-factor of n of
them, merged from that of fewer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import SolverError
from idtool.common.processes import shared_among_processes
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
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
class Pool:
    """Rows of single samples.

    Attributes
    ----------
    blocks
        Per joint, columns and torque in the band, shape (m_j + 1, samples).
    shares
        Per joint, the share of each sample that counts, from 0 to 1, shape (samples,).
    worth
        Number of independent samples that each is worth, shape (samples,).
    drawn_from
        Number of samples that these were drawn from; None: these are all.
    """

    blocks: list[Array]
    shares: list[Array]
    worth: Array
    drawn_from: int | None = None

    def reduction(self, chosen: Indices) -> Reduction:
        """The R-factors of some of the samples."""
        factors = []
        for block, shares in zip(self.blocks, self.shares, strict=True):
            own = shares[chosen]
            factor = Factor.from_shares(block[:, chosen], own)
            factors.append(replace(factor, independent=float(self.worth[chosen] @ own)))
        return tuple(factors)


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


def gather(experiment: Experiment, rng: np.random.Generator, progress: Progress) -> tuple[Reduction, Pool]:
    """The training data as R-factors, and samples drawn from it at random; one pass over the logs.

    Raises
    ------
    LogError
        If nothing is left to fit a joint to.
    """
    total = empty(experiment.equation.active())
    pool: Pool | None = None
    keys, samples = np.zeros(0), 0
    numbers_per_sample = sum(factor.R.shape[1] for factor in total)
    size = min(_POOL, max(_POOL_NUMBERS // numbers_per_sample, 1))
    for run in experiment.runs:
        stage = f"reading {run.signals.log.path.name}"
        for batch in tracked(run.signals.batches(run.train), run.train, progress, stage):
            blocks, counted = experiment.equation.counted_rows(batch)
            shares = [share.astype(float) for share in counted]
            indices = np.arange(blocks[0].shape[1])
            worth = np.full(len(indices), 1 / run.signals.low_pass.redundancy)
            new = Pool(blocks, shares, worth)
            total = merge(total, new.reduction(indices))
            samples += len(indices)
            # Every sample draws a random key; the pool is those with the least ones.
            keys = np.concatenate([keys, rng.random(len(indices))])
            if pool is not None:
                blocks = [np.concatenate(pair, axis=1) for pair in zip(pool.blocks, blocks, strict=True)]
                shares = [np.concatenate(pair) for pair in zip(pool.shares, shares, strict=True)]
                worth = np.concatenate([pool.worth, worth])
            least = np.argsort(keys)[:size]
            keys = keys[least]
            pool = Pool(
                blocks=[block[:, least] for block in blocks],
                shares=[share[least] for share in shares],
                worth=worth[least],
                drawn_from=samples if samples > size else None,
            )
    experiment.checked(total)
    if pool is None:
        raise AssertionError  # ruled out by the check
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
    pool: Pool,
    total: Reduction,
    validation: Reduction,
    active: Sequence[Indices],
    problem_of: dict[str, Callable[[Reduction], Problem]],
    draws: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[int], dict[str, Curve]]:
    """The curves of several constraint sets, all from the same draws.

    Parameters
    ----------
    pool
        Samples to draw from, each draw's larger counts around its smaller ones.
    total
        All training data, at the end of each curve.
    validation
        The data that the error is on.
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
    steps = counts(pool.blocks[0].shape[1])
    few = sum(count < int(np.max(np.concatenate(active))) for count in steps)
    total_draws = _FEW_SAMPLES_FACTOR * draws
    orders = [rng.permutation(steps[-1]) for _ in range(total_draws)]

    def outcomes(draw: int, progress: Progress) -> Array:
        """Outcomes of each set with more and more samples of a draw, shape (sets, counts, 2)."""
        results = np.full((len(problem_of), len(steps), 2), np.nan)
        data, first = empty(active), 0
        for k, count in enumerate(steps[: few if draw >= draws else None]):
            data, first = merge(data, pool.reduction(orders[draw][first:count])), count
            for result, build in zip(results, problem_of.values(), strict=True):
                result[k] = _outcome(build(data), validation, active)
        progress("drawing samples", (draw + 1) / total_draws)
        return results

    by_draw = np.stack(shared_among_processes(outcomes, range(total_draws), progress))
    curves = {}
    for i, name in enumerate(problem_of):
        curves[name] = [by_draw[: total_draws if k < few else draws, i, k] for k in range(len(steps))]
    if pool.drawn_from is not None:
        steps = [*steps, pool.drawn_from]
        for name, build in problem_of.items():
            curves[name].append(np.array([_outcome(build(total), validation, active)]))
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

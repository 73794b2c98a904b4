"""Bias by noise in q and v: least squares beside an estimate by instrumental variables.

Both are made from the same rows, so that what moves one moves the other; the error of their difference is the scatter
of the difference of their clusters' influences: Hausman's test (1978) without his assumption that one of them is
efficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.special import stdtr

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.linear_algebra import least_squares
from idtool.estimation.dataset.blocks import Blocks, merge_reductions, rounded_count
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.identification import Identification
from idtool.estimation.instruments import Kind, instrumented_blocks, instrumented_columns, instruments
from idtool.estimation.two_stage import unprojected, weak_joints
from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.estimation.uncertainty.cluster_robust import ClusterRobustEstimate, cluster_robust_estimate
from idtool.estimation.uncertainty.false_discovery import discoveries

_RANK = 1e-8  # of the largest singular value of scaled columns: less is rounding
_LONGEST = 60.0  # s of closed loop that are simulated only to see whether least squares is biased
_LONGEST_SMOOTHED = 600.0  # s that are smoothed for it: they are held in memory
_MOST_BYTES = 512 << 20  # that R-factors with instruments may take for it
_FALSE_DISCOVERIES = 0.05  # of the parameters that are said to differ


@dataclass(frozen=True)
class BiasCheck:
    """Two estimates of the base parameters, without prior and inequalities; r of them.

    Attributes
    ----------
    kind
        Kind of instruments.
    iterations
        Number of times they were made.
    ls, iv
        Least squares and instrumental variables, shape (r,); NaN where the data do not determine one of them.
    standard_error
        Of their difference, shape (r,).
    differs
        True where it is more than chance explains, and least squares outside the other's 95 % interval; shape (r,).
    weak
        Joints whose instruments tell too little for a difference to be seen.
    """

    kind: Kind
    iterations: int
    ls: Array
    iv: Array
    standard_error: Array
    differs: Mask
    weak: tuple[str, ...] = ()


@dataclass(frozen=True)
class EstimatePair:
    """Least squares and instrumental variables from the same clusters; other attributes as in `BiasCheck`."""

    ls: ClusterRobustEstimate
    iv: ClusterRobustEstimate
    kind: Kind
    iterations: int
    weak: tuple[str, ...]


def paired_estimates(experiment: Experiment, identification: Identification, progress: Progress) -> EstimatePair | None:
    """Least squares and instrumental variables; None where these would take long or much memory, or there are none.

    Parameters
    ----------
    experiment, identification
        Model and data, and their identification.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    two_stage = identification.two_stage
    theta, noise = identification.estimate.theta, identification.estimate.noise
    if not experiment.runs:
        return None
    if two_stage is not None:
        made = two_stage.instruments
    elif _is_too_large(experiment):
        return None
    else:
        try:
            made = tuple(instruments(experiment, theta, progress))
        except ModelError:  # the report on the simulation says so
            return None
    data = instrumented_blocks(experiment, made, progress)
    iv = instrumented_estimate(experiment, data, "iv", noise, theta)
    ls = instrumented_estimate(experiment, data, "ls", noise, theta, iv.blocks_per_cluster)
    kind: Kind = "smoothed" if any(each.kind == "smoothed" for each in made) else "closed_loop"
    weak = weak_joints(experiment.equation, merge_reductions([log.total for log in data]), noise, theta)
    return EstimatePair(ls, iv, kind, two_stage.iterations if two_stage else 1, tuple(weak))


def _seconds(experiment: Experiment) -> float:
    """Length of the training data [s]."""
    return float(sum((part.stop - part.start) * run.signals.log.dt for run in experiment.runs for part in run.train))


def _is_too_large(experiment: Experiment) -> bool:
    """True if instruments would take long to make, or the R-factors with them much memory."""
    longest = _LONGEST if experiment.config.controller else _LONGEST_SMOOTHED
    return _seconds(experiment) > longest or factor_bytes(experiment) > _MOST_BYTES


def factor_bytes(experiment: Experiment) -> int:
    """Bytes that R-factors of [Z_j, Y_j, tau_j] take, if every row counts; see `instrumented_blocks`."""
    columns = instrumented_columns(experiment)
    runs = [run for run in experiment.runs if run.train]
    rows = [experiment.batches(run, held_out=False).rows for run in runs]
    lengths = experiment.block_rows(runs, rows, columns, rounded_count(len(experiment.runs)))
    numbers = 0
    for count, length in zip(rows, lengths, strict=True):
        blocks, rest = divmod(count, length)
        for width in (each + 1 for each in columns):
            factor_rows = blocks * min(length, width) + min(rest, width)
            numbers += width * factor_rows
    return 8 * numbers


def instrumented_estimate(
    experiment: Experiment,
    data: Sequence[Blocks],
    method: Literal["ls", "iv"],
    noise: Array,
    theta: Array,
    blocks_per_cluster: int | None = None,
) -> ClusterRobustEstimate:
    """Estimate and standard errors from blocks of [Z_j, Y_j, tau_j]; see `cluster_robust_estimate`."""
    first_stage = None
    if method == "iv":
        first_stage = _first_stage(merge_reductions([log.total for log in data]))
    else:
        data = [log.map(unprojected) for log in data]
    rng = np.random.default_rng(experiment.config.seed)
    return cluster_robust_estimate(
        experiment.equation, data, noise, theta, experiment.equalities, rng, first_stage, blocks_per_cluster
    )


def _first_stage(stacked: Reduction) -> list[Array]:
    """By joint, what Z_j is multiplied with to come nearest to Y_j, shape (m_j, m_j)."""
    coefficients = []
    for factor in stacked:
        Z, Y = np.split(factor.R[:, :-1], 2, axis=1)
        size = np.linalg.norm(Z, axis=0)
        size[size == 0] = 1.0
        coefficients.append(least_squares(Z / size, Y, _RANK)[0] / size[:, None])
    return coefficients


def bias_check(pair: EstimatePair, base: BaseParameters) -> BiasCheck:
    """Compare two estimates, base parameter by base parameter."""
    rows, ls, iv = base.B, pair.ls, pair.iv
    is_determined = np.isfinite(ls.uncertainty.of(rows)) & np.isfinite(iv.uncertainty.of(rows))
    ls_value = np.where(is_determined, rows @ ls.theta, np.nan)
    iv_value = np.where(is_determined, rows @ iv.theta, np.nan)
    difference = np.abs(ls_value - iv_value)

    error = np.sqrt(np.square((ls.influence - iv.influence) @ rows.T).sum(axis=0))
    error *= np.sqrt(ls.cluster_count / max(ls.cluster_count - 1, 1))
    degrees_of_freedom = np.minimum(ls.uncertainty.degrees_of_freedom(rows), iv.uncertainty.degrees_of_freedom(rows))
    t = difference / np.where(error > 0, error, np.inf)

    differs = np.zeros(len(rows), dtype=bool)
    if is_determined.any():
        p_values = 2 * stdtr(degrees_of_freedom[is_determined], -t[is_determined])
        differs[is_determined] = discoveries(p_values, _FALSE_DISCOVERIES)
    differs &= difference > iv.uncertainty.coverage_factor(rows) * iv.uncertainty.of(rows)
    return BiasCheck(pair.kind, pair.iterations, ls_value, iv_value, error, differs, pair.weak)

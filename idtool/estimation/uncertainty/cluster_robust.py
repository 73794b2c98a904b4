"""Cluster-robust standard errors, from the residual itself, for filtered, autocorrelated, closed-loop data.

An ordinary standard error takes every row for an independent sample. Here rows are taken together in clusters, blocks
of time that are long against the residual's correlation. Their scores are independent whatever happens within a
cluster, which gives the sandwich estimate (Liang & Zeger 1986) with the correction for few clusters, CR2 (Bell &
McCaffrey 2002), and a bootstrap over the same clusters (Künsch 1989) with random weights (Rubin 1981). All of it is
done on R-factors. How long a cluster is follows from the autocorrelation of the scores (Politis & White 2004, corrected
by Patton, Politis & White 2009).

Letters as in `standard_errors`; B clusters; G (B, r, r) information of each on y, s (B, r) scores, the slopes of the
cost.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.memory import release_freed_memory
from idtool.common.threads import in_threads
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.uncertainty.standard_errors import (
    Uncertainty,
    identifiable,
    observable_directions,
)

FEWEST_CLUSTERS = 16  # fewer say nothing of their own scatter
_LEAST_OUTSIDE = 0.05  # least share of a direction's information that is taken to lie outside a cluster
_DRAWS = 400
_SHARES = 4  # of the draws, which threads can take
_DRAWS_AT_ONCE = 10  # each takes as much memory as G of a cluster
_JOINTS_AT_ONCE = 4  # whose directions are in memory
_LONGER = 2.0  # than what makes the variance most accurate: intervals that are too short are worse than rough ones
_INDEPENDENT_SERIES = 10  # directions, at most, that are as good as so many independent series
_LEAST_VARIANCE = 0.1  # share of the variance that correlation may leave of what scores add up to
_BEYOND = 1  # more blocks than there may be in a cluster, by which it is too short
_UNCORRELATED_LAGS = 5  # in a row, at which the correlation counts as gone


@dataclass(frozen=True)
class ClusterRobustEstimate:
    """Unregularized least squares with cluster-robust standard errors.

    Attributes
    ----------
    theta
        The estimate of least squares with equality constraints, but for unobservable directions; shape (p,).
    uncertainty
        Uncertainty of the coefficients; from the number of independent rows alone where there are too few clusters.
    bootstrap
        The same by the bootstrap, None where there are too few clusters.
    influence
        By how much each of the B clusters moved the estimate, to first order, shape (B, p).
    blocks_per_cluster
        Number of the data's blocks in a cluster.
    cluster_seconds
        Length of a cluster [s].
    correlated_beyond_clusters
        True if the residual's correlation reaches further than clusters of these logs can be long.
    """

    theta: Array
    uncertainty: Uncertainty
    bootstrap: Uncertainty | None
    influence: Array
    blocks_per_cluster: int
    cluster_seconds: float
    correlated_beyond_clusters: bool

    @property
    def cluster_count(self) -> int:
        """Number of clusters, B."""
        return len(self.influence)

    @property
    def bootstrap_ratio(self) -> float | None:
        """Standard errors by the bootstrap over those by the sandwich, the median; None where there are none."""
        if self.bootstrap is None or not len(self.bootstrap.covariance_y):
            return None
        resampled = np.diag(self.bootstrap.covariance_y)
        analytic = np.diag(self.uncertainty.covariance_y)
        return float(np.median(np.sqrt(resampled / np.maximum(analytic, np.finfo(float).tiny))))


def cluster_robust_estimate(
    model: LinearModel,
    data: Sequence[Blocks],
    noise: Array,
    theta: Array,
    equalities: EqualityConstraints,
    rng: np.random.Generator,
    first_stage: Sequence[Array] | None = None,
    blocks_per_cluster: int | None = None,
) -> ClusterRobustEstimate:
    """Weighted least squares with equality constraints, without prior and inequalities, and its standard errors.

    Parameters
    ----------
    model
        The torque equation.
    data
        The logs in blocks.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    theta
        An estimate that fulfils exact constraints, shape (p,). The residual is that of the best estimate, which is one
        step away.
    equalities
        The equality constraints.
    rng
        Source of the bootstrap's weights.
    first_stage
        Where the data are of [Z_j, Y_j, tau_j], Z_j instruments: by joint what Z_j is multiplied with to come nearest
        to Y_j, shape (m_j, m_j). The estimate is that of two-stage least squares then.
    blocks_per_cluster
        Default: as many as their correlation asks for.
    """
    split = partial(_split, first_stage=first_stage)
    fitted, _ = split(merge_reductions([log.total for log in data]))
    directions = observable_directions(model, fitted, noise, equalities)
    observable = directions.observable
    spectral_covariance = np.eye(len(directions.singular_values)) / directions.independent_per_row
    spectral = Uncertainty(directions, identifiable(directions, equalities), spectral_covariance)
    release_freed_memory()  # of a decomposition, before that of all clusters' information is taken

    soft = equalities.soft_rows() / np.sqrt(directions.independent_per_row)
    soft_in_y = soft[:, :-1] @ observable
    block_sums = [_block_sums(model, map(split, log.parts), noise, theta, observable) for log in data]
    step = soft_in_y.T @ (soft[:, :-1] @ theta - soft[:, -1]) + sum(s.sum(axis=0) for _, s in block_sums)
    best = theta - observable @ step

    scores = [s - G @ step for G, s in block_sums]
    if first_stage is not None:  # Zᵀ Y of a block is not its G, only of all together
        scores = [_block_sums(model, map(split, log.parts), noise, best, observable)[1] for log in data]
    most = max(sum(map(len, data)) // FEWEST_CLUSTERS, 1)
    wanted = blocks_per_cluster or _blocks_per_cluster(scores)
    count = min(wanted, most)
    G = _joined([_consecutive_sums(G, count) for G, _ in block_sums])
    s = _joined([_consecutive_sums(s, count) for s in scores])

    estimate = ClusterRobustEstimate(
        theta=best,
        uncertainty=spectral,
        bootstrap=None,
        influence=-s @ observable.T,
        blocks_per_cluster=count,
        cluster_seconds=data[0].seconds * count,
        correlated_beyond_clusters=wanted > most + _BEYOND,
    )
    if len(s) < FEWEST_CLUSTERS:
        return estimate
    soft_information = soft_in_y.T @ soft_in_y
    soft_covariance = soft_information / directions.independent_per_row
    s = _cr2_scores(G, s)
    influence = -s @ observable.T
    sandwich = Uncertainty(directions, spectral.identifiable, s.T @ s + soft_covariance, G)
    resampled = _bootstrap_covariance(G, s, soft_information, rng)
    bootstrap = Uncertainty(directions, spectral.identifiable, resampled + soft_covariance, G)
    return replace(estimate, uncertainty=sandwich, bootstrap=bootstrap, influence=influence)


def _split(part: Reduction, first_stage: Sequence[Array] | None) -> tuple[Reduction, Reduction]:
    """Factors whose columns take the residual's score, and those of [Y, tau]: the same but for instruments."""
    if first_stage is None:
        return part, part
    fitted, full = [], []
    for factor, nearest in zip(part, first_stage, strict=True):
        m = len(nearest)
        fitted.append(replace(factor, R=np.column_stack([factor.R[:, :m] @ nearest, np.zeros(len(factor.R))])))
        full.append(replace(factor, R=factor.R[:, m:]))
    return tuple(fitted), tuple(full)


def _block_sums(
    model: LinearModel, parts: Iterable[tuple[Reduction, Reduction]], noise: Array, theta: Array, observable: Array
) -> tuple[Array, Array]:
    """G and s of every block at an estimate."""
    parts = list(parts)
    joints = list(zip(model.active(), noise, strict=True))
    r = observable.shape[1]
    G, s = np.zeros((len(parts), r, r)), np.zeros((len(parts), r))
    work = sum(factor.R.size for fitted, _ in parts for factor in fitted)
    for first in range(0, len(joints), _JOINTS_AT_ONCE):
        chosen = slice(first, first + _JOINTS_AT_ONCE)
        directions = [observable[columns] / sigma for columns, sigma in joints[chosen]]
        coefficients = [np.append(theta[columns], -1.0) / sigma for columns, sigma in joints[chosen]]

        def add_up(
            i: int,
            chosen: slice = chosen,
            directions: list[Array] = directions,
            coefficients: list[Array] = coefficients,
        ) -> None:
            fitted, full = (reduction[chosen] for reduction in parts[i])
            A = np.concatenate([own.R[:, :-1] @ each for own, each in zip(fitted, directions, strict=True)])
            residual = np.concatenate([factor.R @ each for factor, each in zip(full, coefficients, strict=True)])
            G[i] += A.T @ A
            s[i] += A.T @ residual

        in_threads(add_up, range(len(parts)), work)
    return G, s


def _consecutive_sums(x: Array, count: int) -> Array:
    """Sums over so many consecutive entries; a rest of up to half of that joins the last."""
    if count == 1:
        return x
    starts = np.arange(0, max(len(x) - count // 2, 1), count)
    return np.asarray(np.add.reduceat(x, starts, axis=0))


def _joined(arrays: Sequence[Array]) -> Array:
    """Arrays one after the other; of one, no copy is made."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _blocks_per_cluster(scores: Sequence[Array]) -> int:
    """Number of blocks a cluster should have, by the autocorrelation of the scores, shape (blocks, r) of each log.

    All directions are taken together, in units in which their information is the same; their mean correlation is the
    better known for it, but no better than of a few, as they are not independent.
    """
    n = sum(map(len, scores))
    most = max(map(len, scores)) // 2
    R = np.array([sum(_lagged_product(s, lag) for s in scores) for lag in range(most + 1)])
    series = np.clip(scores[0].shape[1], 1, _INDEPENDENT_SERIES)
    noise = 2 * np.sqrt(np.log10(max(n, 2)) / n / series)
    small = np.abs(R) <= noise * R[0]
    last = next((m for m in range(most + 1) if small[m + 1 : m + 1 + _UNCORRELATED_LAGS].all()), most)
    if last == 0:
        return 1
    lags = np.arange(1, min(2 * last, most) + 1)
    taper = np.clip(2 * (1 - lags / (2 * last)), 0, 1)
    long_run = max(R[0] + 2 * float(taper @ R[lags]), _LEAST_VARIANCE * R[0])
    slope = 2 * float(taper @ (lags * R[lags]))
    return max(int(np.ceil(_LONGER * (1.5 * (slope / long_run) ** 2 * n) ** (1 / 3))), 1)


def _lagged_product(s: Array, lag: int) -> float:
    return float((s[lag:] * s[: max(len(s) - lag, 0)]).sum())


def _cr2_scores(G: Array, s: Array) -> Array:
    """Scores as large as those of the true residual, which the estimate makes smaller: CR2's (1 − G)^(−1/2) s."""

    def score_of(cluster: tuple[Array, Array]) -> Array:
        G, s = cluster
        values, vectors = np.linalg.eigh(G)
        rotated = vectors.T @ s / np.sqrt(np.maximum(1 - values, _LEAST_OUTSIDE))
        return np.asarray(vectors @ rotated)

    return np.array(in_threads(score_of, list(zip(G, s, strict=True)), G.size))


def _bootstrap_covariance(G: Array, s: Array, soft: Array, rng: np.random.Generator) -> Array:
    """Covariance of the estimate when every cluster's weight is drawn from the exponential distribution."""
    weights = rng.exponential(size=(_DRAWS, len(s)))
    flat = G.reshape(len(s), -1)

    def estimates(weights: Array) -> Array:
        H = np.empty((_DRAWS_AT_ONCE, *soft.shape))  # always the same memory: new memory takes longer than the product
        y = np.empty((len(weights), len(soft), 1))
        for first in range(0, len(weights), _DRAWS_AT_ONCE):
            w = weights[first : first + _DRAWS_AT_ONCE]
            np.matmul(w, flat, out=H.reshape(len(w), -1))
            H += soft
            scores = w @ s
            y[first : first + _DRAWS_AT_ONCE] = np.linalg.solve(H, scores[:, :, None])
        return y[:, :, 0]

    shares = np.split(weights, _SHARES)
    y = np.concatenate(in_threads(estimates, shares, _DRAWS * soft.size))
    return np.asarray(y.T @ y / _DRAWS)

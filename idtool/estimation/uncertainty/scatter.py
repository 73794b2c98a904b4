"""Standard errors from the residual itself, for filtered, autocorrelated, closed-loop data.

An ordinary standard error takes every row for an independent sample. Here rows are taken together in blocks of time
that are long against the residual's correlation. Their scores are independent whatever happens within a block, which
gives the sandwich estimate clustered by blocks (Liang & Zeger 1986) with the correction for few blocks, CR2 (Bell &
McCaffrey 2002), and a bootstrap over the same blocks (Künsch 1989) with random weights (Rubin 1981). All of it is done
on R-factors. How long a block is follows from the autocorrelation of the scores (Politis & White 2004, corrected by
Patton, Politis & White 2009).

Letters as in `uncertainty`; of B blocks: G (B, r, r) information on y, s (B, r) scores, the slopes of the cost.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, together
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.uncertainty.uncertainty import Uncertainty, directions, identifiable, weighed

FEWEST = 16  # blocks; fewer say nothing of their own scatter
_LEFT = 0.05  # least share of a direction's information that is taken to lie outside a block
_DRAWS = 400
_AT_ONCE = 25  # of them: each takes as much memory as G of a block
_LONGER = 2.0  # than what makes the variance most accurate: intervals that are too short are worse than rough ones
_ALIKE = 10  # directions, at most, that are as good as so many independent series
_LEAST = 0.1  # of the variance, that correlation may leave of what scores add up to
_BEYOND = 1  # more parts than there may be in a block, by which it is too short
_GONE = 5  # lags in a row without correlation, at which it counts as gone


@dataclass(frozen=True)
class Scatter:
    """What resampling says.

    Attributes
    ----------
    theta
        The estimate of least squares with what is known otherwise, but for what the data do not see; shape (p,).
    uncertainty
        Of the coefficients; from the number of independent rows alone where there are too few blocks.
    bootstrap
        The same from resampled blocks, None where there are too few.
    influence
        By how much each of the B blocks moved the estimate, to first order, shape (B, p).
    joined
        How many of the data's blocks were taken as one.
    seconds
        How long each is [s].
    correlated
        Whether the residual's correlation reaches further than blocks of these logs can be long.
    """

    theta: Array
    uncertainty: Uncertainty
    bootstrap: Uncertainty | None
    influence: Array
    joined: int
    seconds: float
    correlated: bool

    @property
    def blocks(self) -> int:
        """How many there are."""
        return len(self.influence)


def scatter(
    model: LinearModel,
    data: Sequence[Blocks],
    noise: Array,
    theta: Array,
    known: Knowledge,
    rng: np.random.Generator,
    first_stage: Sequence[Array] | None = None,
    joined: int | None = None,
) -> Scatter:
    """Standard errors of weighted least squares with what is known otherwise, without prior and inequalities.

    Parameters
    ----------
    model
        The torque equation.
    data
        The logs in blocks.
    noise
        Residual noise of each joint [N·m or N], shape (nv,).
    theta
        An estimate that fulfils what is known exactly, shape (p,). The residual is that of the best estimate, which is
        one step away.
    known
        What is known otherwise.
    rng
        Source of the bootstrap's weights.
    first_stage
        Where the data are of [Z_j, Y_j, tau_j], Z_j instruments: by joint what Z_j is multiplied with to come nearest
        to Y_j, shape (m_j, m_j). The estimate is that of two-stage least squares then.
    joined
        How many blocks to take as one; default: as many as their correlation asks for.
    """
    split = partial(_split, first_stage=first_stage)
    seen = directions(model, split(together([log.total for log in data]))[0], noise, known)
    whole = Uncertainty(seen, identifiable(seen, known), np.eye(len(seen.gain)) / seen.worth)
    soft = known.soft_rows() / np.sqrt(seen.worth)
    told = soft[:, :-1] @ seen.visible
    found = [_moments(model, map(split, log.parts), noise, theta, seen.visible) for log in data]
    away = told.T @ (soft[:, :-1] @ theta - soft[:, -1]) + sum(s.sum(axis=0) for _, s in found)
    best = theta - seen.visible @ away
    scores = [s - G @ away for G, s in found]
    if first_stage is not None:  # Zᵀ Y of a block is not its G, only of all together
        scores = [_moments(model, map(split, log.parts), noise, best, seen.visible)[1] for log in data]
    most = max(sum(map(len, data)) // FEWEST, 1)
    wanted = joined or _block_length(scores)
    joined = min(wanted, most)
    G = np.concatenate([_sums(G, joined) for G, _ in found])
    s = np.concatenate([_sums(x, joined) for x in scores])
    seconds = data[0].seconds * joined
    if len(s) < FEWEST:
        return Scatter(best, whole, None, -s @ seen.visible.T, joined, seconds, wanted > most + _BEYOND)
    soft_spread = told.T @ told / seen.worth
    s = _corrected(G, s)
    sandwich = Uncertainty(seen, whole.identifiable, s.T @ s + soft_spread, G)
    draws = _bootstrap(G, s, told.T @ told, rng)
    bootstrap = Uncertainty(seen, whole.identifiable, draws + soft_spread, G)
    return Scatter(best, sandwich, bootstrap, -s @ seen.visible.T, joined, seconds, wanted > most + _BEYOND)


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


def _moments(
    model: LinearModel, parts: Iterable[tuple[Reduction, Reduction]], noise: Array, theta: Array, visible: Array
) -> tuple[Array, Array]:
    """G and s of every block at an estimate."""
    G, s = [], []
    for fitted, full in parts:
        own_G, own_s = np.zeros((visible.shape[1],) * 2), np.zeros(visible.shape[1])
        for rows, factor, columns, sigma in zip(
            weighed(model, fitted, noise), full, model.active(), noise, strict=True
        ):
            A = rows @ visible
            own_G += A.T @ A
            own_s += A.T @ (factor.R @ np.append(theta[columns], -1.0)) / sigma
        G.append(own_G)
        s.append(own_s)
    return np.array(G), np.array(s)


def _sums(x: Array, count: int) -> Array:
    """Sums over so many consecutive entries; a rest of up to half of that joins the last."""
    starts = np.arange(0, max(len(x) - count // 2, 1), count)
    return np.asarray(np.add.reduceat(x, starts, axis=0))


def _block_length(scores: Sequence[Array]) -> int:
    """How many parts a block should have, by the autocorrelation of the scores, shape (parts, r) of each log.

    All directions are taken together, in units in which their information is the same; their mean correlation is the
    better known for it, but no better than of a few, as they are not independent.
    """
    n, most = sum(map(len, scores)), max(map(len, scores)) // 2
    R = np.array([sum(float((s[k:] * s[: max(len(s) - k, 0)]).sum()) for s in scores) for k in range(most + 1)])
    noise = 2 * np.sqrt(np.log10(max(n, 2)) / n / np.clip(scores[0].shape[1], 1, _ALIKE))
    small = np.abs(R) <= noise * R[0]
    gone = next((m for m in range(most + 1) if small[m + 1 : m + 1 + _GONE].all()), most)
    if gone == 0:
        return 1
    lags = np.arange(1, min(2 * gone, most) + 1)
    taper = np.clip(2 * (1 - lags / (2 * gone)), 0, 1)
    long_run = max(R[0] + 2 * float(taper @ R[lags]), _LEAST * R[0])
    slope = 2 * float(taper @ (lags * R[lags]))
    return max(int(np.ceil(_LONGER * (1.5 * (slope / long_run) ** 2 * n) ** (1 / 3))), 1)


def _corrected(G: Array, s: Array) -> Array:
    """Scores as large as those of the true residual, which the estimate makes smaller: CR2's (1 − G)^(−1/2) s."""
    values, vectors = np.linalg.eigh(G)
    turned = np.einsum("bij,bi->bj", vectors, s) / np.sqrt(np.maximum(1 - values, _LEFT))
    return np.asarray(np.einsum("bij,bj->bi", vectors, turned))


def _bootstrap(G: Array, s: Array, soft: Array, rng: np.random.Generator) -> Array:
    """Covariance of the estimate when every block's weight is drawn from the exponential distribution."""
    weights = rng.exponential(size=(_DRAWS, len(s)))
    flat, squares = G.reshape(len(s), -1), np.zeros_like(soft)
    for w in np.split(weights, _DRAWS // _AT_ONCE):
        H = (w @ flat).reshape(len(w), *soft.shape) + soft
        y = np.linalg.solve(H, (w @ s)[..., None])[..., 0]
        squares += y.T @ y
    return squares / _DRAWS

"""Screening of probes: which of them explain a `LinearizedFit`'s residual on blocks of time they were not fitted to.

With the model's rows Q (n, r) by y and the probe's columns C (n, k), what is solved for every block left out is

    [Qᵀ Q + H   Qᵀ C] [y]   [Qᵀ e + f]
    [Cᵀ Q       Cᵀ C] [c] = [Cᵀ e    ]

over the other blocks, by the Schur complement of the model: C is projected on what is orthogonal to Q and H. H and f
are the information and the pull of prior and constraints.

Letters: F blocks; K coefficients of all probes one after the other, of which a probe has k.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Batch
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.estimation.dataset.experiment import Progress, tracked
from idtool.robot.config import EffectEntry

_MEMORY = 1e7  # numbers that are held at once
_AT_ONCE = 128  # columns that are filtered together
_NOTHING = 1e-18  # of a column, squared and in units of the noise: rounding
_NEW = 1e-5  # share of a column that the model cannot make: with less it says nothing new


@dataclass(frozen=True)
class Found:
    """What came of a probe.

    Attributes
    ----------
    probe
        The hypothesis.
    c
        Its coefficients, shape (k,).
    covariance
        Of them, by the jackknife over blocks, shape (k, k).
    gains
        By how much the squared residual of each block falls, the model and the probe being fitted to the others; in
        units of the noise, shape (F,).
    information
        Of the data on the coefficients, beside the model's, shape (k, k).
    inflation
        How much larger its covariance is than that of independent rows.
    """

    probe: Probe
    c: Array
    covariance: Array
    gains: Array
    information: Array
    inflation: float

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return float(self.gains.sum())

    @property
    def standard_error(self) -> float:
        """Of the gain, from the blocks."""
        return float(np.sqrt(len(self.gains)) * self.gains.std(ddof=1)) if len(self.gains) > 1 else np.inf

    @property
    def allowed(self) -> bool:
        """Whether physics allows the coefficients."""
        return self.probe.is_feasible(self.c) and self.entry is not None

    @cached_property
    def entry(self) -> EffectEntry | None:
        """As a configuration has it."""
        return self.probe.to_entry(self.c, self.information)


@dataclass
class _Sums:
    """Gram matrices of all probes, by block.

    Attributes
    ----------
    P
        Of the model's rows with the columns, shape (F, r, K).
    h
        Of the columns with the residual, (F, K).
    C
        Of each column with those of its own probe, (F, K, most k).
    """

    P: Array
    h: Array
    C: Array


def screened(
    linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str = "looking for causes"
) -> list[Found]:
    """Try probes.

    Parameters
    ----------
    linearized
        What they are to explain.
    probes
        The hypotheses.
    progress
        Told how far it has come.
    stage
        What to call it.
    """
    size = linearized.folds * linearized.ways.shape[1]
    found: list[Found] = []
    some: list[Probe] = []
    for probe in probes:
        some.append(probe)
        if size * sum(p.coefficient_count for p in some) > _MEMORY:
            found += _judged(linearized, some, _summed(linearized, some, progress, stage))
            some = []
    return found + (_judged(linearized, some, _summed(linearized, some, progress, stage)) if some else [])


def _summed(linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str) -> _Sums:
    starts = np.cumsum([0, *(probe.coefficient_count for probe in probes)])
    most = max(probe.coefficient_count for probe in probes)
    F, r, K = linearized.folds, linearized.ways.shape[1], int(starts[-1])
    sums = _Sums(np.zeros((F, r, K)), np.zeros((F, K)), np.zeros((F, K, most)))
    for batch, present, folds in along(linearized, progress, stage):
        Q, e, kept = _rows(linearized, batch, present)
        for joint, index, X in _columns(probes, starts, batch, present):
            own = X / linearized.noise[joint] * kept[joint]
            beside = [_beside(own, index, starts, d) for d in range(most)]
            for f in np.unique(folds):
                part = folds == f
                x = own[:, part]
                sums.P[f][:, index] += Q[joint][:, part] @ x.T
                sums.h[f, index] += x @ e[joint][part]
                for d in range(most):
                    sums.C[f, index, d] += np.einsum("in,in->i", x, beside[d][:, part])
    return sums


def _beside(X: Array, index: Indices, starts: Indices, d: int) -> Array:
    """For each column the d-th of its probe's, zero where it has no such; shape as X."""
    probe = np.searchsorted(starts, index, side="right") - 1
    wanted = starts[probe] + d
    there = wanted < starts[probe + 1]
    at = np.searchsorted(index, np.where(there, wanted, index))
    return np.asarray(X[np.minimum(at, len(index) - 1)] * there[:, None])


def along(
    linearized: LinearizedFit, progress: Progress, stage: str
) -> Iterator[tuple[Batch, LinearizedModel, Indices]]:
    """The training data: batches, the model along each, and the block that each filtered sample is in."""
    first = 0
    for run in (run for run in linearized.experiment.runs if run.train):
        row = 0
        for batch in tracked(run.signals.batches(run.train), run.train, progress, stage):
            present = LinearizedModel(linearized.experiment.equation, linearized.theta, batch.motion)
            count = len(batch.t)
            yield batch, present, first + (row + np.arange(count)) // linearized.length
            row += count
        first += -(-row // linearized.length)


def _rows(
    linearized: LinearizedFit, batch: Batch, present: LinearizedModel
) -> tuple[list[Array], list[Array], list[Array]]:
    """By joint: the model's rows by y, (r, n), the residual, (n,), and which samples count as 1, (n,)."""
    Q, e, kept = [], [], []
    active = linearized.experiment.equation.active()
    keep = linearized.experiment.equation.clean_samples(batch, linearized.apart)
    for j, (own, columns) in enumerate(zip(active, present.columns, strict=True)):
        block = batch.filter(columns) * keep[j] / linearized.noise[j]
        Q.append(linearized.ways[own].T @ block[:-1])
        e.append(block[-1] - linearized.theta[own] @ block[:-1])
        kept.append(keep[j].astype(float))
    return Q, e, kept


def _columns(
    probes: Sequence[Probe], starts: Indices, batch: Batch, present: LinearizedModel
) -> Iterator[tuple[int, Indices, Array]]:
    """Joint, indices of coefficients, and their columns in the band, shape (i, n), some at a time."""
    waiting: dict[int, list[tuple[int, Array]]] = {}
    for start, probe in zip(starts[:-1], probes, strict=True):
        for joint, rows in probe.columns(present.true_motion, present).items():
            own = waiting.setdefault(joint, [])
            own.append((int(start), rows))
            if sum(len(r) for _, r in own) >= _AT_ONCE:
                yield joint, *_filtered(waiting.pop(joint), batch)
    for joint, own in waiting.items():
        yield joint, *_filtered(own, batch)


def _filtered(some: list[tuple[int, Array]], batch: Batch) -> tuple[Indices, Array]:
    index = np.concatenate([start + np.arange(len(rows)) for start, rows in some])
    return index, batch.filter(np.concatenate([rows for _, rows in some]))


def _judged(linearized: LinearizedFit, probes: Sequence[Probe], sums: _Sums) -> list[Found]:
    starts = np.cumsum([0, *(probe.coefficient_count for probe in probes)])
    found: dict[int, Found] = {}
    for k in {probe.coefficient_count for probe in probes}:
        which = [i for i, probe in enumerate(probes) if probe.coefficient_count == k]
        index = np.array([np.arange(starts[i], starts[i] + k) for i in which])  # (probes of that size, k)
        for i, one in zip(which, _of_size(linearized, [probes[i] for i in which], index, sums), strict=True):
            found[i] = one
    return [found[i] for i in range(len(probes))]


def _of_size(linearized: LinearizedFit, probes: Sequence[Probe], index: Indices, sums: _Sums) -> list[Found]:
    """The probes of k coefficients each."""
    F = linearized.folds
    local = [i for i, probe in enumerate(probes) if probe.is_local]
    parts = sums.P[:, :, index], sums.h[:, index], sums.C[:, index, : index.shape[1]]  # (F, r, i, k), (F, i, k), …
    P, h, C = (x.sum(axis=0) for x in parts)
    whole = linearized.B.sum(axis=0) + linearized.held
    c, _, S = _solved(whole, P, h, C, np.zeros(len(whole)))
    left, gains = np.empty((F, *c.shape)), np.empty((F, len(c)))
    for f in range(F):
        y0, B = linearized.without[f], linearized.B[f]
        Pf, hf, Cf = (x[f] for x in parts)
        cf, X, _ = _solved(whole - B, P - Pf, h - hf, C - Cf, y0)
        cf = np.where(_allowed(probes, cf)[:, None], cf, 0.0)
        cf[local] = c[local]
        left[f] = cf
        dy = -np.einsum("rik,ik->ri", X, cf)  # what the model gives way by
        of_c = hf - np.einsum("rik,r->ik", Pf, y0)
        along = np.einsum("rik,ik->ri", Pf, cf)
        gains[f] = (
            2 * (dy * (linearized.g[f] - B @ y0)[:, None]).sum(axis=0) + 2 * (cf * of_c).sum(axis=1)
            - (dy * (B @ dy)).sum(axis=0) - 2 * (dy * along).sum(axis=0)
            - np.einsum("ik,ikl,il->i", cf, Cf, cf)
        )  # fmt: skip
    away = left - left.mean(axis=0)
    covariance = (F - 1) / F * np.einsum("fik,fil->ikl", away, away)
    ordinary = np.einsum("ikk->ik", np.linalg.pinv(S))
    spread = np.einsum("ikk->ik", covariance)
    inflation = (spread / np.where(ordinary > 1e-200, ordinary, np.inf)).mean(axis=1)
    rows = zip(probes, c, covariance, gains.T, S, inflation, strict=True)
    return [Found(probe, c, V, gain, own, float(more)) for probe, c, V, gain, own, more in rows]


def _solved(A: Array, P: Array, h: Array, C: Array, y0: Array) -> tuple[Array, Array, Array]:
    """Coefficients, (i, k), what the model gives way by for each, (r, i, k), and the Schur complement, (i, k, k)."""
    r, i, k = P.shape
    X: Array = np.asarray(np.linalg.solve(A, P.reshape(r, i * k)).reshape(r, i, k), dtype=np.float64)
    S = C - np.einsum("rik,ril->ikl", P, X)
    squares = np.einsum("ikk->ik", C)
    size = np.sqrt(np.where(squares > _NOTHING, squares, np.inf))
    values, vectors = np.linalg.eigh(S / size[:, :, None] / size[:, None, :])
    inverse = np.where(values > _NEW, 1 / np.maximum(values, _NEW), 0.0)
    rhs = (h - np.einsum("rik,r->ik", P, y0)) / size
    c = np.einsum("ikl,il,iml,im->ik", vectors, inverse, vectors, rhs, optimize=True) / size
    return c, X, S


def _allowed(probes: Sequence[Probe], c: Array) -> Mask:
    return np.array([probe.is_feasible(own) for probe, own in zip(probes, c, strict=True)], dtype=bool)

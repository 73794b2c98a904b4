"""Screening of probes by what they explain of a `LinearizedFit`'s residual on blocks of time not used for fitting.

With the model's rows Q (n, r) by y and the probe's columns C (n, k), each block is left out in turn, and

    [Qᵀ Q + H   Qᵀ C] [y]   [Qᵀ e + f]
    [Cᵀ Q       Cᵀ C] [c] = [Cᵀ e    ]

is solved over the others by the Schur complement of the model: C is projected on what is orthogonal to Q and H. H and f
are the information and the pull of prior and constraints.

Letters: F blocks; K coefficients of all probes one after the other, of which a probe has k; i probes of k coefficients.
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

_MAX_NUMBERS = 1e7  # in memory at once
_MAX_COLUMNS = 128  # filtered together
_ROUNDING = 1e-18  # of a column, squared and in units of the noise
_MIN_NEW_SHARE = 1e-5  # of a column, that the model can't reproduce


@dataclass(frozen=True)
class ScreenedProbe:
    """A probe and what it explains.

    Attributes
    ----------
    probe
        The hypothesis.
    c
        Its coefficients, shape (k,).
    covariance
        Jackknife covariance of the coefficients over blocks, shape (k, k).
    gains
        Reduction of the squared residual of each block, model and probe being fitted to the others; in units of the
        noise, shape (F,).
    information
        Information of the data on the coefficients, beside the model's, shape (k, k).
    inflation
        Ratio of the covariance to that of independent rows.
    """

    probe: Probe
    c: Array
    covariance: Array
    gains: Array
    information: Array
    inflation: float

    @property
    def gain(self) -> float:
        """Reduction of the squared residual over all blocks."""
        return float(self.gains.sum())

    @property
    def standard_error(self) -> float:
        """Standard error of the gain, from the blocks."""
        return float(np.sqrt(len(self.gains)) * self.gains.std(ddof=1)) if len(self.gains) > 1 else np.inf

    @property
    def is_possible(self) -> bool:
        """True if physics allows the coefficients and an effect has them."""
        return self.probe.is_feasible(self.c) and self.entry is not None

    @cached_property
    def entry(self) -> EffectEntry | None:
        """Configuration entry; None if there is no such effect."""
        return self.probe.to_entry(self.c, self.information)


@dataclass
class _ProbeSums:
    """Gram matrices of all probes, by block.

    Attributes
    ----------
    P
        Products of the model's rows with the columns, shape (F, r, K).
    h
        Products of the columns with the residual, shape (F, K).
    C
        Products of each column with those of its own probe, shape (F, K, largest k).
    """

    P: Array
    h: Array
    C: Array


def screen_probes(
    linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str = "screening candidates"
) -> list[ScreenedProbe]:
    """Screen the probes, each by itself, by the share of the residual that it explains.

    Parameters
    ----------
    linearized
        The model whose residual they are to explain.
    probes
        The hypotheses.
    progress
        Callback for the stage and its progress, from 0 to 1.
    stage
        Name of this stage.
    """
    screened: list[ScreenedProbe] = []
    for group in _groups_in_memory(linearized, probes):
        sums = _accumulate(linearized, group, progress, stage)
        screened += _solve_all(linearized, group, sums)
    return screened


def _groups_in_memory(linearized: LinearizedFit, probes: Sequence[Probe]) -> Iterator[list[Probe]]:
    """Probes in groups whose sums fit into memory."""
    numbers_per_coefficient = linearized.block_count * linearized.directions.shape[1]
    group: list[Probe] = []
    for probe in probes:
        group.append(probe)
        if numbers_per_coefficient * sum(p.coefficient_count for p in group) > _MAX_NUMBERS:
            yield group
            group = []
    if group:
        yield group


def _coefficient_starts(probes: Sequence[Probe]) -> Indices:
    """Index of each probe's first coefficient, and the number K of all."""
    return np.cumsum([0, *(probe.coefficient_count for probe in probes)])


def _accumulate(linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str) -> _ProbeSums:
    starts = _coefficient_starts(probes)
    max_k = max(probe.coefficient_count for probe in probes)
    F, r, K = linearized.block_count, linearized.directions.shape[1], int(starts[-1])
    sums = _ProbeSums(np.zeros((F, r, K)), np.zeros((F, K)), np.zeros((F, K, max_k)))
    for batch, model, block_index in training_batches(linearized, progress, stage):
        Q, e, valid = _model_rows(linearized, batch, model)
        for joint, index, filtered in _probe_columns(probes, starts, batch, model):
            columns = filtered / linearized.noise[joint] * valid[joint]
            siblings = [_sibling_columns(columns, index, starts, d) for d in range(max_k)]
            for f in np.unique(block_index):
                in_block = block_index == f
                x = columns[:, in_block]
                sums.P[f][:, index] += Q[joint][:, in_block] @ x.T
                sums.h[f, index] += x @ e[joint][in_block]
                for d in range(max_k):
                    sums.C[f, index, d] += np.einsum("in,in->i", x, siblings[d][:, in_block])
    return sums


def _sibling_columns(columns: Array, index: Indices, starts: Indices, d: int) -> Array:
    """The d-th column of each column's own probe, zero if the probe has fewer; same shape as the columns."""
    probe = np.searchsorted(starts, index, side="right") - 1
    wanted = starts[probe] + d
    exists = wanted < starts[probe + 1]
    position = np.searchsorted(index, np.where(exists, wanted, index))
    return np.asarray(columns[np.minimum(position, len(index) - 1)] * exists[:, None])


def training_batches(
    linearized: LinearizedFit, progress: Progress, stage: str
) -> Iterator[tuple[Batch, LinearizedModel, Indices]]:
    """Batches of the training data, the model along each, and the block of each filtered sample."""
    first_block = 0
    for run in linearized.experiment.runs:
        if not run.train:
            continue
        row = 0
        for batch in tracked(run.signals.batches(run.train), run.train, progress, stage):
            model = LinearizedModel(linearized.experiment.equation, linearized.theta, batch.motion)
            rows = row + np.arange(len(batch.t))
            yield batch, model, first_block + rows // linearized.block_length
            row += len(batch.t)
        first_block += -(-row // linearized.block_length)


def _model_rows(
    linearized: LinearizedFit, batch: Batch, model: LinearizedModel
) -> tuple[list[Array], list[Array], list[Array]]:
    """By joint: the model's rows by y, (r, n), the residual, (n,), and 1 for each sample that counts, (n,)."""
    equation = linearized.experiment.equation
    masks = equation.clean_samples(batch, linearized.reversal_margin)
    Q, e, valid = [], [], []
    for j, (active, columns) in enumerate(zip(equation.active(), model.columns, strict=True)):
        block = batch.filter(columns) * masks[j] / linearized.noise[j]
        Q.append(linearized.directions[active].T @ block[:-1])
        e.append(block[-1] - linearized.theta[active] @ block[:-1])
        valid.append(masks[j].astype(float))
    return Q, e, valid


def _probe_columns(
    probes: Sequence[Probe], starts: Indices, batch: Batch, model: LinearizedModel
) -> Iterator[tuple[int, Indices, Array]]:
    """Joint, indices of coefficients, and their filtered columns, shape (i, n), a bounded number at a time."""
    waiting: dict[int, list[tuple[int, Array]]] = {}
    for start, probe in zip(starts[:-1], probes, strict=True):
        for joint, columns in probe.columns(model.true_motion, model).items():
            own = waiting.setdefault(joint, [])
            own.append((int(start), columns))
            if sum(len(x) for _, x in own) >= _MAX_COLUMNS:
                yield joint, *_filtered(waiting.pop(joint), batch)
    for joint, own in waiting.items():
        yield joint, *_filtered(own, batch)


def _filtered(started_columns: list[tuple[int, Array]], batch: Batch) -> tuple[Indices, Array]:
    """Indices of coefficients and their filtered columns, from the first index and the columns of each probe."""
    index = np.concatenate([start + np.arange(len(columns)) for start, columns in started_columns])
    return index, batch.filter(np.concatenate([columns for _, columns in started_columns]))


def _solve_all(linearized: LinearizedFit, probes: Sequence[Probe], sums: _ProbeSums) -> list[ScreenedProbe]:
    """All probes solved, those with the same number of coefficients together."""
    starts = _coefficient_starts(probes)
    screened: dict[int, ScreenedProbe] = {}
    for k in {probe.coefficient_count for probe in probes}:
        numbers = [i for i, probe in enumerate(probes) if probe.coefficient_count == k]
        index = np.array([np.arange(starts[i], starts[i] + k) for i in numbers])  # (i, k)
        solved = _solve_same_size(linearized, [probes[i] for i in numbers], index, sums)
        screened.update(zip(numbers, solved, strict=True))
    return [screened[i] for i in range(len(probes))]


def _solve_same_size(
    linearized: LinearizedFit, probes: Sequence[Probe], index: Indices, sums: _ProbeSums
) -> list[ScreenedProbe]:
    """Probes of k coefficients each, whose indices are given, shape (i, k)."""
    F = linearized.block_count
    block_P = sums.P[:, :, index]  # (F, r, i, k)
    block_h = sums.h[:, index]  # (F, i, k)
    block_C = sums.C[:, index, : index.shape[1]]  # (F, i, k, k)
    P, h, C = block_P.sum(axis=0), block_h.sum(axis=0), block_C.sum(axis=0)
    c, _, schur = _solve(linearized.information, P, h, C, np.zeros(len(linearized.information)))

    local = [i for i, probe in enumerate(probes) if probe.is_local]
    left_out = np.empty((F, *c.shape))  # coefficients without each block
    gains = np.empty((F, len(c)))
    for f in range(F):
        y0 = linearized.jackknife_shift[f]
        gram = linearized.gram[f]
        P_f, h_f, C_f = block_P[f], block_h[f], block_C[f]
        c_f, X, _ = _solve(linearized.information - gram, P - P_f, h - h_f, C - C_f, y0)
        c_f = np.where(_feasible(probes, c_f)[:, None], c_f, 0.0)
        c_f[local] = c[local]
        left_out[f] = c_f

        dy = -np.einsum("rik,ik->ri", X, c_f)  # change of the model's y by the probe
        residual_score = h_f - np.einsum("rik,r->ik", P_f, y0)
        cross = np.einsum("rik,ik->ri", P_f, c_f)
        gains[f] = (
            2 * (dy * (linearized.score[f] - gram @ y0)[:, None]).sum(axis=0)
            + 2 * (c_f * residual_score).sum(axis=1)
            - (dy * (gram @ dy)).sum(axis=0)
            - 2 * (dy * cross).sum(axis=0)
            - np.einsum("ik,ikl,il->i", c_f, C_f, c_f)
        )

    deviation = left_out - left_out.mean(axis=0)
    covariance = (F - 1) / F * np.einsum("fik,fil->ikl", deviation, deviation)
    independent_variance = np.einsum("ikk->ik", np.linalg.pinv(schur))
    variance = np.einsum("ikk->ik", covariance)
    is_determined = independent_variance > 1e-200
    inflation = (variance / np.where(is_determined, independent_variance, np.inf)).mean(axis=1)
    return [
        ScreenedProbe(probe, c[i], covariance[i], gains[:, i], schur[i], float(inflation[i]))
        for i, probe in enumerate(probes)
    ]


def _solve(A: Array, P: Array, h: Array, C: Array, y0: Array) -> tuple[Array, Array, Array]:
    """Coefficients of probes, each by itself, about a model with information A, (r, r), and solution y0, (r,).

    Returns
    -------
    Coefficients, (i, k), change of y against each, (r, i, k), and the Schur complement, (i, k, k).
    """
    r, i, k = P.shape
    X = np.asarray(np.linalg.solve(A, P.reshape(r, i * k)).reshape(r, i, k), dtype=np.float64)
    schur = C - np.einsum("rik,ril->ikl", P, X)
    squares = np.einsum("ikk->ik", C)
    size = np.sqrt(np.where(squares > _ROUNDING, squares, np.inf))
    values, vectors = np.linalg.eigh(schur / size[:, :, None] / size[:, None, :])
    inverse = np.where(values > _MIN_NEW_SHARE, 1 / np.maximum(values, _MIN_NEW_SHARE), 0.0)
    rhs = (h - np.einsum("rik,r->ik", P, y0)) / size
    c = np.einsum("ikl,il,iml,im->ik", vectors, inverse, vectors, rhs, optimize=True) / size
    return c, X, schur


def _feasible(probes: Sequence[Probe], c: Array) -> Mask:
    return np.array([probe.is_feasible(own) for probe, own in zip(probes, c, strict=True)], dtype=bool)

"""Screening of probes by what they explain of a `LinearizedFit`'s residual on blocks of time not used for fitting.

With the model's rows Q (n, r) by y and the probe's columns C (n, k), each block is left out in turn, and

    [Qᵀ Q + H   Qᵀ C] [y]   [Qᵀ e + g]
    [Cᵀ Q       Cᵀ C] [c] = [Cᵀ e    ]

is solved over the others by the Schur complement of the model: C is projected on what is orthogonal to Q and H. H and g
are the information and the pull of prior and constraints; at the optimum, g cancels Qᵀ e of all blocks. The sums over
rows are P = Qᵀ C, h = Cᵀ e and Cᵀ C.

Letters: F blocks; K coefficients of all probes one after the other, of which a probe has k; i probes of k coefficients.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.processes import in_processes, interleaved_shares
from idtool.data.column_cache import KeptColumns
from idtool.data.signals import Batch
from idtool.diagnosis.linearized_fit import FurtherDirections, LinearizedFit
from idtool.dynamics.effects.probe import Probe, joined_probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.estimation.dataset.experiment import Progress, tracked
from idtool.robot.config import EffectEntry

_MIN_PROBES_TO_SHARE = 32  # among processes: fewer take about as long as to start one
_MAX_NUMBERS = 1e7  # in memory at once
_MAX_COLUMNS = 128  # filtered together
_ROUNDING = 1e-18  # squared norm of a column, in units of the noise, up to which it is 0
_MIN_VARIANCE = 1e-200  # of a coefficient; it is 0 for a column that the model has too
_MIN_NEW_SHARE = 1e-5  # of a column's squared norm, that the model cannot reproduce


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
    failure
        Exception for which it could not be evaluated; None if it was.
    """

    probe: Probe
    c: Array
    covariance: Array
    gains: Array
    information: Array
    inflation: float
    failure: Exception | None = None

    @property
    def gain(self) -> float:
        """Reduction of the squared residual over all blocks."""
        return float(self.gains.sum())

    @property
    def standard_error(self) -> float:
        """Standard error of the gain, from the blocks."""
        return sum_standard_error(self.gains) if len(self.gains) > 1 else np.inf

    @property
    def is_possible(self) -> bool:
        """True if physics allows the coefficients and an effect has them."""
        return self.failure is None and self.probe.is_feasible(self.c) and self.entry is not None

    @cached_property
    def entry(self) -> EffectEntry | None:
        """Configuration entry; None if there is no such effect."""
        return self.probe.to_entry(self.c, self.information)

    def marginal_information(self, part: slice) -> Array:
        """Information of the data on some of the coefficients if the others are free too, shape (k, k) of these."""
        covariance = np.linalg.pinv(self.information)
        return np.asarray(np.linalg.pinv(covariance[part, part]))


def sum_standard_error(values: Array) -> float:
    """Standard error of the sum of independent values, shape (F,), from their scatter."""
    return float(np.sqrt(len(values)) * values.std(ddof=1))


class _Solution(NamedTuple):
    """A `ScreenedProbe` without the probe, whose functions cannot be sent between processes."""

    c: Array
    covariance: Array
    gains: Array
    information: Array
    inflation: float
    failure: Exception | None


@dataclass
class _ProbeSums:
    """Gram matrices of all probes, by block.

    Attributes
    ----------
    P
        Products of the model's rows with the columns, shape (F, r, K).
    h
        Products of the columns with the residual, shape (F, K).
    CC
        Products of each column with those of its own probe, shape (F, K, largest k); of pairs with all, (F, K, K).
    """

    P: Array
    h: Array
    CC: Array


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
    are_shared = len(probes) >= _MIN_PROBES_TO_SHARE
    shares = interleaved_shares(len(probes)) if are_shared else [range(len(probes))]

    def solutions_of(share: range, progress: Progress) -> list[_Solution]:
        solutions: list[_Solution] = []
        for group in _groups_in_memory(linearized, [probes[i] for i in share]):
            solutions += _solve_group(linearized, group, progress, stage)
        return solutions

    screened: dict[int, ScreenedProbe] = {}
    for share, solutions in zip(shares, in_processes(solutions_of, shares, progress), strict=True):
        for i, solution in zip(share, solutions, strict=True):
            screened[i] = ScreenedProbe(probes[i], *solution)
    return [screened[i] for i in range(len(probes))]


def screen_pairs(
    linearized: LinearizedFit,
    probes: Sequence[Probe],
    pairs: Sequence[tuple[int, int]],
    progress: Progress,
    stage: str = "screening candidates",
) -> list[ScreenedProbe]:
    """Screen probes two at a time, each pair as a `joined_probe`; the columns of each probe are evaluated once.

    Parameters
    ----------
    linearized
        The model whose residual they are to explain.
    probes
        The hypotheses.
    pairs
        Indices of the two probes of each pair.
    progress
        Callback for the stage and its progress, from 0 to 1.
    stage
        Name of this stage.

    Raises
    ------
    ArithmeticError, ValueError, RuntimeError
        If a probe cannot be evaluated.
    """
    starts = _coefficient_starts(probes)
    ranges = [np.arange(start, stop) for start, stop in pairwise(starts)]
    sums = _zero_sums(linearized, probes, products_per_column=int(starts[-1]))
    for rows in _rows_with_columns(linearized, probes, progress, stage):
        _add_all_products(sums, rows)
    joined = [joined_probe(probes[i], probes[j]) for i, j in pairs]
    coefficients = [np.concatenate([ranges[i], ranges[j]]) for i, j in pairs]
    solutions: dict[int, _Solution] = {}
    for own_pairs in _indices_by_size(joined).values():
        index = np.array([coefficients[n] for n in own_pairs])  # (i, k)
        P = sums.P[:, :, index]  # (F, r, i, k)
        h = sums.h[:, index]  # (F, i, k)
        CC = sums.CC[:, index[:, :, None], index[:, None, :]]  # (F, i, k, k)
        solved = _solve_same_size(linearized, [joined[n] for n in own_pairs], P, h, CC)
        solutions.update(zip(own_pairs, solved, strict=True))
    return [ScreenedProbe(probe, *solutions[n]) for n, probe in enumerate(joined)]


def with_free_parameters(linearized: LinearizedFit, probe: Probe, progress: Progress) -> LinearizedFit:
    """Fit with the coefficients of a probe as further parameters, which are free to first order.

    Screened against it, a candidate gains what it explains beside their best values. Without a column that the model
    cannot reproduce, it is the same fit. Letters as above; W whitens the further directions.
    """
    sums = _zero_sums(linearized, [probe], products_per_column=probe.coefficient_count)
    batch_columns = []
    for rows in _rows_with_columns(linearized, [probe], progress, "screening candidates"):
        _add_all_products(sums, rows)
        columns = np.zeros((len(rows.Q), probe.coefficient_count, len(rows.e[0])))
        for joint, (index, weighted) in rows.columns.items():
            columns[joint, index] = weighted
        batch_columns.append(columns)
    P, h, CC = sums.P, sums.h, sums.CC

    # whitened, and without what the model's own directions reproduce
    total_P = P.sum(axis=0)
    X = np.linalg.solve(linearized.information, total_P)
    information = CC.sum(axis=0) - total_P.T @ X
    size = np.sqrt(np.maximum(CC.sum(axis=0).diagonal(), _ROUNDING))
    values, vectors = np.linalg.eigh(information / size[:, None] / size)
    is_new = values > _MIN_NEW_SHARE
    if not is_new.any():
        return linearized
    W = vectors[:, is_new] / size[:, None] / np.sqrt(values[is_new])
    XW = X @ W

    gram = linearized.gram
    cross = P @ W - gram @ XW
    own = W.T @ CC @ W - np.swapaxes(P @ W, 1, 2) @ XW - XW.T @ (P @ W) + XW.T @ gram @ XW
    H = linearized.prior_information
    return replace(
        linearized,
        gram=np.block([[gram, cross], [np.swapaxes(cross, 1, 2), own]]),
        score=np.concatenate([linearized.score, h @ W - linearized.score @ XW], axis=1),
        prior_information=np.block([[H, -H @ XW], [-XW.T @ H, XW.T @ H @ XW]]),
        further=FurtherDirections(tuple(batch_columns), W, XW, h.sum(axis=0) @ W),
    )


def _solve_group(linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str) -> list[_Solution]:
    """Solve probes together; where that fails, halves of them, until the failing ones are found."""
    try:
        sums = _accumulate(linearized, probes, progress, stage)
        return _solve_all(linearized, probes, sums)
    except (ArithmeticError, ValueError, RuntimeError) as failure:
        if len(probes) == 1:
            return [_failed(linearized, probes[0], failure)]
    half = len(probes) // 2
    first = _solve_group(linearized, probes[:half], progress, stage)
    return first + _solve_group(linearized, probes[half:], progress, stage)


def _failed(linearized: LinearizedFit, probe: Probe, failure: Exception) -> _Solution:
    """Solution of a probe that could not be evaluated: it explains nothing."""
    k = probe.coefficient_count
    none = np.zeros((k, k))
    return _Solution(np.zeros(k), none, np.zeros(linearized.block_count), none, np.nan, failure)


def _groups_in_memory(linearized: LinearizedFit, probes: Sequence[Probe]) -> Iterator[list[Probe]]:
    """Probes in groups whose sums fit into memory."""
    numbers_per_coefficient = linearized.block_count * len(linearized.information)
    group: list[Probe] = []
    numbers = 0
    for probe in probes:
        group.append(probe)
        numbers += numbers_per_coefficient * probe.coefficient_count
        if numbers > _MAX_NUMBERS:
            yield group
            group = []
            numbers = 0
    if group:
        yield group


def _coefficient_starts(probes: Sequence[Probe]) -> Indices:
    """Index of each probe's first coefficient, and the number K of all."""
    return np.cumsum([0, *(probe.coefficient_count for probe in probes)])


def _accumulate(linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str) -> _ProbeSums:
    """Gram matrices of the probes over the training data."""
    starts = _coefficient_starts(probes)
    max_k = max(probe.coefficient_count for probe in probes)
    sums = _zero_sums(linearized, probes, products_per_column=max_k)
    for batch, model, block_index, number in _training_batches(linearized, progress, stage):
        Q, e, valid = _model_rows(linearized, batch, number)
        blocks = _block_slices(block_index)
        for joint, index, filtered in _probe_columns(probes, starts, batch, model):
            columns = filtered * (valid[joint] / linearized.noise[joint])
            probe_rows = _rows_by_probe(starts, index)
            for f, part in blocks:
                x = columns[:, part]
                sums.P[f][:, index] += Q[joint][:, part] @ x.T
                sums.h[f, index] += x @ e[joint][part]
                for rows in probe_rows:
                    own = x[rows]  # (i, k, n)
                    sums.CC[f, index[rows], : rows.shape[1]] += own @ own.transpose(0, 2, 1)
    return sums


def _zero_sums(linearized: LinearizedFit, probes: Sequence[Probe], products_per_column: int) -> _ProbeSums:
    """Gram matrices of no rows yet."""
    F, r, K = linearized.block_count, len(linearized.information), int(_coefficient_starts(probes)[-1])
    return _ProbeSums(np.zeros((F, r, K)), np.zeros((F, K)), np.zeros((F, K, products_per_column)))


class _WeightedRows(NamedTuple):
    """Rows of a batch, in units of the noise; those that do not count are 0.

    Attributes
    ----------
    Q, e
        By joint: the model's rows by y, (r, n), and the residual, (n,).
    blocks
        Number of each block, and its range among the n samples.
    columns
        Joint to indices of coefficients, shape (m,), and their columns, (m, n).
    """

    Q: list[Array]
    e: list[Array]
    blocks: list[tuple[int, slice]]
    columns: dict[int, tuple[Indices, Array]]


def _rows_with_columns(
    linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str
) -> Iterator[_WeightedRows]:
    """The model's rows with all columns of some probes, batch after batch of the training data.

    For a number of probes whose columns of a batch fit in memory; `_accumulate` is for any number.
    """
    starts = _coefficient_starts(probes)
    for batch, model, block_index, number in _training_batches(linearized, progress, stage):
        Q, e, valid = _model_rows(linearized, batch, number)
        parts: dict[int, list[tuple[Indices, Array]]] = {}
        for joint, index, filtered in _probe_columns(probes, starts, batch, model):
            parts.setdefault(joint, []).append((index, filtered * (valid[joint] / linearized.noise[joint])))
        columns = {}
        for joint, own_parts in parts.items():
            indices, weighted = zip(*own_parts, strict=True)
            columns[joint] = np.concatenate(indices), np.concatenate(weighted)
        yield _WeightedRows(Q, e, _block_slices(block_index), columns)


def _add_all_products(sums: _ProbeSums, rows: _WeightedRows) -> None:
    """Add a batch to the Gram matrices, with the products of each column with all others."""
    for joint, (index, columns) in rows.columns.items():
        for f, part in rows.blocks:
            x = columns[:, part]
            sums.P[f][:, index] += rows.Q[joint][:, part] @ x.T
            sums.h[f, index] += x @ rows.e[joint][part]
            sums.CC[f][np.ix_(index, index)] += x @ x.T


def _block_slices(block_index: Indices) -> list[tuple[int, slice]]:
    """Number of each block in a batch, and its range among the batch's filtered samples.

    Parameters
    ----------
    block_index
        Block of each filtered sample, ascending, shape (n,).
    """
    firsts = np.flatnonzero(np.diff(block_index, prepend=-1))
    stops = [*firsts[1:], len(block_index)]
    return [(int(block_index[first]), slice(first, stop)) for first, stop in zip(firsts, stops, strict=True)]


def _rows_by_probe(starts: Indices, index: Indices) -> list[Indices]:
    """Rows of some columns that belong to one probe, shape (i, k) for each number of coefficients k.

    Parameters
    ----------
    starts
        Index of each probe's first coefficient.
    index
        Index of each column's coefficient; those of one probe are next to each other.
    """
    first_rows = np.flatnonzero(np.isin(index, starts[:-1]))
    sizes = np.diff(starts)[np.searchsorted(starts, index[first_rows])]
    return [first_rows[sizes == k, None] + np.arange(k) for k in np.unique(sizes)]


def _training_batches(
    linearized: LinearizedFit, progress: Progress, stage: str
) -> Iterator[tuple[Batch, LinearizedModel, Indices, int]]:
    """Batches of the training data, the model along each, the block of each filtered sample, and the batch's number."""
    first_block = 0
    number = 0
    for run in linearized.experiment.runs:
        if not run.train:
            continue
        row = 0
        for batch in tracked(linearized.experiment.batches(run, held_out=False), run.train, progress, stage):
            model = LinearizedModel(linearized.experiment.equation, linearized.theta, batch.motion)
            rows = row + np.arange(len(batch.t))
            yield batch, model, first_block + rows // linearized.block_length, number
            row += len(batch.t)
            number += 1
        first_block += -(-row // linearized.block_length)


def _model_rows(linearized: LinearizedFit, batch: Batch, number: int) -> tuple[list[Array], list[Array], list[Array]]:
    """By joint: the model's rows by y, (r, n), the residual, (n,), and 1 for each sample that counts, (n,)."""
    equation = linearized.experiment.equation
    masks = linearized.row_equation.clean_samples(batch, linearized.reversal_margin)
    Q, e, valid = [], [], []
    for j, (active, block) in enumerate(zip(equation.active(), equation.filtered_columns(batch), strict=True)):
        weight = masks[j] / linearized.noise[j]
        own_rows = linearized.directions[active].T @ (block[:-1] * weight)
        if linearized.further is not None:
            own_rows = np.concatenate([own_rows, linearized.further.rows(number, j, own_rows)])
        Q.append(own_rows)
        e.append((block[-1] - linearized.theta[active] @ block[:-1]) * weight)
        valid.append(masks[j].astype(float))
    return Q, e, valid


def _probe_columns(
    probes: Sequence[Probe], starts: Indices, batch: Batch, model: LinearizedModel
) -> Iterator[tuple[int, Indices, Array]]:
    """Joint, indices of coefficients, and their filtered columns, shape (m, n), a bounded number m at a time.

    Columns that are kept from an earlier model are not evaluated again.
    """
    motion = model.true_motion
    kept = motion.kept_columns
    if kept is not None and not kept.are_along(motion.q, motion.v, motion.a):
        kept = None
    known: dict[int, list[tuple[int, Array]]] = {}  # by joint: first coefficient and filtered columns
    waiting: dict[int, list[tuple[int, Array]]] = {}  # likewise, unfiltered
    waiting_count: Counter[int] = Counter()
    keys: dict[int, Hashable] = {}  # by first coefficient, of columns that are to be kept
    for start, probe in zip(starts[:-1].tolist(), probes, strict=True):
        if kept is not None and probe.column_key is not None:
            found = kept.find(probe.column_key)
            if found is not None:
                (columns,) = found
                joint = model.equation.joints.index(str(probe.joint))
                known.setdefault(joint, []).append((start, columns))
                continue
            keys[start] = probe.column_key
        for joint, columns in probe.columns(motion, model).items():
            waiting.setdefault(joint, []).append((start, columns))
            waiting_count[joint] += len(columns)
            if waiting_count[joint] >= _MAX_COLUMNS:
                yield joint, *_filtered(waiting.pop(joint), batch, kept, keys)
                waiting_count[joint] = 0
    for joint, own in waiting.items():
        yield joint, *_filtered(own, batch, kept, keys)
    for joint, own in known.items():
        yield joint, _indices(own), np.concatenate([columns for _, columns in own])


def _filtered(
    started_columns: list[tuple[int, Array]], batch: Batch, kept: KeptColumns | None, keys: Mapping[int, Hashable]
) -> tuple[Indices, Array]:
    """Indices of coefficients and their filtered columns, from the first index and the columns of each probe."""
    filtered = batch.filter(np.concatenate([columns for _, columns in started_columns]))
    first = 0
    for start, columns in started_columns:
        if kept is not None and start in keys:
            kept.keep(keys[start], (filtered[first : first + len(columns)].copy(),))
        first += len(columns)
    return _indices(started_columns), filtered


def _indices(started_columns: list[tuple[int, Array]]) -> Indices:
    """Indices of the coefficients, from the first index and the columns of each probe."""
    return np.concatenate([start + np.arange(len(columns)) for start, columns in started_columns])


def _solve_all(linearized: LinearizedFit, probes: Sequence[Probe], sums: _ProbeSums) -> list[_Solution]:
    """All probes solved, those with the same number of coefficients together."""
    starts = _coefficient_starts(probes)
    solutions: dict[int, _Solution] = {}
    for k, own_probes in _indices_by_size(probes).items():
        index = np.array([np.arange(starts[i], starts[i] + k) for i in own_probes])  # (i, k)
        P = sums.P[:, :, index]  # (F, r, i, k)
        h = sums.h[:, index]  # (F, i, k)
        CC = sums.CC[:, index, :k]  # (F, i, k, k)
        solved = _solve_same_size(linearized, [probes[i] for i in own_probes], P, h, CC)
        solutions.update(zip(own_probes, solved, strict=True))
    return [solutions[i] for i in range(len(probes))]


def _indices_by_size(probes: Sequence[Probe]) -> dict[int, list[int]]:
    """Indices of the probes with each number of coefficients."""
    indices: dict[int, list[int]] = {}
    for i, probe in enumerate(probes):
        indices.setdefault(probe.coefficient_count, []).append(i)
    return indices


def _solve_same_size(
    linearized: LinearizedFit, probes: Sequence[Probe], block_P: Array, block_h: Array, block_CC: Array
) -> list[_Solution]:
    """Solve probes of k coefficients each.

    Parameters
    ----------
    linearized
        The model.
    probes
        The probes.
    block_P, block_h, block_CC
        Gram matrices as in `_ProbeSums`, shape (F, r, i, k), (F, i, k) and (F, i, k, k).
    """
    F = linearized.block_count
    P = block_P.sum(axis=0)
    h = block_h.sum(axis=0)
    CC = block_CC.sum(axis=0)
    shift = np.asarray(np.linalg.solve(linearized.information, linearized.total_score), dtype=np.float64)
    c, _, schur = _solve(linearized.information, P, h, CC, shift)

    k = c.shape[1]
    lower = np.array([probe.lower or (-np.inf,) * k for probe in probes])
    upper = np.array([probe.upper or (np.inf,) * k for probe in probes])
    local_probes = [i for i, probe in enumerate(probes) if probe.is_local]
    c_without = np.empty((F, *c.shape))  # coefficients without each block
    gains = np.empty((F, len(c)))
    for f in range(F):
        P_f, h_f, CC_f = block_P[f], block_h[f], block_CC[f]
        y0 = linearized.jackknife_shift[f]
        c_f, X, _ = _solve(linearized.information_without(f), P - P_f, h - h_f, CC - CC_f, y0)
        is_within_bounds = np.logical_and(c_f >= lower, c_f <= upper).all(axis=1, keepdims=True)
        c_f = np.where(is_within_bounds, c_f, 0.0)  # what physics forbids explains nothing
        c_f[local_probes] = c[local_probes]  # other blocks tell nothing of them
        c_without[f] = c_f
        dy = -np.einsum("rik,ik->ri", X, c_f)
        gains[f] = _block_gain(linearized, f, P_f, h_f, CC_f, c_f, dy)

    deviation = c_without - c_without.mean(axis=0)
    covariance = (F - 1) / F * np.einsum("fik,fil->ikl", deviation, deviation)
    inflation = _inflation(covariance, schur)
    return [
        _Solution(c[i], covariance[i], gains[:, i], schur[i], float(inflation[i]), None) for i in range(len(probes))
    ]


def _inflation(covariance: Array, information: Array) -> Array:
    """Ratio of the coefficients' variances to those of independent rows, mean of each probe, shape (i,).

    Parameters
    ----------
    covariance, information
        Covariance of the coefficients, and information of the data on them, shape (i, k, k).
    """
    variance = np.einsum("ikk->ik", covariance)
    independent_variance = np.einsum("ikk->ik", np.linalg.pinv(information))
    is_determined = independent_variance > _MIN_VARIANCE
    return np.asarray((variance / np.where(is_determined, independent_variance, np.inf)).mean(axis=1))


def _block_gain(linearized: LinearizedFit, f: int, P: Array, h: Array, CC: Array, c: Array, dy: Array) -> Array:
    """Reduction of a block's squared residual by each probe, ‖e − Q y0‖² − ‖e − Q (y0 + dy) − C c‖², shape (i,).

    Parameters
    ----------
    linearized
        The model, fitted to the other blocks at y0.
    f
        Number of the block.
    P, h, CC
        Sums over the block's rows, shape (r, i, k), (i, k) and (i, k, k).
    c, dy
        Coefficients of each probe, shape (i, k), and the change of y by it, shape (r, i).
    """
    y0 = linearized.jackknife_shift[f]
    gram = linearized.gram[f]
    model_score = linearized.score[f] - gram @ y0
    probe_score = h - np.einsum("rik,r->ik", P, y0)
    cross = np.einsum("rik,ik->ri", P, c)
    return np.asarray(
        2 * (dy * model_score[:, None]).sum(axis=0)
        + 2 * (c * probe_score).sum(axis=1)
        - (dy * (gram @ dy)).sum(axis=0)
        - 2 * (dy * cross).sum(axis=0)
        - np.einsum("ik,ikl,il->i", c, CC, c)
    )


def _solve(A: Array, P: Array, h: Array, CC: Array, y0: Array) -> tuple[Array, Array, Array]:
    """Coefficients of probes, each by itself, about a model with information A, (r, r), and solution y0, (r,).

    Combinations of columns that the model can reproduce get no coefficient.

    Returns
    -------
    Coefficients c, shape (i, k); X = A⁻¹ P, (r, i, k), by which y changes by −X c; and the Schur complement, (i, k, k).
    """
    r, i, k = P.shape
    X = np.asarray(np.linalg.solve(A, P.reshape(r, i * k)).reshape(r, i, k), dtype=np.float64)
    schur = CC - np.einsum("rik,ril->ikl", P, X)
    squares = np.einsum("ikk->ik", CC)
    size = np.sqrt(np.where(squares > _ROUNDING, squares, np.inf))
    values, vectors = np.linalg.eigh(schur / size[:, :, None] / size[:, None, :])
    inverse = np.where(values > _MIN_NEW_SHARE, 1 / np.maximum(values, _MIN_NEW_SHARE), 0.0)
    scaled_score = (h - np.einsum("rik,r->ik", P, y0)) / size
    c = np.einsum("ikl,il,iml,im->ik", vectors, inverse, vectors, scaled_score, optimize=True) / size
    return c, X, schur

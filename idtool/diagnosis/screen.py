"""Screening of probes by what they explain of a `LinearizedFit`'s residual on blocks of time not used for fitting.

With the model's rows Q (n, r) by y and the probe's columns C (n, k), each block is left out in turn, and

    [Qᵀ Q + H   Qᵀ C] [y]   [Qᵀ e + g]
    [Cᵀ Q       Cᵀ C] [c] = [Cᵀ e    ]

is solved over the other blocks. H and g are the information and the pull of prior and constraints; g cancels the sum of
Qᵀ e over all blocks, since the model is at its optimum. y is eliminated by the Schur complement: only the part of C
counts that the model cannot reproduce. The sums over rows are P = Qᵀ C, h = Cᵀ e and CC = Cᵀ C.

Letters: F blocks; n samples; r directions y of the model; i probes of k coefficients; K coefficients of all probes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.processes import in_processes, interleaved_shares
from idtool.data.column_cache import IdentityKey, KeptColumns
from idtool.data.signals import Batch, Motion
from idtool.diagnosis.linearized_fit import FurtherDirections, LinearizedFit
from idtool.dynamics.effects.probe import Probe, joined_probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.row_filter import RowFilter, SeparateRows
from idtool.estimation.dataset.experiment import Progress, tracked
from idtool.robot.config import EffectEntry

_STAGE = "screening candidates"
_MIN_PROBES_TO_SHARE = 32  # among processes: fewer take about as long as to start one
_MAX_NUMBERS = 1e7  # in memory at once, about
_MAX_COLUMNS = 128  # filtered together
_MAX_MODELS = 8  # along a batch each, that are kept
_ROUNDING = 1e-18  # squared norm of a column, in units of the noise, up to which it is 0
_MIN_VARIANCE = 1e-200  # of a coefficient; it is 0 for a column that the model has too
_MIN_NEW_SHARE = 1e-5  # of a column's squared norm, that the model cannot reproduce


@dataclass(frozen=True, eq=False)
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
        Reduction of each block's squared residual, with model and probe fitted to the other blocks, in units of the
        noise variance, shape (F,).
    information
        Information of the data on the coefficients if the model's are free too, shape (k, k): a Schur complement.
    inflation
        Ratio of the coefficients' variance over blocks to that for independent rows.
    failure
        Exception because of which it could not be evaluated; None if it could.
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
        return sum_standard_error(self.gains)

    @property
    def is_possible(self) -> bool:
        """True if physics allows the coefficients and an effect has them."""
        return self.failure is None and self.probe.is_feasible(self.c) and self.entry is not None

    @cached_property
    def entry(self) -> EffectEntry | None:
        """Configuration entry; None if there is no such effect."""
        return self.probe.to_entry(self.c, self.information)

    def marginal_information(self, part: slice) -> Array:
        """Information of the data on the m coefficients in ``part`` if the others are free too, shape (m, m)."""
        covariance = np.linalg.pinv(self.information)
        return np.asarray(np.linalg.pinv(covariance[part, part]))


def sum_standard_error(values: Array) -> float:
    """Standard error of the sum of independent values, shape (F,), from their scatter; infinite for a single one."""
    if len(values) < 2:
        return np.inf
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
    linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str = _STAGE
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
    stage: str = _STAGE,
) -> list[ScreenedProbe]:
    """Screen pairs of probes, each as a `joined_probe`; the columns of each probe are evaluated once.

    Bounds of the coefficients do not count: a joined probe has none.

    Parameters
    ----------
    linearized, probes, progress, stage
        As for `screen_probes`.
    pairs
        Indices of the two probes of each pair.

    Raises
    ------
    ArithmeticError, ValueError, RuntimeError
        If any of the probes cannot be evaluated.
    """
    sums = _zero_sums(linearized, probes, products_per_column=int(_coefficient_starts(probes)[-1]))
    for rows in _weighted_batches(linearized, probes, progress, stage):
        _add_with_cross_products(sums, rows)

    def products_between(index: Indices) -> Array:
        return sums.CC[:, index[:, :, None], index[:, None, :]]

    ranges = _coefficient_ranges(probes)
    coefficients = [np.concatenate([ranges[i], ranges[j]]) for i, j in pairs]
    joined = [joined_probe(probes[i], probes[j]) for i, j in pairs]
    solutions = _solve_all(linearized, joined, sums, coefficients, products_between)
    return [ScreenedProbe(probe, *solution) for probe, solution in zip(joined, solutions, strict=True)]


def with_free_parameters(linearized: LinearizedFit, probe: Probe, progress: Progress) -> LinearizedFit:
    """Fit in which the coefficients of a probe are free too, to first order.

    Screened against it, a candidate gains only what they cannot explain. If the model can reproduce all columns of the
    probe, the fit is returned as it is.

    Parameters
    ----------
    linearized
        The fit, without `FurtherDirections`.
    probe
        The probe.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    sums = _zero_sums(linearized, [probe], products_per_column=probe.coefficient_count)
    batch_columns = []
    for rows in _weighted_batches(linearized, [probe], progress, _STAGE):
        _add_with_cross_products(sums, rows)
        columns = np.zeros((len(rows.Q), probe.coefficient_count, len(rows.e[0])))
        for joint, (index, weighted) in rows.columns.items():
            columns[joint, index] = weighted
        batch_columns.append(columns)
    P, h, CC = sums.P, sums.h, sums.CC

    # W whitens the new directions; X is what the model's own reproduce of them
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
    PW = P @ W
    overlap = np.swapaxes(PW, 1, 2) @ XW
    cross = PW - gram @ XW
    own = W.T @ CC @ W - overlap - np.swapaxes(overlap, 1, 2) + XW.T @ gram @ XW
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
        sums = _sums_by_probe(linearized, probes, progress, stage)

        def own_products(index: Indices) -> Array:
            return sums.CC[:, index, : index.shape[1]]

        return _solve_all(linearized, probes, sums, _coefficient_ranges(probes), own_products)
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


def _coefficient_ranges(probes: Sequence[Probe]) -> list[Indices]:
    """Indices of each probe's coefficients, shape (k,)."""
    return [np.arange(start, stop) for start, stop in pairwise(_coefficient_starts(probes))]


def _sums_by_probe(linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str) -> _ProbeSums:
    """Gram matrices of the probes over the training data, each column with those of its own probe."""
    starts = _coefficient_starts(probes)
    max_k = max(probe.coefficient_count for probe in probes)
    sums = _zero_sums(linearized, probes, products_per_column=max_k)
    for batch, model, block_index, number in _training_batches(linearized, progress, stage):
        row_filter = _row_filter(linearized, batch)
        Q, e = _model_rows(linearized, row_filter, number)
        blocks = _block_slices(block_index)
        for rows, index, columns in _weighted_columns(linearized, probes, row_filter, model):
            own_places = _places_by_probe(starts, index)
            for f, part in blocks:
                x = _one_after_the_other(columns[:, :, part])
                own_Q = np.concatenate([Q[row][:, part] for row in rows], axis=1)
                own_e = np.concatenate([e[row][part] for row in rows])
                _add_products_with_model(sums, f, index, own_Q, own_e, x)
                for places in own_places:
                    k = places.shape[1]
                    own = x[places]  # (i, k, samples)
                    sums.CC[f, index[places], :k] += own @ own.transpose(0, 2, 1)
    return sums


def _one_after_the_other(columns: Array) -> Array:
    """Columns in several rows of the equation, shape (rows, m, n), with the rows' samples in one row, (m, rows · n)."""
    rows, m, n = columns.shape
    return columns.transpose(1, 0, 2).reshape(m, rows * n)


def _weighted_columns(
    linearized: LinearizedFit, probes: Sequence[Probe], row_filter: RowFilter, model: LinearizedModel
) -> Iterator[tuple[Indices, Indices, Array]]:
    """`_probe_columns` in units of the noise; 0 at samples that do not count."""
    weights = np.stack([_weight(linearized, row_filter, row) for row in range(linearized.joint_count)])
    for rows, index, filtered in _probe_columns(probes, _coefficient_starts(probes), row_filter, model):
        yield rows, index, filtered * weights[rows, None]


def _row_filter(linearized: LinearizedFit, batch: Batch) -> RowFilter:
    """Filter of a batch's rows, of which those count that the fit counts."""
    return linearized.experiment.equation.row_filter(batch, linearized.row_equation, linearized.reversal_margin)


def _weight(linearized: LinearizedFit, row_filter: RowFilter, joint: int) -> Array:
    """Inverse noise of a joint's samples, 0 at those that do not count, shape (n,)."""
    return np.asarray((row_filter.shares[joint] > 0) / linearized.noise[joint])


def _add_products_with_model(sums: _ProbeSums, f: int, index: Indices, Q: Array, e: Array, columns: Array) -> None:
    """Add the products of columns, (m, n), with the model's rows, (r, n), and the residual, (n,), in block f."""
    sums.P[f][:, index] += Q @ columns.T
    sums.h[f, index] += columns @ e


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


def _weighted_batches(
    linearized: LinearizedFit, probes: Sequence[Probe], progress: Progress, stage: str
) -> Iterator[_WeightedRows]:
    """Batches of the training data: the model's rows and all columns of the probes, in units of the noise.

    All columns of a batch are in memory together: this is for few probes, and `_sums_by_probe` for any number.
    """
    for batch, model, block_index, number in _training_batches(linearized, progress, stage):
        row_filter = _row_filter(linearized, batch)
        Q, e = _model_rows(linearized, row_filter, number)
        parts: dict[int, list[tuple[Indices, Array]]] = {}
        for rows, index, columns_in_rows in _weighted_columns(linearized, probes, row_filter, model):
            for row, own_columns in zip(rows.tolist(), columns_in_rows, strict=True):
                parts.setdefault(row, []).append((index, own_columns))
        columns = {}
        for joint, own_parts in parts.items():
            indices, weighted = zip(*own_parts, strict=True)
            columns[joint] = np.concatenate(indices), np.concatenate(weighted)
        yield _WeightedRows(Q, e, _block_slices(block_index), columns)


def _add_with_cross_products(sums: _ProbeSums, rows: _WeightedRows) -> None:
    """Add a batch to the Gram matrices, with the products of each column with all others."""
    for joint, (index, columns) in rows.columns.items():
        for f, part in rows.blocks:
            x = columns[:, part]
            _add_products_with_model(sums, f, index, rows.Q[joint][:, part], rows.e[joint][part], x)
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


def _places_by_probe(starts: Indices, index: Indices) -> list[Indices]:
    """Places of each probe's columns among some columns, shape (i, k) for each number of coefficients k.

    Parameters
    ----------
    starts
        Index of each probe's first coefficient.
    index
        Index of each column's coefficient; those of one probe are next to each other.
    """
    is_first = np.isin(index, starts[:-1])
    first_rows = np.flatnonzero(is_first)
    probe_numbers = np.searchsorted(starts, index[first_rows])
    sizes = np.diff(starts)[probe_numbers]
    rows_by_size = []
    for k in np.unique(sizes):
        first_of_size = first_rows[sizes == k]
        rows_by_size.append(first_of_size[:, None] + np.arange(k))
    return rows_by_size


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
            model = _model_along(
                IdentityKey(linearized.experiment.equation), IdentityKey(linearized.theta), IdentityKey(batch.motion)
            )
            rows = row + np.arange(len(batch.t))
            yield batch, model, first_block + rows // linearized.block_length, number
            row += len(batch.t)
            number += 1
        first_block += math.ceil(row / linearized.block_length)


@lru_cache(_MAX_MODELS)
def _model_along(
    equation: IdentityKey[LinearModel], theta: IdentityKey[Array], motion: IdentityKey[Motion]
) -> LinearizedModel:
    """Model with its coefficients along a motion; the latest are kept, since they are screened against repeatedly."""
    return LinearizedModel(equation.owner, theta.owner, motion.owner)


def _model_rows(linearized: LinearizedFit, row_filter: RowFilter, number: int) -> tuple[list[Array], list[Array]]:
    """By joint: the model's rows by y, (r, n), and the residual, (n,), of the batch with a number."""
    equation = linearized.experiment.equation
    blocks = equation.filtered_columns(row_filter.batch, row_filter)
    Q, e = [], []
    for j, (active, block) in enumerate(zip(equation.active(), blocks, strict=True)):
        weight = _weight(linearized, row_filter, j)
        own_rows = linearized.directions[active].T @ (block[:-1] * weight)
        if linearized.further is not None:
            own_rows = np.concatenate([own_rows, linearized.further.rows(number, j, own_rows)])
        Q.append(own_rows)
        e.append((block[-1] - linearized.theta[active] @ block[:-1]) * weight)
    return Q, e


def _probe_columns(
    probes: Sequence[Probe], starts: Indices, row_filter: RowFilter, model: LinearizedModel
) -> Iterator[tuple[Indices, Indices, Array]]:
    """Rows of the equation, indices of coefficients, and their filtered columns in these rows, shape (rows, m, n).

    All that a coefficient has in a row comes at once. A bounded number of columns is evaluated at a time. With a fixed
    base, those that are kept from an earlier model are not evaluated again, and come all together.
    """
    motion = model.true_motion
    are_rows_separate = isinstance(row_filter, SeparateRows)
    kept = motion.kept_columns
    if kept is not None and not kept.are_along(motion.q, motion.v, motion.a):
        kept = None
    if not are_rows_separate:  # columns of all rows would take too much memory
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
        by_joint = probe.columns(motion, model)
        if len(by_joint) > 1 and not are_rows_separate:
            yield _filtered_together(start, by_joint, row_filter)
            continue
        for joint, columns in by_joint.items():
            waiting.setdefault(joint, []).append((start, columns))
            waiting_count[joint] += len(columns)
            if waiting_count[joint] >= _MAX_COLUMNS:
                yield _filtered(joint, waiting.pop(joint), row_filter, kept, keys)
                waiting_count[joint] = 0
    for joint, own in waiting.items():
        yield _filtered(joint, own, row_filter, kept, keys)
    for joint, own in known.items():
        yield np.array([joint]), _indices(own), np.concatenate([columns for _, columns in own])[None]


def _filtered(
    joint: int,
    started_columns: list[tuple[int, Array]],
    row_filter: RowFilter,
    kept: KeptColumns | None,
    keys: Mapping[int, Hashable],
) -> tuple[Indices, Indices, Array]:
    """Columns of a joint's equation, filtered, in all rows in which they appear; see `_probe_columns`.

    Parameters
    ----------
    joint
        The joint.
    started_columns
        First index and columns of each probe.
    row_filter
        What takes them to the band.
    kept, keys
        Where filtered columns are kept, and under which keys, by first index.
    """
    columns = np.concatenate([columns for _, columns in started_columns])
    rows, filtered = row_filter.filter_columns(np.array([joint]), columns[None])
    if kept is not None:
        _keep(started_columns, filtered[0], kept, keys)
    return rows, _indices(started_columns), filtered


def _filtered_together(
    start: int, by_joint: Mapping[int, Array], row_filter: RowFilter
) -> tuple[Indices, Indices, Array]:
    """Columns of a probe in several equations, filtered, of which each may appear in all rows; see `_probe_columns`.

    Parameters
    ----------
    start
        Index of the probe's first coefficient.
    by_joint
        Its columns in the equation of each joint, shape (k, N).
    row_filter
        What takes them to the band.
    """
    columns = np.stack(list(by_joint.values()))
    rows, filtered = row_filter.filter_columns(np.array(list(by_joint)), columns)
    return rows, start + np.arange(columns.shape[1]), filtered


def _keep(
    started_columns: list[tuple[int, Array]], filtered: Array, kept: KeptColumns, keys: Mapping[int, Hashable]
) -> None:
    """Keep the filtered columns of the probes that have a key."""
    first = 0
    for start, columns in started_columns:
        if start in keys:
            kept.keep(keys[start], (filtered[first : first + len(columns)].copy(),))
        first += len(columns)


def _indices(started_columns: list[tuple[int, Array]]) -> Indices:
    """Indices of the coefficients, from the first index and the columns of each probe."""
    return np.concatenate([start + np.arange(len(columns)) for start, columns in started_columns])


def _solve_all(
    linearized: LinearizedFit,
    probes: Sequence[Probe],
    sums: _ProbeSums,
    coefficients: Sequence[Indices],
    products_of: Callable[[Indices], Array],
) -> list[_Solution]:
    """All probes solved, those with the same number of coefficients together.

    Parameters
    ----------
    linearized, probes, sums
        The model, the probes, and their Gram matrices.
    coefficients
        Indices of each probe's coefficients in the sums, shape (k,).
    products_of
        The products of each probe's columns, shape (F, i, k, k), by their indices, shape (i, k).
    """
    solutions: dict[int, _Solution] = {}
    for own_probes in _indices_by_size(probes).values():
        index = np.array([coefficients[n] for n in own_probes])  # (i, k)
        P = sums.P[:, :, index]  # (F, r, i, k)
        h = sums.h[:, index]  # (F, i, k)
        CC = products_of(index)
        solved = _solve_same_size(linearized, [probes[n] for n in own_probes], P, h, CC)
        solutions.update(zip(own_probes, solved, strict=True))
    return [solutions[n] for n in range(len(probes))]


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
    linearized, probes
        The model, and the probes.
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
    is_new = values > _MIN_NEW_SHARE
    inverse = np.where(is_new, 1 / np.maximum(values, _MIN_NEW_SHARE), 0.0)
    scaled_score = (h - np.einsum("rik,r->ik", P, y0)) / size
    c = np.einsum("ikl,il,iml,im->ik", vectors, inverse, vectors, scaled_score, optimize=True) / size
    new_share = np.einsum("ikl,il->ik", vectors**2, is_new)
    return np.where(new_share > _MIN_NEW_SHARE, c, 0.0), X, schur

"""Logs → `ReducedPart`s, in one pass: all that a fit and its evaluation need of logs of any length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.data.batches import Batches
from idtool.data.excerpt import excerpt_of, seconds_that_fit
from idtool.data.logs import JointLog
from idtool.data.signals import Batch
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.regrouping import regrouped
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.blocks import (
    Blocks,
    block_rows,
    cut_into_blocks,
    merge_reductions,
    merged_blocks,
    most_blocks,
    rounded_count,
)
from idtool.estimation.dataset.drawn_rows import DrawnRows, log_identity, row_keys, uniform_draw
from idtool.estimation.dataset.envelope import Envelope
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.extreme_rows import ROWS_PER_BIN
from idtool.estimation.dataset.passes import LogPart, read_through
from idtool.estimation.dataset.reduced_part import ReducedPart
from idtool.estimation.dataset.reduction import Reduction

_CURVE_BYTES = 16 << 20  # that the rows which curves are drawn from may take, of all logs
_SERIES_BYTES = 8 << 20  # that consecutive rows may take, of all logs
_DRAWN_BYTES = 8 << 20  # that rows drawn at random may take, of all logs
_DRAWN_ROWS = (64, 4096)  # fewest, however much memory they take, and most rows drawn at random from a log
_BINS = (24, 2000)  # fewest and most stretches of time in the curves of a log
_MIN_SERIES_ROWS = 256  # of a log, however much memory they take
_EXCERPT_BYTES = 32 << 20  # that excerpts may take, of all logs
_EXCERPT_SECONDS = (30.0, 180.0)  # shortest, however much memory it takes, and longest excerpt, of all logs
_WINDOW_SECONDS = 5.0  # of an excerpt: each log has one at least


@dataclass(frozen=True)
class ReducedLog:
    """R-factors and other data that are kept of a log.

    Attributes
    ----------
    path
        The file or folder that was read.
    unknown_torque
        Joints whose torque was not logged.
    has_commands
        True if the torque of a joint is that of a controller under the logged command.
    row_step
        Time from one row to the next [s].
    block_rows
        Number of rows in a block of time.
    train, held_out
        Its parts for fitting and for validation, in the order of time.
    excerpt
        Windows of its samples as logged; None: they are not kept, or not read.
    """

    path: Path
    unknown_torque: tuple[str, ...]
    has_commands: bool
    row_step: float
    block_rows: int
    train: tuple[ReducedPart, ...]
    held_out: tuple[ReducedPart, ...]
    excerpt: JointLog | None = None

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return self.path.name

    def parts(self, held_out: bool) -> tuple[ReducedPart, ...]:
        """The parts for validation, or those for fitting."""
        return self.held_out if held_out else self.train


def is_reducible(experiment: Experiment) -> bool:
    """True if one pass over the logs is enough for the errors of all models, and is the fastest way to them.

    For robots with contacts, it is faster to project torques than columns. A diagnosis, which keeps batches, compares
    errors second by second.
    """
    equation = experiment.equation
    is_linear = not (equation.depends_on_parameters or equation.has_sensors)
    sensors = experiment.config.wrench_sensors
    has_coefficients_of_logs = any(sensor.has_offset_by_log or sensor.has_drift for sensor in sensors)
    is_diagnosis = experiment.cache is not None
    return is_linear and equation.contacts is None and not has_coefficients_of_logs and not is_diagnosis


def reduce_logs(
    experiment: Experiment,
    progress: Progress,
    log_count: int | None = None,
    divides_held_out: bool = False,
    draws_rows: bool = False,
    keeps_excerpts: bool = False,
) -> tuple[ReducedLog, ...]:
    """Reduce logs in one pass.

    Parameters
    ----------
    experiment
        Model and data; see `is_reducible`.
    progress
        Callback for the stage and its progress, from 0 to 1.
    log_count
        Number of logs that are used together, of which these are some: what is kept of each depends on it. Logs that
        are reduced one by one, on different machines, are so reduced as they are together. None: there are no others.
    divides_held_out
        If true, parts for validation are in blocks as well, so that they can be used for fitting.
    draws_rows
        If true, rows are drawn at random from each part, for a study of fits to fewer samples.
    keeps_excerpts
        If true, an excerpt of each log is kept, for a diagnosis.
    """
    equation = experiment.equation
    independent = regrouped(equation)
    prior = independent.regrouped_values(equation.prior)
    runs = experiment.runs
    log_count = rounded_count(log_count or len(runs))
    numbered = list(enumerate(runs))
    kinds = [(i, held_out) for i, run in numbered for held_out in (False, True) if run.parts(held_out)]
    batches = [experiment.batches(runs[i], held_out) for i, held_out in kinds]
    row_bytes = 8 * sum(len(active) + 2 for active in equation.active())
    bytes_per_bin = 2 * ROWS_PER_BIN * row_bytes  # in the parts for fitting and for validation
    bins = int(np.clip(_CURVE_BYTES // (bytes_per_bin * log_count), *_BINS))
    series_rows = max(_SERIES_BYTES // (row_bytes * log_count), _MIN_SERIES_ROWS)
    rows_of_series = []
    for (_, held_out), own in zip(kinds, batches, strict=True):
        rows_of_series.append({} if held_out else _spread_series(own, series_rows))
    rows_per_block = _rows_per_block(experiment, log_count)
    drawn_limit = _drawn_limit(equation, log_count) if draws_rows else 0

    def reduce_part(part: LogPart[Batch]) -> ReducedPart:
        i, held_out = kinds[part.log]
        run = runs[i]
        reduced = ReducedPart.empty(independent.equation, Envelope(run.parts(held_out), run.signals.log.t, bins))

        def rows() -> Iterator[tuple[list[Array], Shares]]:
            first_row = part.first_row
            for batch, span in zip(part.batches, part.batches.spans, strict=True):
                kept_rows = rows_of_series[part.log].get(span.start, 0)
                rows, shares = reduced.add_batch(independent.equation, prior, run.signals, batch, kept_rows)
                if drawn_limit:
                    in_band = [own[:-1] for own in rows]
                    keys = row_keys(f"{log_identity(run.signals.log)} {held_out}", first_row, span.rows)
                    worth = 1 / run.signals.low_pass.redundancy
                    reduced.drawn = reduced.drawn.with_rows(in_band, shares, worth, keys, drawn_limit)
                first_row += span.rows
                yield rows, shares

        length = rows_per_block[i] if divides_held_out or not held_out else batches[part.log].rows
        reduced.blocks = dict(cut_into_blocks(rows(), length, run.signals.low_pass.redundancy, part.first_row))
        return reduced

    parts: dict[tuple[int, bool], ReducedPart] = {}
    stages = [f"reading {runs[i].signals.log.path.name}" for i, _ in kinds]
    for k, part in read_through(batches, reduce_part, stages, progress):
        if kinds[k] in parts:
            parts[kinds[k]].merge(part, drawn_limit)
        else:
            parts[kinds[k]] = part
    for part in parts.values():
        part.restore_columns(independent)
    reduced = []
    for i, run in numbered:
        log = run.signals.log
        reduced.append(
            ReducedLog(
                path=log.path,
                unknown_torque=log.unknown_torque,
                has_commands=bool(run.signals.controller.joints.any()),
                row_step=run.signals.row_step,
                block_rows=rows_per_block[i],
                train=(parts[i, False],) if (i, False) in parts else (),
                held_out=(parts[i, True],) if (i, True) in parts else (),
                excerpt=_excerpt(log, log_count) if keeps_excerpts else None,
            )
        )
    return tuple(reduced)


def _excerpt(log: JointLog, log_count: int) -> JointLog:
    """Excerpt of one of so many logs, at the rate and with the signals of that log."""
    of_all_logs = float(np.clip(seconds_that_fit(log, _EXCERPT_BYTES), *_EXCERPT_SECONDS))
    return excerpt_of(log, of_all_logs / log_count, _WINDOW_SECONDS)


def training_blocks(experiment: Experiment, logs: Sequence[ReducedLog]) -> tuple[Blocks, ...]:
    """The training data as R-factors of consecutive blocks, log by log.

    Parameters
    ----------
    experiment
        Model and data.
    logs
        Its logs.

    Raises
    ------
    LogError
        If a joint has no sample that counts.
    """
    used = [log for log in logs if log.train]
    rows = [sum(part.rows for part in log.train) for log in used]
    steps = [log.row_step for log in used]
    count = rounded_count(len(logs))
    most = most_blocks(experiment.columns_of_coefficients)
    lengths = block_rows(rows, steps, experiment.band_hz, most, count)
    blocks = []
    for log, length in zip(used, lengths, strict=True):
        factor = max(length // log.block_rows, 1)
        reductions = []
        for part in log.train:
            reductions += [_without_last_column(block) for block in merged_blocks(part.blocks, factor)]
        of_all_rows = merge_reductions([_without_last_column(part.counted) for part in log.train if part.blocks])
        blocks.append(Blocks(log.name, tuple(reductions), factor * log.block_rows * log.row_step, of_all_rows))
    return experiment.checked_blocks(blocks)


def drawn_training_rows(experiment: Experiment, logs: Sequence[ReducedLog]) -> DrawnRows:
    """Rows drawn at random from the training data, the same ones whether logs were reduced together or one by one.

    Parameters
    ----------
    experiment
        Model and data.
    logs
        Its logs, from which rows were drawn.
    """
    limit = _drawn_limit(experiment.equation, rounded_count(len(logs)))
    draws = []
    for log in logs:
        draws += [part.drawn.least(limit) for part in log.train]
    return uniform_draw(draws, _DRAWN_ROWS[1])


def _drawn_limit(equation: LinearModel, log_count: int) -> int:
    """Largest number of rows that are drawn at random from a part of one of so many logs."""
    numbers_per_row = sum(len(active) + 2 for active in equation.active()) + 2
    return int(np.clip(_DRAWN_BYTES // (8 * numbers_per_row * log_count), *_DRAWN_ROWS))


def _without_last_column(reduction: Reduction) -> Reduction:
    """The reduction to [Y_j, tau_j] of one to [Y_j, tau_j, above_j]."""
    return tuple(factor.without_last_column() for factor in reduction)


def _rows_per_block(experiment: Experiment, logs: int) -> list[int]:
    """Number of rows in a block of each log of an experiment, of as many logs in all."""
    lengths = [0] * len(experiment.runs)
    columns = experiment.columns_of_coefficients
    for is_trained in (True, False):  # the number of blocks of the others limits that of none that is fitted
        numbers = [i for i, run in enumerate(experiment.runs) if bool(run.train) is is_trained]
        runs = [experiment.runs[i] for i in numbers]
        rows = [experiment.batches(run, held_out=not is_trained).rows for run in runs]
        for i, length in zip(numbers, experiment.block_rows(runs, rows, columns, logs), strict=True):
            lengths[i] = length
    return lengths


def _spread_series(batches: Batches[Batch], rows: int) -> dict[int, int]:
    """Numbers of consecutive rows to keep of some batches, spread evenly over a log, by the batch's first sample."""
    if not batches.rows:
        return {}
    last_rows = np.cumsum([span.rows for span in batches.spans])
    longest = max(span.rows for span in batches.spans)
    count = max(rows // longest, 1)
    middle_rows = (np.arange(count) + 0.5) * batches.rows / count
    chosen = np.searchsorted(last_rows, middle_rows).tolist()
    return {batches.spans[i].start: rows // count for i in chosen}

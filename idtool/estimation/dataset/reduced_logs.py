"""Logs → `ReducedPart`s, in one pass: all that a fit and its evaluation need of logs of any length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.data.batches import BatchSpan
from idtool.data.signals import Batch
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.blocks import Blocks, cut_into_blocks
from idtool.estimation.dataset.envelope import Envelope
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.extreme_rows import ROWS_PER_BIN
from idtool.estimation.dataset.passes import LogPart, read_through
from idtool.estimation.dataset.reduced_part import ReducedPart

BatchOfPart = tuple[int, BatchSpan]  # number of the part of a log, and its batch

_DRAWN_BYTES = 8 << 20  # that the rows which curves are drawn from may take, of all logs
_SERIES_BYTES = 8 << 20  # that consecutive rows may take, of all logs
_BINS = (50, 2000)  # fewest and most stretches of time in the curves of a log
_FEWEST_SERIES = 2  # batches of consecutive rows, however much memory they take


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
    """

    path: Path
    unknown_torque: tuple[str, ...]
    has_commands: bool
    row_step: float
    block_rows: int
    train: tuple[ReducedPart, ...]
    held_out: tuple[ReducedPart, ...]

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


def reduce_logs(experiment: Experiment, progress: Progress) -> tuple[ReducedLog, ...]:
    """Reduce logs in one pass.

    Parameters
    ----------
    experiment
        Model and data; see `is_reducible`.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    equation = experiment.equation
    numbered = list(enumerate(experiment.runs))
    kinds = [(i, held_out) for i, run in numbered for held_out in (False, True) if run.parts(held_out)]
    batches = [experiment.batches(experiment.runs[i], held_out) for i, held_out in kinds]
    row_bytes = 8 * sum(len(active) + 2 for active in equation.active())
    bytes_per_bin = ROWS_PER_BIN * row_bytes * max(len(kinds), 1)
    bins = int(np.clip(_DRAWN_BYTES // bytes_per_bin, *_BINS))
    training_batches: list[BatchOfPart] = []
    for k, (_, held_out) in enumerate(kinds):
        if not held_out:
            training_batches += [(k, span) for span in batches[k].spans]
    series = {(k, span.start) for k, span in _chosen_series(training_batches, row_bytes)}
    block_rows = experiment.block_rows()

    def reduce_part(part: LogPart[Batch]) -> ReducedPart:
        i, held_out = kinds[part.log]
        run = experiment.runs[i]
        reduced = ReducedPart.empty(equation, Envelope(run.parts(held_out), run.signals.log.t, bins))

        def rows() -> Iterator[tuple[list[Array], Shares]]:
            for batch, span in zip(part.batches, part.batches.spans, strict=True):
                yield reduced.add_batch(equation, run.signals, batch, (part.log, span.start) in series)

        reduced.blocks = dict(cut_into_blocks(rows(), block_rows, run.signals.low_pass.redundancy, part.first_row))
        return reduced

    parts: dict[tuple[int, bool], ReducedPart] = {}
    stages = [f"reading {experiment.runs[i].signals.log.path.name}" for i, _ in kinds]
    for k, part in read_through(batches, reduce_part, stages, progress):
        if kinds[k] in parts:
            parts[kinds[k]].merge(part)
        else:
            parts[kinds[k]] = part
    reduced = []
    for i, run in numbered:
        log = run.signals.log
        reduced.append(
            ReducedLog(
                path=log.path,
                unknown_torque=log.unknown_torque,
                has_commands=bool(run.signals.controller.joints.any()),
                row_step=run.signals.low_pass.stride * log.dt,
                block_rows=block_rows,
                train=(parts[i, False],) if (i, False) in parts else (),
                held_out=(parts[i, True],) if (i, True) in parts else (),
            )
        )
    return tuple(reduced)


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
    blocks = []
    for log in logs:
        of_log = []
        for part in log.train:
            for block in part.blocks.values():
                of_log.append(tuple(factor.without_last_column() for factor in block))
        if of_log:
            blocks.append(Blocks(log.name, tuple(of_log), log.block_rows * log.row_step))
    return experiment.checked_blocks(blocks)


def _chosen_series(training_batches: Sequence[BatchOfPart], row_bytes: int) -> list[BatchOfPart]:
    """Batches whose rows are kept one after the other, spread evenly over the training data."""
    if not training_batches:
        return []
    longest = max(span.rows for _, span in training_batches)
    most = max(_SERIES_BYTES // (row_bytes * longest), _FEWEST_SERIES)
    places = np.linspace(0, len(training_batches) - 1, min(most, len(training_batches)))
    return [training_batches[place] for place in places.round().astype(int)]

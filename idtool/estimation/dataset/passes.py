"""Batches of logs, read in several processes, since what is made of them can be merged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Generic, TypeVar

import numpy as np

from idtool.common.dataclass import dataclass
from idtool.common.processes import Progress, in_processes, process_count
from idtool.data.batches import Batches

Item = TypeVar("Item")
Result = TypeVar("Result")

_FEWEST_BATCHES = 4  # of a process: for less, a process is not worth its start


@dataclass(frozen=True)
class LogPart(Generic[Item]):
    """Consecutive batches of a log.

    Attributes
    ----------
    log
        Index of the log.
    first_row
        Number of filtered samples of the log before them.
    batches
        What is read of each.
    """

    log: int
    first_row: int
    batches: Batches[Item]


def read_through(
    logs: Sequence[Batches[Item]],
    evaluate: Callable[[LogPart[Item]], Result],
    stages: Sequence[str],
    progress: Progress,
    most_processes: int | None = None,
) -> Iterator[tuple[int, Result]]:
    """Read logs in several processes.

    Parameters
    ----------
    logs
        What is read of each log.
    evaluate
        Function of a part of a log. In a copy of this process, what it returns is sent back.
    stages
        Name of the stage of each log, for the progress.
    progress
        Callback for the stage and its progress, from 0 to 1.
    most_processes
        Number of processes; None: one for each processor core.

    Yields
    ------
    Index of the log, and the result of each of its parts; logs and parts in order.
    """
    batch_count = sum(map(len, logs))
    count = min(most_processes or process_count(), max(batch_count // _FEWEST_BATCHES, 1))

    def evaluate_share(share: Sequence[LogPart[Item]], progress: Progress) -> list[tuple[int, Result]]:
        total = sum(len(part.batches) for part in share)
        results = []
        done = 0
        for part in share:
            tracked = _tracked(part, stages[part.log], done, total, progress)
            results.append((part.log, evaluate(tracked)))
            done += len(part.batches)
        return results

    for results in in_processes(evaluate_share, _shares(logs, count), progress):
        yield from results


def _tracked(part: LogPart[Item], stage: str, done: int, total: int, progress: Progress) -> LogPart[Item]:
    """Copy of a part that reports the progress as its batches are read."""
    places = {span: done + i for i, span in enumerate(part.batches.spans)}

    def tell(item: Item, place: int) -> Item:
        progress(stage, place / total)
        return item

    return LogPart(part.log, part.first_row, part.batches.map_with_span(lambda item, span: tell(item, places[span])))


def _shares(logs: Sequence[Batches[Item]], count: int) -> list[list[LogPart[Item]]]:
    """Parts of the logs in as many shares of about as many rows each; a share without batches is left out."""
    total = sum(batches.rows for batches in logs)
    shares: list[list[LogPart[Item]]] = [[] for _ in range(count)]
    rows_before = 0
    for log, batches in enumerate(logs):
        share_of_batch = []
        for span in batches.spans:
            middle = rows_before + span.rows / 2
            share_of_batch.append(min(int(count * middle / total), count - 1))
            rows_before += span.rows
        first_row = 0
        for i, share in enumerate(shares):
            first, end = np.searchsorted(share_of_batch, [i, i + 1]).tolist()
            if first < end:
                own = batches[first:end]
                share.append(LogPart(log, first_row, own))
                first_row += own.rows
    return [share for share in shares if share]

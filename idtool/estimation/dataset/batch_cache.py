"""`BatchCache`: the batches of logs, kept in bounded memory together with the columns along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from idtool.data.batches import Batches, BatchSpan
from idtool.data.column_cache import ColumnCache, KeptColumns
from idtool.data.signals import Batch, Signals

_MAX_BYTES = 256 << 20
_NUMBERS_PER_SAMPLE = 5  # of each joint: q, v, a, tau and the logged tau


class BatchCache:
    """Batches of logs.

    Parameters
    ----------
    max_bytes
        Memory that they may take, beside that of the columns along them.
    """

    def __init__(self, max_bytes: int = _MAX_BYTES) -> None:
        self._free_bytes = max_bytes
        self._columns = ColumnCache()
        self._batches: dict[tuple[int, tuple[tuple[int, int], ...]], dict[BatchSpan, Batch]] = {}
        self._signals: list[Signals] = []  # kept alive, so that no other log has the same id
        self._batch_count = 0

    def batches(self, signals: Signals, ranges: Sequence[slice]) -> Batches[Batch]:
        """Batches of a log as `Signals.batches` has them, the same objects every time if there is memory for them.

        Parameters
        ----------
        signals
            The log.
        ranges
            Parts of its `ranges`.
        """
        batches = signals.batches(ranges)
        key = (id(signals), tuple((part.start, part.stop) for part in ranges))
        if key not in self._batches:
            samples = sum(part.stop - part.start for part in ranges)
            size = 8 * _NUMBERS_PER_SAMPLE * samples * len(signals.joints)
            if size > self._free_bytes:
                return batches
            self._batches[key] = {}
            self._signals.append(signals)
            self._free_bytes -= size
        kept = self._batches[key]

        def kept_batch(span: BatchSpan) -> Batch:
            if span not in kept:
                kept[span] = self._with_columns(signals.batch(span, signals.low_pass))
            return kept[span]

        return Batches(batches.spans, kept_batch)

    def _with_columns(self, batch: Batch) -> Batch:
        """A batch along which columns are kept."""
        motion = batch.motion
        columns = KeptColumns(self._columns, self._batch_count, motion.q, motion.v, motion.a)
        self._batch_count += 1
        return replace(batch, motion=replace(motion, kept_columns=columns))

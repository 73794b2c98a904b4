"""`BatchCache`: the batches of logs, kept in bounded memory together with the columns along them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

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
        self._batches: dict[tuple[int, tuple[tuple[int, int], ...]], list[Batch]] = {}
        self._signals: list[Signals] = []  # kept alive, so that no other log has the same id
        self._batch_count = 0

    def batches(self, signals: Signals, ranges: Sequence[slice]) -> Iterator[Batch]:
        """Batches of a log as `Signals.batches` yields them, the same objects every time if there is memory for them.

        Parameters
        ----------
        signals
            The log.
        ranges
            Parts of its `ranges`.
        """
        key = (id(signals), tuple((part.start, part.stop) for part in ranges))
        if key in self._batches:
            yield from self._batches[key]
            return
        samples = sum(part.stop - part.start for part in ranges)
        size = 8 * _NUMBERS_PER_SAMPLE * samples * len(signals.joints)
        if size > self._free_bytes:
            yield from signals.batches(ranges)
            return
        kept = []
        for batch in signals.batches(ranges):
            motion = batch.motion
            columns = KeptColumns(self._columns, self._batch_count, motion.q, motion.v, motion.a)
            self._batch_count += 1
            kept.append(replace(batch, motion=replace(motion, kept_columns=columns)))
            yield kept[-1]
        self._batches[key] = kept
        self._signals.append(signals)
        self._free_bytes -= size

"""`Batches`: consecutive batches of a log, or what a function gives for each, evaluated when it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar, overload

from typing_extensions import override

from idtool.common.dataclass import dataclass

Item = TypeVar("Item", covariant=True)
Other = TypeVar("Other")


@dataclass(frozen=True)
class BatchSpan:
    """Samples of one batch.

    Attributes
    ----------
    start, stop
        Range of the log's samples that are filtered.
    before, after
        Numbers of further samples at its ends that only the filter needs.
    rows
        Number of filtered samples.
    """

    start: int
    stop: int
    before: int
    after: int
    rows: int


class Batches(Sequence[Item], Generic[Item]):
    """A sequence with one item for each batch. Nothing is kept: an item is evaluated whenever it is asked for.

    Parameters
    ----------
    spans
        The batches.
    evaluate
        Function that gives the item of a batch.
    """

    def __init__(self, spans: Sequence[BatchSpan], evaluate: Callable[[BatchSpan], Item]) -> None:
        self.spans = tuple(spans)
        self._evaluate = evaluate

    @property
    def rows(self) -> int:
        """Number of filtered samples."""
        return sum(span.rows for span in self.spans)

    def map(self, function: Callable[[Item], Other]) -> Batches[Other]:
        """A function's results for the items."""
        return Batches(self.spans, lambda span: function(self._evaluate(span)))

    def map_with_span(self, function: Callable[[Item, BatchSpan], Other]) -> Batches[Other]:
        """A function's results for the items and their spans."""
        return Batches(self.spans, lambda span: function(self._evaluate(span), span))

    @override
    def __len__(self) -> int:
        return len(self.spans)

    @overload
    def __getitem__(self, index: int) -> Item: ...

    @overload
    def __getitem__(self, index: slice) -> Batches[Item]: ...

    @override
    def __getitem__(self, index: int | slice) -> Item | Batches[Item]:
        if isinstance(index, slice):
            return Batches(self.spans[index], self._evaluate)
        return self._evaluate(self.spans[index])

"""Decoding of many binary messages at once: the layout of one message serves for all messages of the same layout.

Messages of one length differ in their stamp and their values; the bytes that define the layout, such as names and
counts, are the same in nearly all of them. Then the values are at the same offsets. L bytes per message, k messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices, Mask, indices_by_value, items_at, joined_runs
from idtool.common.dataclass import dataclass
from idtool.data.logs.payloads.base import PayloadError
from idtool.data.logs.sample_buffer import Samples

Bytes = NDArray[np.uint8]

_ALL_BITS = 0xFF  # of a byte
_MIN_GAP = 64  # bytes outside the layout; fewer are compared, too, since one slice is faster than two


@dataclass(frozen=True)
class Layout:
    """Offsets of the fields of a message.

    Attributes
    ----------
    joints
        Joint names.
    mask
        The bits that define the layout, shape (L,): messages with the same values there have the same layout.
    fields
        Signal to the offset and the type of its values, one for each joint. The values are side by side, or each has an
        offset of its own, shape (joints,).
    stamp
        Function from messages (k, L) to their times [s], shape (k,).
    """

    joints: tuple[str, ...]
    mask: Bytes
    fields: Mapping[str, tuple[int | Indices, np.dtype[np.floating]]]
    stamp: Callable[[Bytes], Array]

    def samples(self, index: Indices, messages: Bytes) -> Samples:
        """The samples in messages (k, L)."""
        signals = {signal: self.values(messages, signal) for signal in self.fields}
        return Samples(index, self.stamp(messages), self.joints, signals)

    def values(self, messages: Bytes, signal: str) -> NDArray[np.floating]:
        """A signal in messages (k, L), shape (k, len(joints)); a view if the values are side by side."""
        offset, dtype = self.fields[signal]
        if isinstance(offset, int):
            end = offset + len(self.joints) * dtype.itemsize
            return messages[:, offset:end].view(dtype)
        columns = [messages[:, start : start + dtype.itemsize].view(dtype) for start in offset.tolist()]
        return np.concatenate(columns, axis=1, dtype=dtype)


class LayoutDecoder:
    """Decoder of messages; it remembers the layout of the last one, which the next ones mostly have, too.

    Parameters
    ----------
    layout_of
        Function that gives the layout of a message, or None, or raises ValueError.
    """

    def __init__(self, layout_of: Callable[[bytes], Layout | None]) -> None:
        self._layout_of = layout_of
        self._last: _Template | None = None

    def __call__(self, buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        """Samples of the messages in a buffer that have a layout, given their starts and lengths.

        Raises
        ------
        PayloadError
            For a message for which ``layout_of`` raises ValueError.
        """
        samples, _ = self.decode(buffer, starts, lengths)
        return samples

    def decode(self, buffer: bytes, starts: Indices, lengths: Indices) -> tuple[list[Samples], list[int]]:
        """Samples as when called, and indices of the messages without a layout, ascending."""
        samples = []
        without_layout: list[int] = []
        for length, index in indices_by_value(lengths):
            if length == 0:  # an empty message has no joints
                continue
            items = items_at(buffer, starts[index], np.dtype(f"V{length}"))
            messages = items[:, None].view(np.uint8)
            template = self._last
            same = _matches(template, messages)
            while len(index):
                if not same.any():
                    template = self._template_of(messages[0], int(index[0]))
                    same = _matches(template, messages)
                if template is None:
                    without_layout.append(int(index[0]))
                    index, messages, same = index[1:], messages[1:], same[1:]
                    continue
                self._last = template
                matching = messages if same.all() else messages[same]  # a view where possible
                samples.append(template.layout.samples(index[same], matching))
                rest = ~same
                index, messages, same = index[rest], messages[rest], same[rest]
        return samples, sorted(without_layout)

    def _template_of(self, message: Bytes, index: int) -> _Template | None:
        """A template for messages like one with an index; None if it has no layout."""
        try:
            layout = self._layout_of(message.tobytes())
        except ValueError as error:
            raise PayloadError(index, error) from None
        return None if layout is None else _Template(message, layout)


def _matches(template: _Template | None, messages: Bytes) -> Mask:
    """True for messages, shape (k, L), of a template; shape (k,)."""
    return np.zeros(len(messages), dtype=bool) if template is None else template.matches(messages)


class _Template:
    """A message (L,) whose layout is that of all messages with the same bits where it is defined."""

    def __init__(self, message: Bytes, layout: Layout) -> None:
        self.layout = layout
        self._bits = message & layout.mask
        self._parts = [slice(start, stop) for start, stop in joined_runs(layout.mask != 0, _MIN_GAP)]

    def matches(self, messages: Bytes) -> Mask:
        """True for messages, shape (k, L'), with the layout; shape (k,)."""
        is_same = np.full(len(messages), messages.shape[1] == len(self._bits))
        if not is_same.any():
            return is_same
        for part in self._parts:
            mask = self.layout.mask[part]
            bits = messages[:, part]
            if not (mask == _ALL_BITS).all():
                bits = bits & mask
            is_different = bits != self._bits[part]
            if is_different.any():  # which is rare
                is_same &= ~is_different.any(axis=1)
        return is_same

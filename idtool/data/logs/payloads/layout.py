"""Decoding of many binary messages at once: the layout of one message serves for all messages of the same layout.

Messages of one length differ in their stamp and their values; the bytes that define the layout, such as names and
counts, are the same in nearly all of them. Then the values are at the same offsets. L bytes per message, k messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.logs.payloads.base import PayloadError
from idtool.data.logs.sample_buffer import Samples

Bytes = NDArray[np.uint8]


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

    def matches(self, messages: Bytes) -> Mask:
        """True for messages, shape (k, L), with the layout of the first one; shape (k,)."""
        difference = messages ^ messages[0]
        difference &= self.mask
        if not difference.any():  # true of nearly all messages
            return np.ones(len(messages), dtype=bool)
        return np.asarray(~difference.any(axis=1))

    def samples(self, index: Indices, messages: Bytes) -> Samples:
        """The samples in messages (k, L), which must be contiguous."""
        signals = {signal: self.values(messages, signal) for signal in self.fields}
        return Samples(index, self.stamp(messages), self.joints, signals)

    def values(self, messages: Bytes, signal: str) -> NDArray[np.floating]:
        """A signal in contiguous messages (k, L), shape (k, len(joints)); a view if the values are side by side."""
        offset, dtype = self.fields[signal]
        if not isinstance(offset, int):
            value_bytes = offset[:, None] + np.arange(dtype.itemsize)
            return np.take(messages, value_bytes, axis=1).view(dtype)[:, :, 0]
        shape = (len(messages), len(self.joints))
        return np.ndarray(shape, dtype, messages, offset, strides=(messages.shape[1], dtype.itemsize))


def decode_by_layout(
    buffer: bytes, starts: Indices, lengths: Indices, layout_of: Callable[[bytes], Layout | None]
) -> tuple[list[Samples], list[int]]:
    """Samples of the messages in a buffer, given their starts and lengths, and indices of messages without a layout.

    Raises
    ------
    PayloadError
        For a message for which ``layout_of`` raises ValueError.
    """
    samples = []
    without_layout = []
    for length in np.unique(lengths[lengths > 0]).tolist():
        index = np.flatnonzero(lengths == length)
        # a message of this length at every offset of the buffer, as a view
        windows = np.ndarray(len(buffer) - length + 1, f"V{length}", buffer, strides=(1,))
        messages = windows[starts[index]].view(np.uint8).reshape(-1, length)
        while len(index):
            try:
                layout = layout_of(messages[0].tobytes())
            except ValueError as error:
                raise PayloadError(int(index[0]), error) from None
            if layout is None:
                without_layout.append(int(index[0]))
                index, messages = index[1:], messages[1:]
                continue
            same = layout.matches(messages)
            samples.append(layout.samples(index[same], messages if same.all() else messages[same]))
            index, messages = index[~same], messages[~same]
    return samples, sorted(without_layout)

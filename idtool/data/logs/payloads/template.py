"""Decoding of many binary messages at once: one is laid out, and those that are built alike are read as arrays.

Messages of one length differ in their stamp and their values; the bytes that say what is where are the same in
nearly all of them. Where they are, the values stand in the same places. L bytes to a message, k messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.logs.payloads.base import PayloadError
from idtool.data.logs.series import Samples

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Layout:
    """Where a message holds what.

    Attributes
    ----------
    joints
        Names of the joints.
    mask
        The bits that make the layout, shape (L,): a message that has the same ones has the same layout.
    fields
        Signal to the offset and the type of its values, one for each joint.
    stamp
        Times [s], shape (k,), of messages (k, L).
    """

    joints: tuple[str, ...]
    mask: Bytes
    fields: Mapping[str, tuple[int, np.dtype[np.floating]]]
    stamp: Callable[[Bytes], Array]

    def fits(self, messages: Bytes) -> Mask:
        """Whether messages (k, L) have the layout of the first of them."""
        where = np.flatnonzero(self.mask)
        fixed = messages[:, where] & self.mask[where]
        return np.asarray((fixed == fixed[0]).all(axis=1))

    def samples(self, index: Indices, messages: Bytes) -> Samples:
        """What messages (k, L), contiguous, hold."""
        signals = {signal: self.values(messages, signal) for signal in self.fields}
        return Samples(index, self.stamp(messages), self.joints, signals)

    def values(self, messages: Bytes, signal: str) -> NDArray[np.floating]:
        """A signal in the messages (k, L), contiguous: a view of shape (k, len(joints))."""
        offset, dtype = self.fields[signal]
        shape = (len(messages), len(self.joints))
        return np.ndarray(shape, dtype, messages, offset, strides=(messages.shape[1], dtype.itemsize))


def decode_alike(
    buffer: bytes,
    starts: Indices,
    lengths: Indices,
    lay_out: Callable[[bytes], Layout | None],
) -> tuple[list[Samples], list[int]]:
    """Samples of the messages in ``buffer``, and the places of those for which ``lay_out`` has no layout.

    Raises
    ------
    PayloadError
        For a message that ``lay_out`` answers with ValueError.
    """
    samples, rest = [], []
    for length in np.unique(lengths[lengths > 0]).tolist():
        index = np.flatnonzero(lengths == length)
        # every place in the buffer, seen as a message of this length
        places = np.ndarray(len(buffer) - length + 1, f"V{length}", buffer, strides=(1,))
        messages = places[starts[index]].view(np.uint8).reshape(-1, length)
        while len(index):
            try:
                layout = lay_out(messages[0].tobytes())
            except ValueError as error:
                raise PayloadError(int(index[0]), error) from None
            if layout is None:
                rest.append(int(index[0]))
                index, messages = index[1:], messages[1:]
                continue
            alike = layout.fits(messages)
            samples.append(layout.samples(index[alike], messages if alike.all() else messages[alike]))
            index, messages = index[~alike], messages[~alike]
    return samples, sorted(rest)

"""Reading CDR messages from front to back: XCDR1, and plain XCDR2, in both byte orders.

Four bytes tell the representation. Then follow the fields, each aligned to its size (at most 4 bytes in XCDR2).
A string is its length with the closing zero byte, and its bytes; a sequence is its count, and its elements.
XCDR2 puts the size in bytes before arrays and sequences of anything but numbers.
Source: OMG DDS-XTypes 1.3, 7.4 and 7.6.3.1.2; OMG DDSI-RTPS 2.5, 10.
"""

from __future__ import annotations

import struct

import numpy as np

from idtool.common.arrays import Array
from idtool.data.logs.payloads.layout import Bytes

HEADER = 4  # bytes

_REPRESENTATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}  # byte order, largest alignment


def representation(message: bytes) -> tuple[str, int]:
    """Byte order and largest alignment of a message; ValueError if it is not plain CDR."""
    found = None
    if len(message) >= HEADER:
        found = _REPRESENTATIONS.get(int.from_bytes(message[:2], "big"))
    if found is None:
        raise ValueError(f"is not plain CDR: it begins with {message[:HEADER].hex(' ') or 'nothing'}")
    return found


def truncation_error(message: bytes) -> ValueError:
    """Error for a message that ends within a field."""
    return ValueError(f"is incomplete: it ends within a field, after {len(message)} bytes")


def stamp_seconds(messages: Bytes, offset: int, order: str) -> Array:
    """The stamps at an offset of messages (k, L) [s], shape (k,): int32 seconds, uint32 nanoseconds."""
    stamp = np.ascontiguousarray(messages[:, offset : offset + 8])
    parts = stamp.view([("sec", f"{order}i4"), ("nanosec", f"{order}u4")])[:, 0]
    return np.asarray(parts["sec"] + parts["nanosec"] / 1e9)


def no_stamp(messages: Bytes) -> Array:
    """Times of messages (k, L) without stamps: 0, shape (k,)."""
    return np.zeros(len(messages))


class Cursor:
    """Reads a message from front to back and marks the bytes that define its layout.

    All methods raise ValueError where the message ends too early.

    Parameters
    ----------
    message
        The message.

    Attributes
    ----------
    order
        Its byte order.
    max_alignment
        The largest alignment [bytes].
    mask
        The bits that define the layout, shape (L,).
    """

    def __init__(self, message: bytes) -> None:
        self.order, self.max_alignment = representation(message)
        self.message = message
        self.offset = HEADER
        self.mask = np.zeros(len(message), np.uint8)
        self.mask[:2] = 0xFF

    def skip(self, size: int, alignment: int = 1) -> int:
        """Skip ``size`` bytes and return where they begin."""
        start = self.offset + (HEADER - self.offset) % min(alignment, self.max_alignment)
        self.offset = start + size
        if self.offset > len(self.message):
            raise truncation_error(self.message)
        return start

    def skip_collection_size(self) -> None:
        """Skip the size in bytes that XCDR2 puts before a collection of anything but numbers."""
        if self.max_alignment == 4:
            self.skip(4, 4)

    def read_fixed(self, size: int, alignment: int = 1) -> bytes:
        """Read ``size`` bytes that belong to the layout."""
        start = self.skip(size, alignment)
        self.mask[start : self.offset] = 0xFF
        return self.message[start : self.offset]

    def count(self) -> int:
        """Read a count, which belongs to the layout."""
        return int(struct.unpack(f"{self.order}I", self.read_fixed(4, 4))[0])

    def string(self) -> str:
        """Read a string that belongs to the layout."""
        text = self.read_fixed(self.count()).removesuffix(b"\0")
        try:
            return text.decode()
        except UnicodeDecodeError:
            raise ValueError(f"has a name that is not UTF-8: {text[:40]!r}") from None

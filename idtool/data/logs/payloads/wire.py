"""The layout of a protobuf message, read from its bytes.

A field is a tag, with its number and wire type, and its content: a varint (seven bits per byte, the lowest first; the
eighth bit says that more follow), 4 or 8 bytes, or a length and as many bytes.
Source: protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.data.logs.payloads.base import SIGNALS, check_counts, check_names
from idtool.data.logs.payloads.layout import Bytes, Layout

# Field number to the content of the field: a joint's "name", "sec" or "nanosec", a signal with the type of its packed
# values, or a nested message with its own plan.
FieldPlan = Mapping[int, "str | tuple[str, np.dtype[np.floating]] | FieldPlan"]

_VARINT, _FIXED64, _LENGTH_DELIMITED, _FIXED32 = 0, 1, 2, 5  # wire types


class _UnsupportedError(Exception):
    """The message has an unusual structure, or is incomplete."""


class _Parser:
    """Reads a message from front to back and notes the offsets of its fields."""

    def __init__(self, message: bytes) -> None:
        self.message = message
        self.mask = np.zeros(len(message), np.uint8)
        self.joints: list[str] = []
        self.values: dict[str, tuple[int, int, np.dtype[np.floating]]] = {}  # signal to offset, count and type
        self.stamp: dict[str, slice] = {}

    def read_fields(self, offset: int, end: int, plan: FieldPlan) -> None:
        while offset < end:
            tag, offset = self.read_varint(offset, end, 0xFF)
            wire_type = tag & 7
            content = plan.get(tag >> 3)
            start = offset
            if wire_type == _VARINT:
                _, offset = self.read_varint(offset, end, 0x80)  # any number of the same length
                self.add_number(slice(start, offset), content)
            elif wire_type == _LENGTH_DELIMITED:
                size, start = self.read_varint(offset, end, 0xFF)
                offset = start + size
                self.add_content(slice(start, min(offset, end)), content)
            elif wire_type in (_FIXED64, _FIXED32) and content is None:
                offset += 8 if wire_type == _FIXED64 else 4
            else:
                raise _UnsupportedError
        if offset != end:
            raise _UnsupportedError

    def read_varint(self, offset: int, end: int, mask: int) -> tuple[int, int]:
        """The number at ``offset``, and the offset after it; ``mask`` are the bits of its bytes that are layout."""
        number = 0
        for i, byte in enumerate(self.message[offset : min(end, offset + 10)]):
            number |= (byte & 0x7F) << 7 * i
            if byte < 0x80:
                self.mask[offset : offset + i + 1] = mask
                return number, offset + i + 1
        raise _UnsupportedError

    def add_number(self, location: slice, content: object) -> None:
        if content in ("sec", "nanosec") and content not in self.stamp:
            self.stamp[str(content)] = location
        elif content is not None:
            raise _UnsupportedError

    def add_content(self, location: slice, content: object) -> None:
        match content:
            case None:
                pass
            case "name":
                self.mask[location] = 0xFF
                self.joints.append(self.message[location].decode())
            case (str(signal), np.dtype() as dtype) if signal not in self.values:
                count, rest = divmod(location.stop - location.start, dtype.itemsize)
                if rest:
                    raise _UnsupportedError
                self.values[signal] = (location.start, count, dtype)
            case Mapping():
                self.read_fields(location.start, location.stop, content)
            case _:
                raise _UnsupportedError


def layout_of(message: bytes, plan: FieldPlan) -> Layout | None:
    """The layout of a message; None if it has an unusual structure, or is incomplete.

    Raises
    ------
    ValueError
        If its names or the number of its values cannot be used.
    """
    parser = _Parser(message)
    try:
        parser.read_fields(0, len(message), plan)
    except (_UnsupportedError, UnicodeDecodeError):
        return None
    check_names(parser.joints)
    fields = {}
    counts = []
    for signal in SIGNALS.values():
        offset, count, dtype = parser.values.get(signal, (0, 0, np.dtype("<f8")))
        counts.append(count)
        if count:
            fields[signal] = (offset, dtype)
    check_counts(len(parser.joints), counts)
    return Layout(tuple(parser.joints), parser.mask, fields, partial(_seconds, stamp=parser.stamp))


def _seconds(messages: Bytes, stamp: Mapping[str, slice]) -> Array:
    parts = {"sec": np.zeros(len(messages), np.int64), "nanosec": np.zeros(len(messages), np.int64)}
    for part, location in stamp.items():
        for i, byte in enumerate(messages[:, location].T):
            parts[part] |= (byte & 0x7F).astype(np.int64) << 7 * i
    return np.asarray(parts["sec"] + parts["nanosec"] / 1e9)

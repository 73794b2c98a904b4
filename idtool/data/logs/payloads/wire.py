"""Where a protobuf message holds what, read off its bytes.

A field is a tag, which is its number and kind, and its content: a varint (seven bits to a byte, the lowest first,
the eighth says that more follow), 4 or 8 bytes, or a length and as many bytes.
Source: protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.data.logs.payloads.base import SIGNALS, check_counts, check_names
from idtool.data.logs.payloads.template import Bytes, Layout

# Field number to what the field holds: joint "name", "sec" or "nanosec", a signal with the type of its packed
# values, or a message with a plan of its own.
Plan = Mapping[int, "str | tuple[str, np.dtype[np.floating]] | Plan"]


class _UnusualError(Exception):
    """The message is not built in the usual way, or not whole."""


class _Walk:
    """What was found in a message."""

    def __init__(self, message: bytes) -> None:
        self.message = message
        self.mask = np.zeros(len(message), np.uint8)
        self.joints: list[str] = []
        self.values: dict[str, tuple[int, int, np.dtype[np.floating]]] = {}  # signal to offset, count and type
        self.stamp: dict[str, slice] = {}

    def fields(self, at: int, end: int, plan: Plan) -> None:
        while at < end:
            tag, at = self.varint(at, end, 0xFF)
            kind, holds = tag & 7, plan.get(tag >> 3)
            start = at
            if kind == 0:
                _, at = self.varint(at, end, 0x80)  # any number that takes as many bytes
                self.number(slice(start, at), holds)
            elif kind == 2:
                size, start = self.varint(at, end, 0xFF)
                at = start + size
                self.content(slice(start, min(at, end)), holds)
            elif kind in (1, 5) and holds is None:
                at += 8 if kind == 1 else 4
            else:
                raise _UnusualError
        if at != end:
            raise _UnusualError

    def varint(self, at: int, end: int, mask: int) -> tuple[int, int]:
        """The number there, and where it ends."""
        number = 0
        for i, byte in enumerate(self.message[at : min(end, at + 10)]):
            number |= (byte & 0x7F) << 7 * i
            if byte < 0x80:
                self.mask[at : at + i + 1] = mask
                return number, at + i + 1
        raise _UnusualError

    def number(self, where: slice, holds: object) -> None:
        if holds in ("sec", "nanosec") and holds not in self.stamp:
            self.stamp[str(holds)] = where
        elif holds is not None:
            raise _UnusualError

    def content(self, where: slice, holds: object) -> None:
        match holds:
            case None:
                pass
            case "name":
                self.mask[where] = 0xFF
                self.joints.append(self.message[where].decode())
            case (str(signal), np.dtype() as dtype) if signal not in self.values:
                count, over = divmod(where.stop - where.start, dtype.itemsize)
                if over:
                    raise _UnusualError
                self.values[signal] = where.start, count, dtype
            case Mapping():
                self.fields(where.start, where.stop, holds)
            case _:
                raise _UnusualError


def lay_out(message: bytes, plan: Plan) -> Layout | None:
    """The layout of a message; None for one that is not built in the usual way, or not whole.

    Raises
    ------
    ValueError
        If its names or the numbers of its values cannot be used.
    """
    walk = _Walk(message)
    try:
        walk.fields(0, len(message), plan)
    except (_UnusualError, UnicodeDecodeError):
        return None
    check_names(walk.joints)
    counts = {signal: count for signal, (_, count, _) in walk.values.items()}
    check_counts(len(walk.joints), [counts.get(signal, 0) for signal in SIGNALS.values()])
    fields = {signal: (offset, dtype) for signal, (offset, count, dtype) in walk.values.items() if count}
    return Layout(tuple(walk.joints), walk.mask, fields, partial(_seconds, stamp=walk.stamp))


def _seconds(messages: Bytes, stamp: Mapping[str, slice]) -> Array:
    parts = {"sec": np.zeros(len(messages), np.int64), "nanosec": np.zeros(len(messages), np.int64)}
    for part, where in stamp.items():
        for i, byte in enumerate(messages[:, where].T):
            parts[part] |= (byte & 0x7F).astype(np.int64) << 7 * i
    return np.asarray(parts["sec"] + parts["nanosec"] / 1e9)

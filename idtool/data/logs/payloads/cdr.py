"""ROS 2 `sensor_msgs/msg/JointState` in CDR: XCDR1, and plain XCDR2, in both byte orders.

Four bytes say which CDR it is. Then, each aligned to its size (at most 4 bytes in XCDR2) from there on:
int32 sec, uint32 nanosec, string frame_id, string[] name, float64[] position, velocity, effort.
A string is its length with the closing zero byte, and its bytes; a sequence is its count, and its elements.
XCDR2 puts the size in bytes before a sequence of strings. `std_msgs/msg/String` is one string.
Source: OMG DDS-XTypes 1.3, 7.4 and 7.6.3.1.2; OMG DDSI-RTPS 2.5, 10.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices
from idtool.data.logs.payloads.base import SIGNALS, Decoder, TextDecoder, check_counts, check_names
from idtool.data.logs.payloads.template import Bytes, Layout, decode_alike
from idtool.data.logs.series import Samples

if TYPE_CHECKING:
    from mcap.records import Schema

ENCODING = "cdr"
TYPE = "sensor_msgs/msg/JointState"
DEFINITION = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

_KINDS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}  # byte order, largest alignment
_HEADER = 4


def decoder(schema: Schema) -> Decoder | None:
    """Of JointState messages, whatever language their schema is written in."""
    return _decode if schema.name.replace("/msg/", "/") == "sensor_msgs/JointState" else None


def text(schema: Schema) -> TextDecoder | None:
    """Of String messages, whatever language their schema is written in."""
    return _text if schema.name.replace("/msg/", "/") == "std_msgs/String" else None


def _text(message: bytes) -> bytes:
    order, _ = _kind(message)
    begin = _HEADER + 4
    size = struct.unpack_from(f"{order}I", message, _HEADER)[0] if len(message) >= begin else begin
    if begin + size > len(message):
        raise _ended(message)
    return message[begin : begin + size].removesuffix(b"\0")


def _decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
    samples, _ = decode_alike(buffer, starts, lengths, lay_out)
    return samples


def _kind(message: bytes) -> tuple[str, int]:
    """Byte order and largest alignment of a message."""
    kind = _KINDS.get(int.from_bytes(message[:2], "big")) if len(message) >= _HEADER else None
    if kind is None:
        raise ValueError(f"is not plain CDR: it begins with {message[:_HEADER].hex(' ') or 'nothing'}")
    return kind


def _ended(message: bytes) -> ValueError:
    return ValueError(f"ends after {len(message)} bytes, within its fields")


class _Cursor:
    """Walks over a message and notes which of its bytes make the layout."""

    def __init__(self, message: bytes) -> None:
        self.order, self.most = _kind(message)
        self.message = message
        self.at = _HEADER
        self.mask = np.zeros(len(message), np.uint8)
        self.mask[:2] = 0xFF

    def skip(self, size: int, align: int = 1) -> int:
        """Where the next ``size`` bytes begin, which are passed over."""
        start = self.at + (_HEADER - self.at) % min(align, self.most)
        self.at = start + size
        if self.at > len(self.message):
            raise _ended(self.message)
        return start

    def fixed(self, size: int, align: int = 1) -> bytes:
        """The next ``size`` bytes, which make the layout."""
        start = self.skip(size, align)
        self.mask[start : self.at] = 0xFF
        return self.message[start : self.at]

    def count(self) -> int:
        return int(struct.unpack(f"{self.order}I", self.fixed(4, 4))[0])

    def string(self) -> str:
        text = self.fixed(self.count()).removesuffix(b"\0")
        try:
            return text.decode()
        except UnicodeDecodeError:
            raise ValueError(f"has a name that is not UTF-8: {text[:40]!r}") from None


def lay_out(message: bytes) -> Layout:
    """The layout of a JointState message.

    Raises
    ------
    ValueError
        If it is not one.
    """
    cursor = _Cursor(message)
    stamp = cursor.skip(8, 4)
    cursor.skip(cursor.count())  # the frame's name may change from message to message
    if cursor.most == 4:
        cursor.skip(4, 4)
    count = cursor.count()
    if count > len(message):
        raise ValueError(f"is too short for {count} names")
    joints = tuple(cursor.string() for _ in range(count))
    check_names(joints)
    fields = {}
    counts = []
    for signal in SIGNALS.values():
        counts.append(cursor.count())
        if counts[-1]:
            fields[signal] = (cursor.skip(8 * counts[-1], 8), np.dtype(f"{cursor.order}f8"))
    check_counts(count, counts)
    return Layout(joints, cursor.mask, fields, partial(_seconds, offset=stamp, order=cursor.order))


def _seconds(messages: Bytes, offset: int, order: str) -> Array:
    stamp = np.ascontiguousarray(messages[:, offset : offset + 8])
    parts = stamp.view([("sec", f"{order}i4"), ("nanosec", f"{order}u4")])[:, 0]
    return np.asarray(parts["sec"] + parts["nanosec"] / 1e9)


def encode(nanoseconds: NDArray[np.int64], joints: Sequence[str], signals: Mapping[str, Array]) -> Bytes:
    """JointState messages in little-endian XCDR1, shape (k, L).

    Parameters
    ----------
    nanoseconds
        Header stamps [ns], shape (k,), whose seconds fit 32 bits.
    joints
        Names of the joints.
    signals
        Any of q, v and tau, each of shape (k, len(joints)).
    """
    form = _form(joints, signals)
    layout = lay_out(form)
    messages = np.tile(np.frombuffer(form, np.uint8), (len(nanoseconds), 1))
    messages[:, _HEADER : _HEADER + 8] = np.stack(np.divmod(nanoseconds, 10**9), axis=1).astype("<i4").view(np.uint8)
    for signal in layout.fields:
        layout.values(messages, signal)[:] = signals[signal]
    return messages


def _form(joints: Sequence[str], signals: Mapping[str, Array]) -> bytes:
    """A message with all values zero."""
    form = bytearray(b"\0\1\0\0" + bytes(8))

    def put(data: bytes, align: int) -> None:
        form.extend(bytes((_HEADER - len(form)) % align) + data)

    put(struct.pack("<I", 1) + b"\0", 4)  # no frame
    put(struct.pack("<I", len(joints)), 4)
    for joint in joints:
        name = joint.encode() + b"\0"
        put(struct.pack("<I", len(name)) + name, 4)
    for signal in SIGNALS.values():
        put(struct.pack("<I", len(joints) * (signal in signals)), 4)
        if signal in signals:
            put(bytes(8 * len(joints)), 8)
    return bytes(form)

"""ROS 2 `sensor_msgs/msg/JointState` in CDR: XCDR1, and plain XCDR2, in both byte orders.

Four bytes tell the representation. Then follow, each aligned to its size (at most 4 bytes in XCDR2):
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
from idtool.data.logs.payloads.layout import Bytes, Layout, decode_by_layout
from idtool.data.logs.payloads.sensor_types import SENSOR_TYPES, SensorType
from idtool.data.logs.sample_buffer import Samples

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

_REPRESENTATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}  # byte order, largest alignment
_HEADER = 4


def decoder(schema: Schema) -> Decoder | None:
    """Decoder of JointState messages, in whatever language their schema is written."""
    return _decode if schema.name.replace("/msg/", "/") == "sensor_msgs/JointState" else None


def text(schema: Schema) -> TextDecoder | None:
    """Decoder of String messages, in whatever language their schema is written."""
    return _text if schema.name.replace("/msg/", "/") == "std_msgs/String" else None


def sensor(schema: Schema) -> Decoder | None:
    """Decoder of messages of `sensor_types`, whose numbers are the signal ``sensor``."""
    sensor_type = SENSOR_TYPES.get(schema.name.replace("/msg/", "/"))
    if sensor_type is None:
        return None
    layout = partial(_sensor_layout, sensor_type=sensor_type)

    def decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        samples, _ = decode_by_layout(buffer, starts, lengths, layout)
        return samples

    return decode


def _sensor_layout(message: bytes, sensor_type: SensorType) -> Layout:
    """The layout of a sensor's message; ValueError if it is incomplete."""
    cursor = _Cursor(message)
    stamp = None
    if sensor_type.has_header:
        stamp = cursor.skip(8, 4)
        cursor.skip(cursor.count())  # the name of the frame may differ between messages
    dtype = sensor_type.number_type(cursor.order)
    count = len(sensor_type.numbers)
    offset = cursor.skip(count * dtype.itemsize, dtype.itemsize)
    seconds = _no_stamp if stamp is None else partial(_seconds, offset=stamp, order=cursor.order)
    numbers = tuple(str(i) for i in range(count))
    return Layout(numbers, cursor.mask, {"sensor": (offset, dtype)}, seconds)


def _no_stamp(messages: Bytes) -> Array:
    return np.zeros(len(messages))


def _text(message: bytes) -> bytes:
    order, _ = _representation(message)
    start = _HEADER + 4
    if len(message) < start:
        raise _truncation_error(message)
    size = struct.unpack_from(f"{order}I", message, _HEADER)[0]
    if start + size > len(message):
        raise _truncation_error(message)
    return message[start : start + size].removesuffix(b"\0")


def _decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
    samples, _ = decode_by_layout(buffer, starts, lengths, layout_of)
    return samples


def _representation(message: bytes) -> tuple[str, int]:
    """Byte order and largest alignment of a message."""
    representation = None
    if len(message) >= _HEADER:
        representation = _REPRESENTATIONS.get(int.from_bytes(message[:2], "big"))
    if representation is None:
        raise ValueError(f"is not plain CDR: it begins with {message[:_HEADER].hex(' ') or 'nothing'}")
    return representation


def _truncation_error(message: bytes) -> ValueError:
    return ValueError(f"is incomplete: it ends within a field, after {len(message)} bytes")


class _Cursor:
    """Reads a message from front to back and marks the bytes that define its layout."""

    def __init__(self, message: bytes) -> None:
        self.order, self.max_alignment = _representation(message)
        self.message = message
        self.offset = _HEADER
        self.mask = np.zeros(len(message), np.uint8)
        self.mask[:2] = 0xFF

    def skip(self, size: int, alignment: int = 1) -> int:
        """Skip ``size`` bytes and return where they begin."""
        start = self.offset + (_HEADER - self.offset) % min(alignment, self.max_alignment)
        self.offset = start + size
        if self.offset > len(self.message):
            raise _truncation_error(self.message)
        return start

    def read_fixed(self, size: int, alignment: int = 1) -> bytes:
        """Read ``size`` bytes that belong to the layout."""
        start = self.skip(size, alignment)
        self.mask[start : self.offset] = 0xFF
        return self.message[start : self.offset]

    def count(self) -> int:
        return int(struct.unpack(f"{self.order}I", self.read_fixed(4, 4))[0])

    def string(self) -> str:
        text = self.read_fixed(self.count()).removesuffix(b"\0")
        try:
            return text.decode()
        except UnicodeDecodeError:
            raise ValueError(f"has a name that is not UTF-8: {text[:40]!r}") from None


def layout_of(message: bytes) -> Layout:
    """The layout of a JointState message.

    Raises
    ------
    ValueError
        If it is not one.
    """
    cursor = _Cursor(message)
    stamp = cursor.skip(8, 4)
    cursor.skip(cursor.count())  # the name of the frame may differ between messages
    if cursor.max_alignment == 4:
        cursor.skip(4, 4)
    count = cursor.count()
    if count > len(message):
        raise ValueError(f"is too short for {count} names")
    joints = tuple(cursor.string() for _ in range(count))
    check_names(joints)
    fields = {}
    counts = []
    for signal in SIGNALS.values():
        values = cursor.count()
        counts.append(values)
        if values:
            fields[signal] = (cursor.skip(8 * values, 8), np.dtype(f"{cursor.order}f8"))
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
        Header stamps [ns], shape (k,); the seconds must fit 32 bits.
    joints
        Joint names.
    signals
        Any of q, v and tau, each of shape (k, len(joints)).
    """
    template = _zero_message(joints, signals)
    layout = layout_of(template)
    messages = np.tile(np.frombuffer(template, np.uint8), (len(nanoseconds), 1))
    stamps = np.stack(np.divmod(nanoseconds, 10**9), axis=1).astype("<i4")
    messages[:, _HEADER : _HEADER + 8] = stamps.view(np.uint8)
    for signal in layout.fields:
        layout.values(messages, signal)[:] = signals[signal]
    return messages


def _zero_message(joints: Sequence[str], signals: Mapping[str, Array]) -> bytes:
    """A message in which the stamp and all values are zero."""
    message = bytearray(b"\0\1\0\0" + bytes(8))

    def put(data: bytes, alignment: int) -> None:
        message.extend(bytes((_HEADER - len(message)) % alignment) + data)

    put(struct.pack("<I", 1) + b"\0", 4)  # an empty frame_id
    put(struct.pack("<I", len(joints)), 4)
    for joint in joints:
        name = joint.encode() + b"\0"
        put(struct.pack("<I", len(name)) + name, 4)
    for signal in SIGNALS.values():
        put(struct.pack("<I", len(joints) * (signal in signals)), 4)
        if signal in signals:
            put(bytes(8 * len(joints)), 8)
    return bytes(message)

"""ROS 2 messages in CDR.

`sensor_msgs/msg/JointState` is int32 sec, uint32 nanosec, string frame_id, string[] name, float64[] position, velocity,
effort. `std_msgs/msg/String` is one string. The fields of other messages are found by their definition.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array
from idtool.data.logs.payloads.base import (
    SIGNALS,
    Decoder,
    FieldDecoders,
    MessageFields,
    SensorDecoder,
    TextDecoder,
    check_counts,
    check_names,
)
from idtool.data.logs.payloads.cdr_cursor import (
    HEADER,
    Cursor,
    no_stamp,
    representation,
    stamp_seconds,
    truncation_error,
)
from idtool.data.logs.payloads.cdr_fields import field_decoders
from idtool.data.logs.payloads.layout import Bytes, Layout, LayoutDecoder
from idtool.data.logs.payloads.sensor_types import SENSOR_TYPES, SensorType

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


def decoder(schema: Schema) -> Decoder | None:
    """Decoder of JointState messages, in whatever language their schema is written."""
    return LayoutDecoder(layout_of) if schema.name.replace("/msg/", "/") == "sensor_msgs/JointState" else None


def text(schema: Schema) -> TextDecoder | None:
    """Decoder of String messages, in whatever language their schema is written."""
    return _text if schema.name.replace("/msg/", "/") == "std_msgs/String" else None


def sensor(schema: Schema) -> SensorDecoder | None:
    """Decoder of messages of `sensor_types`, in whatever language their schema is written."""
    sensor_type = SENSOR_TYPES.get(schema.name.replace("/msg/", "/"))
    if sensor_type is None:
        return None
    layout_of_message = partial(_sensor_layout, sensor_type=sensor_type)
    return SensorDecoder(LayoutDecoder(layout_of_message), sensor_type.numbers)


def fields(schema: Schema, fields: MessageFields) -> FieldDecoders:
    """Decoders of the addressed fields of any message; FieldError if its definition lacks one of them."""
    return field_decoders(schema, fields)


def _sensor_layout(message: bytes, sensor_type: SensorType) -> Layout:
    """The layout of a sensor's message; ValueError if it is incomplete."""
    cursor = Cursor(message)
    stamp = None
    if sensor_type.has_header:
        stamp = cursor.skip(8, 4)
        cursor.skip(cursor.count())  # the name of the frame may differ between messages
    for _ in range(sensor_type.texts):
        cursor.skip(cursor.count())
    dtype = sensor_type.number_type(cursor.order)
    count = len(sensor_type.numbers)
    offset = cursor.skip(count * dtype.itemsize, dtype.itemsize)
    seconds = no_stamp if stamp is None else partial(stamp_seconds, offset=stamp, order=cursor.order)
    numbers = tuple(str(i) for i in range(count))
    return Layout(numbers, cursor.mask, {"sensor": (offset, dtype)}, seconds)


def _text(message: bytes) -> bytes:
    order, _ = representation(message)
    start = HEADER + 4
    if len(message) < start:
        raise truncation_error(message)
    size = struct.unpack_from(f"{order}I", message, HEADER)[0]
    if start + size > len(message):
        raise truncation_error(message)
    return message[start : start + size].removesuffix(b"\0")


def layout_of(message: bytes) -> Layout:
    """The layout of a JointState message.

    Raises
    ------
    ValueError
        If it is not one.
    """
    cursor = Cursor(message)
    stamp = cursor.skip(8, 4)
    cursor.skip(cursor.count())  # the name of the frame may differ between messages
    cursor.skip_collection_size()
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
    return Layout(joints, cursor.mask, fields, partial(stamp_seconds, offset=stamp, order=cursor.order))


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
    messages[:, HEADER : HEADER + 8] = stamps.view(np.uint8)
    for signal in layout.fields:
        layout.values(messages, signal)[:] = signals[signal]
    return messages


def encode_sensor(sensor_type: SensorType, nanoseconds: NDArray[np.int64], numbers: Array) -> Bytes:
    """Messages of a type of sensor without texts in little-endian XCDR1, shape (k, L).

    Parameters
    ----------
    sensor_type
        The type.
    nanoseconds
        Header stamps [ns], shape (k,), if the type has a header; the seconds must fit 32 bits.
    numbers
        All numbers of the type, shape (k, n).
    """
    dtype = sensor_type.number_type("<")
    template = bytearray(b"\0\1\0\0")
    if sensor_type.has_header:
        template += bytes(8) + struct.pack("<I", 1) + b"\0"  # an empty frame_id
        template += bytes((HEADER - len(template)) % dtype.itemsize)
    start = len(template)
    template += bytes(numbers.shape[1] * dtype.itemsize)
    messages = np.tile(np.frombuffer(bytes(template), np.uint8), (len(numbers), 1))
    if sensor_type.has_header:
        stamps = np.stack(np.divmod(nanoseconds, 10**9), axis=1).astype("<i4")
        messages[:, HEADER : HEADER + 8] = stamps.view(np.uint8)
    messages[:, start:] = np.ascontiguousarray(numbers.astype(dtype)).view(np.uint8)
    return messages


def _zero_message(joints: Sequence[str], signals: Mapping[str, Array]) -> bytes:
    """A message in which the stamp and all values are zero."""
    message = bytearray(b"\0\1\0\0" + bytes(8))

    def put(data: bytes, alignment: int) -> None:
        message.extend(bytes((HEADER - len(message)) % alignment) + data)

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

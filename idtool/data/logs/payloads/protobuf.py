"""The fields of `sensor_msgs/msg/JointState` and `std_msgs/msg/String` in protobuf, whatever their numbers.

Joint states whose values are packed doubles or floats, as proto3 writes them, are read many at once; google.protobuf
decodes the others one by one.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from idtool.common.arrays import Indices
from idtool.data.logs.payloads.base import (
    NANOSECONDS,
    SECONDS,
    SIGNALS,
    STAMPS,
    Decoder,
    PayloadError,
    State,
    TextDecoder,
    samples_of,
)
from idtool.data.logs.payloads.template import decode_alike
from idtool.data.logs.payloads.wire import Plan, lay_out
from idtool.data.logs.series import Samples

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto
    from mcap.records import Schema

ENCODING = "protobuf"

# a field's type and label, by their numbers in descriptor.proto
_FLOATS = {1: np.dtype("<f8"), 2: np.dtype("<f4")}  # double, float
_INTEGERS = (3, 4, 5, 13)  # int64, uint64, int32, uint32
_STRING, _MESSAGE = 9, 11
_REPEATED = 3


def decoder(schema: Schema) -> Decoder | None:
    """Of messages that have repeated names and positions."""
    descriptor = _descriptor(schema) if b"position" in schema.data else None
    if descriptor is None:
        return None
    fields = _fields(descriptor)
    names, positions = fields.get("name"), fields.get("position")
    if not (names and positions and names.type == _STRING and names.label == positions.label == _REPEATED):
        return None
    return _Decoder(descriptor)


def text(schema: Schema) -> TextDecoder | None:
    """Of messages that have one string in a field called ``data``."""
    from google.protobuf.message import DecodeError
    from google.protobuf.message_factory import GetMessageClass

    descriptor = _descriptor(schema) if b"data" in schema.data else None
    field = _fields(descriptor).get("data") if descriptor else None
    if descriptor is None or field is None or field.type != _STRING or field.label == _REPEATED:
        return None
    message = GetMessageClass(descriptor)

    def decode(data: bytes) -> bytes:
        try:
            return str.encode(getattr(message.FromString(data), "data"))  # noqa: B009  # known to the schema alone
        except (DecodeError, TypeError, ValueError) as error:
            raise ValueError(f"is not what its schema says: {error}") from None

    return decode


def _descriptor(schema: Schema) -> Descriptor | None:
    """The message that a FileDescriptorSet describes; None where it does not."""
    from google.protobuf.descriptor_database import DescriptorDatabase, Error
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message import DecodeError

    database = DescriptorDatabase()
    try:
        with warnings.catch_warnings(action="ignore"):  # of files that define the same name
            for file in FileDescriptorSet.FromString(schema.data).file:
                database.Add(file)
            return DescriptorPool(database).FindMessageTypeByName(schema.name)
    except (DecodeError, Error, KeyError, TypeError, ValueError):
        return None


def _fields(descriptor: Descriptor) -> dict[str, FieldDescriptorProto]:
    from google.protobuf.descriptor_pb2 import DescriptorProto

    message = DescriptorProto()
    descriptor.CopyToProto(message)
    return {field.name: field for field in message.field}


def _within(descriptor: Descriptor, path: Sequence[str]) -> Descriptor | None:
    """The message in the field that ``path`` leads to; None where there is no such field."""
    within: Descriptor | None = descriptor
    for name in path:
        field = _fields(within).get(name) if within else None
        if not (within and field and field.type == _MESSAGE and field.label != _REPEATED):
            return None
        within = within.fields_by_name[name].message_type
    return within


class _Decoder:
    def __init__(self, descriptor: Descriptor) -> None:
        from google.protobuf.message_factory import GetMessageClass

        self._message = GetMessageClass(descriptor)
        self._fields = [field for field in SIGNALS if field in _fields(descriptor)]
        self._stamp = next((path for path in STAMPS if _within(descriptor, path)), ())
        self._plan = _plan(descriptor, self._stamp)

    def __call__(self, buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        samples, rest = decode_alike(buffer, starts, lengths, lambda message: lay_out(message, self._plan))
        states = [self._state(i, buffer[starts[i] : starts[i] + lengths[i]]) for i in rest]
        try:
            others = samples_of(states)
        except PayloadError as error:
            raise PayloadError(rest[error.index], error) from None
        return samples + [replace(piece, index=np.array(rest)[piece.index]) for piece in others]

    def _state(self, i: int, data: bytes) -> State:
        from google.protobuf.message import DecodeError

        try:
            message: Any = self._message.FromString(data)
            stamp = attrgetter(".".join(self._stamp))(message) if self._stamp else None
            t = _first(stamp, SECONDS) + _first(stamp, NANOSECONDS) / 1e9
            values = {field: tuple(getattr(message, field)) for field in self._fields}
            return State(t, tuple(message.name), tuple(values.get(field, ()) for field in SIGNALS))
        except (DecodeError, TypeError, ValueError) as error:
            raise PayloadError(i, f"is not what its schema says: {error}") from None


def _first(stamp: object, names: Sequence[str]) -> Any:
    return next((getattr(stamp, name) for name in names if hasattr(stamp, name)), 0)


def _plan(descriptor: Descriptor, path: Sequence[str]) -> Plan:
    """What `lay_out` needs to know of a message whose stamp is where ``path`` leads to."""
    fields = _fields(descriptor)
    plan: dict[int, Any] = {fields["name"].number: "name"}
    for field, signal in SIGNALS.items():
        if field in fields:
            dtype = _FLOATS.get(fields[field].type)
            plan[fields[field].number] = (signal, dtype) if dtype else "other"
    stamp = _within(descriptor, path)
    if path and stamp:
        parts: dict[int, Any] = {
            field.number: part if field.type in _INTEGERS else "other"
            for part, names in (("sec", SECONDS), ("nanosec", NANOSECONDS))
            for name, field in _fields(stamp).items()
            if name in names
        }
        for depth in reversed(range(len(path))):
            outer = _within(descriptor, path[:depth])
            parts = {_fields(outer)[path[depth]].number: parts} if outer else {}
        plan |= parts
    return plan

"""Messages as JSON: the fields of joint states, of `std_msgs/msg/String`, of sensors, and addressed fields of any."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from idtool.common.arrays import Indices
from idtool.common.names import printable
from idtool.data.logs.payloads.base import (
    NANOSECONDS,
    SECONDS,
    SIGNALS,
    STAMP_PATHS,
    Decoder,
    FieldDecoders,
    JointState,
    MessageFields,
    PayloadError,
    SensorDecoder,
    TextDecoder,
    group_states,
)
from idtool.data.logs.payloads.field_values import MessageReader, field_decoders
from idtool.data.logs.payloads.json_schema import parse_schema
from idtool.data.logs.payloads.sensor_shapes import find_sensor
from idtool.data.logs.sample_buffer import Samples
from idtool.robot.message_fields import Step

if TYPE_CHECKING:
    from mcap.records import Schema

ENCODING = "json"


def decoder(schema: Schema) -> Decoder | None:
    """Decoder of messages with lists of names and positions, or of type JointState if the schema names no fields."""
    properties = _properties(schema)
    if not properties:
        return _decode if schema.name.endswith("JointState") else None
    try:
        lists = all("array" in properties[field].get("type", "array") for field in ("name", "position"))
    except (AttributeError, KeyError, TypeError):
        return None
    return _decode if lists else None


def text(schema: Schema) -> TextDecoder | None:
    """Decoder of messages with a field ``data``, or of type String if the schema names no fields."""
    properties = _properties(schema)
    return _text if "data" in properties or (not properties and schema.name.endswith("String")) else None


def sensor(schema: Schema) -> SensorDecoder | None:
    """Decoder of messages with the fields of a sensor, or of such a type if the schema names no fields."""
    return find_sensor(parse_schema(schema.name, schema.data), _Reader())


def fields(schema: Schema, fields: MessageFields) -> FieldDecoders:
    """Decoders of the addressed fields of any message; FieldError if its schema rules one of them out."""
    return field_decoders(_Reader(), parse_schema(schema.name, schema.data), fields)


class _Reader(MessageReader):
    @override
    def parse(self, buffer: bytes, starts: Indices, lengths: Indices) -> list[Any]:
        return _parse(buffer, starts, lengths)

    @override
    def value(self, outer: Any, step: Step) -> Any:
        return outer[step]

    @override
    def is_object(self, value: Any) -> bool:
        return isinstance(value, dict)

    @override
    def stamp_seconds(self, stamp: Any) -> float:
        return _seconds_of(stamp)

    @override
    def default_seconds(self, index: int, message: Any) -> float:
        return _seconds(index, message)


def _properties(schema: Schema) -> Any:
    """The schema's fields; empty if it names none."""
    try:
        return json.loads(schema.data).get("properties") or {}
    except (ValueError, RecursionError, AttributeError):
        return {}


def _text(message: bytes) -> bytes:
    try:
        return str.encode(json.loads(message)["data"])
    except (ValueError, RecursionError, KeyError, TypeError):
        raise ValueError("has no text in a field called data") from None


def _decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
    return group_states([_state(i, message) for i, message in enumerate(_parse(buffer, starts, lengths))])


def _parse(buffer: bytes, starts: Indices, lengths: Indices) -> list[Any]:
    texts = [buffer[start : start + size] for start, size in zip(starts.tolist(), lengths.tolist(), strict=True)]
    try:
        messages = json.loads(b"[%b]" % b",".join(texts))  # faster than one call for each
    except (ValueError, RecursionError):
        messages = []
    if len(messages) != len(texts):
        messages = [_load(i, text) for i, text in enumerate(texts)]
    return list(messages)


def _load(i: int, text: bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PayloadError(i, f"is not JSON: {error}") from None


def _state(i: int, message: Any) -> JointState:
    try:
        joints = tuple(message["name"])
        values = tuple(message.get(field) or () for field in SIGNALS)
        if not (isinstance(message["name"], list) and all(isinstance(joint, str) for joint in joints)):
            raise TypeError
        if not all(isinstance(value, list | tuple) for value in values):
            raise TypeError
    except (AttributeError, KeyError, TypeError):
        raise PayloadError(i, "is not a joint state; it needs a list of names and lists of values") from None
    return JointState(_seconds(i, message), joints, values)


def _seconds(i: int, message: Any) -> float:
    """The stamp of a message [s]; a plain number is returned as it is."""
    for path in STAMP_PATHS:
        stamp = message
        for field in path:
            stamp = stamp.get(field) if isinstance(stamp, dict) else None
        if stamp:
            try:
                return _seconds_of(stamp)
            except (TypeError, OverflowError):
                message_text = f"has a {'.'.join(path)} that is neither a number nor {{sec, nanosec}}"
                raise PayloadError(i, f"{message_text}: {printable(str(stamp))}") from None
    return 0.0


def _seconds_of(stamp: Any) -> float:
    """Seconds of a stamp; TypeError if it is none."""
    if isinstance(stamp, int | float):
        return float(stamp)
    if not any(name in stamp for name in (*SECONDS, *NANOSECONDS)):
        raise TypeError
    return float(_first_value(stamp, SECONDS) + _first_value(stamp, NANOSECONDS) / 1e9)


def _first_value(stamp: Any, names: tuple[str, ...]) -> Any:
    return next((stamp[name] for name in names if name in stamp), 0)

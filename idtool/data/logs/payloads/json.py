"""The fields of `sensor_msgs/msg/JointState` and `std_msgs/msg/String` as JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from idtool.common.arrays import Indices
from idtool.common.names import printable
from idtool.data.logs.payloads.base import (
    NANOSECONDS,
    SECONDS,
    SIGNALS,
    STAMP_PATHS,
    Decoder,
    FieldDecoders,
    FieldError,
    JointState,
    MessageFields,
    PayloadError,
    TextDecoder,
    group_states,
)
from idtool.data.logs.sample_buffer import Samples

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


def sensor(schema: Schema) -> Decoder | None:
    """Sensors are read in CDR only."""
    return None


def fields(schema: Schema, fields: MessageFields) -> FieldDecoders:
    """Fields are addressed in CDR only."""
    raise FieldError(f"log.fields are read in messages in CDR, not in {ENCODING}")


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
    texts = [buffer[start : start + size] for start, size in zip(starts.tolist(), lengths.tolist(), strict=True)]
    try:
        messages = json.loads(b"[%b]" % b",".join(texts))  # faster than one call for each
    except (ValueError, RecursionError):
        messages = []
    if len(messages) != len(texts):
        messages = [_load(i, text) for i, text in enumerate(texts)]
    return group_states([_state(i, message) for i, message in enumerate(messages)])


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
                return float(stamp if isinstance(stamp, int | float) else _stamp_seconds(stamp))
            except (TypeError, OverflowError):
                message_text = f"has a {'.'.join(path)} that is neither a number nor {{sec, nanosec}}"
                raise PayloadError(i, f"{message_text}: {printable(str(stamp))}") from None
    return 0.0


def _stamp_seconds(stamp: Any) -> Any:
    if not any(name in stamp for name in (*SECONDS, *NANOSECONDS)):
        raise TypeError
    return _first_value(stamp, SECONDS) + _first_value(stamp, NANOSECONDS) / 1e9


def _first_value(stamp: Any, names: tuple[str, ...]) -> Any:
    return next((stamp[name] for name in names if name in stamp), 0)

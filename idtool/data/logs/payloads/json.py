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
    STAMPS,
    Decoder,
    PayloadError,
    State,
    TextDecoder,
    samples_of,
)
from idtool.data.logs.series import Samples

if TYPE_CHECKING:
    from mcap.records import Schema

ENCODING = "json"


def decoder(schema: Schema) -> Decoder | None:
    """Of messages whose schema has lists of names and positions, or, where it names no fields, is called JointState."""
    properties = _properties(schema)
    if not properties:
        return _decode if schema.name.endswith("JointState") else None
    try:
        lists = all("array" in properties[field].get("type", "array") for field in ("name", "position"))
    except (AttributeError, KeyError, TypeError):
        return None
    return _decode if lists else None


def text(schema: Schema) -> TextDecoder | None:
    """Of messages whose schema has a field ``data``, or, where it names no fields, is called String."""
    properties = _properties(schema)
    return _text if "data" in properties or (not properties and schema.name.endswith("String")) else None


def _properties(schema: Schema) -> Any:
    """What the schema says of the fields; empty where it names none."""
    try:
        return json.loads(schema.data).get("properties") or {}
    except (ValueError, RecursionError, AttributeError):
        return {}


def _text(message: bytes) -> bytes:
    try:
        return str.encode(json.loads(message)["data"])
    except (ValueError, RecursionError, KeyError, TypeError):
        raise ValueError("is no text in a field called data") from None


def _decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
    texts = [buffer[a : a + n] for a, n in zip(starts.tolist(), lengths.tolist(), strict=True)]
    try:
        messages = json.loads(b"[%b]" % b",".join(texts))  # one call for all, which is faster than one for each
    except (ValueError, RecursionError):
        messages = []
    if len(messages) != len(texts):
        messages = [_load(i, text) for i, text in enumerate(texts)]
    return samples_of([_state(i, message) for i, message in enumerate(messages)])


def _load(i: int, text: bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PayloadError(i, f"is not JSON: {error}") from None


def _state(i: int, message: Any) -> State:
    try:
        joints = tuple(message["name"])
        values = tuple(message.get(field) or () for field in SIGNALS)
        if not (isinstance(message["name"], list) and all(isinstance(joint, str) for joint in joints)):
            raise TypeError
        if not all(isinstance(value, list | tuple) for value in values):
            raise TypeError
    except (AttributeError, KeyError, TypeError):
        raise PayloadError(i, "is no joint state: it needs a list of names, and lists of values") from None
    return State(_seconds(i, message), joints, values)


def _seconds(i: int, message: Any) -> float:
    """The stamp of a message; one that is a number is left in its unit."""
    for path in STAMPS:
        stamp = message
        for field in path:
            stamp = stamp.get(field) if isinstance(stamp, dict) else None
        if stamp:
            try:
                return float(stamp if isinstance(stamp, int | float) else _sum(stamp))
            except (TypeError, OverflowError):
                what = f"has a {'.'.join(path)} that is neither a number nor {{sec, nanosec}}: {printable(str(stamp))}"
                raise PayloadError(i, what) from None
    return 0.0


def _sum(stamp: Any) -> Any:
    total = _first(stamp, SECONDS) + _first(stamp, NANOSECONDS) / 1e9
    if not (total or any(name in stamp for name in (*SECONDS, *NANOSECONDS))):
        raise TypeError
    return total


def _first(stamp: Any, names: tuple[str, ...]) -> Any:
    return next((stamp[name] for name in names if name in stamp), 0)

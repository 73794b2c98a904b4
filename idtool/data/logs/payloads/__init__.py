"""Decoders of message payloads. A new encoding is one new file in this folder.

A member defines `ENCODING`, the message encoding that it reads, and functions that return decoders of a channel's
messages: `decoder` for joint states, `text` for messages that are a single text, `sensor` for an IMU, a pose, a wrench
or a flag, and `fields` for addressed fields of any messages.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import TYPE_CHECKING, Protocol, cast

from idtool.common.names import printable
from idtool.data.logs.payloads.base import Decoder, FieldDecoders, FieldError, MessageFields, SensorDecoder, TextDecoder

if TYPE_CHECKING:
    from mcap.records import Schema


class _Encoding(Protocol):
    ENCODING: str

    def decoder(self, schema: Schema) -> Decoder | None: ...

    def text(self, schema: Schema) -> TextDecoder | None: ...

    def sensor(self, schema: Schema) -> SensorDecoder | None: ...

    def fields(self, schema: Schema, fields: MessageFields) -> FieldDecoders: ...


def decoder_for(encoding: str, schema: Schema) -> Decoder | None:
    """The decoder of a channel's messages; None unless they are joint states in a supported encoding."""
    member = _encodings().get(encoding)
    return member.decoder(schema) if member else None


def text_decoder_for(encoding: str, schema: Schema) -> TextDecoder | None:
    """The decoder of a channel's messages; None unless they are `std_msgs/msg/String` in a supported encoding."""
    member = _encodings().get(encoding)
    return member.text(schema) if member else None


def sensor_decoder_for(encoding: str, schema: Schema) -> SensorDecoder | None:
    """The decoder of a channel's messages; None unless they are those of a sensor in a supported encoding."""
    member = _encodings().get(encoding)
    return member.sensor(schema) if member else None


def field_decoders_for(encoding: str, schema: Schema | None, fields: MessageFields) -> FieldDecoders:
    """The decoders of addressed fields of a channel's messages.

    Raises
    ------
    FieldError
        If the messages do not have these fields, or their encoding or schema is not supported.
    """
    member = _encodings().get(encoding)
    if schema is None:
        raise FieldError("its messages have no schema")
    if member is None:
        raise FieldError(f"its encoding {printable(encoding)} is not supported")
    return member.fields(schema, fields)


@cache
def _encodings() -> dict[str, _Encoding]:
    modules = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return {module.ENCODING: cast(_Encoding, module) for module in modules if hasattr(module, "ENCODING")}

"""What a message's bytes say of the joints. A new encoding is one new file in this folder.

A member gives `ENCODING`, the message encoding that it reads, and `decoder`, which tells from a channel's schema
whether the messages are joint states and how to decode them; `text` does so for messages that are one text.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from typing import TYPE_CHECKING, Protocol, cast

from idtool.data.logs.payloads.base import Decoder, TextDecoder

if TYPE_CHECKING:
    from mcap.records import Schema


class _Encoding(Protocol):
    ENCODING: str

    def decoder(self, schema: Schema) -> Decoder | None: ...

    def text(self, schema: Schema) -> TextDecoder | None: ...


def decoder_for(encoding: str, schema: Schema) -> Decoder | None:
    """The decoder of a channel's messages; None where they are not joint states in an encoding that is known."""
    member = _encodings().get(encoding)
    return member.decoder(schema) if member else None


def text_decoder_for(encoding: str, schema: Schema) -> TextDecoder | None:
    """The decoder of a channel's messages; None where they are no `std_msgs/msg/String` in a known encoding."""
    member = _encodings().get(encoding)
    return member.text(schema) if member else None


@cache
def _encodings() -> dict[str, _Encoding]:
    modules = (importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__))
    return {module.ENCODING: cast(_Encoding, module) for module in modules if hasattr(module, "ENCODING")}

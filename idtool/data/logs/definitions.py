"""The schemas and channels of an MCAP file by id."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Schema

from idtool.common.exceptions import LogError
from idtool.common.names import printable
from idtool.data.logs.mcap_records import RECORD, SCHEMA, RecordBatch

_MAX_BYTES = 1 << 26  # of a file's schemas and channels, which stay in memory while it is read
_MAX_LISTED = 6  # topics


class Definitions:
    """The definitions of a file so far; the first one of an id counts.

    Parameters
    ----------
    path
        The file; errors name it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._channels: set[int] = set()
        self._size = 0

    def read(self, batch: RecordBatch) -> list[tuple[Channel, Schema | None]]:
        """The new channels of a batch, each with the schema of its messages.

        Raises
        ------
        LogError
            If a definition cannot be read, or all of them are too large.
        """
        added = []
        for offset in batch.definitions:
            opcode, length = RECORD.unpack_from(batch.buffer, offset)
            start = offset + RECORD.size
            stream = ReadDataStream(BytesIO(batch.buffer[start : start + length]))
            try:
                if opcode == SCHEMA:
                    schema = Schema.read(stream)
                    if schema.id not in self._schemas:  # writers repeat them
                        self._add_size(length)
                        self._schemas[schema.id] = schema
                    continue
                channel = Channel.read(stream)
            except (McapError, struct.error, UnicodeDecodeError):
                raise LogError(self._path, "is damaged: a schema or channel cannot be read") from None
            if channel.id not in self._channels:
                self._add_size(length)
                self._channels.add(channel.id)
                added.append((channel, self._schemas.get(channel.schema_id)))
        return added

    def check_channel(self, channel: int) -> None:
        """Raise LogError if the file does not define a channel."""
        if channel not in self._channels:
            raise LogError(self._path, f"is damaged: it contains messages of channel {channel}, which is not defined")

    def _add_size(self, size: int) -> None:
        self._size += size
        if self._size > _MAX_BYTES:
            message = f"has more than {_MAX_BYTES >> 20} MiB of schemas and channels; it is not a robot log"
            raise LogError(self._path, message)


def message_type(channel: Channel, schema: Schema | None) -> str:
    """The schema and encoding of a channel's messages, for error messages."""
    return f"{printable(schema.name) if schema else 'no schema'}, {printable(channel.message_encoding)}"


def list_topics(types: Mapping[str, str]) -> str:
    """The first few topics, each with its `message_type`, and the number of others."""
    first = [f"{printable(topic)} ({kind})" for topic, kind in list(types.items())[:_MAX_LISTED]]
    others = len(types) - len(first)
    return (", ".join(first) or "none") + (f" and {others} more" if others else "")

"""The schemas and channels of an MCAP file, by the numbers that its messages bear."""

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
from idtool.data.logs.records import RECORD, SCHEMA, Batch

_MOST_BYTES = 1 << 26  # of a file's schemas and channels, which are kept as long as it is read
_MOST_SHOWN = 6  # topics


class Definitions:
    """What a file has defined so far; the first definition of a number counts.

    Parameters
    ----------
    path
        The file; errors name it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._channels: set[int] = set()
        self._held = 0

    def take(self, batch: Batch) -> list[tuple[Channel, Schema | None]]:
        """The channels that a batch adds, each with the schema of its messages.

        Raises
        ------
        LogError
            If a definition cannot be read, or they take too much room.
        """
        added = []
        for at in batch.definitions:
            begin, length = at + RECORD.size, RECORD.unpack_from(batch.buffer, at)[1]
            stream = ReadDataStream(BytesIO(batch.buffer[begin : begin + length]))
            try:
                if batch.buffer[at] == SCHEMA:
                    schema = Schema.read(stream)
                    if schema.id not in self._schemas:  # writers repeat them
                        self._hold(length)
                        self._schemas[schema.id] = schema
                    continue
                channel = Channel.read(stream)
            except (McapError, struct.error, UnicodeDecodeError):
                raise LogError(self._path, "is damaged: a schema or channel cannot be read") from None
            if channel.id not in self._channels:
                self._hold(length)
                self._channels.add(channel.id)
                added.append((channel, self._schemas.get(channel.schema_id)))
        return added

    def check(self, channel: int) -> None:
        """Raise LogError for messages of a channel that the file does not define."""
        if channel not in self._channels:
            raise LogError(self._path, f"is damaged: it has messages of channel {channel}, but not the channel")

    def _hold(self, size: int) -> None:
        self._held += size
        if self._held > _MOST_BYTES:
            what = f"holds more than {_MOST_BYTES >> 20} MiB of schemas and channels; it is no log of a robot"
            raise LogError(self._path, what)


def kind_of(channel: Channel, schema: Schema | None) -> str:
    """What a channel's messages are, for people."""
    return f"{printable(schema.name) if schema else 'no schema'}, {printable(channel.message_encoding)}"


def listed(kinds: Mapping[str, str]) -> str:
    """The first few topics, each with the kind of its messages by `kind_of`, and how many more there are."""
    few = [f"{printable(name)} ({kind})" for name, kind in list(kinds.items())[:_MOST_SHOWN]]
    more = len(kinds) - len(few)
    return (", ".join(few) or "none") + (f" and {more} more" if more else "")

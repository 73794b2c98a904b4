"""The robot that a bag describes: `robot_state_publisher` latches the URDF's text on a topic of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idtool.common.exceptions import LogError
from idtool.common.names import printable
from idtool.data.logs.bag import files_of, is_bag
from idtool.data.logs.definitions import Definitions, kind_of, listed
from idtool.data.logs.files import records
from idtool.data.logs.payloads import text_decoder_for
from idtool.data.logs.payloads.base import TextDecoder
from idtool.data.logs.records import HEAD, MESSAGE_FIELDS, Batch, Records

_TOPIC = "/robot_description"
_KIND = "std_msgs/msg/String"


@dataclass(frozen=True)
class Description:
    """A robot description.

    Attributes
    ----------
    path
        The bag.
    topic
        The topic it is on.
    text
        The URDF's text.
    """

    path: Path
    topic: str
    text: bytes


def robot_description(paths: Sequence[Path]) -> Description:
    """The one robot description that some logs hold.

    It is that on any topic whose name ends in ``robot_description``. All messages are looked at, and all bags among the
    logs, so that two robots are not taken for one.

    Parameters
    ----------
    paths
        Logs, the first of them a bag.

    Raises
    ------
    LogError
        If there is none, there are two that differ, or a bag cannot be read.
    """
    seen = _Seen()
    found: Description | None = None
    for path in filter(is_bag, paths):
        for other in _descriptions(path, seen):
            if found is None:
                found = other
            if found.text != other.text:
                where = (
                    printable(found.topic)
                    if found.path == path
                    else f"{found.path.name}, topic {printable(found.topic)}"
                )
                what = f"topic {printable(other.topic)} holds another robot description than {where}"
                raise LogError(path, f"{what}; give the URDF to use before the logs")
    if found is None:
        raise LogError(paths[0], f"{seen.missing()}; give a URDF before the log")
    return found


@dataclass
class _Seen:
    """Topics of the bags, and what is on them."""

    kinds: dict[str, str] = field(default_factory=dict)
    possible: list[str] = field(default_factory=list)  # that could carry a description

    def missing(self) -> str:
        if self.possible:
            return f"topic {printable(self.possible[0])} holds no message"
        return f"no topic {_TOPIC} carries the robot's URDF ({_KIND}); there are: {listed(self.kinds)}"


def _descriptions(path: Path, seen: _Seen) -> Iterator[Description]:
    """Every message with a description in a bag."""
    try:
        for file in files_of(path):
            with records(file) as found:
                for topic, text in _texts(path, file, found, seen):
                    yield Description(path, topic, text)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None


def _texts(path: Path, file: Path, found: Records, seen: _Seen) -> Iterator[tuple[str, bytes]]:
    """The descriptions in a file, each with its topic; what space is around them does not count."""
    definitions = Definitions(file)
    decoders: dict[tuple[str, int], TextDecoder | None] = {}  # by encoding and schema, as channels share schemas
    channels: dict[int, tuple[str, TextDecoder]] = {}
    for batch in found:
        for channel, schema in definitions.take(batch):
            seen.kinds.setdefault(channel.topic, kind_of(channel, schema))
            if not (schema and channel.topic.endswith(_TOPIC[1:])):
                continue
            key = channel.message_encoding, schema.id
            if key not in decoders:
                decoders[key] = text_decoder_for(channel.message_encoding, schema)
            if decoder := decoders[key]:
                channels[channel.id] = channel.topic, decoder
                seen.possible.append(channel.topic)
        for channel_id, message in _messages(batch, list(channels)):
            topic, decode = channels[channel_id]
            try:
                text = decode(message).strip()
            except ValueError as error:
                raise LogError(path, f"a message of {printable(topic)} {error}") from None
            if text:
                yield topic, text + b"\n"


def _messages(batch: Batch, channels: Sequence[int]) -> Iterator[tuple[int, bytes]]:
    """The messages of some channels, each with its channel."""
    if not channels or not len(batch.messages):
        return
    heads: NDArray[np.void] = batch.heads
    for i in np.flatnonzero(np.isin(heads["channel"], channels)).tolist():
        start = int(batch.messages[i]) + HEAD.itemsize
        yield int(heads["channel"][i]), batch.buffer[start : start + int(heads["length"][i]) - MESSAGE_FIELDS]

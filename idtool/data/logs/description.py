"""The robot description in a bag: `robot_state_publisher` latches the text of the URDF on a topic of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field
from pathlib import Path

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import printable
from idtool.data.logs.bag import is_bag, log_files
from idtool.data.logs.definitions import Definitions, list_topics, message_type
from idtool.data.logs.mcap_file import open_mcap
from idtool.data.logs.mcap_records import McapRecords, RecordBatch
from idtool.data.logs.payloads import text_decoder_for
from idtool.data.logs.payloads.base import TextDecoder

_TOPIC = "/robot_description"
_MESSAGE_TYPE = "std_msgs/msg/String"


@dataclass(frozen=True)
class RobotDescription:
    """A robot description.

    Attributes
    ----------
    path
        The bag.
    topic
        Its topic.
    text
        The text of the URDF.
    """

    path: Path
    topic: str
    text: bytes


def find_robot_description(paths: Sequence[Path]) -> RobotDescription:
    """The robot description in the bags among some logs.

    It may be on any topic whose name ends in ``robot_description``. All messages of all bags are compared, so that two
    different robots are not mixed up.

    Parameters
    ----------
    paths
        Logs, the first of them a bag.

    Raises
    ------
    LogError
        If there is no description, two differ, or a bag cannot be read.
    """
    topics = _TopicTypes()
    first: RobotDescription | None = None
    for path in filter(is_bag, paths):
        for other in _descriptions(path, topics):
            if first is None:
                first = other
            if first.text != other.text:
                source = f"topic {printable(first.topic)}"
                if first.path != path:
                    source += f" of {first.path.name}"
                message = f"topic {printable(other.topic)} contains a different robot description from {source}"
                raise LogError(path, f"{message}; give the URDF explicitly, before the logs")
    if first is None:
        raise LogError(paths[0], f"{topics.missing_message()}; give a URDF before the log")
    return first


@dataclass
class _TopicTypes:
    """Message types of the bags' topics, and the topics that could carry a description."""

    types: dict[str, str] = field(default_factory=dict)
    candidates: list[str] = field(default_factory=list)

    def missing_message(self) -> str:
        if self.candidates:
            return f"topic {printable(self.candidates[0])} has no messages"
        return f"no topic {_TOPIC} carries a URDF ({_MESSAGE_TYPE}); available: {list_topics(self.types)}"


def _descriptions(path: Path, topics: _TopicTypes) -> Iterator[RobotDescription]:
    """Every robot description in a bag."""
    try:
        for file in log_files(path):
            with open_mcap(file) as records:
                for topic, text in _texts(path, file, records, topics):
                    yield RobotDescription(path, topic, text)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None


def _texts(path: Path, file: Path, records: McapRecords, topics: _TopicTypes) -> Iterator[tuple[str, bytes]]:
    """The robot descriptions in a file with their topics; surrounding white space is removed."""
    definitions = Definitions(file)
    decoders: dict[tuple[str, int], TextDecoder | None] = {}  # by encoding and schema, which channels share
    channels: dict[int, tuple[str, TextDecoder]] = {}
    for batch in records:
        for channel, schema in definitions.read(batch):
            topics.types.setdefault(channel.topic, message_type(channel, schema))
            if not (schema and channel.topic.endswith(_TOPIC[1:])):
                continue
            key = (channel.message_encoding, schema.id)
            if key not in decoders:
                decoders[key] = text_decoder_for(channel.message_encoding, schema)
            if decoder := decoders[key]:
                channels[channel.id] = (channel.topic, decoder)
                topics.candidates.append(channel.topic)
        for channel_id, message in _messages(batch, list(channels)):
            topic, decode = channels[channel_id]
            try:
                text = decode(message).strip()
            except ValueError as error:
                raise LogError(path, f"a message of {printable(topic)} {error}") from None
            if text:
                yield topic, text + b"\n"


def _messages(batch: RecordBatch, channels: Sequence[int]) -> Iterator[tuple[int, bytes]]:
    """The messages of some channels, each with the channel's id."""
    found: list[tuple[int, int, int]] = []  # start, length, channel
    for channel in batch.channels.keys() & set(channels):
        messages = batch.channels[channel]
        for start, length in zip(messages.starts.tolist(), messages.lengths.tolist(), strict=True):
            found.append((start, length, channel))
    for start, length, channel in sorted(found):
        yield channel, batch.buffer[start : start + length]

"""The topics of MCAP files: the one that carries the joint states, and the samples in its messages.

The states are messages of joint states, or the fields of other messages; see `message_options`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable, suggestion
from idtool.data.logs.definitions import Definitions, list_topics, message_type
from idtool.data.logs.mcap_records import ChannelMessages, RecordBatch
from idtool.data.logs.message_options import DEFAULT_MESSAGES, MessageOptions, find_field_source
from idtool.data.logs.payloads import decoder_for
from idtool.data.logs.payloads.base import Decoder, FieldError, MissingFieldError, PayloadError
from idtool.data.logs.sample_buffer import SampleBuffer, Samples

# Key in a channel's metadata: its messages are the commands that belong to the states of the named topic.
COMMANDS_OF = "idtool.commands_of"
_MIN_POSITIONS = 2  # samples with positions that make a log
_ROS1 = "sensor_msgs/JointState, ros1"  # `message_type` of ROS 1 joint states


@dataclass
class _Topic:
    message_type: str
    has_joint_states: bool
    commands_of: str | None
    samples: SampleBuffer
    is_fallback: bool = False  # only read if no other topic has positions
    preset: str | None = None
    field_error: FieldError | None = None
    decoding_error: LogError | None = None  # of a fallback, which may not be needed
    messages: int = 0
    positions: int = 0  # samples with positions, counted up to about `_MIN_POSITIONS`


@dataclass(frozen=True)
class _StateDecoder:
    """Decoder of the joint states in messages of a schema, if they carry any, and attributes of their topic."""

    decode: Decoder | None
    is_fallback: bool = False
    preset: str | None = None
    error: FieldError | None = None


class TopicReader:
    """Decodes the messages of a log's files, one file after the other, and keeps the samples that may be needed.

    A topic whose metadata say that it carries commands is read together with the topic of the states, and as states
    only if it is asked for. If some topics have positions, topics without positions or with a single latched sample
    are no candidates: they are commands, or a start position.

    Parameters
    ----------
    path
        The log; errors name it.
    wanted
        The topic to read; None to find it.
    options
        Which messages other than joint states to read.
    keep_samples
        If false, only `names` are found.
    """

    def __init__(
        self,
        path: Path,
        wanted: str | None,
        options: MessageOptions = DEFAULT_MESSAGES,
        keep_samples: bool = True,
    ) -> None:
        self._path = path
        self._wanted = wanted
        self._options = options
        self._keep_samples = keep_samples
        self._definitions = Definitions(path)
        self._decoders: dict[tuple[str, int], _StateDecoder] = {}  # by encoding and schema, which channels share
        self._channels: dict[int, tuple[str, Decoder | None]] = {}
        self._topics: dict[str, _Topic] = {}
        self._files = 0

    def begin_file(self, file: Path) -> None:
        """Start the next file, in which channels have other ids."""
        self._definitions = Definitions(file)
        self._decoders = {}
        self._files += 1
        for topic in self._topics.values():
            topic.samples.begin_part()

    def read(self, batch: RecordBatch) -> None:
        """Decode the messages of a batch that may be needed.

        Raises
        ------
        LogError
            If a definition or a message cannot be read.
        """
        for channel, schema in self._definitions.read(batch):
            self._add_channel(channel, schema)
        samples_by_topic: dict[str, list[Samples]] = {}
        for channel_id, messages in batch.channels.items():
            self._definitions.check_channel(channel_id)
            name, decoder = self._channels[channel_id]
            topic = self._topics[name]
            needed = self._is_needed(name)
            if decoder and (needed or topic.positions < _MIN_POSITIONS):
                try:
                    samples = self._decode(name, decoder, batch.buffer, messages)
                except LogError as error:
                    if not topic.is_fallback:
                        raise
                    topic.decoding_error = error
                    self._channels[channel_id] = (name, None)
                    samples = []
                except FieldError as error:
                    topic.field_error = topic.field_error or error
                    topic.has_joint_states = False
                    self._channels[channel_id] = (name, None)
                    samples = []
                if topic.positions < _MIN_POSITIONS:
                    topic.positions += sum(map(_count_positions, samples))
                if needed:
                    samples_by_topic.setdefault(name, []).extend(samples)
            topic.messages += len(messages.index)
        for name, samples in samples_by_topic.items():
            self._topics[name].samples.append(samples)

    def __len__(self) -> int:
        """Number of topics, with or without messages."""
        return len(self._topics)

    def select(self) -> str:
        """The states' topic.

        Raises
        ------
        LogError
            If there is not exactly one such topic, or its messages cannot be decoded.
        """
        name = self._wanted
        if name is None:
            if len(self.names) > 1:
                message = (
                    f"{len(self.names)} topics carry joint states; set log.topic to one of {join_names(self.names)}"
                )
                raise LogError(self._path, message)
            if not self.names:
                raise LogError(self._path, self._no_topic_message())
            (name,) = self.names
        elif not (name in self._topics and self._topics[name].has_joint_states and self._topics[name].messages):
            raise LogError(self._path, self._unusable_topic_message(name))
        if error := self._topics[name].decoding_error:
            raise error
        almost_found = any(error.closeness for error in self._field_errors().values())
        if self.are_fields_missing(name) and self._wanted is None and almost_found:
            raise LogError(self._path, self._no_topic_message())
        return name

    def are_fields_missing(self, name: str) -> bool:
        """True if a topic is read as joint states although other fields are asked for, which no topic has."""
        return self._options.are_given and self._topics[name].is_fallback

    def samples(self, name: str) -> SampleBuffer:
        """The samples of a topic."""
        return self._topics[name].samples

    def commands(self, name: str) -> SampleBuffer | None:
        """The samples of the commands that belong to a topic; None if there are none."""
        for topic in self._topics.values():
            if topic.commands_of == name and len(topic.samples):
                return topic.samples
        return None

    def preset(self, name: str) -> str | None:
        """The preset that names the joints of a topic; None if the messages or the configuration name them."""
        return self._topics[name].preset

    @property
    def names(self) -> tuple[str, ...]:
        """The candidates for the states' topic, in the order of their channels."""
        ranks = {
            name: (min(topic.positions, _MIN_POSITIONS), not topic.is_fallback)
            for name, topic in self._topics.items()
            if topic.has_joint_states and topic.messages and not topic.commands_of
        }
        highest = max(ranks.values(), default=None)
        return tuple(name for name, rank in ranks.items() if rank == highest)

    def _no_topic_message(self) -> str:
        field_errors = self._field_errors()
        if field_errors:
            name, error = max(field_errors.items(), key=lambda item: item[1].closeness)
            if error.closeness or len(field_errors) == 1:
                return f"topic {printable(name)}: {error}"
        types = {name: topic.message_type for name, topic in self._topics.items() if topic.messages}
        for name, kind in types.items():
            if kind == _ROS1:
                return (
                    f"topic {printable(name)} carries joint states in the ROS 1 encoding, which is not supported; run "
                    "'rosbags-convert --src <the original .bag> --dst <a new folder> --dst-storage mcap' (pip install "
                    "rosbags) and use that folder"
                )
        if self._options.are_given:
            what = "the fields in log.fields"
            if self._options.preset is not None:
                what = f"messages of preset {self._options.preset}"
            return f"no topic has {what}; available: {list_topics(types)}"
        return f"no topic carries joint states (sensor_msgs/msg/JointState); available: {list_topics(types)}"

    def _field_errors(self) -> dict[str, FieldError]:
        """Why the fields of topics cannot be read."""
        errors = {name: topic.field_error for name, topic in self._topics.items() if topic.messages}
        return {name: error for name, error in errors.items() if error is not None}

    def _unusable_topic_message(self, name: str) -> str:
        if name not in self._topics:
            return f"has no topic {name}; {suggestion(name, self.names or list(self._topics))}"
        topic = self._topics[name]
        if not topic.has_joint_states:
            if topic.field_error is not None:
                return f"topic {name}: {topic.field_error}"
            return f"topic {name} carries {topic.message_type}, not joint states; {suggestion(name, self.names)}"
        return f"topic {name} has no messages"

    def _is_needed(self, name: str) -> bool:
        """True if the samples of a topic may be needed, as far as is known from the messages so far."""
        if not self._keep_samples:
            return False
        commands_of = self._topics[name].commands_of
        if self._wanted is not None:
            return self._wanted in (name, commands_of)
        if commands_of is not None:
            return True
        is_fallback = self._topics[name].is_fallback
        for other, topic in self._topics.items():
            comes_first = is_fallback or not topic.is_fallback
            if topic.positions >= _MIN_POSITIONS and not topic.commands_of and comes_first:
                return other == name
        return True

    def _add_channel(self, channel: Channel, schema: Schema | None) -> None:
        key = (channel.message_encoding, schema.id if schema else 0)
        if key not in self._decoders:
            self._decoders[key] = self._state_decoder(channel.message_encoding, schema)
        found = self._decoders[key]
        if channel.topic not in self._topics:
            commands_of = channel.metadata.get(COMMANDS_OF)
            topic = _Topic(message_type(channel, schema), False, commands_of, SampleBuffer(self._path))
            for _ in range(self._files):
                topic.samples.begin_part()
            self._topics[channel.topic] = topic
        topic = self._topics[channel.topic]
        topic.field_error = topic.field_error or found.error
        if found.decode is not None:
            topic.has_joint_states = True
            topic.is_fallback = found.is_fallback
            topic.preset = found.preset
        self._channels[channel.id] = (channel.topic, found.decode)

    def _state_decoder(self, encoding: str, schema: Schema | None) -> _StateDecoder:
        fields_come_first = self._options.are_given
        decode_joint_states = decoder_for(encoding, schema) if schema else None
        if decode_joint_states and not fields_come_first:
            return _StateDecoder(decode_joint_states)
        source = None
        field_error = None
        try:
            source = find_field_source(encoding, schema, self._options)
        except FieldError as error:
            field_error = error
        if source:
            return _StateDecoder(source.decoders.states, not fields_come_first, source.preset)
        return _StateDecoder(decode_joint_states, is_fallback=True, error=field_error)

    def _decode(self, name: str, decoder: Decoder, buffer: bytes, messages: ChannelMessages) -> list[Samples]:
        """The samples in messages of a buffer, indexed among all messages of the batch.

        FieldError if the first message lacks a field, which its definition did not tell.
        """
        try:
            decoded = decoder(buffer, messages.starts, messages.lengths)
        except PayloadError as error:
            is_first = self._topics[name].messages + error.index == 0
            if isinstance(error, MissingFieldError) and is_first:
                raise error.field_error from None
            number = self._topics[name].messages + error.index + 1
            raise LogError(self._path, f"message {number} of {printable(name)} {error}") from None
        return [replace(messages.stamp(piece), index=messages.index[piece.index]) for piece in decoded]


def _count_positions(samples: Samples) -> int:
    """Number of samples with the position of at least one joint."""
    q = samples.signals.get("q")
    return 0 if q is None else int(np.isfinite(q).any(axis=1).sum())

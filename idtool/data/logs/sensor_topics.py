"""`SensorTopics`: the topics of MCAP files with IMU, pose, contacts and wrenches, as channels.

A topic's name without its slashes is part of the channels' names: a wrench on /force/FL_foot becomes
``force_FL_foot_x``, a flag on /contact/FL_foot ``contact_FL_foot``. The messages of the joints' states may have
channels, too; see `message_options`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.records import Channel as ChannelDefinition
from mcap.records import Schema

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable, suggestion
from idtool.common.notice import Notice
from idtool.data.logs.definitions import Definitions
from idtool.data.logs.log import Channel
from idtool.data.logs.mcap_records import ChannelMessages, RecordBatch
from idtool.data.logs.message_options import FieldSource, MessageOptions, find_field_source
from idtool.data.logs.payloads import sensor_decoder_for
from idtool.data.logs.payloads.base import Decoder, FieldError, MissingFieldError, PayloadError
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.data.logs.stored_arrays import RowBuffer
from idtool.data.logs.times import convert_to_seconds

_MIN_TIMES = 16  # by which the unit of a topic's stamps is judged, which in JSON may be numbers
_PREFIXES = ("force_", "contact_")  # that a topic may have already


@dataclass(frozen=True)
class _Kind:
    """A kind of sensor of which a log may have several topics.

    Attributes
    ----------
    prefix
        Begin of the names of its channels.
    article, word
        Its name in messages.
    key
        Key of its topic in the configuration.
    """

    prefix: str
    article: str
    word: str
    key: str


_IMU = _Kind("imu_", "an", "IMU", "base.imu.topic")
_POSE = _Kind("base_", "a", "pose", "base.pose.topic")


@dataclass
class _Topic:
    """A topic of a sensor and what was read of it so far."""

    type_name: str
    channels: tuple[str, ...]
    decoder: Decoder
    rows: RowBuffer  # times, then the values of the channels that are used
    is_addressed: bool = False  # by the fields of the joints' states
    error: LogError | None = None
    missing_field: FieldError | None = None  # without which it is not of a sensor after all

    @property
    def used(self) -> list[int]:
        """Indices of the channels that are used, which have a name."""
        return [i for i, channel in enumerate(self.channels) if channel]

    @property
    def has_messages(self) -> bool:
        """True if messages were read."""
        return len(self.rows) > 0

    @property
    def is_empty(self) -> bool:
        """True if it has no messages; not known of addressed fields."""
        return not (self.has_messages or self.is_addressed or self.missing_field)


class SensorTopics:
    """Decodes the messages of sensors in a log's files, one file after the other.

    Parameters
    ----------
    path
        The log; errors name it.
    sensors
        The topics of the IMU and of the pose; None: those of the joints' states if they have one, or else the only one.
    options
        Which fields of other messages to read.
    """

    def __init__(self, path: Path, sensors: SensorOptions, options: MessageOptions) -> None:
        self._path = path
        self._sensors = sensors
        self._options = options
        self._definitions = Definitions(path)
        self._by_channel: dict[int, _Topic] = {}
        self._topics: dict[str, _Topic] = {}
        self._sources: dict[tuple[str, int], FieldSource | None] = {}  # by encoding and schema, which channels share

    def begin_file(self, file: Path) -> None:
        """Start the next file, in which channels have other ids."""
        self._definitions = Definitions(file)
        self._by_channel = {}
        self._sources = {}

    def read(self, batch: RecordBatch) -> None:
        """Decode the messages of a batch that are of sensors.

        Raises
        ------
        LogError
            If a definition or a message cannot be read.
        """
        for definition, schema in self._definitions.read(batch):
            if schema is None:
                continue
            topic = self._sensor_topic(definition, schema)
            if topic is not None:
                self._by_channel[definition.id] = self._topics.setdefault(definition.topic, topic)
        for channel_id, messages in batch.channels.items():
            if channel_id in self._by_channel:
                self._decode(self._by_channel[channel_id], batch.buffer, messages)

    @property
    def imus(self) -> tuple[str, ...]:
        """The topics that carry an IMU, with messages."""
        return tuple(name for name, topic in self._topics.items() if topic.has_messages and _carries(topic, _IMU))

    @property
    def poses(self) -> tuple[str, ...]:
        """The topics that carry a pose, with messages."""
        return tuple(name for name, topic in self._topics.items() if topic.has_messages and _carries(topic, _POSE))

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices of topics that could not be used."""
        notices: tuple[Notice, ...] = ()
        empty = [name for name, topic in self._topics.items() if topic.is_empty]
        if empty:
            noun = "topic" if len(empty) == 1 else "topics"
            message = f"no messages on {noun} {join_names(empty)}"
            advice = "a sensor whose topic is empty cannot be used; log it, or leave it out of the configuration"
            notices += (Notice("sensor_topic_empty", "note", None, message, advice),)
        for name, topic in self._topics.items():
            if topic.missing_field is not None:
                message = f"topic {printable(name)} was ignored: {topic.missing_field}"
                notices += (Notice("sensor_topic_ignored", "note", None, message),)
        return notices

    def channels(self, states_topic: str) -> dict[str, Channel]:
        """The channels by name; those of a topic without messages have no values.

        Parameters
        ----------
        states_topic
            The topic of the joints' states, whose fields are read.

        Raises
        ------
        LogError
            If several topics carry an IMU or a pose that is needed and none is chosen, or the chosen one does not.
        """
        topics = {}
        for name, topic in self._topics.items():
            if name == states_topic and topic.error is not None:
                raise topic.error
            if topic.has_messages and (name == states_topic or not topic.is_addressed):
                topics[name] = topic
        empty_topics = {name: topic for name, topic in self._topics.items() if topic.is_empty}
        options = self._sensors
        chosen = {
            _IMU: self._choose(topics, _IMU, options.imu_topic, states_topic, options.needs_imu),
            _POSE: self._choose(topics, _POSE, options.pose_topic, states_topic, options.needs_pose),
        }
        channels = {}
        for name, topic in topics.items():
            t, *values = topic.rows.columns()
            if len(t) >= _MIN_TIMES:
                convert_to_seconds(t)
            for i, x in zip(topic.used, values, strict=True):
                channel = topic.channels[i]
                kind = next((kind for kind in chosen if channel.startswith(kind.prefix)), None)
                if kind is None or chosen[kind] == name:
                    channels[channel] = Channel(t, x)
        for topic in empty_topics.values():
            for channel in filter(None, topic.channels):
                channels.setdefault(channel, Channel(np.empty(0), np.empty(0)))
        return channels

    def _choose(
        self, topics: dict[str, _Topic], kind: _Kind, given: str | None, states_topic: str, is_needed: bool
    ) -> str | None:
        """The topic of a kind of sensor that is read; None if there is none, or several and none is needed."""
        names = [name for name, topic in topics.items() if _carries(topic, kind)]
        if given is not None:
            if given in self._topics and self._topics[given].is_empty and _carries(self._topics[given], kind):
                raise LogError(self._path, f"{kind.key}: no messages on topic {printable(given)}")
            if given not in names:
                what = f"{kind.key}: no {kind.word} on topic {printable(given)}; {suggestion(given, names)}"
                raise LogError(self._path, what)
            return given
        if states_topic in names:
            return states_topic
        if len(names) > 1 and is_needed:
            what = f"{len(names)} topics carry {kind.article} {kind.word}; set {kind.key} to one of {join_names(names)}"
            raise LogError(self._path, what)
        return names[0] if len(names) == 1 else None

    def _sensor_topic(self, definition: ChannelDefinition, schema: Schema) -> _Topic | None:
        """A topic of a sensor, or of messages with addressed fields; None if it is neither."""
        type_name = schema.name.replace("/msg/", "/")
        decoder = sensor_decoder_for(definition.message_encoding, schema)
        if decoder is not None:
            names = decoder.channels(channel_part(definition.topic))
            return self._topic(type_name, names, decoder.decode)
        key = (definition.message_encoding, schema.id)
        if key not in self._sources:
            self._sources[key] = self._find_source(definition.message_encoding, schema)
        source = self._sources[key]
        if source is None or source.decoders.sensors is None:
            return None
        return self._topic(type_name, source.decoders.channels, source.decoders.sensors, is_addressed=True)

    def _topic(self, type_name: str, channels: tuple[str, ...], decoder: Decoder, is_addressed: bool = False) -> _Topic:
        width = 1 + sum(map(bool, channels))
        return _Topic(type_name, channels, decoder, RowBuffer(self._path, width), is_addressed)

    def _find_source(self, encoding: str, schema: Schema) -> FieldSource | None:
        try:
            return find_field_source(encoding, schema, self._options)
        except FieldError:  # if it is of the topic of the states, it is raised there
            return None

    def _decode(self, topic: _Topic, buffer: bytes, messages: ChannelMessages) -> None:
        """Add messages of a buffer to their topic."""
        if topic.missing_field is not None:
            return
        try:
            decoded = topic.decoder(buffer, messages.starts, messages.lengths)
        except PayloadError as error:
            if isinstance(error, MissingFieldError) and not topic.is_addressed and not topic.has_messages:
                topic.missing_field = error.field_error
                return
            fault = LogError(self._path, f"a message of type {printable(topic.type_name)} {error}")
            if not topic.is_addressed:
                raise fault from None
            topic.error = fault  # it may not be the topic of the states
            return
        for piece in decoded:
            t = messages.stamp(piece).t
            topic.rows.append(np.column_stack([t, piece.signals["sensor"][:, topic.used]]))


def _carries(topic: _Topic, kind: _Kind) -> bool:
    return any(channel.startswith(kind.prefix) for channel in topic.channels)


def channel_part(topic: str) -> str:
    """Name of a topic as part of the names of its channels."""
    name = topic.strip("/").replace("/", "_")
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    return name

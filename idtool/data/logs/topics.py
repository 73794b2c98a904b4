"""The topics of MCAP files: the one that carries the joint states, and the samples in its messages."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from idtool.common.arrays import Indices
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable, suggestion
from idtool.data.logs.definitions import Definitions, list_topics, message_type
from idtool.data.logs.mcap_records import HEAD, MESSAGE_FIELDS, RecordBatch
from idtool.data.logs.payloads import decoder_for
from idtool.data.logs.payloads.base import Decoder, PayloadError
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
    messages: int = 0
    positions: int = 0  # samples with positions, counted up to about `_MIN_POSITIONS`


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
    keep_samples
        If false, only `names` are found.
    """

    def __init__(self, path: Path, wanted: str | None, keep_samples: bool = True) -> None:
        self._path = path
        self._wanted = wanted
        self._keep_samples = keep_samples
        self._definitions = Definitions(path)
        self._decoders: dict[tuple[str, int], Decoder | None] = {}  # by encoding and schema, which channels share
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
        if not len(batch.messages):
            return
        heads = batch.heads
        samples_by_topic: dict[str, list[Samples]] = {}
        for channel_id in np.unique(heads["channel"]).tolist():
            self._definitions.check_channel(channel_id)
            name, decoder = self._channels[channel_id]
            topic = self._topics[name]
            index = np.flatnonzero(heads["channel"] == channel_id)
            needed = self._is_needed(name)
            if decoder and (needed or topic.positions < _MIN_POSITIONS):
                samples = self._decode(name, decoder, batch, heads, index)
                if topic.positions < _MIN_POSITIONS:
                    topic.positions += sum(map(_count_positions, samples))
                if needed:
                    samples_by_topic.setdefault(name, []).extend(samples)
            topic.messages += len(index)
        for name, samples in samples_by_topic.items():
            self._topics[name].samples.append(samples)

    def __len__(self) -> int:
        """Number of topics, with or without messages."""
        return len(self._topics)

    def select(self) -> tuple[SampleBuffer, SampleBuffer | None]:
        """The samples of the states' topic, and those of its commands.

        Raises
        ------
        LogError
            If there is not exactly one such topic.
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
        commands = None
        for topic in self._topics.values():
            if commands is None and topic.commands_of == name and len(topic.samples):
                commands = topic.samples
        return self._topics[name].samples, commands

    @property
    def names(self) -> tuple[str, ...]:
        """The candidates for the states' topic, in the order of their channels."""
        positions = {
            name: min(topic.positions, _MIN_POSITIONS)
            for name, topic in self._topics.items()
            if topic.has_joint_states and topic.messages and not topic.commands_of
        }
        most = max(positions.values(), default=0)
        return tuple(name for name, count in positions.items() if count == most)

    def _no_topic_message(self) -> str:
        types = {name: topic.message_type for name, topic in self._topics.items() if topic.messages}
        for name, kind in types.items():
            if kind == _ROS1:
                return (
                    f"topic {printable(name)} carries joint states in the ROS 1 encoding, which is not supported; run "
                    "'rosbags-convert --src <the original .bag> --dst <a new folder> --dst-storage mcap' (pip install "
                    "rosbags) and use that folder"
                )
        return f"no topic carries joint states (sensor_msgs/msg/JointState); available: {list_topics(types)}"

    def _unusable_topic_message(self, name: str) -> str:
        if name not in self._topics:
            return f"has no topic {name}; {suggestion(name, self.names or list(self._topics))}"
        topic = self._topics[name]
        if not topic.has_joint_states:
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
        for other, topic in self._topics.items():
            if topic.positions >= _MIN_POSITIONS and not topic.commands_of:
                return other == name
        return True

    def _add_channel(self, channel: Channel, schema: Schema | None) -> None:
        decoder = None
        if schema:
            key = (channel.message_encoding, schema.id)
            if key not in self._decoders:
                self._decoders[key] = decoder_for(channel.message_encoding, schema)
            decoder = self._decoders[key]
        if channel.topic not in self._topics:
            commands_of = channel.metadata.get(COMMANDS_OF)
            topic = _Topic(message_type(channel, schema), False, commands_of, SampleBuffer(self._path))
            for _ in range(self._files):
                topic.samples.begin_part()
            self._topics[channel.topic] = topic
        self._topics[channel.topic].has_joint_states |= decoder is not None
        self._channels[channel.id] = (channel.topic, decoder)

    def _decode(
        self, name: str, decoder: Decoder, batch: RecordBatch, heads: NDArray[np.void], index: Indices
    ) -> list[Samples]:
        """The samples of the messages of a batch at ``index``; those without a stamp get their log time."""
        heads = heads[index]
        starts = batch.messages[index] + HEAD.itemsize
        lengths = heads["length"].astype(np.intp) - MESSAGE_FIELDS
        try:
            decoded = decoder(batch.buffer, starts, lengths)
        except PayloadError as error:
            number = self._topics[name].messages + error.index + 1
            raise LogError(self._path, f"message {number} of {printable(name)} {error}") from None
        seconds, nanoseconds = np.divmod(heads["log_time"], np.uint64(10**9))
        log_time = seconds + nanoseconds / 1e9
        samples = []
        for piece in decoded:
            t = np.where(piece.t == 0, log_time[piece.index], piece.t)
            samples.append(replace(piece, index=index[piece.index], t=t))
        return samples


def _count_positions(samples: Samples) -> int:
    """Number of samples with the position of at least one joint."""
    q = samples.signals.get("q")
    return 0 if q is None else int(np.isfinite(q).any(axis=1).sum())

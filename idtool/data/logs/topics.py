"""The topics of MCAP files: which one carries the joint states, and what its messages hold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from idtool.common.arrays import Indices
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable, suggestion
from idtool.data.logs.definitions import Definitions, kind_of, listed
from idtool.data.logs.payloads import decoder_for
from idtool.data.logs.payloads.base import Decoder, PayloadError
from idtool.data.logs.records import HEAD, MESSAGE_FIELDS, Batch
from idtool.data.logs.series import Samples, Series

COMMANDS_OF = "idtool.commands_of"  # in a channel's metadata: its messages are the commands to the states of this topic
_FEWEST = 2  # samples with positions that make a log
_ROS1 = "sensor_msgs/JointState, ros1"  # the kind of such messages, by `kind_of`


@dataclass
class _Topic:
    kind: str  # of its messages, for people
    joints: bool  # whether they are joint states
    commands_of: str | None
    series: Series
    messages: int = 0
    positions: int = 0  # samples that hold some, counted up to `_FEWEST` or a batch more


class Topics:
    """Takes the messages of a log's files, one after the other, and keeps those that may be wanted.

    A topic whose metadata says that it carries commands is read with the topic of the states, and for states only
    when it is asked for. Where some topics hold positions, those that hold none, or one sample that was latched, are
    no candidates: they are commands, or where a robot started from.

    Parameters
    ----------
    path
        The log; errors name it.
    wanted
        The topic to read; None to find it.
    keeping
        Whether samples are kept; else only `names` are found.
    """

    def __init__(self, path: Path, wanted: str | None, keeping: bool = True) -> None:
        self._path = path
        self._wanted = wanted
        self._keeping = keeping
        self._definitions = Definitions(path)
        self._decoders: dict[tuple[str, int], Decoder | None] = {}  # by encoding and schema, as channels share schemas
        self._channels: dict[int, tuple[str, Decoder | None]] = {}
        self._topics: dict[str, _Topic] = {}
        self._files = 0

    def begin(self, file: Path) -> None:
        """What is taken from now on is from this file, in which channels have other numbers."""
        self._definitions, self._decoders = Definitions(file), {}
        self._files += 1
        for topic in self._topics.values():
            topic.series.part()

    def take(self, batch: Batch) -> None:
        """Decode what is wanted of a batch.

        Raises
        ------
        LogError
            If a definition or a message cannot be read.
        """
        for added in self._definitions.take(batch):
            self._add(*added)
        if not len(batch.messages):
            return
        heads = batch.heads
        pieces: dict[str, list[Samples]] = {}
        for channel in np.unique(heads["channel"]).tolist():
            self._definitions.check(channel)
            name, decoder = self._channels[channel]
            topic = self._topics[name]
            which = np.flatnonzero(heads["channel"] == channel)
            if decoder and ((kept := self._keeps(name)) or topic.positions < _FEWEST):
                samples = self._decode(name, decoder, batch, heads, which)
                if topic.positions < _FEWEST:
                    topic.positions += sum(map(_positions, samples))
                if kept:
                    pieces.setdefault(name, []).extend(samples)
            topic.messages += len(which)
        for name, samples in pieces.items():
            self._topics[name].series.append(samples)

    def __len__(self) -> int:
        """How many topics there are, with messages or without."""
        return len(self._topics)

    def chosen(self) -> tuple[Series, Series | None]:
        """The samples of the states' topic, and those of their commands.

        Raises
        ------
        LogError
            If there is no such topic, or there are several.
        """
        name = self._wanted
        if name is None:
            if len(self.names) > 1:
                several = (
                    f"{len(self.names)} topics carry joint states; set log.topic to one of {join_names(self.names)}"
                )
                raise LogError(self._path, several)
            if not self.names:
                raise LogError(self._path, self._none())
            (name,) = self.names
        elif not (name in self._topics and self._topics[name].joints and self._topics[name].messages):
            raise LogError(self._path, self._why_not(name))
        commands = (topic.series for topic in self._topics.values() if topic.commands_of == name and len(topic.series))
        return self._topics[name].series, next(commands, None)

    @property
    def names(self) -> tuple[str, ...]:
        """The topics that may be meant, in the order of their channels."""
        held = {
            name: min(topic.positions, _FEWEST)
            for name, topic in self._topics.items()
            if topic.joints and topic.messages and not topic.commands_of
        }
        most = max(held.values(), default=0)
        return tuple(name for name, positions in held.items() if positions == most)

    def _none(self) -> str:
        """Why no topic is read."""
        topics = {name: topic for name, topic in self._topics.items() if topic.messages}
        ros1 = next((name for name, topic in topics.items() if topic.kind == _ROS1), None)
        if ros1 is not None:
            return (
                f"topic {printable(ros1)} carries joint states as ROS 1 encodes them, which is not read; run 'rosbags-"
                "convert --src <the .bag they were recorded in> --dst <a new folder> --dst-storage mcap' (pip install "
                "rosbags) and give that folder"
            )
        there = listed({name: topic.kind for name, topic in topics.items()})
        return f"no topic carries joint states (sensor_msgs/msg/JointState); there are: {there}"

    def _why_not(self, name: str) -> str:
        if name not in self._topics:
            return f"has no topic {name}; {suggestion(name, self.names or list(self._topics))}"
        topic = self._topics[name]
        if not topic.joints:
            return f"topic {name} carries {topic.kind}, not joint states; {suggestion(name, self.names)}"
        return f"topic {name} holds no messages"

    def _keeps(self, name: str) -> bool:
        """Whether the messages of a topic may be wanted, as far as is known."""
        commands_of = self._topics[name].commands_of
        if self._wanted is not None or not self._keeping:
            return self._keeping and self._wanted in (name, commands_of)
        known = (other for other, topic in self._topics.items() if topic.positions >= _FEWEST and not topic.commands_of)
        return commands_of is not None or next(known, name) == name

    def _add(self, channel: Channel, schema: Schema | None) -> None:
        decoder = None
        if schema:
            key = channel.message_encoding, schema.id
            if key not in self._decoders:
                self._decoders[key] = decoder_for(channel.message_encoding, schema)
            decoder = self._decoders[key]
        if channel.topic not in self._topics:
            commands_of = channel.metadata.get(COMMANDS_OF)
            topic = _Topic(kind_of(channel, schema), False, commands_of, Series(self._path))
            for _ in range(self._files):
                topic.series.part()
            self._topics[channel.topic] = topic
        self._topics[channel.topic].joints |= decoder is not None
        self._channels[channel.id] = channel.topic, decoder

    def _decode(
        self, name: str, decoder: Decoder, batch: Batch, heads: NDArray[np.void], which: Indices
    ) -> list[Samples]:
        heads = heads[which]
        starts = batch.messages[which] + HEAD.itemsize
        try:
            samples = decoder(batch.buffer, starts, heads["length"].astype(np.intp) - MESSAGE_FIELDS)
        except PayloadError as error:
            number = self._topics[name].messages + error.index + 1
            raise LogError(self._path, f"message {number} of {printable(name)} {error}") from None
        seconds, nanoseconds = np.divmod(heads["log_time"], np.uint64(10**9))
        logged = seconds + nanoseconds / 1e9
        return [
            replace(piece, index=which[piece.index], t=np.where(piece.t == 0, logged[piece.index], piece.t))
            for piece in samples
        ]


def _positions(samples: Samples) -> int:
    """How many samples hold the position of some joint."""
    q = samples.signals.get("q")
    return 0 if q is None else int(np.isfinite(q).any(axis=1).sum())

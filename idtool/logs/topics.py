"""The topics of MCAP files: which one carries the joint states, and what its messages hold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from idtool.exceptions import LogError
from idtool.logs.definitions import Definitions, kind_of
from idtool.logs.payloads import decoder_for
from idtool.logs.payloads.base import Decoder, PayloadError
from idtool.logs.records import HEAD, MESSAGE_FIELDS, Batch
from idtool.logs.series import Samples, Series
from idtool.names import nearest, shown, some

COMMANDS_OF = "idtool.commands_of"  # in a channel's metadata: its messages are the commands to the states of this topic


@dataclass
class _Topic:
    kind: str  # of its messages, for people
    joints: bool  # whether they are joint states
    commands_of: str | None
    series: Series
    messages: int = 0


class Topics:
    """Takes the messages of a log's files, one after the other, and keeps those that may be wanted.

    A topic whose metadata says that it carries commands is read with the topic of the states, and for states only
    when it is asked for.

    Parameters
    ----------
    path
        The log; errors name it.
    wanted
        The topic to read; None to find it.
    """

    def __init__(self, path: Path, wanted: str | None) -> None:
        self._path = path
        self._wanted = wanted
        self._definitions = Definitions(path)
        self._channels: dict[int, tuple[str, Decoder | None]] = {}
        self._topics: dict[str, _Topic] = {}

    def begin(self, file: Path) -> None:
        """What is taken from now on is from this file, in which channels have other numbers."""
        self._definitions = Definitions(file)
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
            which = np.flatnonzero(heads["channel"] == channel)
            if decoder and self._follows(name):
                pieces.setdefault(name, []).extend(self._decode(name, decoder, batch, heads, which))
            self._topics[name].messages += len(which)
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
        candidates = self._candidates()
        if self._wanted is not None and self._wanted not in candidates:
            raise LogError(self._path, self._why_not(self._wanted))
        if not candidates:
            kinds = [f"{name} ({topic.kind})" for name, topic in self._topics.items() if topic.messages]
            raise LogError(
                self._path,
                f"no topic carries joint states (sensor_msgs/msg/JointState); there are: {some(kinds)}",
            )
        if self._wanted is None and len(candidates) > 1:
            raise LogError(
                self._path, f"{len(candidates)} topics carry joint states; set log.topic to one of {some(candidates)}"
            )
        name = self._wanted or candidates[0]
        commands = (topic.series for topic in self._topics.values() if topic.commands_of == name and len(topic.series))
        return self._topics[name].series, next(commands, None)

    def _candidates(self) -> list[str]:
        return [
            name
            for name, topic in self._topics.items()
            if topic.joints and topic.messages and (name == self._wanted or not topic.commands_of)
        ]

    def _why_not(self, name: str) -> str:
        if name not in self._topics:
            return f"has no topic {name}; {nearest(name, self._candidates() or list(self._topics))}"
        topic = self._topics[name]
        if not topic.joints:
            return f"topic {name} carries {shown(topic.kind)}, not joint states; {nearest(name, self._candidates())}"
        return f"topic {name} holds no messages"

    def _follows(self, name: str) -> bool:
        """Whether the messages of a topic may be wanted, as far as is known."""
        topic = self._topics[name]
        if self._wanted is not None:
            return self._wanted in (name, topic.commands_of)
        return topic.commands_of is not None or self._candidates()[:1] in ([], [name])

    def _add(self, channel: Channel, schema: Schema | None) -> None:
        decoder = decoder_for(channel.message_encoding, schema) if schema else None
        commands_of = channel.metadata.get(COMMANDS_OF)
        new = _Topic(kind_of(channel, schema), False, commands_of, Series(self._path))
        topic = self._topics.setdefault(channel.topic, new)
        topic.joints |= decoder is not None
        self._channels[channel.id] = channel.topic, decoder

    def _decode(
        self, name: str, decoder: Decoder, batch: Batch, heads: NDArray[np.void], which: NDArray[np.intp]
    ) -> list[Samples]:
        heads = heads[which]
        starts = batch.messages[which] + HEAD.itemsize
        try:
            samples = decoder(batch.buffer, starts, heads["length"].astype(np.intp) - MESSAGE_FIELDS)
        except PayloadError as error:
            number = self._topics[name].messages + error.index + 1
            raise LogError(self._path, f"message {number} of {shown(name)} {error}") from None
        seconds, nanoseconds = np.divmod(heads["log_time"], np.uint64(10**9))
        logged = seconds + nanoseconds / 1e9
        return [
            replace(piece, index=which[piece.index], t=np.where(piece.t == 0, logged[piece.index], piece.t))
            for piece in samples
        ]

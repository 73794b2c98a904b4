"""`SensorTopics`: the topics of MCAP files with IMU, contacts and wrenches, as channels.

A topic's name without its slashes is part of the channels' names: a wrench on /force/FL_foot becomes
``force_FL_foot_x``, a flag on /contact/FL_foot ``contact_FL_foot``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable, suggestion
from idtool.data.logs.definitions import Definitions
from idtool.data.logs.log import Channel
from idtool.data.logs.mcap_records import HEAD, MESSAGE_FIELDS, RecordBatch
from idtool.data.logs.payloads import sensor_decoder_for
from idtool.data.logs.payloads.base import Decoder, PayloadError
from idtool.data.logs.payloads.sensor_types import SENSOR_TYPES

_IMU = "sensor_msgs/Imu"
_PREFIXES = ("force_", "contact_")  # that a topic may have already


@dataclass
class _Topic:
    """A topic of a sensor and what was read of it so far."""

    type_name: str
    channels: tuple[str, ...]
    decoder: Decoder
    times: list[Array] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)


class SensorTopics:
    """Decodes the messages of sensors in a log's files, one file after the other.

    Parameters
    ----------
    path
        The log; errors name it.
    imu
        The topic of the IMU; None: the only one.
    """

    def __init__(self, path: Path, imu: str | None) -> None:
        self._path = path
        self._imu = imu
        self._definitions = Definitions(path)
        self._by_channel: dict[int, _Topic] = {}
        self._topics: dict[str, _Topic] = {}

    def begin_file(self, file: Path) -> None:
        """Start the next file, in which channels have other ids."""
        self._definitions = Definitions(file)
        self._by_channel = {}

    def read(self, batch: RecordBatch) -> None:
        """Decode the messages of a batch that are of sensors.

        Raises
        ------
        LogError
            If a definition or a message cannot be read.
        """
        for channel, schema in self._definitions.read(batch):
            if schema is None:
                continue
            type_name = schema.name.replace("/msg/", "/")
            decoder = sensor_decoder_for(channel.message_encoding, schema)
            if decoder is not None:
                names = SENSOR_TYPES[type_name].channels(_channel_name(channel.topic))
                topic = self._topics.setdefault(channel.topic, _Topic(type_name, names, decoder))
                self._by_channel[channel.id] = topic
        if not len(batch.messages) or not self._by_channel:
            return
        heads = batch.heads
        for channel_id in np.unique(heads["channel"]).tolist():
            if channel_id in self._by_channel:
                self._decode(self._by_channel[channel_id], batch, np.flatnonzero(heads["channel"] == channel_id))

    def channels(self) -> dict[str, Channel]:
        """The channels by name.

        Raises
        ------
        LogError
            If several topics carry an IMU and none is chosen, or the chosen one does not.
        """
        imus = [name for name, topic in self._topics.items() if topic.type_name == _IMU and topic.times]
        if self._imu is not None and self._imu not in imus:
            what = f"base.imu.topic: no IMU on topic {printable(self._imu)}; {suggestion(self._imu, imus)}"
            raise LogError(self._path, what)
        if self._imu is None and len(imus) > 1:
            what = f"{len(imus)} topics carry an IMU; set base.imu.topic to one of {join_names(imus)}"
            raise LogError(self._path, what)
        channels = {}
        for name, topic in self._topics.items():
            is_other_imu = topic.type_name == _IMU and self._imu not in (None, name)
            if not topic.times or is_other_imu:
                continue
            t = np.concatenate(topic.times)
            values = np.concatenate(topic.values)
            used_channels = [channel for channel in topic.channels if channel]
            for channel, x in zip(used_channels, values.T, strict=True):
                channels[channel] = Channel(t, np.ascontiguousarray(x))
        return channels

    def _decode(self, topic: _Topic, batch: RecordBatch, index: Indices) -> None:
        """Add the messages of a batch at ``index``; those without a stamp get their log time."""
        heads = batch.heads[index]
        starts = batch.messages[index] + HEAD.itemsize
        lengths = heads["length"].astype(np.intp) - MESSAGE_FIELDS
        try:
            decoded = topic.decoder(batch.buffer, starts, lengths)
        except PayloadError as error:
            raise LogError(self._path, f"a message of type {topic.type_name} {error}") from None
        log_time = heads["log_time"] / 1e9
        for piece in decoded:
            topic.times.append(np.where(piece.t == 0, log_time[piece.index], piece.t))
            used = [i for i, channel in enumerate(topic.channels) if channel]
            # a copy, so that the messages need not be kept
            topic.values.append(np.array(piece.signals["sensor"][:, used], dtype=np.float64))


def _channel_name(topic: str) -> str:
    """Name of a topic as part of the names of its channels."""
    name = topic.strip("/").replace("/", "_")
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    return name

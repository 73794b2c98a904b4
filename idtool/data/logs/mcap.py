"""MCAP logs: ROS 2 JointState messages, and the same fields as JSON and protobuf.

Written logs have the states on one topic, the commands, if any, on another, and every sensor on one of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable
from idtool.common.notice import Notice
from idtool.data.logs.bag import MCAP, ZSTD, log_files
from idtool.data.logs.interleaved import make_log_of_complete_samples
from idtool.data.logs.log import JointLog, truncation_notice
from idtool.data.logs.mcap_file import open_mcap
from idtool.data.logs.message_options import DEFAULT_MESSAGES, MessageOptions
from idtool.data.logs.payloads.cdr import DEFINITION, TYPE, encode, encode_sensor
from idtool.data.logs.payloads.sensor_types import SENSOR_TYPES
from idtool.data.logs.sample_buffer import SampleBuffer
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.data.logs.sensor_messages import SensorMessages, sensor_messages
from idtool.data.logs.sensor_topics import SensorTopics
from idtool.data.logs.times import convert_to_seconds
from idtool.data.logs.topics import COMMANDS_OF, TopicReader

if TYPE_CHECKING:
    from mcap.writer import Writer

SUFFIXES = (".mcap",)

_STATES_TOPIC = "/joint_states"
_COMMANDS_TOPIC = "/joint_commands"
_STATES = {"q": "q", "v": "v", "tau": "tau"}  # from a message's signals to the log's
_COMMANDS = {"q": "qcmd", "v": "vcmd"}
_BLOCK = 4096  # messages encoded together


def matches(head: bytes) -> bool:
    """True if a file that begins with ``head`` is MCAP, or MCAP compressed by rosbag2."""
    return head.startswith((MCAP, ZSTD))


def read(
    path: Path,
    topic: str | None,
    columns: Mapping[str, str],
    sensors: SensorOptions | None = None,
    messages: MessageOptions = DEFAULT_MESSAGES,
) -> JointLog:
    """Read the joint states of ``topic``, or of the only topic that carries any; ``columns`` are for CSV.

    Parameters
    ----------
    path
        The file, or the rosbag2 folder, whose files are parts of one log.
    sensors
        How to read the topics of sensors; None: they are not read.
    messages
        Which messages other than joint states to read.

    Raises
    ------
    LogError
        If a file is damaged, or there is not exactly one topic to read.
    """
    topics = TopicReader(path, topic, messages)
    sensor_topics = SensorTopics(path, sensors, messages) if sensors is not None else None
    truncated: dict[int, str] = {}  # names of truncated files by their number
    for i, file in enumerate(log_files(path)):
        topics.begin_file(file)
        if sensor_topics is not None:
            sensor_topics.begin_file(file)
        with open_mcap(file) as records:
            for batch in records:
                topics.read(batch)
                if sensor_topics is not None:
                    sensor_topics.read(batch)
        if records.truncated:
            truncated[i] = "the file" if file == path else file.name
    if truncated and not len(topics):
        raise LogError(path, "was cut off before its first message")
    states_topic = topics.select()
    states, commands = topics.samples(states_topic), topics.commands(states_topic)
    notices: list[Notice] = []
    for i, name in truncated.items():
        count, last_time = states.part_extent(i)
        kept = f"{count} samples, up to t = {last_time:.3f} s" if count else "no samples"
        notices.append(truncation_notice(name, kept))
    t, joints, signals = states.arrays()
    if commands:
        try:
            signals |= _command_signals(commands, t, joints)
        except ValueError as error:
            advice = "no action is needed if the log contains the measured torque"
            message = f"the commands were ignored: {error}"
            notices.append(Notice("commands_left_out", "warning", None, message, advice))
    preset = topics.preset(states_topic)
    if preset is not None and messages.preset is None:
        unnamed = f"the messages of topic {printable(states_topic)} do not name their joints"
        message = f"{unnamed}; read by preset {preset}"
        advice = "if this is another robot, set log.preset or log.field_joints"
        notices.append(Notice("preset_assumed", "note", None, message, advice))
    if topics.are_fields_missing(states_topic):
        message = (
            f"no topic has the fields of log.fields or log.preset; read: joint states of {printable(states_topic)}"
        )
        notices.append(Notice("fields_ignored", "note", None, message))
    if columns:
        message = f"log.columns is only for CSV and was ignored: {join_names(columns)}"
        notices.append(Notice("columns_ignored", "note", None, message))
    notices += convert_to_seconds(t)
    log = make_log_of_complete_samples(path, t, joints, signals, tuple(notices))
    if sensor_topics is None:
        return replace(log, preset=preset)
    channels = sensor_topics.channels(states_topic)
    return replace(log, preset=preset, channels=channels, notices=log.notices + sensor_topics.notices)


def _command_signals(commands: SampleBuffer, t: Array, joints: tuple[str, ...]) -> dict[str, Array]:
    """Commands as signals of the states' samples; ValueError if joints or times differ."""
    times, names, signals = commands.arrays()
    count = min(len(times), len(t))  # a truncated file may lack the last commands
    if names != joints or not np.array_equal(times[:count], t[:count]):
        raise ValueError("their joints or times differ from those of the states")
    if len(times) != len(t):
        signals = commands.signals_of(len(t))
    return {_COMMANDS[name]: array for name, array in signals.items() if name in _COMMANDS}


def write(file: BinaryIO, log: JointLog) -> None:
    """Write a log with stamps rounded to nanoseconds.

    Raises
    ------
    ValueError
        If a time does not fit a stamp.
    """
    from mcap.writer import Writer

    sensors = sensor_messages(log.channels, float(np.min(log.t, initial=np.inf)))
    for t in (log.t, *(messages.t for messages in sensors)):
        if not (np.abs(t) < 2**31 - 1).all():
            raise ValueError("its times are too large for a header stamp, which has 32 bits for the seconds")
    writer = Writer(file)
    writer.start(profile="ros2", library="idtool")
    schema = writer.register_schema(TYPE, "ros2msg", DEFINITION.encode())
    topics = [(writer.register_channel(_STATES_TOPIC, "cdr", schema), _STATES)]
    if log.signals.keys() & _COMMANDS.values():
        metadata = {COMMANDS_OF: _STATES_TOPIC}
        topics.append((writer.register_channel(_COMMANDS_TOPIC, "cdr", schema, metadata), _COMMANDS))
    sensor_writers = [_SensorWriter(writer, messages) for messages in sensors]
    for start in range(0, len(log), _BLOCK):
        rows = slice(start, start + _BLOCK)
        stamps = _nanoseconds(log.t[rows])
        messages = []
        for channel, names in topics:
            signals = {field: log.signals[name][rows] for field, name in names.items() if name in log.signals}
            messages.append((channel, encode(stamps, log.joints, signals)))
        for i, stamp in enumerate(stamps.tolist()):
            time = max(0, stamp)
            for channel, data in messages:
                writer.add_message(channel, time, data[i].tobytes(), time, start + i)
        for sensor_writer in sensor_writers:
            sensor_writer.write_until(float(log.t[rows][-1]))
    for sensor_writer in sensor_writers:
        sensor_writer.write_until(np.inf)
    writer.finish()  # type: ignore[no-untyped-call]


class _SensorWriter:
    """Writes the messages of a sensor's topic step by step, so that they are in the file near those of the joints."""

    def __init__(self, writer: Writer, messages: SensorMessages) -> None:
        self._writer = writer
        self._messages = messages
        self._type = SENSOR_TYPES[messages.type_name]
        type_name = messages.type_name.replace("/", "/msg/")
        schema = writer.register_schema(type_name, "ros2msg", self._type.definition.encode())
        self._channel = writer.register_channel(messages.topic, "cdr", schema)
        self._count = 0

    def write_until(self, t: float) -> None:
        """Write what is left of the messages up to a time [s]."""
        stop = int(np.searchsorted(self._messages.t, t, side="right"))
        for start in range(self._count, stop, _BLOCK):
            rows = slice(start, min(start + _BLOCK, stop))
            stamps = _nanoseconds(self._messages.t[rows])
            data = encode_sensor(self._type, stamps, self._messages.numbers[rows])
            for i, stamp in enumerate(stamps.tolist()):
                time = max(0, stamp)
                self._writer.add_message(self._channel, time, data[i].tobytes(), time, start + i)
        self._count = max(self._count, stop)


def _nanoseconds(t: Array) -> NDArray[np.int64]:
    seconds = np.floor(t)
    return np.asarray(seconds.astype(np.int64) * 10**9 + np.rint((t - seconds) * 1e9).astype(np.int64))

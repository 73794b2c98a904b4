"""MCAP logs: ROS 2 JointState messages, and the same fields as JSON and protobuf.

What is written holds the states on one topic and the commands, if there are any, on another.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.logs.bag import MCAP, ZSTD, files_of
from idtool.data.logs.files import records
from idtool.data.logs.interleaved import log_of
from idtool.data.logs.log import Log, truncation
from idtool.data.logs.payloads.cdr import DEFINITION, TYPE, encode
from idtool.data.logs.series import Series
from idtool.data.logs.times import in_seconds
from idtool.data.logs.topics import COMMANDS_OF, Topics

SUFFIXES = (".mcap",)

_STATES_TOPIC, _COMMANDS_TOPIC = "/joint_states", "/joint_commands"
_STATES = {"q": "q", "v": "v", "tau": "tau"}  # a message's signals to the log's
_COMMANDS = {"q": "qcmd", "v": "vcmd"}
_BLOCK = 4096  # messages built together


def matches(head: bytes) -> bool:
    """Whether a file that begins with ``head`` is MCAP, or compressed as rosbag2 compresses MCAP."""
    return head.startswith((MCAP, ZSTD))  # what follows the former is the version


def read(path: Path, topic: str | None, columns: Mapping[str, str]) -> Log:
    """Read the joint states of ``topic``, or of the only topic that carries some; ``columns`` are for CSV.

    Parameters
    ----------
    path
        The file, or the rosbag2 folder, whose files are parts of one log.

    Raises
    ------
    LogError
        If a file is damaged, or no topic or several can be meant.
    """
    topics, cut = Topics(path, topic), {}
    for i, file in enumerate(files_of(path)):
        topics.begin(file)
        with records(file) as found:
            for batch in found:
                topics.take(batch)
        if found.cut:
            cut[i] = "the file" if file == path else file.name
    if cut and not len(topics):
        raise LogError(path, "was cut off before its first message")
    states, commands = topics.chosen()
    notices: list[Notice] = []
    for i, name in cut.items():
        notices.append(truncation(name, _kept(*states.held(i))))
    t, joints, signals = states.arrays()
    if commands:
        try:
            signals |= _aligned(commands, t, joints)
        except ValueError as error:
            advice = "nothing to do if the log holds the measured torque"
            message = f"the commands were left out: {error}"
            notices.append(Notice("commands_left_out", "warning", None, message, advice))
    if columns:
        message = f"log.columns names columns of CSV, of which MCAP has none; ignored: {join_names(columns)}"
        notices.append(Notice("columns_ignored", "note", None, message))
    return log_of(path, t, joints, signals, (*notices, *in_seconds(t)))


def _kept(samples: int, end: float) -> str:
    """How much of a file that was cut off is read, in words."""
    return f"{samples} samples, up to t = {end:.3f} s" if samples else "no samples"


def _aligned(commands: Series, t: Array, joints: tuple[str, ...]) -> dict[str, Array]:
    """Commands as signals of the states' samples; ValueError where they are not those of the same samples."""
    times, names, signals = commands.arrays()
    count = min(len(times), len(t))  # a file that was cut off may lack the last ones
    if names != joints or not np.array_equal(times[:count], t[:count]):
        raise ValueError("their joints or times are not those of the states")
    for array in signals.values():
        array.resize((len(t), len(joints)), refcheck=False)
        array[count:] = np.nan
    return {_COMMANDS[name]: array for name, array in signals.items() if name in _COMMANDS}


def write(file: BinaryIO, log: Log) -> None:
    """Write a log, its stamps rounded to nanoseconds.

    Raises
    ------
    ValueError
        If a time does not fit a stamp.
    """
    from mcap.writer import Writer

    if not (np.abs(log.t) < 2**31 - 1).all():
        raise ValueError("holds times that do not fit a header stamp, which has 32 bits for the seconds")
    writer = Writer(file)
    writer.start(profile="ros2", library="idtool")
    schema = writer.register_schema(TYPE, "ros2msg", DEFINITION.encode())
    topics = [(writer.register_channel(_STATES_TOPIC, "cdr", schema), _STATES)]
    if log.signals.keys() & _COMMANDS.values():
        metadata = {COMMANDS_OF: _STATES_TOPIC}
        topics.append((writer.register_channel(_COMMANDS_TOPIC, "cdr", schema, metadata), _COMMANDS))
    for start in range(0, len(log), _BLOCK):
        rows = slice(start, start + _BLOCK)
        seconds = np.floor(log.t[rows])
        stamps = seconds.astype(np.int64) * 10**9 + np.rint((log.t[rows] - seconds) * 1e9).astype(np.int64)
        messages = []
        for channel, names in topics:
            signals = {field: log.signals[name][rows] for field, name in names.items() if name in log.signals}
            messages.append((channel, encode(stamps, log.joints, signals)))
        for i, stamp in enumerate(stamps.tolist()):
            time = max(0, stamp)
            for channel, data in messages:
                writer.add_message(channel, time, data[i].tobytes(), time, start + i)
    writer.finish()  # type: ignore[no-untyped-call]

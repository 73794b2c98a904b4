"""The topics of a log that carry joint states, or an IMU."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from idtool.common.exceptions import LogError
from idtool.data.logs.bag import log_files
from idtool.data.logs.mcap import matches
from idtool.data.logs.mcap_file import open_mcap
from idtool.data.logs.mcap_records import RecordBatch
from idtool.data.logs.message_options import DEFAULT_MESSAGES, MessageOptions
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.data.logs.sensor_topics import SensorTopics
from idtool.data.logs.topics import TopicReader

_HEAD_BYTES = 8


def state_topics(path: Path, options: MessageOptions = DEFAULT_MESSAGES) -> tuple[str, ...]:
    """The topics of an MCAP file or rosbag2 folder that carry joint states, in order; empty for other formats.

    ``options`` tell which messages other than joint states are read.

    Raises
    ------
    LogError
        If the log cannot be read.
    """
    topics = TopicReader(path, None, options, keep_samples=False)
    for part in _mcap_files(path):
        topics.begin_file(part)
        for batch in _batches(path, part):
            topics.read(batch)
    return topics.names


def imu_topics(path: Path, options: MessageOptions = DEFAULT_MESSAGES) -> tuple[str, ...]:
    """The topics of an MCAP file or rosbag2 folder that carry an IMU, in order; empty for other formats.

    Raises
    ------
    LogError
        If the log cannot be read.
    """
    return sensor_topics(path, options).imus


def sensor_topics(path: Path, options: MessageOptions = DEFAULT_MESSAGES) -> SensorTopics:
    """The topics of sensors in an MCAP file or rosbag2 folder; none in other formats.

    Raises
    ------
    LogError
        If the log cannot be read.
    """
    topics = SensorTopics(path, SensorOptions(), options)
    for part in _mcap_files(path):
        topics.begin_file(part)
        for batch in _batches(path, part):
            topics.read(batch)
    return topics


def _mcap_files(path: Path) -> tuple[Path, ...]:
    """The files of a log in MCAP; empty for other formats."""
    try:
        if path.is_dir():
            return tuple(log_files(path))
        with path.open("rb") as file:
            return tuple(log_files(path)) if matches(file.read(_HEAD_BYTES)) else ()
    except OSError as error:
        raise _unreadable(path, error) from None


def _batches(path: Path, file: Path) -> Iterator[RecordBatch]:
    """Batches of records of one file of a log."""
    try:
        with open_mcap(file) as records:
            yield from records
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: OSError) -> LogError:
    return LogError(path, f"cannot be read: {error.strerror or error}")

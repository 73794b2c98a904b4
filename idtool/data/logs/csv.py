"""CSV logs: a header line, then one line per sample."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from idtool.common.exceptions import LogError
from idtool.common.names import count_text, join_names
from idtool.common.notice import Notice
from idtool.data.logs.columns import find_columns
from idtool.data.logs.interleaved import make_log_of_complete_samples
from idtool.data.logs.log import SIGNALS, Channel, JointLog, truncation_notice
from idtool.data.logs.merged_rows import merge_rows, take_rows
from idtool.data.logs.message_options import DEFAULT_MESSAGES, MessageOptions
from idtool.data.logs.sample_buffer import SampleBuffer, Samples
from idtool.data.logs.sensor_channels import SensorOptions, finite_samples, is_flag
from idtool.data.logs.stored_arrays import RowBuffer
from idtool.data.logs.table import CsvTable
from idtool.data.logs.times import convert_to_seconds

SUFFIXES = (".csv",)

_BLOCK = 1 << 14  # samples written together
_CONTROL_CHARACTERS = re.compile(rb"[\x00-\x08\x0e-\x1f]")


def matches(head: bytes) -> bool:
    """True if a file that begins with ``head`` is text in UTF-8."""
    try:
        head.decode()
    except UnicodeDecodeError as error:
        if error.start < len(head) - 3:  # otherwise, the last character is cut off
            return False
    return not _CONTROL_CHARACTERS.search(head)


def read(
    path: Path,
    topic: str | None,
    columns: Mapping[str, str],
    sensors: SensorOptions | None = None,
    messages: MessageOptions = DEFAULT_MESSAGES,
) -> JointLog:
    """Read a table with canonical column names, or those in ``columns``; ``topic`` selects one of several topics.

    The channels of sensors are read whatever ``sensors`` says.

    Raises
    ------
    LogError
        If the header has no signals, or a line does not fit the header.
    """
    with path.open("rb") as file:
        table = CsvTable(path, file)
        column_map = find_columns(path, table.header, topic, columns)
        used = [column_map.time]
        positions: dict[str, list[int]] = {}  # in the rows, where -1 is an extra column of NaN
        for signal, indices in column_map.signals.items():
            positions[signal] = []
            for i in indices:
                positions[signal].append(-1 if i is None else len(used))
                if i is not None:
                    used.append(i)
        sensor_columns = [0, *range(len(used), len(used) + len(column_map.channels))]
        joint_columns = len(used)
        used += column_map.channels.values()
        samples = SampleBuffer(path)
        sensor_rows = RowBuffer(path, len(sensor_columns))
        empty_rows = 0
        flags = frozenset(i for name, i in column_map.channels.items() if is_flag(name))
        for all_rows in table.rows(used, flags):
            if column_map.channels:
                sensor_rows.append(all_rows[:, sensor_columns])
            rows = all_rows[:, :joint_columns]
            filled = rows[~np.isnan(rows[:, 1:]).all(axis=1)]
            empty_rows += len(rows) - len(filled)
            with_nan = np.pad(filled, ((0, 0), (0, 1)), constant_values=np.nan)
            signals = {signal: with_nan[:, i] for signal, i in positions.items()}
            samples.append([Samples(np.arange(len(filled)), filled[:, 0], column_map.joints, signals)])
    if not len(samples):
        raise LogError(path, "has no samples after the header line; check the logger, or give another log")
    t, joints, arrays = samples.arrays()
    notices: list[Notice] = []
    if column_map.unused:
        message = f"columns without a joint signal were ignored: {join_names(column_map.unused)}"
        advice = "if one of them is a joint signal, map it in log.columns of the configuration"
        notices.append(Notice("unused_columns", "note", None, message, advice))
    if messages.are_given:
        message = "log.fields and log.preset are only for MCAP and were ignored"
        notices.append(Notice("fields_ignored", "note", None, message))
    if empty_rows:
        were = "was" if empty_rows == 1 else "were"
        message = f"{count_text(empty_rows, 'row')} without a joint signal {were} skipped"
        notices.append(Notice("unused_rows", "note", None, message))
    notices += convert_to_seconds(t)
    if table.truncated:
        notices.append(truncation_notice("the file", f"{len(t)} samples, up to t = {t[-1]:.3f} s"))
    log = make_log_of_complete_samples(path, t, joints, arrays, tuple(notices))
    if not len(sensor_rows):
        return log
    sensor_times, *sensor_values = sensor_rows.columns()
    convert_to_seconds(sensor_times)
    channels = {}
    for name, x in zip(column_map.channels, sensor_values, strict=True):
        channels[name] = Channel(sensor_times, x)
    return replace(log, channels=channels)


def write(file: BinaryIO, log: JointLog) -> None:
    """Write a log with canonical column names and all digits of every number.

    The channels of sensors have a value only in the rows of their own times.
    """
    columns = [(name, j) for j, joint in enumerate(log.joints) for name in SIGNALS if log.has(name, joint)]
    channels = {name: finite_samples(channel) for name, channel in log.channels.items()}
    times, (joint_rows, *channel_rows) = merge_rows(log.t, [channel.t for channel in channels.values()])
    header = io.StringIO()
    names = ["t", *(f"{name}_{log.joints[j]}" for name, j in columns), *channels]
    csv.writer(header, lineterminator="\n").writerow(names)
    file.write(header.getvalue().encode())
    for start in range(0, len(times), _BLOCK):
        rows = slice(start, start + _BLOCK)
        of_joints = [take_rows(log.signals[name][:, j], joint_rows[rows]) for name, j in columns]
        of_sensors = []
        for channel, own_rows in zip(channels.values(), channel_rows, strict=True):
            of_sensors.append(take_rows(channel.x, own_rows[rows]))
        table = np.column_stack([times[rows], *of_joints, *of_sensors])
        write_cell = _cell if channels else repr
        file.writelines(",".join(map(write_cell, row)).encode() + b"\n" for row in table.tolist())


def _cell(x: float) -> str:
    """A number; empty for NaN."""
    return "" if math.isnan(x) else repr(x)

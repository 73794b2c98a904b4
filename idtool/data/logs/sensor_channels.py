"""Channels of sensors that are of no joint: IMU, contact flags, forces, pose of the base.

Each has stamps of its own, in the clock of the joints' samples. Units: rad/s, m/s², N, N·m, m.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import count_text, join_names, printable, suggestion
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.logs.log import Channel, JointLog
from idtool.data.logs.stored_arrays import StoredRows, blocks_of, column_ranges, is_in_file

SENSOR_CHANNEL = re.compile(r"imu_(q[wxyz]|[wa][xyz])|base_q?[xyz]|base_qw|contact_.+|force_.+_m?[xyz]")

_QUATERNIONS = {
    "IMU": ("imu_qw", "imu_qx", "imu_qy", "imu_qz"),
    "pose": ("base_qw", "base_qx", "base_qy", "base_qz"),
}
_QUATERNION_SIZE = 4
_MIN_NORM = 0.5  # of a quaternion; drivers publish zeros as long as they know no orientation
_MAX_CLOCK_ERROR = 86_400.0  # s, from a flag to the joints, beyond which it has another clock
_MAX_STEPS = 10.0  # from one sample of a channel to the next, in median steps, beyond which it has a gap


@dataclass(frozen=True)
class SensorOptions:
    """Options for reading the topics of sensors.

    Attributes
    ----------
    imu_topic
        Topic of the IMU; None: the only one.
    pose_topic
        Topic of the base's pose; None: the only one.
    needs_imu, needs_pose
        True to refuse several topics of which none is chosen; else none of them is read.
    """

    imu_topic: str | None = None
    pose_topic: str | None = None
    needs_imu: bool = True
    needs_pose: bool = False


def with_sensors(log: JointLog, names: Iterable[str]) -> JointLog:
    """The log with only some of its channels; samples at which one of them is missing are in no segment.

    A contact whose flag has no value counts as closed.

    Parameters
    ----------
    log
        The log.
    names
        The channels that are needed.

    Raises
    ------
    LogError
        If the log lacks one of them, or no two samples in a row have all.
    """
    channels = {}
    empty_flags = []
    for name in dict.fromkeys(names):
        if not log.channels:
            what = f"has no channel {printable(name)}, and none of any sensor (in Python, use Model.read_log)"
            raise LogError(log.path, what)
        if name not in log.channels:
            raise LogError(log.path, f"has no channel {printable(name)}; {suggestion(name, list(log.channels))}")
        channels[name] = finite_samples(log.channels[name])
        if is_flag(name):
            if not len(channels[name].t):
                empty_flags.append(name)
            channels[name] = _closed_before(_in_same_clock(name, channels[name], log), log)
        elif len(channels[name].t) < 2:
            what = f"channel {printable(name)} has no values; log this sensor, or leave it out of the configuration"
            raise LogError(log.path, what)
    for sensor, names_of_quaternion in _QUATERNIONS.items():
        orientation = {name: channels[name] for name in names_of_quaternion if name in channels}
        if orientation:
            channels |= _continuous_orientation(sensor, orientation, log)
    is_missing = np.zeros(len(log), dtype=bool)
    for name, channel in channels.items():
        if not is_flag(name):
            is_missing |= _is_in_gap(channel, log)
    segments = tuple(_complete_segments(log.segments, is_missing))
    if not segments:
        what = f"no two samples in a row have joints and sensors; compare the times of {join_names(list(channels))}"
        raise LogError(log.path, what)
    notices = log.notices
    samples_before = sum(segment.stop - segment.start for segment in log.segments)
    samples_left = sum(segment.stop - segment.start for segment in segments)
    lost = samples_before - samples_left
    if lost:
        message = f"{count_text(lost, 'sample')} without a value of every sensor; left out"
        notices += (Notice("sensors_missing", "note", None, message),)
    if empty_flags:
        message = f"no value of {join_names(empty_flags)}: these contacts count as closed all the time"
        advice = "log the flags; contact forces that are eliminated without need cost accuracy"
        notices += (Notice("contact_flag_empty", "warning", None, message, advice),)
    return replace(log, channels=channels, segments=segments, notices=notices)


def channels_as_logged(log: JointLog, names: Iterable[str]) -> dict[str, Channel]:
    """Some channels of a log that `with_sensors` made, without the values that it added."""
    channels = {}
    for name in dict.fromkeys(names):
        channel = log.channels[name]
        channels[name] = Channel(channel.t[1:], channel.x[1:]) if is_flag(name) else channel
    return channels


def is_flag(name: str) -> bool:
    """True for a contact flag, which may be logged only when it changes."""
    return name.startswith("contact_")


def is_dead(log: JointLog, names: Iterable[str]) -> bool:
    """True if none of a sensor's channels, of which a log has all, ever changes: it was not connected."""
    values = [finite_samples(log.channels[name]).x for name in names]
    return all(len(x) > 0 and _is_constant(x) for x in values)


def _is_constant(x: Array) -> bool:
    least, greatest = column_ranges(x[:, None])
    return bool(least[0] == greatest[0])


def finite_samples(channel: Channel) -> Channel:
    """The channel's finite samples in the order of time; the very channel if it has no others."""
    if _is_in_order(channel):
        return channel
    is_finite = np.isfinite(channel.t) & np.isfinite(channel.x)
    t = channel.t[is_finite]
    order = np.argsort(t, kind="stable")
    return Channel(t[order], channel.x[is_finite][order])


def _is_in_order(channel: Channel) -> bool:
    """True if all samples are finite and in the order of time."""
    latest = -np.inf
    for rows in blocks_of([channel.t, channel.x], len(channel.t)):
        t = channel.t[rows]
        if not (np.isfinite(t).all() and np.isfinite(channel.x[rows]).all()):
            return False
        if t[0] < latest or (np.diff(t) < 0).any():
            return False
        latest = float(t[-1])
    return True


def _in_same_clock(name: str, flag: Channel, log: JointLog) -> Channel:
    """A flag whose times are near the joints', if it has any; LogError if they are of another clock."""
    if not len(flag.t):
        return flag
    start, end = log.t[log.segments[0].start], log.t[log.segments[-1].stop - 1]
    distance = max(flag.t[0] - end, start - flag.t[-1], 0.0)
    if distance > _MAX_CLOCK_ERROR:
        what = (
            f"the times of {printable(name)} are {short_number(distance)} s away from those of the joints: it "
            "has another clock"
        )
        raise LogError(log.path, what)
    return flag


def _closed_before(flag: Channel, log: JointLog) -> Channel:
    """A flag that counts as set before its first value, since a force that is eliminated without need does no harm."""
    start = min(float(log.t[log.segments[0].start]), float(flag.t.min(initial=np.inf))) - 1.0
    return Channel(_with_first(log.path, start, flag.t), _with_first(log.path, 1.0, flag.x))


def _with_first(path: Path, first: float, x: Array) -> Array:
    """An array, shape (k,), behind another first value; in a file if the array is in one."""
    if not is_in_file(x):
        return np.concatenate([[first], x])
    rows = StoredRows(path, 1)
    rows.append(np.array([[first]]))
    for part in blocks_of([x], len(x)):
        rows.append(x[part, None])
    return rows.array()[:, 0]


def _continuous_orientation(sensor: str, parts: Mapping[str, Channel], log: JointLog) -> dict[str, Channel]:
    """The four parts of a quaternion, whose sign means nothing, without jumps of the sign and without zeros."""
    if len(parts) < _QUATERNION_SIZE or len({len(part.t) for part in parts.values()}) > 1:
        return dict(parts)
    if _is_continuous(list(parts.values())):
        return dict(parts)
    quaternions = np.stack([part.x for part in parts.values()])
    is_known = np.linalg.norm(quaternions, axis=0) > _MIN_NORM
    if is_known.sum() < 2:
        what = f"the orientation of the {sensor} ({join_names(list(parts))}) is zero; log it, from link to world"
        raise LogError(log.path, what)
    quaternions = quaternions[:, is_known]
    is_reversed = (quaternions[:, 1:] * quaternions[:, :-1]).sum(axis=0) < 0
    sign = np.where(np.cumsum(np.concatenate([[False], is_reversed])) % 2, -1.0, 1.0)
    continuous = {}
    for (name, part), x in zip(parts.items(), quaternions, strict=True):
        continuous[name] = Channel(part.t[is_known], x * sign)
    return continuous


def _is_continuous(parts: Sequence[Channel]) -> bool:
    """True if a quaternion is known at all of its samples, and its sign never jumps."""
    columns = [part.x for part in parts]
    count = len(columns[0])
    for rows in blocks_of(columns, count):
        quaternions = np.stack([x[rows.start : rows.stop + 1] for x in columns])
        is_known = np.linalg.norm(quaternions, axis=0) > _MIN_NORM
        is_reversed = (quaternions[:, 1:] * quaternions[:, :-1]).sum(axis=0) < 0
        if not is_known.all() or is_reversed.any():
            return False
    return count > 1


def _is_in_gap(channel: Channel, log: JointLog) -> Mask:
    """True for samples of the log before a channel's first value, after its last, or in a gap of it."""
    longest = _MAX_STEPS * max(float(np.median(np.diff(channel.t))), log.dt)
    is_in_gap = np.zeros(len(log), dtype=bool)
    for rows in blocks_of([channel.t], len(log)):
        t = log.t[rows]
        next_sample = np.searchsorted(channel.t, t, side="left")
        after = channel.t[np.minimum(next_sample, len(channel.t) - 1)]
        before = channel.t[np.maximum(next_sample - 1, 0)]
        with np.errstate(invalid="ignore"):
            is_outside = (t < channel.t[0] - log.dt) | (t > channel.t[-1] + log.dt)
            is_in_gap[rows] = is_outside | (after - before > longest)
    return is_in_gap


def _complete_segments(segments: tuple[slice, ...], is_missing: Mask) -> Iterator[slice]:
    """Parts of segments in which nothing is missing, of at least two samples."""
    for segment in segments:
        edges = np.flatnonzero(np.diff(is_missing[segment], prepend=True, append=True))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start > 1:
                yield slice(segment.start + int(start), segment.start + int(stop))

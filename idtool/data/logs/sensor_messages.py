"""Channels of sensors as ROS 2 messages: the topics from which `SensorTopics` reads the same channels."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.names import printable
from idtool.data.logs.log import SET, Channel
from idtool.data.logs.merged_rows import merge_rows, take_rows
from idtool.data.logs.payloads.base import channel_names
from idtool.data.logs.payloads.sensor_types import SENSOR_TYPES
from idtool.data.logs.sensor_channels import finite_samples
from idtool.data.logs.sensor_topics import channel_part

_IMU, _WRENCH, _FLAG = "sensor_msgs/Imu", "geometry_msgs/WrenchStamped", "std_msgs/Bool"
_POSE = "geometry_msgs/PoseStamped"
_PATTERNS = (  # of channels: type of the messages, and topic
    (re.compile(r"imu_.+"), _IMU, "/imu"),
    (re.compile(r"base_.+"), _POSE, "/pose"),
    (re.compile(r"force_(.+)_m?[xyz]"), _WRENCH, "/force/{}"),
    (re.compile(r"contact_(.+)"), _FLAG, "/contact/{}"),
)


@dataclass(frozen=True)
class SensorMessages:
    """The messages of a topic.

    Attributes
    ----------
    topic
        The topic.
    type_name
        Their type.
    t
        Times [s], ascending, shape (k,).
    numbers
        Numbers of the type, shape (k, n); NaN where a channel has no value.
    """

    topic: str
    type_name: str
    t: Array
    numbers: Array


def sensor_messages(channels: Mapping[str, Channel], start: float) -> list[SensorMessages]:
    """The messages of the channels of a log that begins at ``start`` [s].

    Raises
    ------
    ValueError
        If a channel cannot be a topic.
    """
    by_topic: dict[str, dict[str, Channel]] = {}
    types: dict[str, str] = {}
    for name, channel in channels.items():
        for pattern, type_name, topic_pattern in _PATTERNS:
            if match := pattern.fullmatch(name):
                part = match[1] if pattern.groups else ""
                topic = topic_pattern.format(part)
                if part and channel_part(topic) != part:
                    raise ValueError(f"channel {printable(name)} cannot be a topic; write CSV")
                by_topic.setdefault(topic, {})[name] = finite_samples(channel)
                types[topic] = type_name
    return [_messages(topic, types[topic], own, start) for topic, own in by_topic.items()]


def _messages(topic: str, type_name: str, channels: Mapping[str, Channel], start: float) -> SensorMessages:
    if type_name == _FLAG:
        (name,) = channels
        t, x = _without_negative_times(name, channels[name], start)
        return SensorMessages(topic, type_name, t, (x > SET).astype(np.float64)[:, None])
    names = channel_names(SENSOR_TYPES[type_name].numbers, channel_part(topic))
    t, (_, *samples) = merge_rows(np.empty(0), [channel.t for channel in channels.values()])
    numbers = np.zeros((len(t), len(names)))
    for k, name in enumerate(names):
        if name:  # covariances are 0, which means unknown
            numbers[:, k] = np.nan
    for (name, channel), rows in zip(channels.items(), samples, strict=True):
        numbers[:, names.index(name)] = take_rows(channel.x, rows)
    return SensorMessages(topic, type_name, t, numbers)


def _without_negative_times(name: str, flag: Channel, start: float) -> tuple[Array, Array]:
    """Times and values of a flag, whose messages have no stamp but the time of the log, which is not negative.

    The value that it has at 0 counts from there.
    """
    before = np.flatnonzero(flag.t < 0)
    if not len(before):
        return flag.t, flag.x
    if start < 0:
        raise ValueError(f"channel {printable(name)} has negative times, which a flag in MCAP cannot have; write CSV")
    first = before[-1]
    t: NDArray[np.float64] = np.maximum(flag.t[first:], 0.0)
    return t, flag.x[first:]

"""The sensors of a log that are of no joint, by the names of their channels."""

from __future__ import annotations

import re

import numpy as np

from idtool.data.inspection.records import LoggedSensor, SensorKind
from idtool.data.logs.log import JointLog
from idtool.data.logs.sensor_channels import finite_samples, is_flag

_WRENCH = re.compile(r"force_(.+)_(m?)[xyz]")
_IMU = re.compile(r"imu_[qwa][wxyz]")
_POSE = re.compile(r"base_(?:[xyz]|q[wxyz])")
_KINDS: tuple[SensorKind, ...] = ("imu", "pose", "contact_flag", "force", "other")  # in the order of the list
_WRENCH_SIZE = 6


def logged_sensors(log: JointLog) -> tuple[LoggedSensor, ...]:
    """The IMU, the pose of the base, contact flags, and sensors of force and moment of a log; other channels last."""
    groups: dict[tuple[SensorKind, str], list[str]] = {}
    for name in log.channels:
        groups.setdefault(_sensor_of(name), []).append(name)
    sensors = []
    for (kind, name), channels in sorted(groups.items(), key=lambda group: _KINDS.index(group[0][0])):
        own_kind: SensorKind = "wrench" if kind == "force" and len(channels) == _WRENCH_SIZE else kind
        sensors.append(LoggedSensor(name, own_kind, tuple(channels), _rate(log, channels[0])))
    return tuple(sensors)


def _sensor_of(channel: str) -> tuple[SensorKind, str]:
    """Kind and name of the sensor that a channel belongs to."""
    if _IMU.fullmatch(channel):
        return "imu", "imu"
    if _POSE.fullmatch(channel):
        return "pose", "base"
    if is_flag(channel):
        return "contact_flag", channel
    wrench = _WRENCH.fullmatch(channel)
    return ("other", channel) if wrench is None else ("force", wrench[1])


def _rate(log: JointLog, name: str) -> float | None:
    """Median rate of a channel's values [Hz]; None with fewer than two."""
    t = finite_samples(log.channels[name]).t
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return 1 / step if step > 0 else None

"""The sensors of a log that are of no joint, by the names of their channels."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from idtool.data.inspection.records import LoggedSensor, SensorKind
from idtool.data.logs.log import JointLog
from idtool.data.logs.sensor_channels import finite_samples, is_flag

_WRENCH = re.compile(r"force_(.+)_(m?)[xyz]")
_IMU = re.compile(r"imu_[qwa][wxyz]")
_WRENCH_SIZE = 6


def logged_sensors(log: JointLog) -> tuple[LoggedSensor, ...]:
    """The IMU, the contact flags and the sensors of force and moment of a log, in this order; other channels last."""
    groups: dict[tuple[int, str], list[str]] = {}
    for name in log.channels:
        wrench = _WRENCH.fullmatch(name)
        if _IMU.fullmatch(name):
            key = (0, "imu")
        elif is_flag(name):
            key = (1, name)
        elif wrench is not None:
            key = (2, wrench[1])
        else:
            key = (3, name)
        groups.setdefault(key, []).append(name)
    sensors = []
    for (place, name), channels in sorted(groups.items(), key=lambda group: group[0][0]):
        sensors.append(LoggedSensor(name, _kind(place, channels), tuple(channels), _rate(log, channels[0])))
    return tuple(sensors)


def _kind(place: int, channels: Sequence[str]) -> SensorKind:
    if place == 2:
        return "wrench" if len(channels) == _WRENCH_SIZE else "force"
    kinds: tuple[SensorKind, ...] = ("imu", "contact_flag", "force", "other")
    return kinds[place]


def _rate(log: JointLog, name: str) -> float | None:
    """Median rate of a channel's values [Hz]; None with fewer than two."""
    t = finite_samples(log.channels[name]).t
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return 1 / step if step > 0 else None

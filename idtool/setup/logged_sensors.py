"""`LoggedSensors`: the channels of sensors that are of no joint and that all logs have."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from idtool.common.dataclass import dataclass
from idtool.data.base_sensors import ACCELEROMETER, GYROSCOPE, ORIENTATION, POSE
from idtool.data.logs import JointLog
from idtool.data.logs.sensor_channels import finite_samples

_FLAG = re.compile(r"contact_(.+)")
_FORCE = re.compile(r"force_(.+)_x")
_AVERAGE = 0.1  # s, over which the noise of an IMU averages out
_MAX_RATE = 0.02  # rad/s, rms, of a base that stands still
_MAX_POSE_CHANGE = 1e-3  # m and rad/2, rms, of such a base
_MAX_ACCELERATION = 0.2  # m/s², rms, by which that of such a base changes


@dataclass(frozen=True)
class LoggedSensors:
    """The channels of sensors that all logs have, with values that change.

    Attributes
    ----------
    has_imu
        True if all logs have angular velocity and acceleration.
    has_pose
        True if all logs have the pose of the base.
    has_orientation
        True if all logs have the orientation of the IMU, or no IMU and a pose.
    base_moves
        True if the IMU, or without one the pose, moves in some log.
    flags
        Channel of each contact flag, by the name of the contact.
    wrenches
        Channels of each measured force, three, or six with the moment, by the name of the sensor.
    in_some_logs
        Channels that some logs lack, or have without values.
    """

    has_imu: bool
    has_pose: bool
    has_orientation: bool
    base_moves: bool
    flags: Mapping[str, str]
    wrenches: Mapping[str, tuple[str, ...]]
    in_some_logs: tuple[str, ...]

    @classmethod
    def of_logs(cls, logs: Sequence[JointLog]) -> LoggedSensors:
        """The sensors of some logs."""
        by_log = [_filled_channels(log) for log in logs]
        every = list(dict.fromkeys(name for names in by_log for name in names))
        shared = [name for name in every if all(name in names for names in by_log)]
        imu = (*GYROSCOPE, *ACCELEROMETER)
        has_imu = all(name in shared for name in imu) and all(_changes(log, imu) for log in logs)
        has_pose = all(name in shared for name in POSE) and all(_changes(log, POSE) for log in logs)
        if has_imu:
            has_orientation = all(name in shared for name in ORIENTATION)
            base_moves = any(map(_base_moves, logs))
        else:
            has_orientation = has_pose
            base_moves = has_pose and any(_change(log, POSE) > _MAX_POSE_CHANGE for log in logs)
        wrenches = {name: own for name, own in _wrenches(shared).items() if all(_changes(log, own) for log in logs)}
        flags = {found[1]: name for name in shared if (found := _FLAG.fullmatch(name))}
        return cls(
            has_imu=has_imu,
            has_pose=has_pose,
            has_orientation=has_orientation,
            base_moves=base_moves,
            flags=flags,
            wrenches=wrenches,
            in_some_logs=tuple(name for name in every if name not in shared),
        )


def _filled_channels(log: JointLog) -> list[str]:
    """Channels with values; a flag has at least one, others have two."""
    filled = []
    for name, channel in log.channels.items():
        least = 1 if _FLAG.fullmatch(name) else 2
        if np.isfinite(channel.x).sum() >= least:
            filled.append(name)
    return filled


def _wrenches(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Channels of the forces, with those of the moments where there are three."""
    wrenches = {}
    for name in names:
        found = _FORCE.fullmatch(name)
        if found is None:
            continue
        force = tuple(f"force_{found[1]}_{axis}" for axis in "xyz")
        moment = tuple(f"force_{found[1]}_m{axis}" for axis in "xyz")
        if all(channel in names for channel in force):
            has_moment = all(channel in names for channel in moment)
            wrenches[found[1]] = (*force, *moment) if has_moment else force
    return wrenches


def _changes(log: JointLog, names: Sequence[str]) -> bool:
    """True if one of some channels changes: a sensor that is dead reads the same all the time."""
    return any(np.ptp(finite_samples(log.channels[name]).x) > 0 for name in names)


def _base_moves(log: JointLog) -> bool:
    """True if the IMU turns or accelerates."""
    return _change(log, GYROSCOPE) > _MAX_RATE or _change(log, ACCELEROMETER) > _MAX_ACCELERATION


def _change(log: JointLog, names: Sequence[str]) -> float:
    """Standard deviation of a vector whose noise is averaged out."""
    variance = 0.0
    for name in names:
        channel = finite_samples(log.channels[name])
        step = float(np.median(np.diff(channel.t))) or _AVERAGE
        samples = min(max(round(_AVERAGE / step), 1), len(channel.x))
        variance += float(np.var(uniform_filter1d(channel.x, samples)))
    return math.sqrt(variance)

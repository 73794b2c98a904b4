"""Faults of an IMU that show in its own channels: dead sensor, other unit, gravity removed, other orientation.

At rest and on average over a motion, an accelerometer shows gravity upward: 9.81 m/s² along the vertical that the
orientation tells.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.base_sensors import ACCELEROMETER, GYROSCOPE, ORIENTATION
from idtool.data.logs.log import JointLog
from idtool.data.logs.sensor_channels import finite_samples, is_dead
from idtool.data.smoothing import moving_mean

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_MAX_SAMPLES = 1 << 16
_AVERAGE = 1.0  # s, over which the acceleration of a motion averages out
_WITHOUT_GRAVITY = 0.5  # of gravity, below which the mean acceleration has none
_TOLERANCE = 0.15  # of gravity, by which the mean acceleration may differ
_MAX_ANGLE = np.deg2rad(12)  # between gravity and the vertical
_DEGREES = np.rad2deg(1.0)
_OTHER_RATE, _SAME_RATE = 0.3, 0.7  # correlation of angular velocities that are not, or are, the same
_MAX_UNIT_ERROR = 1.5  # ratio of an angular velocity to that of the orientation, or the reverse


def imu_findings(log: JointLog) -> Iterator[Notice]:
    """Notices about the IMU of a log; none without accelerometer and gyroscope."""
    channels = {}
    for name in (*ACCELEROMETER, *GYROSCOPE, *ORIENTATION):
        if name in log.channels:
            channels[name] = finite_samples(log.channels[name])
    is_complete = all(name in channels and len(channels[name].t) for name in (*ACCELEROMETER, *GYROSCOPE))
    if not is_complete:
        return
    if dead := dead_imu_sensors(log):
        message = f"the {dead} has a constant reading"
        yield Notice("imu_dead", "problem", "imu", message, "log what it measures")
        return
    longest = max(log.segments, key=lambda segment: segment.stop - segment.start)
    t = log.t[longest][:_MAX_SAMPLES]
    acceleration = np.stack([channels[name].at(t) for name in ACCELEROMETER])
    rates = np.stack([channels[name].at(t) for name in GYROSCOPE])
    samples = max(round(_AVERAGE / log.dt), 1)
    mean = moving_mean(acceleration, samples)
    size = float(np.median(np.linalg.norm(mean, axis=0)))
    if abs(size * STANDARD_GRAVITY - STANDARD_GRAVITY) < _TOLERANCE * STANDARD_GRAVITY:
        message = f"the acceleration is {short_number(size)} on average: it is in g, not in m/s²"
        yield Notice("imu_unit", "problem", "imu", message, "multiply it by 9.81 when you log it")
        return
    if size < _WITHOUT_GRAVITY * STANDARD_GRAVITY:
        message = (
            f"the acceleration is {short_number(size)} m/s² on average instead of 9.81: gravity was removed from it"
        )
        advice = "log what the accelerometer measures, which includes gravity"
        yield Notice("imu_without_gravity", "problem", "imu", message, advice)
        return
    if abs(size - STANDARD_GRAVITY) > _TOLERANCE * STANDARD_GRAVITY:
        message = f"the acceleration is {short_number(size)} m/s² on average instead of 9.81"
        yield Notice("imu_scale", "warning", "imu", message, "check the unit and the calibration of the accelerometer")
    if not all(name in channels and len(channels[name].t) for name in ORIENTATION):
        return
    quaternions = np.stack([channels[name].at(t) for name in ORIENTATION])
    if not (np.linalg.norm(quaternions, axis=0) > 0).all():
        message = "its orientation is zero at some samples"
        yield Notice("imu_orientation", "problem", "imu", message, "log the orientation of the IMU, from link to world")
        return
    yield from _orientation_findings(quaternions, mean)
    yield from _rate_findings(quaternions, rates, log.dt)


def dead_imu_sensors(log: JointLog) -> str:
    """Names of the IMU's sensors that read the same all the time, joined as text; empty: none do."""
    sensors = {"accelerometer": ACCELEROMETER, "gyroscope": GYROSCOPE}
    dead = [name for name, channels in sensors.items() if is_dead(log, channels)]
    return " and the ".join(dead)


def _orientation_findings(quaternions: Array, mean: Array) -> Iterator[Notice]:
    """Notice if the mean acceleration, shape (3, N), is not along the vertical of the orientation, shape (4, N)."""
    angle = _angle_to_vertical(quaternions, mean)
    if angle < _MAX_ANGLE:
        return
    others = {
        "qw seems to be the first of the four numbers, not the last": np.roll(quaternions, -1, axis=0),
        "it seems to be the rotation from world to link": quaternions * np.array([[-1.0], [-1.0], [-1.0], [1.0]]),
    }
    message = f"gravity is {np.rad2deg(angle):.0f}° from the vertical that its orientation tells"
    for reason, other in others.items():
        if _angle_to_vertical(other, mean) < _MAX_ANGLE:
            message = f"{message}: {reason}"
            break
    advice = "compare the order and the direction of its orientation (link to world) and the axes of base.imu.link"
    yield Notice("imu_orientation", "problem", "imu", message, advice)


def _angle_to_vertical(quaternions: Array, mean: Array) -> float:
    """Median angle [rad] between the mean acceleration and the vertical of an orientation."""
    from scipy.spatial.transform import Rotation

    up = Rotation.from_quat(quaternions.T).as_matrix()[:, 2]  # the world's z axis in the IMU's
    cosine = (up.T * mean).sum(axis=0) / np.maximum(np.linalg.norm(mean, axis=0), 1e-9)
    return float(np.median(np.arccos(np.clip(cosine, -1, 1))))


def _rate_findings(quaternions: Array, rates: Array, dt: float) -> Iterator[Notice]:
    """Notice if the angular velocity, shape (3, N), differs from that of the orientation, shape (4, N)."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_quat(quaternions.T)
    step = max(round(0.05 / dt), 1)
    if len(rotations) <= 2 * step:
        return
    change = _rates_of(rotations, step, dt)
    measured = moving_mean(rates, step)[:, step // 2 : step // 2 + change.shape[1]]
    if np.square(change).mean() < np.square(np.deg2rad(1.0)):  # it hardly turns
        return
    ratio = float(np.sqrt(np.square(measured).mean() / np.square(change).mean()))
    if 1 / _MAX_UNIT_ERROR < ratio < _MAX_UNIT_ERROR:
        reverse = _rates_of(rotations.inv(), step, dt)
        if _correlation(measured, change) < _OTHER_RATE and _correlation(measured, reverse) > _SAME_RATE:
            message = "by the angular velocity, its orientation seems to be the rotation from world to link"
            yield Notice(
                "imu_orientation", "problem", "imu", message, "log the orientation of the IMU, from link to world"
            )
        return
    message = f"the angular velocity is {short_number(ratio)} times the rate at which its orientation changes"
    advice = "check its unit"
    if 1 / _MAX_UNIT_ERROR < ratio / _DEGREES < _MAX_UNIT_ERROR:
        message = f"{message}: it is in degrees per second, not in rad/s"
        advice = "convert it when you log it"
    yield Notice("imu_unit", "problem", "imu", message, advice)


def _rates_of(rotations: Rotation, step: int, dt: float) -> Array:
    """Mean angular velocity over ``step`` samples, along the axes of the turning frame, shape (3, N − step) [rad/s]."""
    change = rotations[:-step].inv() * rotations[step:]
    return np.asarray(change.as_rotvec().T / (step * dt))


def _correlation(first: Array, second: Array) -> float:
    """Correlation of two angular velocities, shape (3, N), about 0."""
    size = np.linalg.norm(first) * np.linalg.norm(second)
    return float((first * second).sum() / size) if size else 0.0

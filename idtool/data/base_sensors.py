"""`BaseSensors`: motion of a floating base, from the channels of its IMU in a log.

Everything is along the axes of the base's frame. The velocity of the base's origin is not measured, and not needed: the
equation of motion holds in every frame that moves uniformly, so that it may be 0 at every sample. The acceleration is
the proper one, which an accelerometer shows: at rest, it points upward and is as large as gravity.

Letters: w angular velocity [rad/s], alpha its derivative [rad/s²], f proper acceleration [m/s²]. N samples. Times are
those of the log's own stamps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.data.filters import DIFFERENCE_REACH, differentiate
from idtool.data.logs.log import JointLog
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.robot.body import Frame
from idtool.robot.config import Config
from idtool.robot.model import RobotModel

# channels along the IMU's axes; the orientation is the rotation from the IMU to the world, its real part last
GYROSCOPE = ("imu_wx", "imu_wy", "imu_wz")
ACCELEROMETER = ("imu_ax", "imu_ay", "imu_az")
ORIENTATION = ("imu_qx", "imu_qy", "imu_qz", "imu_qw")


def sensor_options(config: Config) -> SensorOptions | None:
    """Options for reading the sensors of a robot from a log; None if it has none."""
    if not (config.base.kind == "floating" or config.contacts or config.wrench_sensors):
        return None
    return SensorOptions(imu_topic=config.base.imu.topic)


def needed_channels(config: Config) -> tuple[str, ...]:
    """Channels of a log that a configuration needs beside those of the joints."""
    needed: list[str] = []
    for _, channels in channels_by_sensor(config):
        needed += channels
    return tuple(needed)


def channels_by_sensor(config: Config) -> list[tuple[str, tuple[str, ...]]]:
    """Pairs of a sensor and its `needed_channels`: the joint of a wrench sensor, ``imu``, or the name of a contact."""
    sensors = [(sensor.joint, sensor.logged_channels) for sensor in config.wrench_sensors]
    if config.base.kind == "floating":
        of_imu: tuple[str, ...] = (*GYROSCOPE, *ACCELEROMETER)
        if any(contact.needs_orientation for contact in config.contacts):
            of_imu += ORIENTATION
        sensors.append(("imu", of_imu))
    return sensors + [(contact.name, contact.logged_channels) for contact in config.contacts]


def sensor_step(log: JointLog, config: Config) -> float:
    """Sample time of the slowest sensor whose values a configuration takes at every sample [s]; 0 without any.

    The orientation changes slowly, and flags jump.
    """
    slow = {*ORIENTATION, *(contact.flag for contact in config.contacts)}
    names = [name for name in needed_channels(config) if name not in slow]
    return max((log.channels[name].step for name in names), default=0.0)


class BaseSensors:
    """The sensors of a floating base in a log.

    Parameters
    ----------
    log
        The log, with the channels of the IMU.
    config
        The configuration of its IMU.
    imu_frame
        Frame of the IMU in the base's.
    """

    def __init__(self, log: JointLog, config: Config, imu_frame: Frame) -> None:
        self._channels = log.channels
        self._imu_frame = imu_frame
        self._imu_delay = config.base.imu.known_delay

    @classmethod
    def of_log(cls, log: JointLog, model: RobotModel, config: Config) -> BaseSensors | None:
        """The sensors of a model's base in a log; None if the base is fixed."""
        if not model.has_floating_base:
            return None
        imu_link = config.base.imu.link or model.robot.root
        return cls(log, config, model.frames[imu_link])

    @property
    def lookahead(self) -> float:
        """Time after a sample until all values of the IMU that belong to it are there [s]."""
        names = [*GYROSCOPE, *ACCELEROMETER, *(name for name in ORIENTATION if name in self._channels)]
        return max(self._channels[name].step for name in names) + max(self._imu_delay, 0.0)

    def angular_velocity(self, t: Array) -> Array:
        """Angular velocity of the base as measured, at times [s] of N samples, shape (3, N) [rad/s]."""
        return np.asarray(self._imu_frame.R @ self._imu(GYROSCOPE, t))

    def kinematics(self, t: Array, dt: float, smooth: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Velocity and acceleration of the base coordinates, as `RobotModel` has them; shape (6, N) each.

        Parameters
        ----------
        t
            Times [s] of the samples and of those about them that ``smooth`` and two derivatives take, as the joints'
            positions need them.
        dt
            Sample time [s].
        smooth
            Low-pass of the signals; it drops those samples that it takes beside the ones that derivatives need.
        """
        reach = DIFFERENCE_REACH
        filtered_w = smooth(self.angular_velocity(t))
        filtered_f = smooth(self._imu_frame.R @ self._imu(ACCELEROMETER, t))
        alpha = differentiate(filtered_w, dt)[:, reach:-reach]
        w = filtered_w[:, 2 * reach : -2 * reach]
        f_at_imu = filtered_f[:, 2 * reach : -2 * reach]
        lever_arm = self._imu_frame.p
        tangential = np.cross(alpha, lever_arm, axis=0)
        centripetal = np.cross(w, np.cross(w, lever_arm, axis=0), axis=0)
        f_at_base = f_at_imu - tangential - centripetal
        velocity = np.concatenate([np.zeros_like(w), w])
        acceleration = np.concatenate([f_at_base, alpha])
        return velocity, acceleration

    def world_to_base(self, t: Array) -> Array:
        """Rotation of the world's axes, z upward, into the base's frame at times [s], shape (3, 3, N)."""
        quaternions = self._imu(ORIENTATION, t)
        imu_to_world = Rotation.from_quat(quaternions.T).as_matrix()
        base_to_imu = self._imu_frame.R.T
        base_to_world = imu_to_world @ base_to_imu
        world_to_base = base_to_world.transpose(0, 2, 1)
        return np.moveaxis(world_to_base, 0, -1)

    def _values(self, names: Sequence[str], t: Array) -> Array:
        """Values of channels at times, shape (channels, N)."""
        return np.stack([self._channels[name].at(t) for name in names])

    def _imu(self, names: Sequence[str], t: Array) -> Array:
        """Values of the IMU's channels, whose stamps are late, at times."""
        return self._values(names, t + self._imu_delay)

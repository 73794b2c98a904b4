"""`BaseSensors`: motion of a floating base and of its contacts, from the channels of a log.

Everything is along the axes of the base's frame. The velocity of the base's origin is not measured, and not needed: the
equation of motion holds in every frame that moves uniformly, so that it may be 0 at every sample. The acceleration is
the proper one, which an accelerometer shows: at rest, it points upward and is as large as gravity.

Letters: w angular velocity [rad/s], alpha its derivative [rad/s²], f proper acceleration [m/s²]. N samples. Times are
those of the log's own stamps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array, Mask
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


@dataclass(frozen=True)
class ContactSamples:
    """The contacts of a robot at N samples.

    Attributes
    ----------
    world_to_base
        Rotation of the world's axes, z upward, into the base's frame, shape (3, 3, N).
    is_closed
        True where a contact may act: its flag, widened, is set, or it has none; shape (contacts, N).
    wrenches
        Measured force and moment on the link, along the axes of the contact's ``frame``, shape (contacts, 6, N)
        [N, N·m]; 0 if they were not measured.
    """

    world_to_base: Array
    is_closed: Mask
    wrenches: Array

    def every(self, stride: int) -> ContactSamples:
        """One of every ``stride`` samples."""
        return ContactSamples(
            self.world_to_base[..., ::stride], self.is_closed[:, ::stride], self.wrenches[..., ::stride]
        )


def sensor_options(config: Config) -> SensorOptions | None:
    """Options for reading the sensors of a robot from a log; None if it has none."""
    if config.base.kind == "fixed" and not config.wrench_sensors:
        return None
    return SensorOptions(imu_topic=config.base.imu.topic)


def needed_channels(config: Config) -> tuple[str, ...]:
    """Channels of a log that a configuration needs beside those of the joints."""
    return tuple(channel for _, channels in channels_by_sensor(config) for channel in channels)


def channels_by_sensor(config: Config) -> list[tuple[str, tuple[str, ...]]]:
    """The same channels by what they belong to: joint of a wrench sensor, ``imu``, name of a contact."""
    sensors = [(sensor.joint, sensor.logged_channels) for sensor in config.wrench_sensors]
    if config.base.kind == "fixed":
        return sensors
    needs_orientation = any(contact.needs_orientation for contact in config.contacts)
    sensors.append(("imu", (*GYROSCOPE, *ACCELEROMETER, *(ORIENTATION if needs_orientation else ()))))
    return sensors + [(contact.name, contact.logged_channels) for contact in config.contacts]


def sensor_step(log: JointLog, config: Config) -> float:
    """Sample time of the slowest sensor whose values a configuration takes at every sample [s]; 0 without any.

    The orientation changes slowly, and flags jump.
    """
    slow = {*ORIENTATION, *(contact.flag for contact in config.contacts)}
    names = [name for name in needed_channels(config) if name not in slow]
    return max((float(np.median(np.diff(log.channels[name].t))) for name in names), default=0.0)


class BaseSensors:
    """The sensors of a floating base in a log.

    Parameters
    ----------
    log
        The log, with all channels that are needed.
    config
        The configuration: its IMU and its contacts.
    imu_frame
        Frame of the IMU in the base's.
    """

    def __init__(self, log: JointLog, config: Config, imu_frame: Frame) -> None:
        self._channels = log.channels
        self._contacts = config.contacts
        self._imu_frame = imu_frame
        self._imu_delay = config.base.imu.known_delay
        self._has_orientation = any(contact.needs_orientation for contact in config.contacts)

    @classmethod
    def of_log(cls, log: JointLog, model: RobotModel, config: Config) -> BaseSensors | None:
        """The sensors of a model's base in a log; None if the base is fixed."""
        if not model.has_floating_base:
            return None
        imu_link = config.base.imu.link or model.robot.root
        return cls(log, config, model.frames[imu_link])

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
            Zero-phase low-pass of the signals; it drops as many samples at both ends.
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

    def contacts(self, t: Array, smooth: Callable[[Array], Array]) -> ContactSamples:
        """The contacts at the samples.

        Parameters
        ----------
        t
            Times [s] of the samples and of those about them that ``smooth`` takes.
        smooth
            Zero-phase low-pass of the signals; it drops as many samples at both ends.
        """
        filtered_count = smooth(t[None]).shape[1]
        margin = (len(t) - filtered_count) // 2
        inner = t[margin : len(t) - margin]
        is_closed = np.ones((len(self._contacts), len(inner)), dtype=bool)
        wrenches = np.zeros((len(self._contacts), 6, len(inner)))
        for k, contact in enumerate(self._contacts):
            if contact.flag_channel is not None:
                is_closed[k] = self._channels[contact.flag_channel].is_set(inner, contact.widen)
            if contact.force is not None:
                wrenches[k, :3] = smooth(self._values(contact.force, t))
            if contact.moment is not None:
                wrenches[k, 3:] = smooth(self._values(contact.moment, t))
        return ContactSamples(self._world_to_base(inner), is_closed, wrenches)

    def _values(self, names: Sequence[str], t: Array) -> Array:
        """Values of channels at times, shape (channels, N)."""
        return np.stack([self._channels[name].at(t) for name in names])

    def _imu(self, names: Sequence[str], t: Array) -> Array:
        """Values of the IMU's channels, whose stamps are late, at times."""
        return self._values(names, t + self._imu_delay)

    def _world_to_base(self, t: Array) -> Array:
        """Rotation of the world's axes into the base's frame, shape (3, 3, N); the identity if no contact needs it."""
        if not self._has_orientation:
            return np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(t)))
        quaternions = self._imu(ORIENTATION, t)
        imu_to_world = Rotation.from_quat(quaternions.T).as_matrix()
        base_to_imu = self._imu_frame.R.T
        base_to_world = imu_to_world @ base_to_imu
        world_to_base = base_to_world.transpose(0, 2, 1)
        return np.moveaxis(world_to_base, 0, -1)

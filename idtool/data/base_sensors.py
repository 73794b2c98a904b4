"""`BaseSensors`: motion of a floating base and its contacts, from the channels of a log.

Letters, along the axes of the base's frame: w angular velocity [rad/s], alpha its derivative [rad/s²], f proper
acceleration of the frame's origin [m/s²], which at rest is upward by gravity. N samples.
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
from idtool.robot.config import Config, Contact
from idtool.robot.model import RobotModel

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
        Whether each of k contacts may act, shape (k, N).
    wrenches
        Force and moment on the link as measured, along the axes of the contact's own frame, shape (k, 6, N) [N, N·m];
        0 if they were not.
    """

    world_to_base: Array
    is_closed: Mask
    wrenches: Array


def sensor_options(config: Config) -> SensorOptions | None:
    """How to read the sensors of a log; None with a fixed base, which needs none."""
    if config.base.kind == "fixed":
        return None
    return SensorOptions(config.base.imu.topic)


def needed_channels(config: Config) -> tuple[str, ...]:
    """Channels of a log that a configuration with a floating base needs."""
    channels = [*GYROSCOPE, *ACCELEROMETER]
    if any(_needs_orientation(contact) for contact in config.contacts):
        channels += ORIENTATION
    for contact in config.contacts:
        channels += contact.channels
    return tuple(channels)


def _needs_orientation(contact: Contact) -> bool:
    """True if where a contact is, or the axes of its wrench, depend on the orientation of the base."""
    return contact.radius > 0 or (contact.is_measured and contact.frame == "world")


def sensor_step(log: JointLog) -> float:
    """Sample time of the slowest sensor of a log's base [s]; contact flags may be slower."""
    steps = [float(np.median(np.diff(log.channels[name].t))) for name in (*GYROSCOPE, *ACCELEROMETER)]
    return max(steps)


def base_sensors(log: JointLog, model: RobotModel, config: Config) -> BaseSensors | None:
    """The sensors of a model's base in a log; None if the base is fixed."""
    if not model.has_floating_base:
        return None
    return BaseSensors(log, config, model.frames[config.base.imu.link or model.robot.root])


class BaseSensors:
    """The sensors of a floating base in a log.

    Parameters
    ----------
    log
        The log, with all channels that are needed.
    config
        The configuration.
    imu_frame
        Frame of the IMU in the base's.
    """

    def __init__(self, log: JointLog, config: Config, imu_frame: Frame) -> None:
        self._channels = log.channels
        self._contacts = config.contacts
        self._imu_frame = imu_frame
        delay = config.base.imu.delay
        self._imu_delay = 0.0 if delay == "auto" else float(delay)
        self._has_orientation = any(_needs_orientation(contact) for contact in config.contacts)

    def kinematics(self, t: Array, dt: float, smooth: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Velocity and acceleration of the base coordinates, as `RobotModel` has them; shape (6, N) each.

        Parameters
        ----------
        t
            Times [s] of the samples and of those about them that ``smooth`` and two derivatives take.
        dt
            Sample time [s].
        smooth
            The signals' own filter.
        """
        r = DIFFERENCE_REACH
        to_base = self._imu_frame.R
        w = smooth(to_base @ self._imu(GYROSCOPE, t))
        f = smooth(to_base @ self._imu(ACCELEROMETER, t))
        alpha = differentiate(w, dt)[:, r:-r]
        w, f = w[:, 2 * r : -2 * r], f[:, 2 * r : -2 * r]
        lever_arm = self._imu_frame.p
        centripetal = np.cross(w, np.cross(w, lever_arm, axis=0), axis=0)
        at_origin = f - np.cross(alpha, lever_arm, axis=0) - centripetal
        return np.concatenate([np.zeros_like(w), w]), np.concatenate([at_origin, alpha])

    def contacts(self, t: Array, smooth: Callable[[Array], Array]) -> ContactSamples:
        """The contacts at the samples.

        Parameters
        ----------
        t
            Times [s] of the samples and of those about them that ``smooth`` takes.
        smooth
            The signals' own filter.
        """
        margin = (len(t) - smooth(t[None]).shape[1]) // 2
        inner = t[margin : len(t) - margin]
        is_closed = np.ones((len(self._contacts), len(inner)), dtype=bool)
        wrenches = np.zeros((len(self._contacts), 6, len(inner)))
        for k, contact in enumerate(self._contacts):
            flag = contact.flag_channel
            if flag is not None and flag in self._channels:  # else it is always closed, or yet to be detected
                is_closed[k] = self._is_closed(flag, contact.widen, inner)
            measured = [self._channels[name].at(t) for name in (*(contact.force or ()), *(contact.moment or ()))]
            if measured:
                wrenches[k, : len(measured)] = smooth(np.stack(measured))
        return ContactSamples(self._world_to_base(inner), is_closed, wrenches)

    def _imu(self, names: Sequence[str], t: Array) -> Array:
        """Channels of the IMU at times of the joints' clock."""
        return np.stack([self._channels[name].at(t + self._imu_delay) for name in names])

    def _world_to_base(self, t: Array) -> Array:
        """Rotation of the world's axes into the base's frame, shape (3, 3, N); the identity if it is not needed."""
        if not self._has_orientation:
            return np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(t)))
        imu_to_world = Rotation.from_quat(self._imu(ORIENTATION, t).T).as_matrix()
        base_to_world = imu_to_world @ self._imu_frame.R.T
        return base_to_world.transpose(2, 1, 0)

    def _is_closed(self, flag: str, widen: float, t: Array) -> Mask:
        """True at times at which a flag, widened at both ends, is set."""
        channel = self._channels[flag]
        set_times = channel.t[channel.x > 0.5]
        count = np.searchsorted(set_times, t + widen, side="right") - np.searchsorted(set_times, t - widen)
        return np.asarray((count > 0) | (channel.latest(t - widen) > 0.5))

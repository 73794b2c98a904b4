"""`BaseSensors`: motion of a floating base, from the channels of its IMU or of its pose in a log.

Everything is along the axes of the base's frame. The velocity of the base's origin is not measured, and not needed: the
equation of motion holds in every frame that moves uniformly, so that it may be 0 at every sample. The acceleration is
the proper one, which an accelerometer shows: at rest, it points upward and is as large as gravity.

A pose by motion capture or odometry is differentiated as the joints' positions are. Its noise grows with the square of
the frequency, so that the band is lower than with an IMU.

Letters: w angular velocity [rad/s], alpha its derivative [rad/s²], f proper acceleration [m/s²]. N samples. Times are
those of the log's own stamps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.filters import DIFFERENCE_REACH, differentiate
from idtool.data.logs.log import JointLog
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.robot.body import Frame
from idtool.robot.config import Config
from idtool.robot.model import RobotModel

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

# Channels of an IMU, along its axes. The orientation is the rotation from the IMU to the world, its real part last.
GYROSCOPE = ("imu_wx", "imu_wy", "imu_wz")
ACCELEROMETER = ("imu_ax", "imu_ay", "imu_az")
ORIENTATION = ("imu_qx", "imu_qy", "imu_qz", "imu_qw")
# Channels of the pose of a link in the world; the orientation likewise.
POSITION = ("base_x", "base_y", "base_z")
POSE_ORIENTATION = ("base_qx", "base_qy", "base_qz", "base_qw")
POSE = (*POSITION, *POSE_ORIENTATION)

POSE_CUTOFF = 12.0  # Hz: the acceleration of a pose with 0.1 mm of noise at 1 kHz then has 0.04 m/s² of it
_INTERPOLATION_NODES = 6  # samples from which a value in between follows, by a polynomial of degree 5
_SMOOTHING = 0.02  # s, of velocities that are compared


def sensor_options(config: Config) -> SensorOptions | None:
    """Options for reading the sensors of a robot from a log; None if it has none."""
    if not (config.base.kind == "floating" or config.contacts or config.wrench_sensors):
        return None
    base = config.base
    pose_topic = None if base.pose is None else base.pose.topic
    return SensorOptions(base.imu.topic, pose_topic, needs_imu=not base.uses_pose, needs_pose=base.pose is not None)


def needed_channels(config: Config) -> tuple[str, ...]:
    """Channels of a log that a configuration needs beside those of the joints."""
    needed: list[str] = []
    for _, channels in channels_by_sensor(config):
        needed += channels
    return tuple(needed)


def channels_by_sensor(config: Config) -> list[tuple[str, tuple[str, ...]]]:
    """Pairs of a sensor and its `needed_channels`: joint of a wrench sensor, ``imu``, ``pose``, or a contact."""
    sensors = [(sensor.joint, sensor.logged_channels) for sensor in config.wrench_sensors]
    if config.base.kind == "floating" and config.base.pose is not None:
        sensors.append(("pose", POSE))
    if config.base.kind == "floating" and not config.base.uses_pose:
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


def band_limit(config: Config) -> float:
    """Highest default cut-off for the sensors of the base [Hz]."""
    is_by_pose = config.base.kind == "floating" and config.base.uses_pose
    return POSE_CUTOFF if is_by_pose else np.inf


class BaseSensors(ABC):
    """The sensors of a floating base in a log."""

    @staticmethod
    def of_log(log: JointLog, model: RobotModel, config: Config) -> BaseSensors | None:
        """The sensors of a model's base in a log; None if the base is fixed."""
        if not model.has_floating_base:
            return None
        if config.base.uses_pose:
            return pose_sensors(log, model, config)
        frame = model.frames[config.base.imu.link or model.robot.root]
        return ImuSensors(log, frame, config.base.imu.known_delay)

    @property
    @abstractmethod
    def lookahead(self) -> float:
        """Time after a sample until all values of the sensors that belong to it are there [s]."""

    @abstractmethod
    def angular_velocity(self, t: Array) -> Array:
        """Angular velocity of the base as measured, at evenly spaced times [s], shape (3, N) [rad/s]."""

    @abstractmethod
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

    @abstractmethod
    def world_to_base(self, t: Array) -> Array:
        """Rotation of the world's axes, z upward, into the base's frame at times [s], shape (3, 3, N)."""


class ImuSensors(BaseSensors):
    """An IMU on a floating base.

    Parameters
    ----------
    log
        The log, with the channels of the IMU.
    frame
        Frame of the IMU in the base's.
    delay
        How late it is [s].
    """

    def __init__(self, log: JointLog, frame: Frame, delay: float) -> None:
        self._channels = log.channels
        self._imu_frame = frame
        self._imu_delay = delay

    @property
    @override
    def lookahead(self) -> float:
        names = [*GYROSCOPE, *ACCELEROMETER, *(name for name in ORIENTATION if name in self._channels)]
        return max(self._channels[name].step for name in names) + max(self._imu_delay, 0.0)

    @override
    def angular_velocity(self, t: Array) -> Array:
        return np.asarray(self._imu_frame.R @ self._imu(GYROSCOPE, t))

    @override
    def kinematics(self, t: Array, dt: float, smooth: Callable[[Array], Array]) -> tuple[Array, Array]:
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

    @override
    def world_to_base(self, t: Array) -> Array:
        quaternions = self._imu(ORIENTATION, t)
        imu_to_world = _rotations(quaternions).as_matrix()
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


class PoseSensors(BaseSensors):
    """A pose of a link on a floating base, by motion capture or odometry.

    Parameters
    ----------
    log
        The log, with the channels of the pose.
    frame
        Frame of the link in the base's.
    delay
        How late it is [s].
    gravity
        Along the axes of the pose's world, shape (3,) [m/s²].
    """

    def __init__(self, log: JointLog, frame: Frame, delay: float, gravity: Array) -> None:
        self._channels = log.channels
        self._frame = frame
        self._delay = delay
        self._gravity = gravity

    @property
    @override
    def lookahead(self) -> float:
        nodes_after = _INTERPOLATION_NODES // 2
        return nodes_after * max(self._channels[name].step for name in POSE) + max(self._delay, 0.0)

    @override
    def angular_velocity(self, t: Array) -> Array:
        from scipy.ndimage import gaussian_filter1d

        quaternions = self._values(POSE_ORIENTATION, t)
        dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
        smoothed = gaussian_filter1d(quaternions, _SMOOTHING / dt, axis=-1)
        return np.asarray(self._frame.R @ _angular_velocity(smoothed, np.gradient(smoothed, dt, axis=-1)))

    @override
    def kinematics(self, t: Array, dt: float, smooth: Callable[[Array], Array]) -> tuple[Array, Array]:
        reach = DIFFERENCE_REACH
        quaternions = smooth(self._values(POSE_ORIENTATION, t))
        rate = differentiate(quaternions, dt)
        w_in_link = _angular_velocity(quaternions[:, reach:-reach], rate)
        w = self._frame.R @ w_in_link
        alpha = differentiate(w, dt)
        link_to_world = _rotations(quaternions)
        origin = self._base_origin(smooth(self._values(POSITION, t)), link_to_world)
        acceleration = differentiate(differentiate(origin, dt), dt)
        in_world = acceleration - self._gravity[:, None]
        in_link = link_to_world[2 * reach : -2 * reach].inv().apply(in_world.T).T
        f = self._frame.R @ in_link
        w = w[:, reach:-reach]
        return np.concatenate([np.zeros_like(w), w]), np.concatenate([f, alpha])

    def linear_velocity(self, t: Array) -> Array:
        """Velocity of the base's origin along the axes of the base, at evenly spaced times [s], shape (3, N) [m/s]."""
        from scipy.ndimage import gaussian_filter1d

        dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
        link_to_world = _rotations(self._values(POSE_ORIENTATION, t))
        origin = self._base_origin(self._values(POSITION, t), link_to_world)
        velocity = gaussian_filter1d(origin, _SMOOTHING / dt, axis=-1, order=1) / dt
        return np.asarray(self._frame.R @ link_to_world.inv().apply(velocity.T).T)

    @override
    def world_to_base(self, t: Array) -> Array:
        link_to_world = _rotations(self._values(POSE_ORIENTATION, t)).as_matrix()
        world_to_base = self._frame.R @ link_to_world.transpose(0, 2, 1)
        return np.moveaxis(world_to_base, 0, -1)

    def _base_origin(self, position: Array, link_to_world: Rotation) -> Array:
        """Place of the base's origin in the world by the link's position, shape (3, N), and N rotations; (3, N) [m]."""
        origin_in_link = -self._frame.R.T @ self._frame.p
        return np.asarray(position + link_to_world.apply(origin_in_link).T)

    def _values(self, names: Sequence[str], t: Array) -> Array:
        """Values of channels, whose stamps are late, at times; shape (channels, N)."""
        first = self._channels[names[0]]
        own_times = t + self._delay
        near = _nodes_near(first.t, own_times)
        samples = np.stack([self._channels[name].x[near] for name in names])
        return interpolate(first.t[near], samples, own_times)


def pose_sensors(log: JointLog, model: RobotModel, config: Config) -> PoseSensors | None:
    """The pose of a model's base in a log, also if it is only compared; None without one."""
    pose = config.base.pose
    if pose is None:
        return None
    frame = model.frames[pose.link or model.robot.root]
    return PoseSensors(log, frame, pose.known_delay, np.array(config.gravity))


def interpolate(nodes: Array, x: Array, t: Array) -> Array:
    """Values between samples, by the polynomial through the nearest six: a line would have no second derivative.

    Parameters
    ----------
    nodes
        Times of the samples [s], shape (k,), in order.
    x
        The samples, shape (channels, k).
    t
        Times [s], shape (N,); beyond the samples, they are taken as at their ends.

    Returns
    -------
    Shape (channels, N).
    """
    is_new = np.concatenate([[True], np.diff(nodes) > 0])
    nodes, x = nodes[is_new], x[:, is_new]
    t = np.clip(t, nodes[0], nodes[-1])
    count = min(_INTERPOLATION_NODES, len(nodes))
    first = np.clip(np.searchsorted(nodes, t) - count // 2, 0, len(nodes) - count)
    near = first[:, None] + np.arange(count)  # (N, count)
    times = nodes[near]
    values = np.zeros((len(x), len(t)))
    for j in range(count):
        weight = np.ones_like(t)
        for k in range(count):
            if k != j:
                weight *= (t - times[:, k]) / (times[:, j] - times[:, k])
        values += weight * x[:, near[:, j]]
    return values


def _nodes_near(nodes: Array, t: Array) -> slice:
    """Samples that `interpolate` takes for times: those about them, and enough with other times beyond them."""
    first = int(np.searchsorted(nodes, t.min(initial=np.inf)))
    last = int(np.searchsorted(nodes, t.max(initial=-np.inf), side="right"))
    margin = 2 * _INTERPOLATION_NODES
    while True:
        start, stop = max(first - margin, 0), min(last + margin, len(nodes))
        before = len(np.unique(nodes[start:first]))
        after = len(np.unique(nodes[last:stop]))
        has_enough_before = start == 0 or before > _INTERPOLATION_NODES
        if has_enough_before and (stop == len(nodes) or after > _INTERPOLATION_NODES):
            return slice(start, stop)
        margin *= 2


def _angular_velocity(quaternions: Array, rate: Array) -> Array:
    """Angular velocity along the axes of the turning frame, from a quaternion, real part last, and its rate.

    Shapes (4, N); the norm need not be 1. The result has the shape (3, N) [rad/s].
    """
    v, s = quaternions[:3], quaternions[3]
    dv, ds = rate[:3], rate[3]
    # vector part of 2 q* dq/dt
    vector = s * dv - ds * v - np.cross(v, dv, axis=0)
    return np.asarray(2 * vector / np.square(quaternions).sum(axis=0))


def _rotations(quaternions: Array) -> Rotation:
    """N rotations of quaternions, real part last, shape (4, N)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions.T)

"""The log of a standing trajectory as the robot's sensors would give it, for what `fit` makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.data.base_sensors import ACCELEROMETER, GYROSCOPE, ORIENTATION
from idtool.data.logs import JointLog, make_log
from idtool.data.logs.log import Channel
from idtool.excitation.standing.kinematics import StandingSamples
from idtool.robot.config import Config
from idtool.robot.model import RobotModel


def predicted_log(
    model: RobotModel, config: Config, feet: tuple[str, ...], t: Array, samples: StandingSamples, torque: Array
) -> JointLog:
    """A log without noise of joints, IMU and flags.

    Parameters
    ----------
    model, config
        The robot and its configuration.
    feet
        Names of the contacts that are closed.
    t
        Times, shape (N,) [s].
    samples
        The motion.
    torque
        Torques of the joints, shape (n, N).
    """
    n = model.joint_count
    signals = {"q": samples.motion.q[:n].T, "v": samples.motion.v[:n].T, "tau": torque.T}
    log = make_log(Path("design"), t, model.joint_names, {name: x.copy() for name, x in signals.items()})
    channels = _imu_channels(model, config, t, samples)
    for contact in config.contacts:
        if contact.flag_channel is not None:
            channels[contact.flag_channel] = Channel(t, np.full(len(t), float(contact.name in feet)))
        for channel in (*(contact.force or ()), *(contact.moment or ())):
            channels[channel] = Channel(t, np.zeros(len(t)))  # changes the torque, but no column
    return replace(log, channels=channels)


def _imu_channels(model: RobotModel, config: Config, t: Array, samples: StandingSamples) -> dict[str, Channel]:
    """Channels of the IMU, whose stamps are late by its delay."""
    imu = config.base.imu
    frame = model.frames[imu.link or model.robot.root]
    base = model.base_coordinates
    w, f = samples.motion.v[base][3:], samples.motion.a[base][:3]
    alpha = samples.motion.a[base][3:]
    lever = frame.p[:, None]
    tangential = np.cross(alpha, lever, axis=0)
    centripetal = np.cross(w, np.cross(w, lever, axis=0), axis=0)
    stamps = t + imu.known_delay
    orientation = Rotation.from_matrix(samples.base_to_world @ frame.R).as_quat().T
    values = {
        GYROSCOPE: frame.R.T @ w,
        ACCELEROMETER: frame.R.T @ (f + tangential + centripetal),
        ORIENTATION: _continuous(orientation),
    }
    channels = {}
    for names, rows in values.items():
        for name, row in zip(names, rows, strict=True):
            channels[name] = Channel(stamps, row)
    return channels


def _continuous(quaternions: Array) -> Array:
    """The quaternions (4, N), or their negatives, without jumps of their sign."""
    products = np.einsum("in,in->n", quaternions[:, 1:], quaternions[:, :-1])
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0, -1.0, 1.0)]))
    return np.asarray(quaternions * signs)

"""Checks the sign of wrench sensors by the URDF's bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.data.signals import Signals
from idtool.robot.config import Config
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import RobotModel

MIN_CORRELATION = 0.5  # of a force with that of the URDF's bodies, from which it tells the sign


def sign_notices(signals: Signals, model: RobotModel, config: Config) -> Iterator[Notice]:
    """Notices about sensors whose force changes oppositely to that of the URDF's bodies.

    Parameters
    ----------
    signals, model, config
        As for `force_correlations`.
    """
    correlations = force_correlations(signals, model, config)
    for sensor in config.wrench_sensors:
        if correlations.get(sensor.joint, 0.0) < -MIN_CORRELATION:
            message = "its force changes oppositely to that of the URDF's bodies"
            yield Notice("wrench_sensor_sign", "problem", sensor.joint, message, f"set sign: {-sensor.sign}")


def force_correlations(signals: Signals, model: RobotModel, config: Config) -> dict[str, float]:
    """By fixed joint, correlation of the changes of a sensor's force with those of the URDF's bodies.

    A sensor between a contact and the base carries the contact's force too, and is left out.

    Parameters
    ----------
    signals
        A log, of which the first batch is used.
    model
        The tree of bodies, with the parameters of the URDF.
    config
        The configuration.
    """
    if not config.wrench_sensors:
        return {}
    batch = next(iter(signals.batches()), None)
    if batch is None:
        return {}
    motion = batch.motion
    pi = np.stack([body.pi for body in model.bodies])
    by_urdf = inverse_dynamics(model, pi, motion.q, motion.v, motion.a)
    support = model.support()
    contact_bodies = [model.frames[contact.link].body for contact in config.contacts]
    correlations = {}
    for i, sensor in enumerate(config.wrench_sensors):
        first = model.sensor_coordinates(i).start
        force = slice(first, first + 3)
        if not support[contact_bodies, first].any():
            correlations[sensor.joint] = _correlation(motion.tau[force], by_urdf[force])
    return correlations


def _correlation(a: Array, b: Array) -> float:
    """Correlation of the changes of two vectors, shape (3, N) each; 0 if one does not change."""
    # changes, since what a sensor reads without load is not known
    changes_a = a - a.mean(axis=1, keepdims=True)
    changes_b = b - b.mean(axis=1, keepdims=True)
    size = float(np.linalg.norm(changes_a) * np.linalg.norm(changes_b))
    return float((changes_a * changes_b).sum()) / size if size else 0.0

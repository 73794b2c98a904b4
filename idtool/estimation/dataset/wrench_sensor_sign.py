"""Checks the sign of wrench sensors by the URDF's bodies.

The force of a sensor that carries bodies alone changes with theirs. That of one between the base and a contact, such
as the ankle's, carries what the contact carries of the robot too. A floating base rests on its contacts, so that they
push upward: against the weight of the bodies that the sensor carries.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.signals import Signals
from idtool.robot.config import Config
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import RobotModel

_MIN_CORRELATION = 0.5  # of a force with that of the URDF's bodies, from which it tells the sign
_MIN_CARRIED_SHARE = 0.15  # of the robot's weight on a contact, from which it tells the sign


def sign_notices(signals: Signals, model: RobotModel, config: Config) -> Iterator[Notice]:
    """Notices about sensors whose force is opposite to what the URDF's bodies let expect.

    Parameters
    ----------
    signals, model, config
        As for `sensor_signs`.
    """
    signs = sensor_signs(signals, model, config)
    for sensor in config.wrench_sensors:
        if signs.get(sensor.joint, sensor.sign) != sensor.sign:
            message = "the force of this wrench sensor is opposite to that of the URDF's bodies"
            yield Notice("wrench_sensor_sign", "problem", sensor.joint, message, f"set sign: {-sensor.sign}")


def sensor_signs(signals: Signals, model: RobotModel, config: Config) -> dict[str, int]:
    """By fixed joint, sign of a sensor as a log tells it; without those of which it does not.

    Parameters
    ----------
    signals
        A log, of which the first batch is used.
    model
        The tree of bodies, with the parameters of the URDF.
    config
        The configuration.
    """
    batch = next(iter(signals.batches()), None) if config.wrench_sensors else None
    if batch is None:
        return {}
    motion = batch.motion
    pi = np.stack([body.pi for body in model.bodies])
    by_urdf = inverse_dynamics(model, pi, motion.q, motion.v, motion.a)
    support = model.support()
    contact_bodies = [model.frames[contact.link].body for contact in config.contacts]
    signs: dict[str, int] = {}
    for i, sensor in enumerate(config.wrench_sensors):
        first = model.sensor_coordinates(i).start
        force = slice(first, first + 3)
        measured, expected = motion.tau[force], by_urdf[force]
        if not support[contact_bodies, first].any():
            agreement = _correlation(measured, expected) / _MIN_CORRELATION
        elif model.has_floating_base:
            agreement = _carried_force(measured, expected) / (_MIN_CARRIED_SHARE * STANDARD_GRAVITY * model.mass)
        else:
            continue
        if abs(agreement) > 1:
            signs[sensor.joint] = sensor.sign if agreement > 0 else -sensor.sign
    return signs


def _carried_force(measured: Array, by_bodies: Array) -> float:
    """Mean force by which contacts carry the robot [N], against the direction of the bodies' force, (3, N) each."""
    size = np.linalg.norm(by_bodies, axis=0)
    is_known = size > 0
    along_bodies = ((by_bodies - measured) * by_bodies).sum(axis=0)[is_known] / size[is_known]
    return float(along_bodies.mean()) if is_known.any() else 0.0


def _correlation(a: Array, b: Array) -> float:
    """Correlation of the changes of two vectors, shape (3, N) each; 0 if one does not change."""
    # changes, since what a sensor reads without load is not known
    changes_a = a - a.mean(axis=1, keepdims=True)
    changes_b = b - b.mean(axis=1, keepdims=True)
    size = float(np.linalg.norm(changes_a) * np.linalg.norm(changes_b))
    return float((changes_a * changes_b).sum()) / size if size else 0.0

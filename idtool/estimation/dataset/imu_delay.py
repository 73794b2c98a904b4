"""Delay of an IMU against the joints, from a robot that stands.

While three feet or more are on the ground and do not slip, the joints' velocities determine how the base turns. The
gyroscope measures the same, later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_erosion

from idtool.common.arrays import Array, Mask
from idtool.common.notice import Notice
from idtool.data.base_sensors import GYROSCOPE, BaseSensors
from idtool.data.inspection.velocity import velocity_agreement
from idtool.data.logs.log import JointLog
from idtool.data.signals import Motion
from idtool.dynamics.contact_forces import ContactForces
from idtool.robot.config import Config, Contact
from idtool.robot.model import RobotModel

_MAX_SAMPLES = 30_000
_MIN_SECONDS = 3.0  # of standing
_EROSION = 0.1  # s, at the ends of a contact in which a foot may slip
_MIN_RANK_RATIO = 1e-3  # of the least to the largest singular value, with which closed feet determine the base's motion
_MIN_AGREEMENT = 0.8  # share of the gyroscope's power that the joints must explain
_MIN_SIGNIFICANCE = 3.0  # ratio of a delay to its standard error
_COMPLIANCE = 1e-3  # s, by which soft feet let the base follow the joints late or early


@dataclass(frozen=True)
class ImuDelay:
    """How late an IMU is against the joints, with its standard error [s]."""

    value: float
    standard_error: float

    @property
    def text(self) -> str:
        """The delay in words."""
        return f"{1e3 * self.value:.2f} ± {1e3 * self.standard_error:.2f} ms"


def with_imu_delay(config: Config, model: RobotModel, logs: Sequence[JointLog]) -> tuple[Config, list[Notice]]:
    """The configuration with the IMU's delay, where it is determined, and notices about it.

    Parameters
    ----------
    config
        The configuration of a robot with a floating base; a delay of ``auto`` is determined.
    model
        The tree of bodies.
    logs
        The logs, with the sensors of the base.
    """
    delay = imu_delay(logs, model, config)
    given = config.base.imu.delay
    used = 0.0 if given == "auto" else float(given)
    if delay is None or abs(delay.value - used) < _MIN_SIGNIFICANCE * delay.standard_error:
        return config, []
    if given != "auto":
        message = f"it is {delay.text} late against the joints; a delay of {1e3 * used:.3g} ms is given"
        return config, [Notice("imu_delay", "warning", "imu", message, "set base.imu.delay to auto")]
    message = f"it is {delay.text} late against the joints; idtool corrects it"
    imu = config.base.imu.model_copy(update={"delay": delay.value})
    corrected = config.model_copy(update={"base": config.base.model_copy(update={"imu": imu})})
    return corrected, [Notice("imu_delay", "note", "imu", message)]


def imu_delay(logs: Sequence[JointLog], model: RobotModel, config: Config) -> ImuDelay | None:
    """Delay of the IMU by all logs; None if the robot does not stand in any, or hardly turns."""
    mean = _mean([found for log in logs if (found := _delay_in_log(log, model, config)) is not None])
    return mean and replace(mean, standard_error=float(np.hypot(mean.standard_error, _COMPLIANCE)))


def _delay_in_log(log: JointLog, model: RobotModel, config: Config) -> ImuDelay | None:
    """Delay of the IMU in a log, with the error by noise; None if the log does not tell it."""
    feet = tuple(contact for contact in config.contacts if _is_flagged_foot(contact, model))
    if not feet:
        return None
    segment = max(log.segments, key=lambda s: s.stop - s.start)
    samples = slice(segment.start, min(segment.stop, segment.start + _MAX_SAMPLES))
    directions, q_rate = _foot_directions(log, model, config, feet, samples)
    part = _longest_run(_stands(directions))
    if (part.stop - part.start) * log.dt < _MIN_SECONDS:
        return None
    turning = _base_turning(directions[:, :, part], q_rate[:, part])
    t = log.t[samples][part]
    measured = np.stack([log.channels[name].at(t) for name in GYROSCOPE])
    to_base = model.frames[config.base.imu.link or model.robot.root].R
    agreements = []
    for own, of_joints in zip(to_base @ measured, turning, strict=True):
        agreement = velocity_agreement(np.cumsum(of_joints) * log.dt, own, log.dt)
        if agreement.agreement > _MIN_AGREEMENT:
            agreements.append(ImuDelay(agreement.lag - log.dt / 2, agreement.lag_error))  # a sum is half a sample early
    return _mean(agreements)


def _is_flagged_foot(contact: Contact, model: RobotModel) -> bool:
    """True for a contact that is on a moving link, and of which the log tells when it is closed."""
    return contact.flag is not None and not model.bodies[model.frames[contact.link].body].is_base


def _foot_directions(
    log: JointLog, model: RobotModel, config: Config, feet: tuple[Contact, ...], samples: slice
) -> tuple[Array, Array]:
    """Velocity of each component of the closed feet per coordinate, shape (k, nv, N), and dq/dt, shape (nv, N)."""
    columns = [log.joints.index(name) for name in model.joint_names]
    q = np.zeros((len(model.joints), samples.stop - samples.start))
    q[: model.joint_count] = log.signals["q"][samples][:, columns].T
    rate = np.gradient(q, log.dt, axis=1)
    unwidened = tuple(
        contact.model_copy(update={"widen": 0.0, "force": None, "moment": None, "frame": "link"}) for contact in feet
    )
    imu = config.base.imu.model_copy(update={"delay": 0.0})
    base = config.base.model_copy(update={"imu": imu})
    settings = config.model_copy(update={"contacts": unwidened, "base": base})
    frame = model.frames[config.base.imu.link or model.robot.root]
    t = log.t[samples]
    contacts = BaseSensors(log, settings, frame).contacts(t, lambda x: x)
    reach = max(round(_EROSION / log.dt), 1)
    closed = np.stack([binary_erosion(row, iterations=reach) for row in contacts.is_closed])
    zero = np.zeros_like(q)
    motion = Motion(t, q, zero, zero, zero, zero, np.ones(len(q)), log.dt, contacts=replace(contacts, is_closed=closed))
    return ContactForces(model, unwidened, np.ones(len(q))).unknown_directions(motion), rate


def _stands(directions: Array) -> Mask:
    """True for samples at which closed feet determine the motion of the base, shape (N,)."""
    of_base = np.moveaxis(directions[:, -6:], -1, 0)  # (N, k, 6)
    if of_base.shape[1] < of_base.shape[2]:
        return np.zeros(len(of_base), dtype=bool)
    singular = np.linalg.svd(of_base, compute_uv=False)
    return np.asarray(singular[:, -1] > _MIN_RANK_RATIO * singular[:, 0])


def _longest_run(mask: Mask) -> slice:
    """The longest run of true samples."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    starts, stops = edges[::2], edges[1::2]
    if not len(starts):
        return slice(0, 0)
    longest = int(np.argmax(stops - starts))
    return slice(int(starts[longest]), int(stops[longest]))


def _base_turning(directions: Array, q_rate: Array) -> Array:
    """Angular velocity of the base by least squares, the feet being at rest, shape (3, N) [rad/s]."""
    of_base = np.moveaxis(directions[:, -6:], -1, 0)  # (N, k, 6)
    feet_velocity = np.einsum("kvn,vn->nk", directions[:, :-6], q_rate[:-6])
    gram = of_base.transpose(0, 2, 1) @ of_base
    right = of_base.transpose(0, 2, 1) @ feet_velocity[:, :, None]
    return np.asarray(-np.linalg.solve(gram, right)[:, 3:, 0].T)


def _mean(delays: Sequence[ImuDelay]) -> ImuDelay | None:
    """Mean of several estimates by their standard errors; None without any."""
    if not delays:
        return None
    weights = np.array([delay.standard_error**-2 for delay in delays])
    value = float(np.average([delay.value for delay in delays], weights=weights))
    return ImuDelay(value, float(weights.sum() ** -0.5))

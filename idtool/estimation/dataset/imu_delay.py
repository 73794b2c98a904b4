"""Estimates how late an IMU is against the joints, from a robot that stands.

Feet that are on the ground and do not slip determine how the base turns with the joints: J_base v = −J_joints dq/dt.
The gyroscope measures the same, later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.base_sensors import BaseSensors
from idtool.data.contact_channels import ContactChannels
from idtool.data.logs.log import JointLog
from idtool.data.signals import Motion
from idtool.data.velocity_agreement import velocity_agreement
from idtool.dynamics.contact_model import ContactModel
from idtool.robot.config import Config, Contact
from idtool.robot.model import BASE_COORDINATES, RobotModel

_MAX_SAMPLES = 30_000  # of a log's longest segment, from its start, which bounds memory and time
_MIN_SECONDS = 3.0  # of standing
_CONTACT_EDGE = 0.1  # s, after each touchdown and before each lift-off, in which a foot may slip
_MIN_RANK_RATIO = 1e-3  # of the least to the largest singular value of J_base, with which feet determine its motion
_MIN_AGREEMENT = 0.8  # share of the gyroscope's power that the joints must explain
_MIN_SIGNIFICANCE = 3.0  # ratio of a difference to its standard error, from which it is one
_ERROR_BY_SOFT_FEET = 1e-3  # s, by which soft feet let the base follow the joints early or late
_BASE = len(BASE_COORDINATES)


@dataclass(frozen=True)
class ImuDelay:
    """Delay of an IMU against the joints, with its standard error [s]: what happens at t is stamped t + value."""

    value: float
    standard_error: float

    @property
    def text(self) -> str:
        """The delay with its error and unit."""
        return f"{1e3 * self.value:.2f} ± {1e3 * self.standard_error:.2f} ms"


def with_imu_delay(config: Config, model: RobotModel, logs: Sequence[JointLog]) -> tuple[Config, list[Notice]]:
    """The configuration with the estimated delay of the IMU, and notices about it.

    Parameters
    ----------
    config
        The configuration of a robot with a floating base. A delay of ``auto`` is replaced by the estimate if that
        differs from 0 by three standard errors; a number is only checked.
    model
        The tree of bodies.
    logs
        The logs, with the sensors of the base and the flags of all contacts.
    """
    delay = estimate_imu_delay(config, model, logs)
    sensor = config.base.sensor
    name = config.base.sensor_name
    present_delay = sensor.known_delay
    if delay is None:
        return config, []
    difference = abs(delay.value - present_delay)
    if difference < _MIN_SIGNIFICANCE * delay.standard_error:
        return config, []
    lag = f"it lags the joint measurements by {delay.text}"
    if sensor.delay != "auto":
        message = f"{lag}; a delay of {short_number(1e3 * present_delay)} ms is given"
        return config, [Notice("imu_delay", "warning", name, message, f"set base.{name}.delay to auto")]
    message = f"{lag}; idtool corrects it"
    corrected = config.model_copy(update={"base": config.base.with_delay(delay.value)})
    return corrected, [Notice("imu_delay", "note", name, message)]


def estimate_imu_delay(config: Config, model: RobotModel, logs: Sequence[JointLog]) -> ImuDelay | None:
    """Delay of the IMU by all logs; None if the robot does not stand in any, or hardly turns.

    Its standard error is that by noise and by soft feet.
    """
    by_log = [_delay_in_log(config, model, log) for log in logs]
    mean = _mean([delay for delay in by_log if delay is not None])
    if mean is None:
        return None
    standard_error = float(np.hypot(mean.standard_error, _ERROR_BY_SOFT_FEET))
    return replace(mean, standard_error=standard_error)


def _delay_in_log(config: Config, model: RobotModel, log: JointLog) -> ImuDelay | None:
    """Delay of the IMU in a log, with its error by noise alone; None if the log does not tell it."""
    from scipy.integrate import cumulative_trapezoid

    flagged = [contact for contact in config.contacts if _is_flagged_foot(contact, model, log)]
    if not flagged:
        return None
    feet = tuple(foot.with_unknown_wrench().model_copy(update={"widen": 0.0}) for foot in flagged)
    # orientation and gyroscope as they are stamped
    settings = config.model_copy(update={"base": config.base.with_delay(0.0), "contacts": feet})
    sensors = BaseSensors.of_log(log, model, settings)
    if sensors is None:
        return None

    longest = max(log.segments, key=lambda segment: segment.stop - segment.start)
    samples = slice(longest.start, min(longest.stop, longest.start + _MAX_SAMPLES))
    q = _positions(log, model, samples)
    J = _feet_jacobian(model, sensors, feet, log, samples, q)
    standing = _longest_run(_determines_base(J))
    if (standing.stop - standing.start) * log.dt < _MIN_SECONDS:
        return None
    q_rate = np.gradient(q, log.dt, axis=1)
    expected_rates = _base_angular_velocity(J[:, :, standing], q_rate[:, standing])
    t_standing = log.t[samples][standing]
    measured_rates = sensors.angular_velocity(t_standing)
    by_axis = []
    for measured, expected in zip(measured_rates, expected_rates, strict=True):
        angle = cumulative_trapezoid(expected, dx=log.dt, initial=0)
        match = velocity_agreement(angle, measured, log.dt)
        if match.agreement > _MIN_AGREEMENT:
            by_axis.append(ImuDelay(match.lag, match.lag_error))
    return _mean(by_axis)


def _is_flagged_foot(contact: Contact, model: RobotModel, log: JointLog) -> bool:
    """True for a contact that is on a moving link, and of which a flag in a log tells when it is closed."""
    body = model.bodies[model.frames[contact.link].body]
    if contact.flag_channel is None or body.is_base:
        return False
    return len(log.channels[contact.flag_channel].t) > 1  # the first is added, see `with_sensors`


def _positions(log: JointLog, model: RobotModel, samples: slice) -> Array:
    """Positions of all coordinates, shape (nv, N); those of the base are 0, so that all is along its axes.

    Those of wrench sensors, at which nothing moves, are 0 too.
    """
    columns = [log.joints.index(name) for name in model.joint_names]
    of_joints = log.signals["q"][samples][:, columns].T
    of_others = np.zeros((len(model.joints) - model.joint_count, of_joints.shape[1]))
    return np.concatenate([of_joints, of_others])


def _feet_jacobian(
    model: RobotModel, sensors: BaseSensors, feet: tuple[Contact, ...], log: JointLog, samples: slice, q: Array
) -> Array:
    """Jacobian of all feet, shape (k, nv, N); the rows of a foot are 0 where it is open, or has just been.

    The generalized force per unit of a contact force is also the velocity of the contact per unit of each coordinate's.
    """
    from scipy.ndimage import binary_erosion

    t = log.t[samples]
    contacts = ContactChannels(feet, log.channels, sensors).samples(t, t, lambda signal: signal)
    edge = max(round(_CONTACT_EDGE / log.dt), 1)
    is_settled = [binary_erosion(is_closed, iterations=edge) for is_closed in contacts.is_closed]
    zero = np.zeros_like(q)
    motion = Motion(
        t=log.t[samples],
        q=q,
        v=zero,
        a=zero,
        tau=zero,
        logged_tau=zero,
        velocity_deadband=np.ones(len(q)),
        dt=log.dt,
        contacts=replace(contacts, is_closed=np.stack(is_settled)),
    )
    return ContactModel(model, feet, noise=np.ones(len(q))).unknown_directions(motion)


def _determines_base(J: Array) -> Mask:
    """Mask of the samples at which closed feet determine the motion of the base, shape (N,)."""
    J_base = np.moveaxis(J[:, -_BASE:], -1, 0)  # (N, k, 6)
    if J_base.shape[1] < _BASE:
        return np.zeros(len(J_base), dtype=bool)
    singular_values = np.linalg.svd(J_base, compute_uv=False)
    return np.asarray(singular_values[:, -1] > _MIN_RANK_RATIO * singular_values[:, 0])


def _longest_run(mask: Mask) -> slice:
    """The longest run of true samples; empty without any."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))  # starts and stops by turns
    starts, stops = edges[::2], edges[1::2]
    if not len(starts):
        return slice(0, 0)
    longest = int(np.argmax(stops - starts))
    return slice(int(starts[longest]), int(stops[longest]))


def _base_angular_velocity(J: Array, q_rate: Array) -> Array:
    """Angular velocity of the base by least squares, the feet being at rest, shape (3, N) [rad/s]."""
    J_base = np.moveaxis(J[:, -_BASE:], -1, 0)  # (N, k, 6)
    J_base_transposed = J_base.transpose(0, 2, 1)
    by_joints = np.einsum("kvn,vn->nk", J[:, :-_BASE], q_rate[:-_BASE])  # velocity of the feet, the base being at rest
    gram = J_base_transposed @ J_base
    right = J_base_transposed @ by_joints[:, :, None]
    base_velocity = -np.linalg.solve(gram, right)[:, :, 0]
    return np.asarray(base_velocity[:, 3:].T)


def _mean(delays: Sequence[ImuDelay]) -> ImuDelay | None:
    """Mean of several estimates, weighted by their standard errors; None without any."""
    if not delays:
        return None
    weights = np.array([delay.standard_error**-2 for delay in delays])
    value = float(np.average([delay.value for delay in delays], weights=weights))
    return ImuDelay(value, float(weights.sum() ** -0.5))

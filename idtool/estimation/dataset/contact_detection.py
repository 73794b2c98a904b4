"""Contacts by the torque of a leg's own joints: where no flag was logged, and as a check of those that were.

The joints of a leg carry the force on its foot: −F = (J Jᵀ)⁻¹ J (tau − Y pi), with the original URDF's pi. Links that
are a third too heavy, or dry friction that the URDF lacks, are worth a few newtons, so that a force of a twentieth of
the weight tells a contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.base_sensors import base_sensors
from idtool.data.logs.log import Channel, JointLog
from idtool.data.signals import Batch, Signals
from idtool.dynamics.contact_forces import ContactForces
from idtool.robot.config import Config, Contact
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import RobotModel

_CLOSED = 0.05  # of the weight, from which a force tells a contact
_LOADED = 0.15  # of the weight, from which a force without a flag is no error of the URDF
_MAX_LOADED_SHARE = 0.02  # of the time, that a foot may be loaded without a flag
_MAX_UNLOADED_SHARE = 0.3  # of the time, that a foot may have its flag without a load
_ALWAYS = 0.98  # share of the time, from which a flag is always set
_JOINTS = 3  # of a leg, that tell the force on its foot


@dataclass(frozen=True)
class FootForces:
    """Size of the forces on some feet by the torque of their legs.

    Attributes
    ----------
    contacts
        The feet.
    t
        Times [s], shape (N,).
    size
        Shape (feet, N) [N].
    """

    contacts: tuple[Contact, ...]
    t: Array
    size: Array


def foot_forces(signals: Signals, model: RobotModel, contacts: Sequence[Contact]) -> FootForces:
    """Forces on the feet of a robot in a log.

    Parameters
    ----------
    signals
        The log.
    model
        The tree of bodies, with the parameters of the URDF.
    contacts
        All contacts of the robot; those on links that fewer than three joints move are left out.
    """
    feet = tuple(contact for contact in contacts if is_detectable(contact, model))
    unconditional = tuple(contact.model_copy(update={"flag": None, "force": None, "moment": None}) for contact in feet)
    forces = ContactForces(model, unconditional, np.ones(len(model.joints)))
    pi = np.stack([body.pi for body in model.bodies])
    times = [np.zeros(0)]
    sizes = [np.zeros((len(feet), 0))]
    for batch in signals.batches():
        t, size = _forces_in_batch(batch, model, pi, forces)
        times.append(t)
        sizes.append(size)
    return FootForces(feet, np.concatenate(times), np.concatenate(sizes, axis=1))


def with_detected_contacts(log: JointLog, model: RobotModel, config: Config) -> JointLog:
    """The log with a flag for every contact whose flag is ``auto``, and with notices about flags.

    Parameters
    ----------
    log
        The log, with the sensors of the base.
    model
        The tree of bodies.
    config
        The configuration.
    """
    if not any(contact.flag is not None and is_detectable(contact, model) for contact in config.contacts):
        return log
    signals = Signals(log, model.joint_names, config, base_sensors(log, model, config))
    found = foot_forces(signals, model, config.contacts)
    if not len(found.t):  # too short; what reads it next says so
        return log
    weight = 9.81 * sum(float(body.pi[0]) for body in model.bodies)
    channels = dict(log.channels)
    closed = []
    notices = []
    for contact, size in zip(found.contacts, found.size, strict=True):
        if contact.is_detected:
            flag = size > _CLOSED * weight
            channels[str(contact.flag_channel)] = Channel(found.t + log.start, flag.astype(float))
            closed.append(f"{contact.name} for {100 * flag.mean():.0f} %")
        elif contact.flag is not None:
            notices += _flag_findings(contact, log.channels[contact.flag], found.t + log.start, size / weight)
    if closed:
        message = f"contacts were detected by the torque of the legs; they are closed {join_names(closed)} of the time"
        advice = "log the contact flags or the foot forces if the robot has them"
        notices.append(Notice("contacts_detected", "note", None, message, advice))
    return replace(log, channels=channels, notices=(*log.notices, *notices))


def is_detectable(contact: Contact, model: RobotModel) -> bool:
    """True for a point on a link that at least three joints move, whose torque tells the force."""
    body = model.frames[contact.link].body
    joints = model.support()[body, : model.joint_count].sum()
    return contact.kind == "point" and joints >= _JOINTS


def _forces_in_batch(batch: Batch, model: RobotModel, pi: Array, forces: ContactForces) -> tuple[Array, Array]:
    """Times of the filtered samples, shape (n,), and size of the force on each foot, shape (feet, n)."""
    motion = batch.motion
    unexplained = batch.filter(motion.tau - inverse_dynamics(model, pi, motion.q, motion.v, motion.a))
    inner = slice(batch.before, len(motion.t) - batch.after, batch.low_pass.stride)
    directions = forces.unknown_directions(motion, are_all_closed=True)[:, : model.joint_count, inner]
    sizes = []
    for foot in range(len(forces.contacts)):
        J = np.moveaxis(directions[3 * foot : 3 * foot + 3], -1, 0)  # (n, 3, joints)
        of_leg = J @ unexplained[: model.joint_count].T[:, :, None]
        gram = J @ J.transpose(0, 2, 1)
        gram += 1e-9 * np.eye(3)  # a straight leg
        sizes.append(np.linalg.norm(np.linalg.solve(gram, of_leg)[:, :, 0], axis=1))
    return batch.t, np.array(sizes)


def _flag_findings(contact: Contact, flag: Channel, t: Array, load: Array) -> list[Notice]:
    """Notices about a flag that is always set, or not set under load; ``load`` is a share of the weight, shape (N,)."""
    is_set = flag.latest(t) > 0.5
    is_widened = (flag.latest(t - contact.widen) > 0.5) | (flag.latest(t + contact.widen) > 0.5) | is_set
    if is_set.mean() > _ALWAYS and (load < _CLOSED).mean() > _MAX_UNLOADED_SHARE:
        unloaded = f"{100 * (load < _CLOSED).mean():.0f} % of the time, its leg carries no load"
        message = f"the flag is always set, but {unloaded}: this costs accuracy"
        return [Notice("contact_always_closed", "warning", contact.name, message, "log when the foot is on the ground")]
    loaded_share = float((~is_widened & (load > _LOADED)).mean())
    if loaded_share > _MAX_LOADED_SHARE:
        message = f"{100 * loaded_share:.0f} % of the time, its leg carries a load while the flag is not set"
        advice = "lower the threshold of the flag, check its sign and its time, or set flag: auto"
        return [Notice("contact_without_flag", "warning", contact.name, message, advice)]
    return []

"""Detects the contacts of feet by the torque of their legs, where no flag was logged, and checks flags that were.

A force F on a foot changes the torque of its leg's joints by −Jᵀ F, with the foot's Jacobian J, shape (3, joints). So
F = −(J Jᵀ)⁻¹ J e, where e is the measured torque less that of the original URDF's inverse dynamics. Links that are a
third too heavy, or friction that the URDF lacks, are worth a few hundredths of the robot's weight; more tells a
contact. Near a posture in which J is singular, as with a straight leg, small errors of the torque make large forces:
such samples say nothing against a flag.

A contact on the base whose flag is ``auto``, such as a rope, is closed while no other contact carries the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.base_sensors import BaseSensors
from idtool.data.contact_channels import ContactChannels
from idtool.data.logs.log import Channel, JointLog
from idtool.data.signals import Batch, Signals
from idtool.data.wrench_channels import WrenchChannels
from idtool.dynamics.contact_model import ContactModel
from idtool.robot.config import Config, Contact
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import RobotModel

_MIN_CONTACT_LOAD = 0.05  # of the weight, from which a force tells a contact
_MIN_UNFLAGGED_LOAD = 0.15  # of the weight, from which a force without a flag is more than an error of the URDF
_MAX_UNFLAGGED_SHARE = 0.02  # of the time, for such a load
_MAX_UNLOADED_SHARE = 0.3  # of the time, for a flag that is always set while the leg carries no load
_MIN_ALWAYS_SHARE = 0.98  # of the time, from which a flag is always set
_MIN_CARRIED_SHARE = 0.3  # of the weight, from which feet whose forces are known carry the robot
_MIN_LEG_JOINTS = 3  # that determine the force on a foot
_MIN_CARRIED, _MAX_CARRIED = 0.5, 2.0  # of the weight, by the torque: beyond what wrong masses in a URDF account for
_NO_LOAD = 0.1  # of the weight: the robot hangs from something that the configuration does not know
_MIN_SUPPORTED_SAMPLES = 40
_MIN_GRAM = 1e-9  # m², added to J Jᵀ, which is singular for a straight leg
_MIN_SINGULAR_RATIO = 0.15  # smallest over largest singular value of J, from which the torque tells the force


@dataclass(frozen=True)
class FootLoads:
    """Sizes of the forces on some feet by the torque of their legs, in units of the robot's weight.

    Attributes
    ----------
    feet
        The feet.
    t
        Times by the log's stamps [s], shape (N,).
    load
        Force over weight, shape (feet, N).
    vertical_load
        Its upward part, shape (feet, N).
    is_reliable
        True where the leg's posture lets its torque tell the force, shape (feet, N).
    """

    feet: tuple[Contact, ...]
    t: Array
    load: Array
    vertical_load: Array
    is_reliable: Mask


def with_detected_contacts(log: JointLog, model: RobotModel, config: Config) -> JointLog:
    """The log with a flag for every contact whose flag is ``auto``, and with notices about all flags of feet.

    Parameters
    ----------
    log
        The log, with the sensors of the base.
    model
        The tree of bodies, with the parameters of the URDF.
    config
        The configuration, whose contacts with the flag ``auto`` are feet for `is_foot`, or on the base.

    Raises
    ------
    LogError
        If a contact has the flag ``auto``, but a joint of its leg has no torque.
    """
    flagged = [contact for contact in config.contacts if contact.flag is not None and is_foot(contact, model)]
    feet = [foot for foot in flagged if _torque_is_known(foot, log, model)]
    loads = foot_loads(log, model, config, feet) if feet else None
    if loads is not None:
        log = _with_detected_feet(log, loads)
    supports = [contact for contact in config.contacts if is_support(contact, model)]
    if supports:
        log = _with_detected_supports(log, model, config, supports, loads)
    torque_notice = _torque_notice(loads, log, model, config) if loads is not None else None
    return log if torque_notice is None else replace(log, notices=(*log.notices, torque_notice))


def _with_detected_feet(log: JointLog, loads: FootLoads) -> JointLog:
    """The log with a flag for every foot whose flag is ``auto``, and with notices about all flags of feet."""
    channels = dict(log.channels)
    notices = []
    shares = []
    for foot, load, is_reliable in zip(loads.feet, loads.load, loads.is_reliable, strict=True):
        if foot.has_automatic_flag:
            is_loaded = load > _MIN_CONTACT_LOAD
            channels[str(foot.flag_channel)] = Channel(loads.t, is_loaded.astype(float))
            shares.append(f"{foot.name} {100 * is_loaded.mean():.0f} %")
            continue
        notice = _flag_notice(foot, log.channels[str(foot.flag_channel)], loads.t, load, is_reliable)
        if notice is not None:
            notices.append(notice)
    if shares:
        message = f"contacts were detected from the leg torques; fraction of the time closed: {join_names(shares)}"
        advice = "log the contact flags or the foot forces if the robot has them"
        notices.append(Notice("contacts_detected", "note", None, message, advice))
    return replace(log, channels=channels, notices=(*log.notices, *notices))


def _torque_notice(loads: FootLoads, log: JointLog, model: RobotModel, config: Config) -> Notice | None:
    """Notice about torques of the wrong sign or scale, by which the feet do not carry the robot's weight; else None.

    On average, the feet carry the weight while nothing else holds the robot.
    """
    others = [contact for contact in config.contacts if contact not in loads.feet]
    if any(contact.flag_channel is None for contact in others):  # it may act at any time
        return None
    is_supported = loads.is_reliable.all(axis=0)
    for contact in others:
        is_supported &= ~log.channels[str(contact.flag_channel)].is_set(loads.t, contact.widen)
    for foot in loads.feet:
        if not foot.has_automatic_flag and not log.channels[str(foot.flag_channel)].is_set(loads.t).any():
            return None
    if is_supported.sum() < _MIN_SUPPORTED_SAMPLES:
        return None
    carried = float(loads.vertical_load[:, is_supported].sum(axis=0).mean())
    if carried < -_NO_LOAD:
        what = (
            f"the leg torques imply that the feet pull on the ground with {short_number(-carried, 2)} times "
            "the robot's weight"
        )
        return Notice("torque_sign", "problem", "tau", what, "reverse the sign of the torque (log.scale)")
    if _MIN_CARRIED <= carried <= _MAX_CARRIED or carried <= _NO_LOAD:
        return None
    what = f"the leg torques imply that the feet carry {short_number(carried, 2)} times the robot's weight"
    advice = "check the scale of the torque (log.scale: N·m at the joint output per logged unit) and the URDF's masses"
    if carried < _MIN_CARRIED:
        advice += "; if something else holds the robot, add a contact for it"
    return Notice("torque_scale", "warning", "tau", what, advice)


def _with_detected_supports(
    log: JointLog, model: RobotModel, config: Config, supports: Sequence[Contact], loads: FootLoads | None
) -> JointLog:
    """The log with a flag for every contact that holds the base while no other contact carries the robot."""
    from scipy.ndimage import binary_propagation

    others = [contact for contact in config.contacts if contact not in supports]
    carriers = flag_channels([contact for contact in others if not contact.has_automatic_flag], log)
    carriers += measured_loads(others, log, model)
    if loads is not None:
        detected = [load for foot, load in zip(loads.feet, loads.load, strict=True) if foot.has_automatic_flag]
        if detected:  # their sum, since errors of one leg may pass for a contact
            is_carried = np.sum(detected, axis=0) > _MIN_CARRIED_SHARE
            carriers.append(Channel(loads.t, is_carried.astype(float)))
    t = np.concatenate([log.t[segment] for segment in log.segments])
    channels = dict(log.channels)
    notices = []
    for support in supports:
        is_held = ~is_any_set(carriers, t)
        is_held_for_long = ~is_any_set(carriers, t, support.widen)
        is_closed = binary_propagation(is_held_for_long, mask=is_held)  # not in steps and short flights
        channels[str(support.flag_channel)] = Channel(t, is_closed.astype(float))
        if is_closed.any():
            share = f"{100 * is_closed.mean():.0f} % of the time"
            message = f"contact {support.name} counts as closed while no other contact is: {share}"
            notices.append(Notice("support_detected", "note", None, message))
    return replace(log, channels=channels, notices=(*log.notices, *notices))


def flag_channels(contacts: Sequence[Contact], log: JointLog) -> list[Channel]:
    """Flags of the contacts that have one in a log."""
    return [log.channels[contact.flag_channel] for contact in contacts if contact.flag_channel is not None]


def measured_loads(contacts: Sequence[Contact], log: JointLog, model: RobotModel) -> list[Channel]:
    """For each contact with a measured force and without a flag, where it carries a share of the robot's weight."""
    channels = []
    for contact in contacts:
        if contact.force is None or contact.flag is not None:
            continue
        t = log.channels[contact.force[0]].t
        force = np.stack([log.channels[name].at(t) for name in contact.force])
        is_loaded = np.linalg.norm(force, axis=0) > _MIN_CONTACT_LOAD * STANDARD_GRAVITY * model.mass
        channels.append(Channel(t, is_loaded.astype(float)))
    return channels


def is_any_set(flags: Sequence[Channel], t: Array, widen: float = 0.0) -> Mask:
    """True at times [s], shape (N,), at which one of some flags is set; ``widen`` as for `Channel.is_set`."""
    is_set = np.zeros(len(t), dtype=bool)
    for flag in flags:
        is_set |= flag.is_set(t, widen)
    return is_set


def _torque_is_known(foot: Contact, log: JointLog, model: RobotModel) -> bool:
    """True if a log has the torque of all joints of a leg; LogError if it does not, but tells the foot's flag."""
    unknown = [name for name in _leg_joints(foot, model) if name in log.unknown_torque]
    if unknown and foot.has_automatic_flag:
        what = f"has no torque of {join_names(unknown)}, which the flag auto of contact {foot.name} needs"
        raise LogError(log.path, f"{what}; log the torque, or name the channel of a flag")
    return not unknown


def _leg_joints(contact: Contact, model: RobotModel) -> list[str]:
    """Joints that move the link of a contact."""
    moves = model.support()[model.frames[contact.link].body]
    return [name for j, name in enumerate(model.joint_names) if moves[j]]


def is_foot(contact: Contact, model: RobotModel) -> bool:
    """True for a point on a link that at least three joints move, whose torque tells the force."""
    return contact.kind == "point" and len(_leg_joints(contact, model)) >= _MIN_LEG_JOINTS


def is_support(contact: Contact, model: RobotModel) -> bool:
    """True for a contact on the base whose flag is ``auto``: it is closed while no other contact carries the robot."""
    return contact.has_automatic_flag and model.bodies[model.frames[contact.link].body].is_base


def foot_loads(log: JointLog, model: RobotModel, config: Config, feet: Sequence[Contact]) -> FootLoads:
    """Loads of some feet in a log, by the torque of their legs.

    Parameters
    ----------
    log
        The log, with the sensors of the base.
    model
        The tree of bodies, with the parameters of the URDF.
    config
        The configuration.
    feet
        The feet, whose flags and measured forces do not count.
    """
    always_unknown = tuple(foot.with_unknown_wrench().model_copy(update={"flag": None}) for foot in feet)
    settings = config.model_copy(update={"contacts": always_unknown})
    base_sensors = BaseSensors.of_log(log, model, settings)
    wrench_channels = WrenchChannels.of_log(log, model, settings)
    contact_channels = ContactChannels.of_log(log, settings, base_sensors)
    signals = Signals(log, model.joint_names, settings, base_sensors, wrench_channels, contact_channels)
    contact_model = ContactModel(model, always_unknown, noise=np.ones(len(model.joints)))
    times = []
    forces = []
    vertical_forces = []
    is_reliable = []
    for batch in signals.batches():
        force, vertical_force, is_reliable_force = _foot_forces(batch, model, contact_model)
        times.append(log.start + batch.t)
        forces.append(force)
        vertical_forces.append(vertical_force)
        is_reliable.append(is_reliable_force)
    if not times:  # too short for the filter, which the fit says; then all feet count as loaded
        shape = (len(feet), 1)
        ones = np.ones(shape)
        return FootLoads(tuple(feet), np.array([log.start]), ones, ones, np.zeros(shape, dtype=bool))
    weight = STANDARD_GRAVITY * model.mass
    return FootLoads(
        feet=tuple(feet),
        t=np.concatenate(times),
        load=np.concatenate(forces, axis=1) / weight,
        vertical_load=np.concatenate(vertical_forces, axis=1) / weight,
        is_reliable=np.concatenate(is_reliable, axis=1),
    )


def _foot_forces(batch: Batch, model: RobotModel, contact_model: ContactModel) -> tuple[Array, Array, Mask]:
    """Forces on the feet at a batch's filtered samples by the torque of their legs.

    Returns
    -------
    Their sizes, their upward parts [N], and where they are reliable; shape (feet, n) each.
    """
    motion = batch.motion
    pi = np.stack([body.pi for body in model.bodies])
    by_urdf = inverse_dynamics(model, pi, motion.q, motion.v, motion.a)
    unexplained = batch.filter(motion.tau - by_urdf)[: model.joint_count]
    unexplained_columns = unexplained.T[:, :, None]  # (n, joints, 1)
    directions = batch.at_filtered_samples(contact_model.unknown_directions(motion))
    by_joints = directions[:, : model.joint_count]
    forces = []
    vertical_forces = []
    is_reliable = []
    for foot, contact in enumerate(contact_model.contacts):
        components = slice(3 * foot, 3 * foot + 3)
        J = np.moveaxis(by_joints[components], -1, 0)  # (n, 3, joints)
        gram = J @ J.transpose(0, 2, 1)
        smallest, _, largest = np.linalg.eigvalsh(gram).T  # squares of the singular values of J
        is_reliable.append(smallest > _MIN_SINGULAR_RATIO**2 * largest)
        force = -np.linalg.solve(gram + _MIN_GRAM * np.eye(3), J @ unexplained_columns)[:, :, 0]
        forces.append(np.linalg.norm(force, axis=1))
        up = np.broadcast_to(contact_model.up_of(contact, motion), (3, len(motion.t)))
        vertical_forces.append(np.einsum("ni,in->n", force, batch.at_filtered_samples(up)))
    return np.array(forces), np.array(vertical_forces), np.array(is_reliable)


def _flag_notice(foot: Contact, flag: Channel, t: Array, load: Array, is_reliable: Mask) -> Notice | None:
    """Notice about a foot's flag that is always set, or not set under load; None if it fits the load, shape (N,)."""
    set_share = flag.is_set(t).mean()
    unloaded_share = ((load < _MIN_CONTACT_LOAD) & is_reliable).mean()
    if set_share > _MIN_ALWAYS_SHARE and unloaded_share > _MAX_UNLOADED_SHARE:
        message = (
            f"the flag is always set, but its leg carries no load {100 * unloaded_share:.0f} % of the time: this costs "
            "accuracy"
        )
        return Notice("contact_always_closed", "warning", foot.name, message, "log when the foot is on the ground")
    is_unflagged_load = (load > _MIN_UNFLAGGED_LOAD) & is_reliable & ~flag.is_set(t, foot.widen)
    unflagged_share = is_unflagged_load.mean()
    if unflagged_share > _MAX_UNFLAGGED_SHARE:
        message = f"{100 * unflagged_share:.0f} % of the time, its leg carries a load while the flag is not set"
        advice = "lower the threshold of the flag, check its sign and its time, or set flag: auto"
        return Notice("contact_without_flag", "warning", foot.name, message, advice)
    return None

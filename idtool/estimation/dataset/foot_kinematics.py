"""`FootMotion`: motion of the points of contact of a robot's feet, by joints and gyroscope alone.

With the velocity v of the base's origin, which is not known, and its angular velocity w, the material point of foot i
at the ground has the velocity v + w × pᵢ + Jᵢ dq/dt. A ball rolls: its point of contact is a radius below its centre,
and turns with the foot. All points of feet that are on the ground and do not slip have the velocity 0, so that the
velocities with v = 0 agree among them.

Shapes: N samples, nv coordinates. Everything is along the axes of the base.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.base_sensors import PoseSensors
from idtool.data.contact_channels import ContactSamples
from idtool.data.logs.log import JointLog
from idtool.data.signals import Batch, Signals
from idtool.dynamics.contact_model import ContactModel, contacts_of
from idtool.robot.config import Contact
from idtool.robot.model import RobotModel

_MIN_WEIGHT_SHARE = 0.05  # of the robot's weight, from which a measured force tells that a foot is on the ground
_MAX_SECONDS = 60.0  # of a stretch


@dataclass(frozen=True)
class FootMotion:
    """Motion of the feet in a stretch without gaps.

    Attributes
    ----------
    t
        Times by the log's stamps [s], shape (N,), at least two, evenly spaced.
    by_joints
        Velocity of each point of contact by the joints alone, as if the base stood still, shape (feet, 3, N) [m/s].
    position
        Place of each point of contact, shape (feet, 3, N) [m].
    angular_velocity
        That of the base by the gyroscope, shape (3, N) [rad/s].
    is_closed
        True where a foot is on the ground, shape (feet, N).
    base_velocity
        Velocity of the base's origin by its pose, shape (3, N) [m/s]; None without one.
    """

    t: Array
    by_joints: Array
    position: Array
    angular_velocity: Array
    is_closed: Mask
    base_velocity: Array | None = None

    @property
    def dt(self) -> float:
        """Time between samples [s]."""
        return float(self.t[1] - self.t[0])

    @property
    def velocity(self) -> Array:
        """Velocity of each point of contact less that of the base's origin, shape (feet, 3, N) [m/s]."""
        return self.by_joints + np.cross(self.angular_velocity[None], self.position, axis=1)

    def average(self, x: Array, window: float) -> Array:
        """Moving average of samples, shape (…, N), over a window [s]."""
        from scipy.ndimage import uniform_filter1d

        return np.asarray(uniform_filter1d(x, max(round(window / self.dt), 1), axis=-1))

    def settled(self, margin: float) -> Mask:
        """True where a foot has been on the ground for a time [s], and will be for as long; shape (feet, N).

        While a foot touches down or lifts off, it scuffs, and what is soft of it deforms.
        """
        from scipy.ndimage import binary_erosion

        samples = max(int(np.ceil(margin / self.dt)), 1)
        return np.stack([binary_erosion(is_closed, iterations=samples) for is_closed in self.is_closed])


def without_mean(x: Array, weights: Array) -> Array:
    """Vectors of the feet less their mean over those with the weight 1; 0 for those with the weight 0.

    Parameters
    ----------
    x
        Shape (feet, …, N).
    weights
        0 or 1, shape (feet, N).

    Returns
    -------
    The same shape as x.
    """
    axes_between = (1,) * (x.ndim - 2)
    w = weights.reshape(len(weights), *axes_between, -1)
    mean = (x * w).sum(axis=0) / np.maximum(w.sum(axis=0), 1.0)
    return np.asarray((x - mean) * w)


def flagged_feet(contacts: Sequence[Contact], model: RobotModel, log: JointLog) -> tuple[Contact, ...]:
    """Contacts on links that the joints move, of which a flag or a force in a log tells when they are closed."""
    return tuple(contact for contact in contacts if _is_flagged_foot(contact, model, log))


def foot_motions(
    signals: Signals, model: RobotModel, feet: Sequence[Contact], pose: PoseSensors | None = None
) -> Iterator[FootMotion]:
    """Motion of some feet in each stretch of a log that has more than one sample.

    Parameters
    ----------
    signals
        The log, with the sensors of a floating base.
    model
        The tree of bodies.
    feet
        The feet, from `flagged_feet`.
    pose
        Pose of the base, which its velocity follows from; None: it is not known.
    """
    # of a foot that lies flat, the motion of its point tells as much
    points = tuple(foot.with_unknown_wrench().model_copy(update={"flag": None, "kind": "point"}) for foot in feet)
    contact_model = ContactModel(model, points, noise=np.ones(len(model.joints)))
    for part in _short_parts(signals.ranges, round(_MAX_SECONDS / signals.log.dt)):
        pieces = [_motion_in_batch(batch, signals.log, model, feet, contact_model) for batch in signals.batches([part])]
        if sum(len(piece.t) for piece in pieces) < 2:
            continue
        motion = _joined(pieces)
        yield motion if pose is None else replace(motion, base_velocity=pose.linear_velocity(motion.t))


def _joined(pieces: Sequence[FootMotion]) -> FootMotion:
    """Motion in consecutive batches as one, without the base's velocity."""
    return FootMotion(
        t=np.concatenate([piece.t for piece in pieces]),
        by_joints=np.concatenate([piece.by_joints for piece in pieces], axis=-1),
        position=np.concatenate([piece.position for piece in pieces], axis=-1),
        angular_velocity=np.concatenate([piece.angular_velocity for piece in pieces], axis=-1),
        is_closed=np.concatenate([piece.is_closed for piece in pieces], axis=-1),
    )


def _short_parts(ranges: Sequence[slice], length: int) -> Iterator[slice]:
    """The ranges, those that are longer cut into parts of a length, which bounds memory."""
    for samples in ranges:
        for start in range(samples.start, samples.stop, length):
            yield slice(start, min(start + length, samples.stop))


def _motion_in_batch(
    batch: Batch, log: JointLog, model: RobotModel, feet: Sequence[Contact], contact_model: ContactModel
) -> FootMotion:
    """Motion of the feet at the filtered samples of a batch."""
    q = batch.filter(batch.motion.q)
    v = batch.filter(batch.motion.v)
    world_to_base = batch.at_filtered_samples(contacts_of(batch.motion).world_to_base)
    count = q.shape[1]
    always_closed = np.ones((len(feet), count), dtype=bool)
    contacts = ContactSamples(world_to_base, always_closed, np.zeros((len(feet), 6, count)))
    at_filtered_samples = replace(batch.motion, q=q, v=v, contacts=contacts)
    # the generalized force per unit of a contact force is also the velocity of the contact per unit of a coordinate's
    J = contact_model.unknown_directions(at_filtered_samples).reshape(len(feet), 3, len(q), count)
    base = model.base_coordinates
    base_to_foot = J[:, :, base][:, :, :3]  # which the velocity of the base's origin goes through
    J_in_base = np.einsum("fijn,ficn->fjcn", base_to_foot, J)
    by_joints = np.einsum("fjcn,cn->fjn", J_in_base[:, :, : model.joint_count], v[: model.joint_count])
    by_turning = J_in_base[:, :, base][:, :, 3:]  # column k: unit vector k × position
    position = np.stack([by_turning[:, 1, 2], by_turning[:, 2, 0], by_turning[:, 0, 1]], axis=1)
    t = log.start + batch.t
    is_closed = np.stack([_is_closed(foot, model, log, t) for foot in feet])
    return FootMotion(t, by_joints, position, v[base][3:], is_closed)


def _is_flagged_foot(contact: Contact, model: RobotModel, log: JointLog) -> bool:
    if model.bodies[model.frames[contact.link].body].is_base:
        return False
    if contact.flag_channel is None:
        return contact.is_measured
    return len(log.channels[contact.flag_channel].t) > 1  # the first is added, see `with_sensors`


def _is_closed(foot: Contact, model: RobotModel, log: JointLog, t: Array) -> Mask:
    """True where a foot is on the ground, by its flag as it was logged, or by its measured force."""
    if foot.flag_channel is not None:
        return log.channels[foot.flag_channel].is_set(t)
    force = np.stack([log.channels[name].at(t) for name in foot.force or ()])
    least = _MIN_WEIGHT_SHARE * STANDARD_GRAVITY * model.mass
    return np.asarray(np.linalg.norm(force, axis=0) > least)

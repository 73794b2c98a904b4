"""`ContactModel`: contacts in the equation of motion of a robot.

Its nv rows are those of the joints and, with a floating base, the six of the base after them; it is linear in the
parameters pi:

    Y pi = [tau; 0] + Σ Jᵢᵀ Fᵢ  (1)

A measured wrench F is a known generalized force Jᵀ F, which is added to tau. An unknown one is eliminated. Let W whiten
the rows: their noise has unit variance, and is uncorrelated. Let P be the orthogonal projector onto what no unknown
contact force exerts in them. Then P W Jᵀ = 0, so that P W Y pi = P W tau holds whatever the unknown forces are. Least
squares on these rows is generalized least squares on (1) with the forces as free unknowns at every sample (theorem of
Frisch, Waugh and Lovell).

Without correlation, W divides every row by the standard deviation of its noise. With the correlation R, the quotients
are multiplied by R^(-1/2): of all whitening matrices, this one changes the rows least (Kessy, Lewin & Strimmer 2018,
ZCA-cor).

The dry friction of a joint at rest is unknown too. It acts on the joint's own row alone, and is eliminated likewise.

P varies with time, and so it does not commute with a filter. It is applied at every sample, before the low-pass.

Shapes: nv generalized coordinates, N samples, k components of unknown contact forces, c coordinates that move a body.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.column_cache import IdentityKey
from idtool.data.contact_channels import ContactSamples
from idtool.data.signals import Motion
from idtool.robot.config import Contact
from idtool.robot.kinematics import BodyJacobian, BodyMotion, body_motions, cross, jacobians_of, rotate
from idtool.robot.model import RobotModel

# Added to the diagonal of the Gram matrix of unit vectors, which is singular where some combination of contact forces
# exerts nothing.
_RIDGE = 1e-11
_MIN_WEIGHT_SHARE = 0.02  # of the robot's weight: a smaller measured force is noise
_MIN_ARM = 0.1  # m, at which such a force makes the smallest moment that is more than noise
_MAX_FRICTION = 2.0  # coefficient of friction; where a leg is straight, its torque does not tell the force
_MIN_FORCE = 1e-9  # N


@dataclass(frozen=True)
class ContactModel:
    """Generalized forces of a robot's contacts: of the measured wrenches, and of all that unknown ones can exert.

    Attributes
    ----------
    model
        The tree of bodies.
    contacts
        The contacts, in the order of those in `ContactSamples`.
    noise
        Standard deviation of the noise of each row of (1), above 0, shape (nv,) [N or N·m].
    correlation
        Of the noise of the rows, positive definite, shape (nv, nv); None: rows count as uncorrelated.
    """

    model: RobotModel
    contacts: tuple[Contact, ...]
    noise: Array
    correlation: Array | None = None

    def with_noise(self, noise: Array) -> ContactModel:
        """A copy with other noise of the rows, shape (nv,)."""
        return replace(self, noise=noise)

    def with_correlation(self, correlation: Array) -> ContactModel:
        """A copy with another correlation of the rows' noise, shape (nv, nv)."""
        return replace(self, correlation=correlation)

    @cached_property
    def _decorrelation(self) -> Array:
        """Symmetric inverse square root of the correlation, shape (nv, nv)."""
        if self.correlation is None:
            return np.eye(len(self.noise))
        eigenvalues, eigenvectors = np.linalg.eigh(self.correlation)
        return np.asarray((eigenvectors / np.sqrt(eigenvalues)) @ eigenvectors.T)

    def acts_on_joints(self, contact_samples: ContactSamples) -> Mask:
        """True where a contact force acts on a link that the joints move, shape (N,); not for less than noise."""
        acts = np.zeros(contact_samples.is_closed.shape[1], dtype=bool)
        least = _MIN_WEIGHT_SHARE * STANDARD_GRAVITY * self.model.mass
        for i, contact in enumerate(self.contacts):
            if self.model.bodies[self.model.frames[contact.link].body].is_base:
                continue
            is_loaded = contact_samples.is_closed[i]
            if contact.is_measured:
                force, moment = np.linalg.norm(contact_samples.wrenches[i].reshape(2, 3, -1), axis=1)
                is_loaded = is_loaded & ((force > least) | (moment > _MIN_ARM * least))
            acts |= is_loaded
        return acts

    def measured_force(self, motion: Motion) -> Array:
        """Generalized force of the measured wrenches, which is added to tau, shape (nv, N) [N or N·m].

        It is 0 for a motion that is of no log, and so has no contacts.
        """
        generalized_force = np.zeros_like(motion.tau)
        measured = [i for i, contact in enumerate(self.contacts) if contact.is_measured]
        if not measured or motion.contacts is None:
            return generalized_force
        contact_samples = motion.contacts
        motions, jacobians = self._kinematics(motion)
        for i in measured:
            contact = self.contacts[i]
            body = self.model.frames[contact.link].body
            to_body = self._wrench_to_body(contact, motions, contact_samples)
            force = rotate(to_body, contact_samples.wrenches[i, :3])
            moment = rotate(to_body, contact_samples.wrenches[i, 3:])
            J_linear, J_angular = self._contact_jacobian(contact, jacobians[body], motions, contact_samples)
            of_force = np.einsum("icn,in->cn", J_linear, force)
            of_moment = np.einsum("icn,in->cn", J_angular, moment)
            generalized_force[jacobians[body].coordinates] += of_force + of_moment
        return generalized_force

    def projector(self, motion: Motion, unknown_friction: Mapping[int, Mask]) -> Array:
        """Orthogonal projector P onto what neither unknown contact forces nor unknown friction exert.

        Parameters
        ----------
        motion
            N samples, with their contacts.
        unknown_friction
            Row of a joint → samples at which its friction is unknown, shape (N,).

        Returns
        -------
        Shape (N, nv, nv), for whitened rows.
        """
        projector = self._projector_off_friction(unknown_friction, motion.q.shape[1])
        directions = self.unknown_directions(motion)
        for exerted, samples in _exerted_together(directions):
            off_friction = projector[samples]
            whitened = self._whitened(directions[exerted][:, :, samples])
            unit, _ = _unit_directions(whitened @ off_friction)
            onto_contacts = unit.transpose(0, 2, 1) @ np.linalg.solve(_gram(unit), unit)
            projector[samples] = off_friction - onto_contacts
        return projector

    def _projector_off_friction(self, unknown_friction: Mapping[int, Mask], count: int) -> Array:
        """Orthogonal projector onto what unknown friction of joints does not exert, shape (N, nv, nv)."""
        nv = len(self.noise)
        is_unknown = np.zeros((nv, count), dtype=bool)
        for joint, mask in unknown_friction.items():
            is_unknown[joint] = mask
        projector = np.empty((count, nv, nv))
        for joints, samples in _samples_by_column(is_unknown):
            Q, _ = np.linalg.qr(self._decorrelation[:, joints])
            projector[samples] = np.eye(nv) - Q @ Q.T
        return projector

    def _whitened(self, rows: Array) -> Array:
        """Whitened rows by sample, from shape (k, nv, N) to (N, k, nv)."""
        by_sample = np.moveaxis(rows, -1, 0)
        in_units_of_noise = by_sample / self.noise
        return in_units_of_noise if self.correlation is None else in_units_of_noise @ self._decorrelation

    def unknown_forces(self, directions: Array, residual: Array) -> Array:
        """Components of the unknown contact forces that explain most of a residual, shape (k, N) [N or N·m].

        Parameters
        ----------
        directions
            From `unknown_directions`, shape (k, nv, N).
        residual
            Torque less Y pi, shape (nv, N).
        """
        forces = np.zeros((len(directions), residual.shape[1]))
        for exerted, samples in _exerted_together(directions):
            unit, length = _unit_directions(self._whitened(directions[exerted][:, :, samples]))
            whitened = self._whitened(residual[None, :, samples]).transpose(0, 2, 1)
            along_unit = np.linalg.solve(_gram(unit), unit @ whitened)[:, :, 0]
            forces[exerted[:, None], samples] = -(along_unit / length[:, :, 0]).T
        return forces

    def gains(self, projector: Array) -> Array:
        """Matrices that take rows of (1) to rows without what unknown forces can exert, shape (N, nv, nv).

        The rows are whitened, projected, and multiplied by their noise, so that they are in N or N·m again.

        Parameters
        ----------
        projector
            From `projector`, shape (N, nv, nv).
        """
        of_whitened = projector if self.correlation is None else projector @ self._decorrelation
        return np.asarray(of_whitened * (self.noise[:, None] / self.noise))

    def unknown_directions(self, motion: Motion) -> Array:
        """Generalized force per unit of each component of the unknown contact forces, in body axes, shape (k, nv, N).

        It is 0 at samples at which the contact is open.
        """
        key = ("unknown directions", IdentityKey(self.model), self.contacts)
        return motion.once(key, lambda: self._evaluated_directions(motion))

    def _evaluated_directions(self, motion: Motion) -> Array:
        """`unknown_directions`, evaluated."""
        unknown = [i for i, contact in enumerate(self.contacts) if not contact.is_measured]
        nv, count = motion.q.shape
        if not unknown:
            return np.zeros((0, nv, count))
        contact_samples = contacts_of(motion)
        motions, jacobians = self._kinematics(motion)
        directions = []
        for i in unknown:
            contact = self.contacts[i]
            body_jacobian = jacobians[self.model.frames[contact.link].body]
            J_linear, J_angular = self._contact_jacobian(contact, body_jacobian, motions, contact_samples)
            transmitted = [J_linear]
            if contact.kind == "surface":  # a point transmits no moment
                transmitted.append(J_angular)
            for J in transmitted:
                on_all_coordinates = np.zeros((3, nv, count))
                on_all_coordinates[:, body_jacobian.coordinates] = J * contact_samples.is_closed[i]
                directions.append(on_all_coordinates)
        return np.concatenate(directions)

    def torque_by_compliance(self, motion: Motion, unknown_forces: Array, max_load: float) -> Array:
        """Generalized force that the contacts exert in addition per compliance of their balls [m/N], shape (nv, N).

        Parameters
        ----------
        motion
            N samples, with their contacts.
        unknown_forces
            From `unknown_forces`, shape (k, N) [N or N·m].
        max_load
            Largest normal force of a contact [N]; more counts as this.
        """
        contact_samples = contacts_of(motion)
        motions, jacobians = self._kinematics(motion)
        torque = np.zeros_like(motion.tau)
        first = 0  # index of the first component of the next unknown contact
        for i, contact in enumerate(self.contacts):
            body = self.model.frames[contact.link].body
            if contact.is_measured:
                to_body = self._wrench_to_body(contact, motions, contact_samples)
                force = rotate(to_body, contact_samples.wrenches[i, :3])
            else:
                force = unknown_forces[first : first + 3]
                first += 3 if contact.kind == "point" else 6
            if not contact.is_compliant:
                continue
            up = self._up_in_body(body, motions, contact_samples)
            normal = np.einsum("in,in->n", up, force)
            load = np.clip(normal, 0.0, max_load)
            tangential = _within_friction_cone(force - normal * up, load)
            moment = load * cross(up, tangential)
            J_angular = jacobians[body].S_w
            torque[jacobians[body].coordinates] += np.einsum("icn,in->cn", J_angular, moment)
        return torque

    def _kinematics(self, motion: Motion) -> tuple[Sequence[BodyMotion], Mapping[int, BodyJacobian]]:
        """Motion of every body without its rates, and Jacobians, which do not depend on them, of those in contact."""
        bodies = tuple(self.model.frames[contact.link].body for contact in self.contacts)

        def evaluate() -> tuple[Sequence[BodyMotion], Mapping[int, BodyJacobian]]:
            zero_rates = np.zeros_like(motion.q)
            motions = body_motions(self.model, motion.q, zero_rates, zero_rates)
            return motions, jacobians_of(self.model, motions, bodies)

        return motion.once(("contact kinematics", IdentityKey(self.model), bodies), evaluate)

    def _contact_jacobian(
        self,
        contact: Contact,
        body_jacobian: BodyJacobian,
        motions: Sequence[BodyMotion],
        contact_samples: ContactSamples,
    ) -> tuple[Array, Array]:
        """Jacobian of a contact's point in the axes of its body, linear and angular part, shape (3, c, N) each."""
        link_frame = self.model.frames[contact.link]
        in_link = np.asarray(contact.point)
        point = (link_frame.p + link_frame.R @ in_link)[:, None]
        if contact.radius:  # a ball touches level ground a radius below its centre
            up = self._up_in_body(link_frame.body, motions, contact_samples)
            point = point - (contact.radius + contact_samples.radius_change) * up
        by_rotation = cross(body_jacobian.S_w, point[:, None])
        J_linear = body_jacobian.S_v + by_rotation
        coordinates, count = body_jacobian.S_w.shape[1], contact_samples.is_closed.shape[1]
        shape = (3, coordinates, count)  # a Jacobian that does not depend on q has one sample
        return np.broadcast_to(J_linear, shape), np.broadcast_to(body_jacobian.S_w, shape)

    def up_of(self, contact: Contact, motion: Motion) -> Array:
        """The vertical along the axes of the body that a contact acts on, shape (3, N) or (3, 1)."""
        motions, _ = self._kinematics(motion)
        return self._up_in_body(self.model.frames[contact.link].body, motions, contacts_of(motion))

    def _up_in_body(self, body: int, motions: Sequence[BodyMotion], contact_samples: ContactSamples) -> Array:
        """The vertical along the axes of a body, shape (3, N) or (3, 1)."""
        return rotate(self._base_to_body(motions, body), self._up_in_base(contact_samples))

    def _up_in_base(self, contact_samples: ContactSamples) -> Array:
        """The vertical along the axes of the base, shape (3, N) or (3, 1)."""
        if self.model.has_floating_base:
            return contact_samples.world_to_base[:, 2]
        gravity = self.model.gravity[:, None]
        return np.asarray(-gravity / np.linalg.norm(gravity))

    def _wrench_to_body(
        self, contact: Contact, motions: Sequence[BodyMotion], contact_samples: ContactSamples
    ) -> Array:
        """Rotation from the axes of a measured wrench to those of its body, shape (3, 3, N) or (3, 3, 1)."""
        link_frame = self.model.frames[contact.link]
        if contact.frame == "link":
            return link_frame.R[:, :, None]
        base_to_body = self._base_to_body(motions, link_frame.body)
        return np.asarray(np.einsum("ij...,jk...->ik...", base_to_body, contact_samples.world_to_base))

    def _base_to_body(self, motions: Sequence[BodyMotion], body: int) -> Array:
        """Rotation from the axes of the base to those of a body, shape (3, 3, N) or (3, 3, 1)."""
        base_to_body = np.eye(3)[:, :, None]
        while body >= 0:
            base_to_body = np.einsum("ij...,jk...->ik...", base_to_body, motions[body].rotation.matrix)
            body = self.model.bodies[body].mount.body
        return base_to_body


def _within_friction_cone(tangential: Array, load: Array) -> Array:
    """Tangential force, shape (3, N), shortened to what friction transmits under a load, shape (N,) [N]."""
    size = np.linalg.norm(tangential, axis=0)
    share = _MAX_FRICTION * load / np.maximum(size, _MIN_FORCE)
    return np.asarray(tangential * np.minimum(share, 1.0))


def _exerted_together(directions: Array) -> Iterator[tuple[Indices, Indices]]:
    """Components of unknown forces and the samples at which exactly these can act, of directions of shape (k, nv, N).

    Samples at which none can are left out.
    """
    for can_act, samples in _samples_by_column(np.asarray(directions.any(axis=1))):
        if can_act.any():
            yield np.flatnonzero(can_act), samples


def _samples_by_column(mask: Mask) -> Iterator[tuple[Mask, Indices]]:
    """Each different column of a mask of shape (k, N), and the samples that have it; fast if it seldom changes."""
    is_change = (mask[:, 1:] != mask[:, :-1]).any(axis=0)
    stretches: dict[bytes, list[Indices]] = {}
    for samples in np.split(np.arange(mask.shape[1]), np.flatnonzero(is_change) + 1):
        column = mask[:, samples[0]]
        stretches.setdefault(column.tobytes(), []).append(samples)
    for parts in stretches.values():
        yield mask[:, parts[0][0]], np.concatenate(parts)


def _unit_directions(whitened: Array) -> tuple[Array, Array]:
    """Directions in whitened rows, of unit length, shape (N, k, nv), and their lengths before, (N, k, 1)."""
    length = np.linalg.norm(whitened, axis=2, keepdims=True)
    length[length == 0] = 1.0  # of a force that acts only on joints with unknown friction
    return whitened / length, length


def _gram(unit: Array) -> Array:
    """Gram matrices of directions of unit length, shape (N, k, nv), made regular; shape (N, k, k)."""
    return np.asarray(unit @ unit.transpose(0, 2, 1) + _RIDGE * np.eye(unit.shape[1]))


def contacts_of(motion: Motion) -> ContactSamples:
    """Contacts of a motion; ValueError if it has none."""
    if motion.contacts is None:
        raise ValueError("the motion has no contacts, but the robot has some with unknown forces")
    return motion.contacts

"""`ContactForces`: forces at the contacts of a robot, measured ones known and unknown ones eliminated.

H q̈ + C q̇ + g = [tau; 0] + Σ Jᵢᵀ Fᵢ (1). A measured wrench F is a known generalized force Jᵀ F. An unknown one is
eliminated: with rows in units of their noise sigma, the orthogonal projector P onto what no contact force can exert
satisfies P Jᵀ = 0, so that P Y pi = P tau holds whatever F is, and least squares on P Y pi = P tau is the generalized
least-squares estimate with the forces as free unknowns. The unknown dry friction of a joint at rest is one more such
force, on its own row.

The projector is applied at every sample before the low-pass. The equation then remains exact: the projector varies with
time, so it would not commute with the filter.

Shapes: nv generalized coordinates, N samples, k components of unknown contact forces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.base_sensors import ContactSamples
from idtool.data.signals import Motion
from idtool.robot.config import Contact
from idtool.robot.kinematics import BodyJacobian, body_jacobians, body_motions, body_placements, cross, rotate
from idtool.robot.model import RobotModel

Placements = Mapping[int, tuple[Array, Array]]  # as `body_placements` gives them

_SINGULAR = 1e-11  # of a squared unit direction: combinations of contact forces that exert nothing


@dataclass(frozen=True)
class ContactForces:
    """Forces at the contacts of a robot.

    Attributes
    ----------
    model
        The tree of bodies.
    contacts
        The contacts.
    noise
        Noise of each row, shape (nv,) [N or N·m].
    """

    model: RobotModel
    contacts: tuple[Contact, ...]
    noise: Array

    def with_noise(self, noise: Array) -> ContactForces:
        """The same contacts with other noise of the rows, shape (nv,)."""
        return replace(self, noise=noise)

    def measured_torque(self, motion: Motion) -> Array:
        """Generalized force of the measured wrenches, shape (nv, N) [N or N·m]; 0 for a motion without contacts."""
        torque = np.zeros_like(motion.tau)
        measured = [i for i, contact in enumerate(self.contacts) if contact.is_measured]
        if not measured or motion.contacts is None:
            return torque
        samples = motion.contacts
        jacobians = self._jacobians(motion)
        placements = body_placements(self.model, motion.q)
        for i in measured:
            contact = self.contacts[i]
            frame = self.model.frames[contact.link]
            force, moment = samples.wrenches[i, :3], samples.wrenches[i, 3:]
            if contact.frame == "world":
                base_to_body = placements[frame.body][0].transpose(2, 1, 0)
                to_body = np.einsum("ij...,jk...->ik...", base_to_body, samples.world_to_base)
            else:
                to_body = frame.R[:, :, None]
            linear, angular = self._contact_jacobian(contact, jacobians[frame.body], placements, samples)
            coordinates = jacobians[frame.body].coordinates
            torque[coordinates] += np.einsum("ikn,in->kn", linear, rotate(to_body, force))
            torque[coordinates] += np.einsum("ikn,in->kn", angular, rotate(to_body, moment))
        return torque

    def projector(self, motion: Motion, resting: Mapping[int, Mask]) -> Array:
        """Projector onto what unknown forces cannot exert, shape (N, nv, nv), for rows in units of their noise.

        Parameters
        ----------
        motion
            N samples.
        resting
            By joint, the samples at which its own friction is unknown, shape (N,).
        """
        nv, samples = motion.q.shape
        is_free = np.ones((samples, nv))
        for joint, mask in resting.items():
            is_free[mask, joint] = 0.0
        identity = np.eye(nv) * is_free[:, None, :]
        directions = self.unknown_directions(motion)
        if not len(directions):
            return identity
        A = np.moveaxis(directions, -1, 0) / self.noise * is_free[:, None, :]  # (N, k, nv)
        size = np.linalg.norm(A, axis=2, keepdims=True)
        A = A / np.where(size > 0, size, 1.0)  # 0 at open contacts; others differ by orders of magnitude
        gram = A @ A.transpose(0, 2, 1) + _SINGULAR * np.eye(len(directions))
        return np.asarray(identity - A.transpose(0, 2, 1) @ np.linalg.solve(gram, A))

    def projected(self, projector: Array, rows: Array) -> Array:
        """Rows without what unknown forces can exert, in their own units.

        Parameters
        ----------
        projector
            As `projector` gives it.
        rows
            Shape (nv, ..., N).
        """
        flat = rows.reshape(len(rows), -1, rows.shape[-1])
        in_noise = np.moveaxis(flat, -1, 0) / self.noise[:, None]
        projected = (projector @ in_noise) * self.noise[:, None]
        return np.ascontiguousarray(np.moveaxis(projected, 0, -1)).reshape(rows.shape)

    def unknown_directions(self, motion: Motion, are_all_closed: bool = False) -> Array:
        """Generalized force per unit of each component of the unknown contact forces, shape (k, nv, N).

        0 at samples at which the contact is open, unless ``are_all_closed``.
        """
        unknown = [i for i, contact in enumerate(self.contacts) if not contact.is_measured]
        nv, samples = motion.q.shape
        if not unknown:
            return np.zeros((0, nv, samples))
        is_closed = np.ones((len(self.contacts), samples), dtype=bool)
        if not are_all_closed:
            is_closed = _samples(motion).is_closed
        jacobians = self._jacobians(motion)
        placements = body_placements(self.model, motion.q)
        directions = []
        for i in unknown:
            contact = self.contacts[i]
            jacobian = jacobians[self.model.frames[contact.link].body]
            parts = self._contact_jacobian(contact, jacobian, placements, _samples(motion))
            for part in parts if contact.kind == "surface" else parts[:1]:
                full = np.zeros((3, nv, samples))
                full[:, jacobian.coordinates] = part * is_closed[i]
                directions.append(full)
        return np.concatenate(directions)

    def _jacobians(self, motion: Motion) -> Sequence[BodyJacobian]:
        """Jacobians of all bodies along a motion."""
        at_rest = np.zeros_like(motion.q)
        return body_jacobians(self.model, body_motions(self.model, motion.q, at_rest, at_rest))

    def _contact_jacobian(
        self, contact: Contact, jacobian: BodyJacobian, placements: Placements, samples: ContactSamples
    ) -> tuple[Array, Array]:
        """Linear and angular velocity of a contact along the axes of its body's frame, per coordinate, (3, c, N)."""
        frame = self.model.frames[contact.link]
        point = (frame.p + frame.R @ np.asarray(contact.point))[:, None]
        if contact.radius:
            base_to_body = placements[frame.body][0].transpose(2, 1, 0)
            up = rotate(base_to_body, samples.world_to_base[:, 2])
            point = point - contact.radius * up
        linear = jacobian.S_v + cross(jacobian.S_w, point[:, None])
        shape = (*jacobian.S_w.shape[:2], samples.is_closed.shape[1])
        return np.broadcast_to(linear, shape), np.broadcast_to(jacobian.S_w, shape)


def _samples(motion: Motion) -> ContactSamples:
    """Contacts of a motion; ValueError if it has none."""
    if motion.contacts is None:
        raise ValueError("a motion of a robot with a floating base has its contacts")
    return motion.contacts

"""`FootCompliance`: balls of the feet that give way under load, so that the ground acts nearer to their centre.

A ball with the compliance c gives way by c F_n under the normal force F_n, so that the contact force F exerts the
moment c F_n (up × F) about the place at which a rigid ball would touch the ground. The torque is linear in c. Since it
is of second order in the force, the forces need not be known well: they follow from the torque of the legs, and hardly
from the masses, which are to be identified.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.signals import Motion
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import Contact
from idtool.robot.model import WRENCH_SIZE, RobotModel

EFFECT = "foot_compliance"
OWNER = "feet"

_ARM = 0.3  # m, of a typical moment of the weight
_JOINT_SHARE = 0.02  # of this moment, that the torque of a leg may be wrong by
_BASE_SHARE = 0.2  # of the weight and its moment, that the masses may be wrong by
_UNKNOWN_FACTOR = 1e3  # times as much noise, of a torque that was not logged
_MAX_LOAD = 3.0  # weights on a ball: where a leg is straight, its torque does not tell the force
_SUPPORTING_FEET = 2  # on which the weight makes the balls give way by less than their radius


class FootCompliance(Effect):
    """Compliance of the balls on which a robot with a floating base stands, one value for all of them.

    Parameters
    ----------
    model
        The robot.
    contacts
        Its contacts.
    prior
        Compliance before any data [m/N].
    """

    def __init__(self, model: RobotModel, contacts: Sequence[Contact], prior: float) -> None:
        weight = STANDARD_GRAVITY * model.mass
        radii = [contact.radius for contact in contacts if contact.is_compliant]
        largest = max(radii) / (weight / _SUPPORTING_FEET)
        self.coefficients = (
            Coefficient(EFFECT, OWNER, "compliance", "m/N", prior, lower=0.0, upper=max(largest, prior)),
        )
        self.active = tuple(np.array([0]) for _ in model.joints)
        self._bodies = RigidBodies(model)
        self._prior_bodies = np.array([coefficient.prior for coefficient in self._bodies.coefficients])
        self._noise = np.full(len(model.joints), _JOINT_SHARE * weight * _ARM)
        for start in range(model.joint_count, len(model.joints), WRENCH_SIZE):  # of the sensors and of the base
            share = _BASE_SHARE if start == model.base_coordinates.start else _JOINT_SHARE
            self._noise[start : start + 3] = share * weight
            self._noise[start + 3 : start + WRENCH_SIZE] = share * weight * _ARM
        self._contacts = ContactModel(model, tuple(contacts), self._noise)
        self._max_load = _MAX_LOAD * weight

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        for row, column in zip(out, self._column(motion), strict=True):
            row[0] = column

    def _column(self, motion: Motion) -> Array:
        """Torque per compliance, shape (nv, N); kept for other motions along the same samples, if it can be."""
        kept = motion.kept_columns
        if kept is None or motion.contacts is None or not kept.are_along(motion.q, motion.v, motion.a):
            return self._evaluated_column(motion)
        torque = blake2b(motion.tau.tobytes()).digest()
        key = EFFECT, self._prior_bodies.tobytes(), motion.contacts.radius_change, torque
        (column,) = kept.get(key, lambda: (self._evaluated_column(motion),))
        return column

    def _evaluated_column(self, motion: Motion) -> Array:
        if motion.contacts is None:
            return np.zeros_like(motion.q)
        noise = self._noise.copy()
        noise[list(motion.unknown_torque)] *= _UNKNOWN_FACTOR
        contacts = self._contacts.with_noise(noise)
        rigid_torque = self._bodies.torque(self._prior_bodies, motion)
        residual = motion.tau + contacts.measured_force(motion) - rigid_torque
        forces = contacts.unknown_forces(contacts.unknown_directions(motion), residual)
        return -contacts.torque_by_compliance(motion, forces, self._max_load)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        """Add nothing: the legs are simulated in the air."""

"""`StandingRobot`: a robot on its feet: its motion in the torque equation, and the loads that go with it.

Shapes: n joints, nv coordinates of the model, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.contact_channels import ContactSamples
from idtool.data.signals import Motion
from idtool.dynamics.regressor import LinearModel
from idtool.excitation.limits import Limits
from idtool.excitation.patterns import MotionSamples
from idtool.excitation.standing.ground_forces import GroundForces, GroundLoads
from idtool.excitation.standing.kinematics import FootKinematics
from idtool.robot.model import RobotModel


class Loads(NamedTuple):
    """Torques of the joints, shape (n, N), loads of the feet, and how far these are beyond the limits, shape (N,)."""

    torque: Array
    ground: GroundLoads
    violation: Array


@dataclass(frozen=True)
class StandingRobot:
    """A robot on its feet.

    Attributes
    ----------
    model, equation
        The robot, with a floating base and contacts, and its torque equation.
    theta
        Coefficients that predict the torque, shape (p,).
    limits
        Limits of the joints.
    feet, forces
        The feet on the ground, and the forces on them.
    """

    model: RobotModel
    equation: LinearModel
    theta: Array
    limits: Limits
    feet: FootKinematics
    forces: GroundForces

    @property
    def even_load(self) -> float:
        """Weight per foot [N]."""
        return STANDARD_GRAVITY * self.model.mass / len(self.feet.feet)

    def motion(self, samples: MotionSamples, base_to_world: Array, t: Array, velocity_deadband: Array) -> Motion:
        """Samples of a design as the torque equation takes them, with the feet on the ground, without torque."""
        zero = np.zeros_like(samples.q)
        dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
        contacts = self._contact_samples(base_to_world)
        return Motion(
            t, *samples, tau=zero, logged_tau=zero, velocity_deadband=velocity_deadband, dt=dt, contacts=contacts
        )

    def _contact_samples(self, base_to_world: Array) -> ContactSamples:
        """The feet closed, all other contacts open."""
        contacts = () if self.equation.contacts is None else self.equation.contacts.contacts
        feet = {foot.name for foot in self.feet.feet}
        count = len(base_to_world)
        closed = [contact.name in feet or contact.flag is None for contact in contacts]
        is_closed = np.repeat(np.array(closed, dtype=bool)[:, None], count, axis=1)
        wrenches = np.zeros((len(contacts), 6, count))
        return ContactSamples(np.moveaxis(base_to_world, 0, -1).transpose(1, 0, 2), is_closed, wrenches)

    def loads(self, required: Array, jacobian: Array, soles: list[Array]) -> Loads:
        """Loads that go with a motion.

        Parameters
        ----------
        required
            Generalized force that the motion takes, shape (nv, N).
        jacobian
            Jacobian of the feet, shape (N, k, nv).
        soles
            Rotation of every foot's link to the world, shape (3, 3) each.
        """
        F, torque = self.forces.distribute(jacobian, required)
        ground = self.forces.loads(F, soles)
        return Loads(torque, ground, self.forces.violations(ground, self.even_load))

    def static_loads(self, q: Array, base_to_world: Array, soles: list[Array]) -> Loads:
        """Loads at rest in postures with the joints at q, shape (n, N), and the base turned so, shape (N, 3, 3)."""
        nv, count = len(self.model.joints), q.shape[1]
        n = self.model.joint_count
        positions, zero, proper = np.zeros((3, nv, count))
        positions[:n] = q
        proper[self.model.base_coordinates][:3] = STANDARD_GRAVITY * base_to_world[:, 2, :].T
        t = np.arange(count, dtype=float)
        deadband = np.full(nv, 1.0)  # at rest, friction takes either side
        motion = self.motion(MotionSamples(positions, zero, proper), base_to_world, t, deadband)
        required = self.equation.torque(motion, self.theta)
        return self.loads(required, self.feet.jacobian(q, base_to_world), soles)

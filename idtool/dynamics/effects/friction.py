"""Joint friction that is linear in its coefficients: b v + c sign(v) + offset (26).

An offset is the same as a Coulomb friction that depends on the direction of motion.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import DryFriction, JointTerm


class ViscousFriction(JointTerm):
    """b v."""

    id = "viscous_friction"
    means = "friction that grows with speed"
    shows = "steady motion at several speeds"
    name = "viscous"
    friction = True
    unit = ("N·m·s/rad", "N·s/m")

    def column(self, motion: Motion) -> Array:
        """The velocity."""
        return np.asarray(motion.v[self.joint])


class CoulombFriction(DryFriction):
    """c sign(v)."""

    id = "coulomb_friction"
    means = "friction that does not depend on speed"
    shows = "slow motion in both directions"
    name = "coulomb"
    unit = ("N·m", "N")

    def level(self, motion: Motion) -> Array:
        """One."""
        return np.ones_like(motion.t)


class TorqueOffset(JointTerm):
    """A constant."""

    id = "torque_offset"
    means = "a constant torque, or friction that differs between the directions"
    shows = "standstill and slow motion in both directions at several positions"
    name = "offset"
    unit = ("N·m", "N")
    lower = -np.inf
    even = False

    def column(self, motion: Motion) -> Array:
        """One."""
        return np.ones_like(motion.t)

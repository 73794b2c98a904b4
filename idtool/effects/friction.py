"""Joint friction that is linear in its coefficients: b v + c sign(v) + offset (26).

An offset is the same as a Coulomb friction that depends on the direction of motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from idtool.effects.joint_term import JointTerm
from idtool.signals import Motion

Array = NDArray[np.float64]

_FAST = 0.1  # widths a sample above which the sign changes within it
_SURE = 3.0  # widths of the rounded sign beyond which it is ±1 to half a percent


class ViscousFriction(JointTerm):
    """b v."""

    id = "viscous_friction"
    name = "viscous"
    unit = ("N·m·s/rad", "N·s/m")

    def column(self, motion: Motion) -> Array:
        """The velocity."""
        return np.asarray(motion.v[self.joint])


class CoulombFriction(JointTerm):
    """c sign(v), the sign rounded where v is too small to have one."""

    id = "coulomb_friction"
    name = "coulomb"
    unit = ("N·m", "N")

    def column(self, motion: Motion) -> Array:
        """The direction of motion, the mean over the time from half a sample before to half a sample after."""
        x = motion.v[self.joint] / motion.still[self.joint]
        between = 0.5 * (x[1:] + x[:-1])
        edge = np.concatenate([x[:1], between, x[-1:]])
        change = np.diff(edge)
        mean: Array = np.tanh(x)
        fast = np.abs(change) > _FAST
        integral = np.logaddexp(edge, -edge)  # of tanh
        mean[fast] = np.diff(integral)[fast] / change[fast]
        return mean

    def undefined(self, motion: Motion) -> dict[int, NDArray[np.bool_]]:
        """Where the joint rests: friction there can be anything up to c."""
        return {self.joint: np.abs(motion.v[self.joint]) < _SURE * motion.still[self.joint]}


class TorqueOffset(JointTerm):
    """A constant."""

    id = "torque_offset"
    name = "offset"
    unit = ("N·m", "N")
    lower = -np.inf
    even = False

    def column(self, motion: Motion) -> Array:
        """One."""
        return np.ones_like(motion.t)

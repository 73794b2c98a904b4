"""The reflected inertia of a rotor that the model has not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from idtool.effects.joint_term import JointTerm
from idtool.mechanism import Mechanism
from idtool.signals import Motion

Array = NDArray[np.float64]


class RotorInertia(JointTerm):
    """I_a a: a rotor's inertia about its axis times its gear ratio squared."""

    id = "rotor_inertia"
    name = "inertia"
    unit = ("kg·m²", "kg")

    def column(self, motion: Motion) -> Array:
        """The acceleration."""
        return np.asarray(motion.a[self.joint])

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.armature[int(self.joint)] += theta[0]

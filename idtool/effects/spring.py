"""Springs across a joint, and what acts like one: hoses, cable bundles, balancers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from idtool.effects.joint_effect import Held
from idtool.effects.joint_term import JointTerm
from idtool.signals import Motion

Array = NDArray[np.float64]


class ParallelSpring(JointTerm):
    """k (q − q0). The rest position q0 is held; with a torque offset on the joint it does not matter which it is."""

    id = "parallel_spring"
    name = "stiffness"
    unit = ("N·m/rad", "N/m")
    held = (Held("rest_position"),)

    def column(self, motion: Motion) -> Array:
        """The deflection."""
        return np.asarray(motion.q[self.joint] - self.shape["rest_position"])

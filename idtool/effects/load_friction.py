"""Friction that grows with the load on the transmission."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from idtool.effects.joint_term import DryFriction
from idtool.signals import Motion

Array = NDArray[np.float64]


class LoadDependentFriction(DryFriction):
    """c abs(tau_load) sign(v), tau_load being the joint's actuator torque: what the transmission passes on."""

    id = "load_dependent_friction"
    means = "friction grows with the load"
    shows = "the same slow sweep with another load"
    name = "coefficient"
    unit = ("1", "1")
    upper = 0.6  # a transmission that takes more does not move by itself

    def level(self, motion: Motion) -> Array:
        """The torque's size."""
        return np.abs(motion.tau[self.joint])

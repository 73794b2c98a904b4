"""Friction that grows with the load on the transmission."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import DryFriction
from idtool.dynamics.effects.loaded_term import LoadedTerm


class LoadDependentFriction(LoadedTerm, DryFriction):
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

    def with_own(self, tau: Array, theta: Array, motion: Motion) -> Array:
        """See `LoadedTerm.with_own`: y = tau + c abs(y) sign(v)."""
        joint, tau = int(self.joint), tau.copy()
        tau[joint] /= 1 - np.clip(theta[0], 0.0, self.upper) * np.sign(tau[joint] * motion.v[joint])
        return tau

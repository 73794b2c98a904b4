"""Friction that grows with the load on the transmission."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import DryFriction
from idtool.dynamics.effects.load_dependent_term import LoadDependentTerm


class LoadDependentFriction(LoadDependentTerm, DryFriction):
    """c abs(tau_load) sign(v); tau_load is the joint's actuator torque, which the transmission passes on."""

    id = "load_dependent_friction"
    label = "load-dependent friction"
    description = "friction grows with the load"
    excitation_hint = "the same slow sweep with another load"
    cause = "torque"
    follows_direction = True
    coefficient_name = "coefficient"
    units = ("1", "1")
    upper = 0.6  # a transmission with more is self-locking

    @override
    def level(self, motion: Motion) -> Array:
        return np.abs(motion.tau[self.joint])

    @override
    def actuator_torque(self, tau: Array, theta: Array, motion: Motion) -> Array:
        """Solution y of y = tau + c abs(y) sign(v)."""
        joint = int(self.joint)
        tau = tau.copy()
        c = np.clip(theta[0], 0.0, self.upper)
        tau[joint] /= 1 - c * np.sign(tau[joint] * motion.v[joint])
        return tau

"""Viscous friction."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.simulator_element import Damping, SimulatorElement


class ViscousFriction(JointTerm):
    """Viscous friction b v (Wensing et al. 2018, Eq. 26)."""

    id = "viscous_friction"
    description = "friction grows with speed"
    excitation_hint = "steady motion at several speeds"
    coefficient_name = "viscous"
    is_friction = True
    is_commonplace = True
    friction_key = "viscous"
    urdf_attribute = "damping"
    units = ("N·m·s/rad", "N·s/m")

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray(motion.v[self.joint])

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        return (Damping(int(self.joint), float(theta[0])),)

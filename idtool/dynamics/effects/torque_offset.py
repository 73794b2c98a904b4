"""A constant torque, which is also the asymmetric part of a Coulomb friction that depends on the direction."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.init_trial import InitTrial
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.simulator_element import ConstantTorque, SimulatorElement


class TorqueOffset(JointTerm):
    """A constant torque (Wensing et al. 2018, Eq. 26)."""

    id = "torque_offset"
    is_countable = True
    description = "a constant torque acts, or friction differs between the directions"
    excitation_hint = "standstill and slow motion in both directions at several positions"
    coefficient_name = "offset"
    is_commonplace = True
    friction_key = "offset"
    init_trial = InitTrial(name="an offset", heading="torque offset")
    units = ("N·m", "N")
    lower = -np.inf
    even = False

    @override
    def column(self, motion: Motion) -> Array:
        return np.ones_like(motion.t)

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        return (ConstantTorque(int(self.joint), float(theta[0])),)

"""Viscous friction."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm


class ViscousFriction(JointTerm):
    """b v (26)."""

    id = "viscous_friction"
    description = "friction that grows with speed"
    excitation_hint = "steady motion at several speeds"
    name = "viscous"
    is_friction = True
    units = ("N·m·s/rad", "N·s/m")

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray(motion.v[self.joint])

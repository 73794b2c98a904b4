"""A constant torque, which is also the asymmetric part of a Coulomb friction that depends on the direction."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm


class TorqueOffset(JointTerm):
    """A constant (26)."""

    id = "torque_offset"
    description = "a constant torque, or friction that differs between the directions"
    excitation_hint = "standstill and slow motion in both directions at several positions"
    name = "offset"
    units = ("N·m", "N")
    lower = -np.inf
    even = False

    @override
    def column(self, motion: Motion) -> Array:
        return np.ones_like(motion.t)

"""Drag that grows with the square of speed: windage, oil, water."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.simulator_element import QuadraticDamping, SimulatorElement


class QuadraticDrag(JointTerm):
    """d v abs(v)."""

    id = "quadratic_drag"
    description = "drag grows with the square of speed"
    excitation_hint = "steady motion at several high speeds"
    coefficient_name = "drag"
    is_friction = True
    units = ("N·m·s²/rad²", "N·s²/m²")

    @override
    def column(self, motion: Motion) -> Array:
        v = motion.v[self.joint]
        return np.asarray(v * np.abs(v))

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        return (QuadraticDamping(int(self.joint), float(theta[0])),)

"""Coulomb friction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import DryFriction
from idtool.dynamics.effects.simulator_element import FrictionLoss, SimulatorElement


class CoulombFriction(DryFriction):
    """Coulomb friction c sign(v) (Wensing et al. 2018, Eq. 26)."""

    id = "coulomb_friction"
    label = "Coulomb friction"
    description = "a friction of the same size at every speed opposes the motion"
    excitation_hint = "slow motion in both directions"
    coefficient_name = "coulomb"
    is_commonplace = True
    friction_key = "coulomb"
    urdf_attribute = "friction"
    units = ("N·m", "N")

    @classmethod
    @override
    def dry_friction(cls, values: Mapping[str, Any]) -> float:
        return float(values["coulomb"])

    @override
    def level(self, motion: Motion) -> Array:
        return np.ones_like(motion.t)

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        return (FrictionLoss(int(self.joint), float(theta[0])),)

"""Reflected inertia of a rotor that the model lacks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.mechanism import Mechanism


class RotorInertia(JointTerm):
    """I_a a: a rotor's inertia about its axis times its gear ratio squared."""

    id = "rotor_inertia"
    description = "a rotor is missing from the model"
    excitation_hint = "quick motion of the joint in several postures"
    name = "inertia"
    units = ("kg·m²", "kg")

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """One trial on joints for which the model has no rotor."""
        has_rotor = any(body.kind == "rotor" and body.ratios[joint] for body in summary.model.bodies)
        if not has_rotor:
            yield {}

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray(motion.a[self.joint])

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.armature[int(self.joint)] += theta[0]

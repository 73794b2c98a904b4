"""Reflected inertia of a rotor that the model lacks."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.init_trial import InitTrial
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.mechanism import Mechanism


class RotorInertia(JointTerm):
    """I_a a: a rotor's inertia about its axis times its gear ratio squared."""

    id = "rotor_inertia"
    description = "a rotor is missing from the model"
    excitation_hint = "quick motion of the joint in several postures"
    cause = "acceleration"
    coefficient_name = "inertia"
    is_commonplace = True
    is_rotor_inertia = True
    init_trial = InitTrial(
        name="rotor inertia",
        heading="rotor inertia",
        comment="reflected rotor inertia {value} (inertia of the rotor × gear ratio²)",
    )
    units = ("kg·m²", "kg")

    @override
    def column(self, motion: Motion) -> Array:
        """Acceleration of the motor, with which the rotor turns, shape (N,)."""
        joint = int(self.joint)
        acceleration = motion.a[joint]
        if joint in motion.motor_minus_link:
            acceleration = acceleration + motion.motor_minus_link[joint][2]
        return np.asarray(acceleration)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.armature[int(self.joint)] += theta[0]

"""The reflected inertia of a rotor that the model has not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.survey import Survey
from idtool.dynamics.mechanism import Mechanism


class RotorInertia(JointTerm):
    """I_a a: a rotor's inertia about its axis times its gear ratio squared."""

    id = "rotor_inertia"
    means = "a rotor is missing from the model"
    shows = "quick motion of the joint in several postures"
    name = "inertia"
    unit = ("kg·m²", "kg")

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: where the model has no rotor."""
        if not any(body.kind == "rotor" and body.ratios[joint] for body in survey.model.bodies):
            yield {}

    def column(self, motion: Motion) -> Array:
        """The acceleration."""
        return np.asarray(motion.a[self.joint])

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.armature[int(self.joint)] += theta[0]

"""Springs across a joint, and what acts like one: hoses, cable bundles, balancers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.robot.config import EffectEntry


class ParallelSpring(JointTerm):
    """k (q − q0). The rest position q0 is held; with a torque offset on the joint it does not matter which it is."""

    id = "parallel_spring"
    means = "a spring acts across the joint"
    shows = "slow motion over the whole travel"
    contains = ("torque_offset",)
    name = "stiffness"
    unit = ("N·m/rad", "N/m")
    held = (Held("rest_position"),)

    @classmethod
    def probe(cls, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
        """See `JointEffect.probe`: k q and −k q0; where the joint has an offset, the rest position is that of q = 0."""
        name, alone = survey.model.names[joint], survey.has("torque_offset", survey.model.names[joint])
        rows = 1 if alone else 2

        def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
            return {joint: np.stack([motion.q[joint], np.ones_like(motion.t)])[:rows]}

        def entry(c: Array, information: Array) -> EffectEntry:
            rest = 0.0 if alone or not c[0] else -c[1] / c[0]
            return cls.entry(survey.model, joint, {"stiffness": c[0], "rest_position": rest})

        free = (-np.inf,) * (rows - 1)
        return Probe(cls.id, name, None, columns, rows, entry, {}, (cls.lower, *free))

    def column(self, motion: Motion) -> Array:
        """The deflection."""
        return np.asarray(motion.q[self.joint] - self.shape["rest_position"])

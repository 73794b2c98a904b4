"""Friction whose direction changes over a range of speeds, as where a simulator rounds its sign off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import JointTerm, log_cosh, mean_within
from idtool.dynamics.effects.probe import spread
from idtool.dynamics.effects.survey import Survey

_SLOWEST = 4.0  # widths of the sign of a measured velocity
_FASTEST, _TRIED = 0.3, 6  # of the rms speed: more would pass for viscous friction


class RoundedFriction(JointTerm):
    """c tanh(v / velocity), which takes over from Coulomb friction's c sign(v) as far as the data say."""

    id = "rounded_friction"
    means = "friction changes its direction over a range of speeds"
    shows = "slow reversals"
    upon = ("coulomb_friction",)
    name = "coulomb"
    friction = True
    named = False
    unit = ("N·m", "N")
    held = (Held("velocity", positive=True),)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`."""
        for velocity in spread(_SLOWEST * survey.still[joint], _FASTEST * survey.speed[joint], _TRIED):
            yield {"velocity": velocity}

    def column(self, motion: Motion) -> Array:
        """The rounded direction, its mean over a sample."""
        x = motion.v[self.joint] / self.shape["velocity"]
        return mean_within(np.tanh(x), x, log_cosh)

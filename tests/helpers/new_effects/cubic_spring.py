"""An effect that the package does not have: all that it takes to add one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.named_effect import NonlinearParameter

_TRIALS = 9


class CubicSpring(JointTerm):
    """k (q − q0)³. The rest position q0 is nonlinear."""

    id = "cubic_spring"
    is_countable = True
    description = "a spring that stiffens acts across the joint"
    excitation_hint = "slow motion over the whole travel"
    name = "stiffness"
    units = ("N·m/rad³", "N/m³")
    nonlinear_parameters = (NonlinearParameter("rest_position", ("rad", "m")),)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Rest positions over the travel."""
        for position in np.linspace(summary.q_min[joint], summary.q_max[joint], _TRIALS):
            yield {"rest_position": float(position)}

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray((motion.q[self.joint] - self.nonlinear_values["rest_position"]) ** 3)

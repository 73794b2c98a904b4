"""Friction whose direction changes over a range of speeds, as in a simulator that smooths sign(v)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm, log_cosh, sample_mean
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import geometric_grid

_MIN_VELOCITY = 4.0  # velocity deadbands
_MAX_VELOCITY = 0.3  # of the rms speed: more would pass for viscous friction
_TRIALS = 6


class RoundedFriction(JointTerm):
    """c tanh(v / velocity), beside Coulomb friction, c sign(v): the data decide the share of each."""

    id = "rounded_friction"
    description = "friction changes its sign gradually around zero speed"
    excitation_hint = "slow reversals"
    requires = ("coulomb_friction",)
    coefficient_name = "coulomb"
    is_friction = True
    reportable = False
    units = ("N·m", "N")
    nonlinear_parameters = (NonlinearParameter("velocity", ("rad/s", "m/s"), positive=True),)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        slowest = _MIN_VELOCITY * summary.velocity_deadband[joint]
        fastest = _MAX_VELOCITY * summary.rms_velocity[joint]
        for velocity in geometric_grid(slowest, fastest, _TRIALS):
            yield {"velocity": velocity}

    @override
    def column(self, motion: Motion) -> Array:
        """Rounded direction of motion; in a log, its mean over each sample."""
        x = motion.v[self.joint] / self.nonlinear_values["velocity"]
        if motion.is_log:
            return sample_mean(np.tanh(x), x, log_cosh)
        return np.asarray(np.tanh(x))

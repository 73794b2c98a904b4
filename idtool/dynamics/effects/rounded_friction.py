"""Friction whose direction changes over a range of speeds, as in a simulator that smooths sign(v)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

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
_MAX_LEAD_VELOCITY = 0.1  # of the rms speed, with a lead
_TRIALS = 6
_TYPICAL_LEAD = 0.01  # s: MuJoCo's friction loss with its default solref has 9.5 ms
_MAX_LEAD = 0.05  # s


class RoundedFriction(JointTerm):
    """c tanh(v / velocity), beside Coulomb friction, c sign(v): the data decide the share of each.

    With ``coulomb: false`` in the joint's ``friction``, it stands in place of Coulomb friction.

    With a lead [s], which may be left out, it is c clip(v / velocity, −1, 1) of the velocity that much later. This is
    MuJoCo's friction loss, a soft constraint: its force is proportional to b v + a up to its limit, with
    b = 2 / (d_max timeconst), so that it changes its sign 1 / b before the velocity does.
    """

    id = "rounded_friction"
    description = "friction changes its sign gradually around zero speed"
    excitation_hint = "slow reversals"
    requires = ("coulomb_friction",)
    coefficient_name = "coulomb"
    optional_linear_parameters = ("coulomb",)
    is_friction = True
    reportable = False
    units = ("N·m", "N")
    nonlinear_parameters = (
        NonlinearParameter("velocity", ("rad/s", "m/s"), positive=True, open_ended=True),
        NonlinearParameter("lead", ("s", "s"), optional_maximum=_MAX_LEAD),
    )

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        slowest = _MIN_VELOCITY * summary.velocity_deadband[joint]
        fastest = _MAX_VELOCITY * summary.rms_velocity[joint]
        for velocity in geometric_grid(slowest, fastest, _TRIALS):
            yield {"velocity": velocity, "lead": 0.0}
        fastest = _MAX_LEAD_VELOCITY * summary.rms_velocity[joint]
        for velocity in geometric_grid(min(slowest, fastest / 2), fastest, _TRIALS):
            yield {"velocity": velocity, "lead": _TYPICAL_LEAD}

    @classmethod
    @override
    def dry_friction(cls, values: Mapping[str, Any]) -> float:
        return float(values["coulomb"])

    @classmethod
    @override
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """Also a lead over so wide a range of speeds that c (v + lead a) / velocity would be a rotor's inertia."""
        fastest = _MAX_LEAD_VELOCITY * summary.rms_velocity[summary.model.names.index(str(joint))]
        if values.get("lead", 0.0) and float(values["velocity"]) > fastest:
            return "its change of sign is too wide"
        return super().implausibility(values, joint, summary)

    @override
    def column(self, motion: Motion) -> Array:
        """Rounded direction of motion; in a log, its mean over each sample. States have no later velocity."""
        v = motion.v[self.joint]
        if not motion.is_log:
            return np.asarray(np.tanh(v / self.nonlinear_values["velocity"]))
        lead = self.nonlinear_values["lead"]
        if lead:
            v = np.interp(motion.t + lead, motion.t, v)
        x = v / self.nonlinear_values["velocity"]
        if lead:
            return sample_mean(np.clip(x, -1, 1), x, _integral_of_clip)
        return sample_mean(np.tanh(x), x, log_cosh)


def _integral_of_clip(x: Array) -> Array:
    """Integral of clip(x, −1, 1), up to a constant."""
    beyond = np.maximum(np.abs(x) - 1, 0.0)
    return np.asarray(np.square(np.minimum(np.abs(x), 1.0)) / 2 + beyond)

"""Friction that changes over a log: warm-up, temperature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import DryFriction, JointTerm, JointTerms
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import geometric_grid

_SHORTEST = 0.1  # time constant, as a share of the longest log
_LONGEST = 2.0
_TRIALS = 6


def _completed_share(motion: Motion, time_constant: float | Array) -> Array:
    """1 − exp(−t/T), the share of the change that has taken place."""
    return np.asarray(-np.expm1(-motion.t / time_constant))


class _ViscousChange(JointTerm):
    coefficient_name = "viscous_change"
    is_friction = True
    units = ("N·m·s/rad", "N·s/m")
    lower = -np.inf

    @override
    def column(self, motion: Motion) -> Array:
        share = _completed_share(motion, self.nonlinear_values["time_constant"])
        return np.asarray(motion.v[self.joint] * share)


class _CoulombChange(DryFriction):
    coefficient_name = "coulomb_change"
    units = ("N·m", "N")
    lower = -np.inf

    @override
    def level(self, motion: Motion) -> Array:
        return _completed_share(motion, self.nonlinear_values["time_constant"])


class FrictionDrift(JointTerms):
    """(b v + c sign(v)) (1 − exp(−t/T)), t from the log's first sample; b and c are of either sign, T is nonlinear.

    Every log starts with the joint in the same state.
    """

    id = "friction_drift"
    description = "friction changes over the log"
    excitation_hint = "the same motion, repeated after warm-up"
    cause = "time"
    follows_direction = True
    generalizes = ("viscous_friction", "coulomb_friction")
    is_friction = True
    requires = ("coulomb_friction", "presliding_hysteresis")
    nonlinear_parameters = (NonlinearParameter("time_constant", ("s", "s"), positive=True, open_ended=True),)
    term_types = (_ViscousChange, _CoulombChange)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Time constants of changes that begin and go on within a log."""
        for time_constant in geometric_grid(_SHORTEST * summary.duration, _LONGEST * summary.duration, _TRIALS):
            yield {"time_constant": time_constant}

    @classmethod
    @override
    def linear_parameters(cls) -> tuple[str, ...]:
        return "viscous", "coulomb"

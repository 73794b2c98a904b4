"""A torque measurement with a wrong scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.fixed_effect import single_joint_torque
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.torque_sensor import TorqueSensorEffect

_MIN_GAIN = 0.2
_MAX_GAIN = 5.0


class TorqueGain(TorqueSensorEffect):
    """Measured torque = gain × true torque, as with a wrong torque constant, gear ratio or efficiency."""

    id = "torque_gain"
    is_countable = True
    description = "the measured torque is a multiple of the true one"
    excitation_hint = "the same motion with and without a known mass on the last link"
    cause = "torque"
    nonlinear_parameters = (NonlinearParameter("gain", positive=True),)

    @classmethod
    @override
    def torque_derivative(
        cls,
        summary: DataSummary,
        joint: int,
        nonlinear_values: Mapping[str, float],
        motion: Motion,
        linearized: Linearization,
    ) -> Array:
        """Derivative in units of the measured torque; otherwise a gain of zero would explain everything."""
        return single_joint_torque(joint, linearized.predicted_torque[joint], motion)

    @classmethod
    @override
    def values_from_coefficient(cls, c: float, nonlinear_values: Mapping[str, float]) -> Mapping[str, float] | None:
        gain = 1 + c
        return {"gain": gain} if _MIN_GAIN < gain < _MAX_GAIN else None

    @override
    def to_measured(self, tau: Array) -> Array:
        return np.asarray(self.nonlinear_values["gain"] * tau)

    @override
    def to_true(self, tau: Array) -> Array:
        return np.asarray(tau / self.nonlinear_values["gain"])

"""A torque measurement that is not linear at high load."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.fixed_effect import single_joint_torque
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.torque_sensor import TorqueSensorEffect

_LEVELS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)  # of the peak torque, where it may begin to bend


class TorqueSaturation(TorqueSensorEffect):
    """Measured torque that bends away from the true one beyond a level.

    With x and y what the true and the measured torque have above the level in size:

    - bend ≥ 0: x = y + bend y²/2. The measured torque falls behind, as that of a strain gauge at the end of its range
      does; its slope is 1 at the level and half of that where y = 1 / bend.
    - bend < 0: y = x − bend x²/2. The measured torque runs ahead, as that from the current of a motor whose iron
      saturates does.

    So it is one to one over all torques, its slope has no jump, both directions are polynomials or square roots of
    them, which noise and wrong values cannot drive to infinity, and bend = 0 is no saturation. The level is in N·m or
    N, the bend in the inverse of that.
    """

    id = "torque_saturation"
    description = "the measured torque saturates at high load"
    excitation_hint = "standstill and slow motion at high and at low load"
    cause = "torque"
    generalizes = ("torque_gain",)
    nonlinear_parameters = (
        NonlinearParameter("level", ("N·m", "N"), positive=True),
        NonlinearParameter("bend", ("1/(N·m)", "1/N")),
    )

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Levels that the torque exceeds."""
        for share in _LEVELS:
            yield {"level": share * float(summary.peak_torque[joint])}

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
        """Derivative by the bend."""
        tau = linearized.predicted_torque[joint]
        above = np.maximum(np.abs(tau) - nonlinear_values["level"], 0.0)
        return single_joint_torque(joint, -np.sign(tau) * np.square(above) / 2, motion)

    @classmethod
    @override
    def values_from_coefficient(cls, c: float, nonlinear_values: Mapping[str, float]) -> Mapping[str, float] | None:
        return {**nonlinear_values, "bend": c}

    @override
    def to_measured(self, tau: Array) -> Array:
        return self._bent(tau, -self.nonlinear_values["bend"])

    @override
    def to_true(self, tau: Array) -> Array:
        return self._bent(tau, self.nonlinear_values["bend"])

    def _bent(self, tau: Array, bend: float) -> Array:
        """Torque whose excess over the level is increased by bend/2 times its square, or the inverse of that map."""
        above = np.maximum(np.abs(tau) - self.nonlinear_values["level"], 0.0)
        bent = above + bend / 2 * above**2
        if bend < 0:
            bent = 2 * above / (1 + np.sqrt(1 - 2 * bend * above))  # (√(1 + 2bx) − 1) / b without cancellation
        return np.asarray(tau + np.sign(tau) * (bent - above))

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

_MIN_SLOPE = 0.02  # of the true torque over the commanded one of a motor
_SHARPEST = 20.0  # bend of a motor times its level, with which a fit begins: from a sharper one, it would not move
_LEVELS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)  # of the peak torque, where it may begin to bend


class TorqueSaturation(TorqueSensorEffect):
    """Measured torque that bends away from the true one beyond a level.

    With x and y what the true and the measured torque have above the level in size:

    - bend ≥ 0: x = y + bend y²/2. The measured torque falls behind, as that of a strain gauge at the end of its range
      does; its slope is 1 at the level and half of that where y = 1 / bend.
    - bend < 0: x = (1 − exp(bend y)) / −bend. The measured torque runs ahead, as the commanded torque of a motor does
      that saturates: the true torque never gets more than −1 / bend above the level, and a very negative bend is a
      limit. Where x would rise by less than 2 % of y, it does so by 2 %.

    So it is one to one over all torques, its slope at the level has no jump, and bend = 0 is no saturation. The level
    is in N·m or N, the bend in the inverse of that.
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
        peak = float(summary.peak_torque[joint])
        if not peak:  # none was logged
            return
        for share in _LEVELS:
            yield {"level": share * peak}

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
        return {**nonlinear_values, "bend": max(c, -_SHARPEST / nonlinear_values["level"])}

    @override
    def to_measured(self, tau: Array) -> Array:
        level, bend = self.nonlinear_values["level"], self.nonlinear_values["bend"]
        x = np.maximum(np.abs(tau) - level, 0.0)
        y = _fallen_behind(x, bend) if bend >= 0 else _before_limiting(x, -bend)
        return np.asarray(tau + np.sign(tau) * (y - x))

    @override
    def to_true(self, tau: Array) -> Array:
        level, bend = self.nonlinear_values["level"], self.nonlinear_values["bend"]
        y = np.maximum(np.abs(tau) - level, 0.0)
        x = y + bend / 2 * y**2 if bend >= 0 else _limited(y, -bend)
        return np.asarray(tau + np.sign(tau) * (x - y))

    @property
    @override
    def compares_true_torque(self) -> bool:
        """True for a motor that saturates: what is commanded beyond that moves nothing, and no motion tells it."""
        return bool(self.nonlinear_values["bend"] < 0)


def _fallen_behind(x: Array, bend: float) -> Array:
    """Solution y of x = y + bend y²/2, without cancellation."""
    return np.asarray(2 * x / (1 + np.sqrt(1 + 2 * bend * x)))


def _limited(y: Array, b: float) -> Array:
    """(1 − exp(−b y)) / b, continued with its least slope."""
    last = -np.log(_MIN_SLOPE) / b
    within = np.minimum(y, last)
    return np.asarray(-np.expm1(-b * within) / b + _MIN_SLOPE * (y - within))


def _before_limiting(x: Array, b: float) -> Array:
    """Inverse of `_limited`."""
    largest = (1 - _MIN_SLOPE) / b
    within = np.minimum(x, largest)
    return np.asarray(-np.log1p(-b * within) / b + (x - within) / _MIN_SLOPE)

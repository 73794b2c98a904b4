"""Torque ripple: cogging, gear mesh, eccentric encoders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.number_text import short_number
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm, JointTerms
from idtool.dynamics.effects.named_effect import NonlinearParameter, ParameterValue
from idtool.robot.model import RobotModel

_SPACING = 0.42  # periods over the travel between the n that are tried
_FEWEST = 1.2  # periods over the travel: fewer pass for springs and stops
_MAX_TRIALS = 220
_SLOW = 0.3  # of the rms speed, at which a wave must stay within the band to be seen


class _Wave(JointTerm):
    units = ("N·m", "N")
    lower = -np.inf
    even = False

    def angle(self, motion: Motion) -> Array:
        """Angle n q of the wave [rad]."""
        return np.asarray(self.nonlinear_values["periods"] * motion.q[self.joint])


class _Sine(_Wave):
    coefficient_name = "sine"  # A cos φ

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray(np.sin(self.angle(motion)))


class _Cosine(_Wave):
    coefficient_name = "cosine"  # A sin φ

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray(np.cos(self.angle(motion)))


class TorqueRipple(JointTerms):
    """A sin(n q + φ), identified as A cos φ sin(n q) + A sin φ cos(n q); a joint may have several with other n.

    n is nonlinear. It counts periods per turn of the joint, so that a motor's own are its gear ratio times those of its
    turn, and need not be whole. On a prismatic joint it is per 2π m.
    """

    id = "torque_ripple"
    description = "the torque varies periodically with the angle"
    excitation_hint = "slow motion over the whole travel at several speeds"
    cause = "position"
    generalizes = ("parallel_spring", "end_stop", "torque_offset")
    nonlinear_parameters = (
        NonlinearParameter(
            "periods",
            ("per turn", "per 2π m"),
            positive=True,
            distinguishes_instances=True,
            max_standard_error=0.3,
        ),
    )
    term_types = (_Sine, _Cosine)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Waves from about one period over the travel to those that leave the band even in slow motion."""
        turns = summary.q_range[joint] / (2 * np.pi)
        speed = summary.rms_velocity[joint]
        if not turns > 0 or not speed > 0:
            return
        fastest = 2 * np.pi * summary.band_hz / (_SLOW * speed)
        count = int(min((fastest - _FEWEST / turns) * turns / _SPACING, _MAX_TRIALS))
        for k in range(max(count, 0)):
            yield {"periods": float((_FEWEST + _SPACING * k) / turns)}

    @classmethod
    @override
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """A part of one period, which is as well a spring, a stop or an offset."""
        turns = float(summary.q_range[summary.model.names.index(str(joint))] / (2 * np.pi))
        periods_in_travel = float(values["periods"]) * turns
        if periods_in_travel >= 1:
            return ""
        return (
            f"the travel covers only {short_number(periods_in_travel, 2)} of its periods: it may be a spring, "
            "a stop or an offset"
        )

    @classmethod
    @override
    def linear_parameters(cls) -> tuple[str, ...]:
        return "amplitude", "phase"

    @classmethod
    @override
    def with_values(
        cls, model: RobotModel, joint: int, values: Mapping[str, float], nonlinear_values: Mapping[str, float]
    ) -> Self:
        amplitude, phase = values["amplitude"], values["phase"]
        prior = [amplitude * np.cos(phase), amplitude * np.sin(phase)]
        return cls(model, joint, prior, nonlinear_values)

    @override
    def parameters(self, theta: Array, covariance: Array) -> dict[str, ParameterValue]:
        """Amplitude and phase, errors to first order. The phase lies in [−π, π]."""
        amplitude = float(np.hypot(*theta))
        phase = float(np.arctan2(theta[1], theta[0]))
        if not amplitude or not np.isfinite(covariance).all():
            return {"amplitude": (amplitude, None), "phase": (phase, None)}
        amplitude_gradient = theta / amplitude
        phase_gradient = np.array([-amplitude_gradient[1], amplitude_gradient[0]]) / amplitude
        amplitude_error = float(np.sqrt(amplitude_gradient @ covariance @ amplitude_gradient))
        phase_error = float(np.sqrt(phase_gradient @ covariance @ phase_gradient))
        return {"amplitude": (amplitude, amplitude_error), "phase": (phase, phase_error)}

    @property
    @override
    def cause_period(self) -> float:
        return float(2 * np.pi / self.nonlinear_values["periods"])

    @override
    def parameter_units(self) -> dict[str, str]:
        return {**super().parameter_units(), "phase": "rad"}

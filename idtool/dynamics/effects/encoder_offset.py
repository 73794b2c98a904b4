"""Encoders whose zero is not the joint's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.fixed_effect import FixedJointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.mechanism import Mechanism

_MAX_OFFSET = 0.7  # rad or m: a larger one is another zero by intention


class EncoderOffset(FixedJointEffect):
    """True q = measured q + offset. A controller acts on the measured one."""

    id = "encoder_offset"
    is_countable = True
    is_screened_to_first_order = True
    description = "the zero position of the encoder differs from that of the joint"
    cause = "position"
    excitation_hint = (
        "standstill at positions over the whole travel, also with the base turned over or tilted by a known angle"
    )
    nonlinear_parameters = (NonlinearParameter("offset", ("rad", "m")),)

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
        zeros = np.zeros_like(motion.t)
        return linearized.torque_change_by_motion(joint, zeros + 1, zeros, zeros)

    @classmethod
    @override
    def values_from_coefficient(cls, c: float, nonlinear_values: Mapping[str, float]) -> Mapping[str, float] | None:
        return {"offset": c} if abs(c) < _MAX_OFFSET else None

    @override
    def correct_motion(self, motion: Motion) -> Motion:
        q = motion.q.copy()
        q[self.joint] += self.nonlinear_values["offset"]
        return replace(motion, q=q)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.position_offset[self.joint] += self.nonlinear_values["offset"]

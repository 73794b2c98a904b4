"""Springs across a joint and what acts like one: hoses, cable bundles, balancers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.number_text import short_number
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.simulator_element import SimulatorElement, Spring
from idtool.robot.config import EffectEntry

_MAX_REST_DISTANCE = 20.0  # of the travel, from its middle: farther away, the torque varies by less than 5 %


class ParallelSpring(JointTerm):
    """k (q − q0). The rest position q0 is nonlinear; it does not matter on a joint with a torque offset."""

    id = "parallel_spring"
    is_countable = True
    description = "a spring acts across the joint"
    excitation_hint = "slow motion over the whole travel"
    cause = "position"
    generalizes = ("torque_offset",)
    coefficient_name = "stiffness"
    is_commonplace = True
    units = ("N·m/rad", "N/m")
    nonlinear_parameters = (NonlinearParameter("rest_position", ("rad", "m"), arbitrary_beside="torque_offset"),)

    @classmethod
    @override
    def probe(cls, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
        """Probe with the coefficients k and −k q0; on a joint with an offset k alone, about q0 = 0."""
        name = summary.model.names[joint]
        has_offset = summary.has_effect("torque_offset", name)
        count = 1 if has_offset else 2

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            rows = np.stack([motion.q[joint], np.ones_like(motion.t)])
            return {joint: rows[:count]}

        def to_entry(c: Array, information: Array) -> EffectEntry:
            rest_position = 0.0
            if not has_offset and c[0]:
                rest_position = -c[1] / c[0]
            return cls.to_entry(summary.model, joint, {"stiffness": c[0], "rest_position": rest_position})

        return Probe(
            effect=cls.id,
            joint=name,
            link=None,
            columns=columns,
            coefficient_count=count,
            to_entry=to_entry,
            lower=(cls.lower, -np.inf)[:count],
        )

    @classmethod
    @override
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """A spring that is at rest so far from the motion that its torque is an offset."""
        if summary.has_effect("torque_offset", str(joint)):
            return ""  # the rest position has no influence then
        j = summary.model.names.index(str(joint))
        middle = (summary.q_min[j] + summary.q_max[j]) / 2
        rest_position = float(values["rest_position"])
        if abs(rest_position - middle) <= _MAX_REST_DISTANCE * summary.q_range[j]:
            return ""
        return (
            "its torque hardly varies over the travel, as it would be at rest at "
            f"{short_number(rest_position)}: an offset"
        )

    @override
    def column(self, motion: Motion) -> Array:
        return np.asarray(motion.q[self.joint] - self.nonlinear_values["rest_position"])

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        return (Spring(int(self.joint), float(theta[0]), float(self.nonlinear_values["rest_position"])),)

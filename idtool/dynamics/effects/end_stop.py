"""End stops: springs that a joint runs into."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.simulator_element import OneSidedSpring, SimulatorElement
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import UrdfJoint

_SHARES = (0.02, 0.04, 0.07, 0.1, 0.14, 0.19, 0.25, 0.32)  # of the travel that lie beyond the positions tried


class EndStop(JointTerm):
    """k (q − position) beyond the position, and nothing before it.

    Beyond means above it with a ``side`` of 1, and below it with one of −1. By default, that is on the side of the
    joint's limit that is nearer to it where the URDF has both, else away from zero. The position is nonlinear; a joint
    may have several stops.
    """

    id = "end_stop"
    is_countable = True
    description = "an elastic end stop acts beyond a position"
    excitation_hint = "slow motion into the end stop and out of it"
    cause = "position"
    generalizes = ("parallel_spring", "torque_offset")
    coefficient_name = "stiffness"
    units = ("N·m/rad", "N/m")
    even = False
    nonlinear_parameters = (
        NonlinearParameter("position", ("rad", "m"), distinguishes_instances=True, max_standard_error=0.03),
        NonlinearParameter("side", choices=(-1.0, 1.0)),
    )

    def __init__(
        self, model: RobotModel, joint: int, prior: float = 0.0, nonlinear_values: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(model, joint, prior, nonlinear_values)
        usual_side = _usual_side(model.joints[joint], self.nonlinear_values["position"])
        self.nonlinear_values.setdefault("side", usual_side)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Stops towards both ends of the travel, wherever the joint's limits are."""
        low, travel = float(summary.q_min[joint]), float(summary.q_range[joint])
        if not travel > 0:
            return
        for share in _SHARES:
            yield {"position": low + share * travel, "side": -1.0}
            yield {"position": low + (1 - share) * travel, "side": 1.0}

    @classmethod
    @override
    def to_entry(cls, model: RobotModel, joint: int, values: Mapping[str, float]) -> EffectEntry:
        given = dict(values)
        if given.get("side") == _usual_side(model.joints[joint], given["position"]):
            del given["side"]
        return super().to_entry(model, joint, given)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        super().add_to_forward_model(theta, mechanism)
        mechanism.breakpoints.append((int(self.joint), self.nonlinear_values["position"]))

    @override
    def column(self, motion: Motion) -> Array:
        side = self.nonlinear_values["side"]
        depth = np.maximum(side * (motion.q[self.joint] - self.nonlinear_values["position"]), 0.0)
        return np.asarray(side * depth)

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        position = float(self.nonlinear_values["position"])
        side = float(self.nonlinear_values["side"])
        return (OneSidedSpring(int(self.joint), float(theta[0]), position, side),)


def _usual_side(joint: UrdfJoint, position: float) -> float:
    """Side of a stop by the joint's limits: 1 if it acts above the position, −1 if below."""
    limited = np.isfinite(joint.lower) and np.isfinite(joint.upper) and joint.lower < joint.upper
    middle = (joint.lower + joint.upper) / 2 if limited else 0.0
    return 1.0 if position >= middle else -1.0

"""Torque of one joint that leaks into another: cables and belts led past a joint, differentials out of trim."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.load_dependent_term import LoadDependentTerm
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.simulator_element import SimulatorElement, TorqueTransfer
from idtool.robot.model import RobotModel

# By whether the receiving joint and the source joint are prismatic.
_UNITS = {(False, False): "1", (False, True): "m", (True, False): "1/m", (True, True): "1"}


class TransmissionCoupling(LoadDependentTerm):
    """−c tau_source: the joint is driven by its own actuator torque and c times that of the source joint.

    For the same motion it then needs so much less of its own. A joint may have several sources.
    """

    id = "transmission_coupling"
    description = "part of another joint's torque acts on this one"
    excitation_hint = "motion of each joint alone"
    cause = "torque"
    coefficient_name = "coefficient"
    lower = -np.inf
    even = False
    nonlinear_parameters = (NonlinearParameter("source", is_joint=True, distinguishes_instances=True),)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """The joints before and behind it, whose cables and belts may be led past it."""
        name = summary.model.names[joint]
        for source in _neighbours(summary.model, joint):
            if (cls.id, name, float(source)) not in summary.effect_keys:
                yield {"source": float(source)}

    @override
    def unit_on(self, model: RobotModel, joint: int) -> str:
        source = int(self.nonlinear_values["source"])
        receiver_is_prismatic = model.joints[joint].kind == "prismatic"
        source_is_prismatic = model.joints[source].kind == "prismatic"
        return _UNITS[receiver_is_prismatic, source_is_prismatic]

    @property
    @override
    def cause_joint(self) -> int:
        return int(self.nonlinear_values["source"])

    @override
    def column(self, motion: Motion) -> Array:
        source = np.reshape(self.nonlinear_values["source"], np.shape(self.joint)).astype(np.intp)
        return -motion.tau[source]

    @override
    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        return (TorqueTransfer(int(self.joint), int(self.nonlinear_values["source"]), float(theta[0])),)


def _neighbours(model: RobotModel, joint: int) -> list[int]:
    """Joints on a common path from the base with a joint: those before it and behind it."""
    neighbours: set[int] = set()
    for i in range(len(model.bodies)):
        path = _moving_joints(model, i)
        if joint in path:
            neighbours |= path
    return sorted(neighbours - {joint})


def _moving_joints(model: RobotModel, i: int) -> set[int]:
    """Joints that move a body."""
    joints: set[int] = set()
    while i >= 0:
        body = model.bodies[i]
        joints |= set(np.flatnonzero(body.ratios).tolist())
        i = body.mount.body
    return joints

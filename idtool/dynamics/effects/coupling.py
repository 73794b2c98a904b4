"""Torque of one joint that leaks into another: cables and belts led past a joint, differentials out of trim."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.loaded_term import LoadedTerm
from idtool.dynamics.effects.survey import Survey
from idtool.robot.model import Model

_UNITS = {(False, False): "1", (False, True): "m", (True, False): "1/m", (True, True): "1"}


class TransmissionCoupling(LoadedTerm):
    """−c tau_source: the joint is driven by its own actuator torque and c times that of the source joint.

    So it takes so much less of its own for the same motion. A joint may have several sources.
    """

    id = "transmission_coupling"
    means = "torque of another joint leaks into this one"
    shows = "motion of each joint alone"
    name = "coefficient"
    lower = -np.inf
    even = False
    held = (Held("source", joint=True, apart=True),)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: the joints before and behind it, whose cables and belts may be led past it."""
        for source in _beside(survey.model, joint):
            if (cls.id, survey.model.names[joint], float(source)) not in survey.taken:
                yield {"source": float(source)}

    def unit_in(self, model: Model, joint: int) -> str:
        """See `JointTerm.unit_in`."""
        receiver, source = (model.joints[j].kind == "prismatic" for j in (joint, int(self.shape["source"])))
        return _UNITS[receiver, source]

    def column(self, motion: Motion) -> Array:
        """The source's torque, the other way."""
        source = np.reshape(self.shape["source"], np.shape(self.joint)).astype(np.intp)
        return -motion.tau[source]


def _beside(model: Model, joint: int) -> list[int]:
    """Joints that move some body together with a joint: those before it and behind it."""
    moved = [set(np.flatnonzero(body.ratios).tolist()) | _above(model, i) for i, body in enumerate(model.bodies)]
    found: set[int] = set()
    for chain in moved:
        if joint in chain:
            found |= chain
    return sorted(found - {joint})


def _above(model: Model, i: int) -> set[int]:
    """Joints that a body hangs on."""
    found: set[int] = set()
    while (i := model.bodies[i].mount.body) >= 0:
        found |= set(np.flatnonzero(model.bodies[i].ratios).tolist())
    return found

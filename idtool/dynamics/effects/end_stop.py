"""End stops: what a joint runs into."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.survey import Survey
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.model import Model
from idtool.robot.urdf.reading import Joint

_SHARES = (0.02, 0.04, 0.07, 0.1, 0.14, 0.19, 0.25, 0.32)  # of the travel that lie beyond


class EndStop(JointTerm):
    """k (q − position) beyond the position, and nothing before it.

    Beyond means above it or below it: on the side of the joint's limit that is nearer to it where the URDF has both,
    else away from zero. The position is held; a joint may have several stops.
    """

    id = "end_stop"
    means = "a stop pushes back beyond a position"
    shows = "slow motion into the region and out of it"
    contains = ("parallel_spring", "torque_offset")
    name = "stiffness"
    unit = ("N·m/rad", "N/m")
    even = False
    held = (Held("position", apart=True, error=0.03),)

    def __init__(self, model: Model, joint: int, prior: float = 0.0, shape: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, prior, shape)
        self.shape["side"] = _side(model.joints[joint], self.shape["position"])

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: towards both ends of the travel."""
        low, travel = survey.low[joint], survey.travel[joint]
        for share in _SHARES:
            for position in (low + share * travel, low + (1 - share) * travel):
                above = position > low + travel / 2
                if travel > 0 and (_side(survey.model.joints[joint], position) > 0) == above:
                    yield {"position": float(position)}

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        super().join(theta, mechanism)
        mechanism.stops.append((int(self.joint), self.shape["position"]))

    def column(self, motion: Motion) -> Array:
        """How far the joint is beyond the position."""
        side = self.shape["side"]
        return np.asarray(side * np.maximum(side * (motion.q[self.joint] - self.shape["position"]), 0.0))


def _side(joint: Joint, position: float) -> float:
    """1 for a stop that acts above the position, −1 for one below."""
    limited = np.isfinite(joint.lower) and np.isfinite(joint.upper) and joint.lower < joint.upper
    middle = (joint.lower + joint.upper) / 2 if limited else 0.0
    return 1.0 if position >= middle else -1.0

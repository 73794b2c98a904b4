"""`JointTerm`: the base of effects that are one coefficient times one column on one joint."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from idtool.effects.base import Coefficient, Effect
from idtool.model import Model
from idtool.signals import Motion

Array = NDArray[np.float64]


class JointTerm(Effect):
    """One coefficient on one joint.

    Attributes
    ----------
    id, name
        The effect's id and the coefficient's name (contract section 6).
    unit
        For a revolute joint, and for a prismatic one.
    lower
        The least value that physics allows.
    even
        Whether the coefficient stays as it is when the joint's direction is turned round.
    held
        Names of the effect's other parameters, on which its column depends.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    prior
        The coefficient before any data.
    shape
        Values of the parameters in ``held``.
    """

    id: str
    name: str
    unit: tuple[str, str]
    lower: float = 0.0
    even: bool = True
    held: tuple[str, ...] = ()

    def __init__(self, model: Model, joint: int, prior: float = 0.0, shape: Mapping[str, float] | None = None) -> None:
        self.joint = joint
        self.shape = dict(shape or {})
        owner = model.joints[joint]
        unit = self.unit[owner.kind == "prismatic"]
        self.coefficients = (Coefficient(self.id, owner.name, self.name, unit, prior, lower=self.lower),)
        self.active = tuple(np.arange(int(j == joint)) for j in range(len(model.joints)))

    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """See `Effect.write`."""
        out[self.joint][0] = self.column(motion)

    @abstractmethod
    def column(self, motion: Motion) -> Array:
        """Torque per unit of the coefficient, shape (N,)."""

"""`HeldEffect`, `HeldJointEffect`: effects whose parameters are all held, which add no unknown to the equation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.base import Coefficient
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.named import NamedEffect, Value
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model


class HeldEffect(NamedEffect):
    """An effect without coefficients.

    Parameters
    ----------
    model
        The robot.
    """

    coefficients: tuple[Coefficient, ...] = ()

    def __init__(self, model: Model) -> None:
        self.active = tuple(np.arange(0) for _ in model.joints)

    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """See `Effect.write`; there is no column."""

    def parameters(self, theta: Array, covariance: Array) -> dict[str, Value]:
        """See `NamedEffect.parameters`; none is identified."""
        return {}


class HeldJointEffect(HeldEffect, JointEffect):
    """An effect on one joint without coefficients.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    shape
        Values of the parameters.
    """

    joint: int

    def __init__(self, model: Model, joint: int, shape: Mapping[str, float] | None = None) -> None:
        HeldEffect.__init__(self, model)
        JointEffect.__init__(self, model, joint, shape)

    @classmethod
    def made(cls) -> tuple[str, ...]:
        """See `JointEffect.made`."""
        return ()

    @classmethod
    def with_values(cls, model: Model, joint: int, values: Mapping[str, float], shape: Mapping[str, float]) -> Self:
        """See `JointEffect.with_values`."""
        return cls(model, joint, shape)

    @classmethod
    @abstractmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """By how much the predicted torque changes, to first order, with a unit of the coefficient; shape (nv, N)."""

    @classmethod
    @abstractmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """All parameters by the coefficient and the values tried; None where it cannot be."""

    @classmethod
    def probe(cls, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
        """See `JointEffect.probe`."""

        def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
            change = cls.slopes(survey, joint, shape, motion, present)
            return {j: row[None] for j, row in enumerate(change) if row.any()}

        def entry(c: Array, information: Array) -> EffectEntry | None:
            values = cls.solved(float(c[0]), shape)
            return None if values is None else cls.entry(survey.model, joint, values)

        return Probe(cls.id, survey.model.names[joint], None, columns, 1, entry, shape)


def only(joint: int, row: Array, motion: Motion) -> Array:
    """A change of one joint's torque, shape (N,), among all; shape (nv, N)."""
    change = np.zeros_like(motion.q)
    change[joint] = row
    return change

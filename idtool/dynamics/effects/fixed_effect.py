"""`FixedEffect`, `FixedJointEffect`: effects of nonlinear parameters only, which add no unknown to the equation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.effect import Coefficient
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NamedEffect, ParameterValue
from idtool.dynamics.effects.probe import Probe
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel


class FixedEffect(NamedEffect):
    """An effect without coefficients.

    Parameters
    ----------
    model
        The robot.
    """

    coefficients: tuple[Coefficient, ...] = ()

    def __init__(self, model: RobotModel) -> None:
        self.active = tuple(np.arange(0) for _ in model.joints)

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        pass

    @override
    def parameters(self, theta: Array, covariance: Array) -> dict[str, ParameterValue]:
        return {}


class FixedJointEffect(FixedEffect, JointEffect):
    """An effect on one joint without coefficients.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    nonlinear_values
        Values of the parameters.
    """

    joint: int

    def __init__(self, model: RobotModel, joint: int, nonlinear_values: Mapping[str, float] | None = None) -> None:
        FixedEffect.__init__(self, model)
        JointEffect.__init__(self, model, joint, nonlinear_values)

    @classmethod
    @override
    def linear_parameters(cls) -> tuple[str, ...]:
        return ()

    @classmethod
    @override
    def with_values(
        cls, model: RobotModel, joint: int, values: Mapping[str, float], nonlinear_values: Mapping[str, float]
    ) -> Self:
        return cls(model, joint, nonlinear_values)

    @classmethod
    @abstractmethod
    def torque_derivative(
        cls,
        summary: DataSummary,
        joint: int,
        nonlinear_values: Mapping[str, float],
        motion: Motion,
        linearized: Linearization,
    ) -> Array:
        """Derivative of the predicted torque by the coefficient of the effect's probe, shape (nv, N)."""

    @classmethod
    @abstractmethod
    def values_from_coefficient(cls, c: float, nonlinear_values: Mapping[str, float]) -> Mapping[str, float] | None:
        """All parameters, from the probe's coefficient and the values tried; None if there is no such effect."""

    @classmethod
    @override
    def probe(cls, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            change = cls.torque_derivative(summary, joint, nonlinear_values, motion, linearized)
            return {j: row[None] for j, row in enumerate(change) if row.any()}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            values = cls.values_from_coefficient(float(c[0]), nonlinear_values)
            if values is None:
                return None
            return cls.to_entry(summary.model, joint, values)

        return Probe(
            effect=cls.id,
            joint=summary.model.names[joint],
            link=None,
            columns=columns,
            coefficient_count=1,
            to_entry=to_entry,
            nonlinear_values=nonlinear_values,
        )


def single_joint_torque(joint: int, torque: Array, motion: Motion) -> Array:
    """Torque of one joint, shape (N,), among zeros for the others; shape (nv, N)."""
    out = np.zeros_like(motion.q)
    out[joint] = torque
    return out

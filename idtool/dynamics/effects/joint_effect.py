"""`JointEffect`: an effect that acts on one joint, and its reading from an entry of a configuration."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ConfigError
from idtool.common.names import printable
from idtool.common.number_text import short_number
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.effect import Effect
from idtool.dynamics.effects.entry_parameters import (
    check_parameter_names,
    entry_location,
    read_joint_index,
    read_number,
)
from idtool.dynamics.effects.named_effect import NamedEffect, NonlinearParameter, ParameterValue
from idtool.dynamics.effects.probe import Probe
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MIN_POSITIVE = 1e-6  # SI: the inverse square of a smaller number is not finite


class JointEffect(NamedEffect):
    """An effect on one joint.

    Attributes
    ----------
    joint
        Index of the joint.
    owner
        Name of the joint.
    is_prismatic
        True for a prismatic joint.
    nonlinear_values
        Values of the nonlinear parameters, and what follows from them.
    optional_linear_parameters
        The linear parameters that an entry may leave out; they are then 0.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    nonlinear_values
        Values of the nonlinear parameters.
    """

    optional_linear_parameters: tuple[str, ...] = ()

    def __init__(self, model: RobotModel, joint: int, nonlinear_values: Mapping[str, float] | None = None) -> None:
        self.joint: int | Indices = joint
        self.owner = model.joints[joint].name
        self.is_prismatic = model.joints[joint].kind == "prismatic"
        self.nonlinear_values: dict[str, Any] = {}
        for parameter in self.nonlinear_parameters:
            if parameter.optional_maximum is not None:
                self.nonlinear_values[parameter.name] = 0.0
        self.nonlinear_values |= nonlinear_values or {}

    @classmethod
    @abstractmethod
    def linear_parameters(cls) -> tuple[str, ...]:
        """Names of the parameters that follow from the coefficients."""

    @classmethod
    def may_act_on(cls, model: RobotModel, joint: int) -> bool:
        """False on a joint of the robot whose model has the effect in another form."""
        has_rotor = any(body.kind == "rotor" and body.ratios[joint] for body in model.bodies)
        return not (cls.is_rotor_inertia and has_rotor)

    @classmethod
    def zero_entry(cls, joint: str) -> EffectEntry:
        """Configuration entry on a joint with all parameters at 0 that may not be left out."""
        names = list(cls.linear_parameters())
        names += [parameter.name for parameter in cls.nonlinear_parameters if not parameter.may_be_left_out]
        return EffectEntry(effect=cls.id, joint=joint, parameters=dict.fromkeys(names, 0.0))

    @classmethod
    @abstractmethod
    def with_values(
        cls, model: RobotModel, joint: int, values: Mapping[str, float], nonlinear_values: Mapping[str, float]
    ) -> Self:
        """Effect with given values of the linear and of the nonlinear parameters."""

    @classmethod
    @override
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> Self:
        if entry.joint is None or entry.link is not None:
            raise ConfigError(entry_location(entry), "acts on a joint; give `joint` and not `link`")
        joint = read_joint_index(entry, entry.joint, model)
        given = [
            parameter
            for parameter in cls.nonlinear_parameters
            if parameter.name in entry.parameters or not parameter.may_be_left_out
        ]
        optional = cls.optional_linear_parameters
        required = [name for name in cls.linear_parameters() if name not in optional]
        required += [parameter.name for parameter in given]
        check_parameter_names(entry, tuple(required), optional)

        values: dict[str, float] = {}
        for name in cls.linear_parameters():
            values[name] = read_number(entry, name) if name in entry.parameters else 0.0
        nonlinear_values = {parameter.name: _read_nonlinear(entry, parameter, model, joint) for parameter in given}
        effect = cls.with_values(model, joint, values, nonlinear_values)
        for c in effect.coefficients:
            if c.prior < c.lower:
                raise ConfigError(
                    entry_location(entry), f"{c.name} of {c.prior:g} is out of range; give {c.lower:g} or more"
                )
        return effect

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        may_repeat = any(parameter.distinguishes_instances for parameter in cls.nonlinear_parameters)
        for index, joint in enumerate(summary.model.joint_names):
            if summary.has_effect(cls.id, joint) and not may_repeat:
                continue
            for nonlinear_values in cls.trial_values(summary, index):
                probe = cls.probe(summary, index, nonlinear_values)
                yield replace(probe, rebuild=partial(cls.probe, summary, index))

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in cls.nonlinear_parameters if parameter.is_continuous)

    @classmethod
    @override
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """Dry friction that is larger than any torque of the joint."""
        largest_friction = cls.dry_friction(values)
        peak = float(summary.peak_torque[summary.model.names.index(str(joint))])
        if largest_friction <= peak:
            return ""
        return (
            f"its friction, {short_number(largest_friction)}, is larger than the largest torque of the joint, "
            f"{short_number(peak)}"
        )

    @classmethod
    def dry_friction(cls, values: Mapping[str, Any]) -> float:
        """Largest dry friction torque by the parameters [N·m or N]; 0 if the effect is none."""
        return 0.0

    @classmethod
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Values of the nonlinear parameters to try on a joint; nothing where the joint can't have the effect."""
        if cls.may_act_on(summary.model, joint):
            yield {}

    @classmethod
    @abstractmethod
    def probe(cls, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
        """Probe of the effect on a joint at given nonlinear values."""

    @classmethod
    def to_entry(cls, model: RobotModel, joint: int, values: Mapping[str, float]) -> EffectEntry:
        """Configuration entry with values of all parameters."""
        joint_names = {parameter.name for parameter in cls.nonlinear_parameters if parameter.is_joint}
        given: dict[str, Any] = {}
        for name, value in values.items():
            given[name] = model.names[int(value)] if name in joint_names else float(value)
        return EffectEntry(effect=cls.id, joint=model.names[joint], parameters=given)

    @property
    def instance(self) -> tuple[float, ...]:
        """Values that distinguish the effect from others of its kind on the joint."""
        return tuple(
            self.nonlinear_values[parameter.name]
            for parameter in self.nonlinear_parameters
            if parameter.distinguishes_instances
        )

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return self.id, self.owner, *self.instance

    @override
    def distance_to(self, other: NamedEffect) -> float:
        if not isinstance(other, JointEffect) or (self.id, self.owner) != (other.id, other.owner):
            return np.inf
        distance = 0.0
        for parameter in self.nonlinear_parameters:
            if not parameter.distinguishes_instances:
                continue
            value, other_value = self.nonlinear_values[parameter.name], other.nonlinear_values[parameter.name]
            if value != other_value:
                relative = abs(value - other_value) / max(abs(value), abs(other_value))
                distance = max(distance, np.inf if parameter.is_joint else relative)
        return distance

    @property
    @override
    def column_key(self) -> Hashable | None:
        depends_on_model = type(self).set_operating_point is not Effect.set_operating_point
        if depends_on_model:
            return None
        return type(self), int(self.joint), tuple(sorted(self.nonlinear_values.items()))

    @override
    def parameters(self, theta: Array, covariance: Array) -> dict[str, ParameterValue]:
        errors = np.sqrt(np.diag(covariance))
        parameters: dict[str, ParameterValue] = {}
        for name, value, error in zip(self.linear_parameters(), theta, errors, strict=True):
            parameters[name] = (float(value), float(error) if np.isfinite(error) else None)
        return parameters

    @override
    def parameter_units(self) -> dict[str, str]:
        units = {name: c.unit for name, c in zip(self.linear_parameters(), self.coefficients, strict=True)}
        for parameter in self.nonlinear_parameters:
            units[parameter.name] = parameter.units[self.is_prismatic]
        return units


def _read_nonlinear(entry: EffectEntry, parameter: NonlinearParameter, model: RobotModel, joint: int) -> float:
    """Value of a nonlinear parameter; a joint's index where it names one."""
    name = parameter.name
    if parameter.is_joint:
        index = read_joint_index(entry, entry.parameters[name], model, name)
        if index == joint:
            own = printable(model.names[joint])
            raise ConfigError(entry_location(entry), f"{name} must not be the joint {own} itself; name another joint")
        return float(index)

    maximum = parameter.optional_maximum
    value = read_number(entry, name)
    if parameter.choices and value not in parameter.choices:
        allowed = " or ".join(f"{choice:g}" for choice in parameter.choices)
        raise ConfigError(entry_location(entry), f"{name} of {value:g} is out of range; give {allowed}")
    if maximum is not None and not 0 <= value <= maximum:
        what = f"{name} of {value:g} is out of range; give a value from 0 to {maximum:g}"
        raise ConfigError(entry_location(entry), what)
    if parameter.positive and value < _MIN_POSITIVE:
        raise ConfigError(entry_location(entry), f"{name} of {value:g} is out of range; give {_MIN_POSITIVE:g} or more")
    return value

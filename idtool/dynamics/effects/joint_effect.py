"""`JointEffect`: an effect that acts on one joint, and how an entry of a configuration is read as one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ConfigError
from idtool.common.names import shown
from idtool.dynamics.effects.named import NamedEffect, Value, check_names, joint_index, number, place
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Survey
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model

_LEAST = 1e-6  # SI, of what must be above 0: the inverse square of what is smaller is not finite


@dataclass(frozen=True)
class Held:
    """A parameter on which an effect's columns depend.

    Attributes
    ----------
    name
        As in the contract.
    positive
        Whether it must be above 0.
    joint
        Whether it is the name of another joint, whose index the effect then holds.
    apart
        Whether a joint may have the effect more than once, with different values of this.
    error
        The largest that its standard error may be where the effect is named; None: a share of the value.
    most
        Of one that may be left out, which is then 0, the largest; None: it may not.
    """

    name: str
    positive: bool = False
    joint: bool = False
    apart: bool = False
    error: float | None = None
    most: float | None = None


class JointEffect(NamedEffect):
    """An effect on one joint.

    Attributes
    ----------
    held
        The parameters on which its columns depend.
    joint
        Index of the joint.
    shape
        Values of the parameters in ``held``, and what follows from them.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    shape
        Values of the parameters in ``held``.
    """

    held: tuple[Held, ...] = ()

    def __init__(self, model: Model, joint: int, shape: Mapping[str, float] | None = None) -> None:
        self.joint: int | Indices = joint
        self.shape: dict[str, Any] = {held.name: 0.0 for held in self.held if held.most is not None} | dict(shape or {})
        self.owner = model.joints[joint].name

    @classmethod
    @abstractmethod
    def made(cls) -> tuple[str, ...]:
        """Names of the parameters that its coefficients make."""

    @classmethod
    @abstractmethod
    def with_values(cls, model: Model, joint: int, values: Mapping[str, float], shape: Mapping[str, float]) -> Self:
        """The effect with values of the parameters that its coefficients make, and of those held."""

    @classmethod
    def of(cls, entry: EffectEntry, model: Model) -> Self:
        """See `NamedEffect.of`."""
        if entry.joint is None or entry.link is not None:
            raise ConfigError(place(entry), "acts on a joint; give joint, and no link")
        joint = joint_index(entry, entry.joint, model)
        optional = [held.name for held in cls.held if held.most is not None and held.name not in entry.parameters]
        check_names(entry, (*cls.made(), *(held.name for held in cls.held if held.name not in optional)))
        values = {name: number(entry, name) for name in cls.made()}
        shape = {held.name: _held(entry, held, model, joint) for held in cls.held}
        effect = cls.with_values(model, joint, values, shape)
        for c in effect.coefficients:
            if c.prior < c.lower:
                raise ConfigError(place(entry), f"{c.name} of {c.prior:g} cannot be; give {c.lower:g} or more")
        return effect

    @classmethod
    def probes(cls, survey: Survey) -> Iterator[Probe]:
        """See `NamedEffect.probes`."""
        several = any(held.apart for held in cls.held)
        for joint, moving in enumerate(survey.model.joints):
            if several or not survey.has(cls.id, moving.name):
                for shape in cls.tried(survey, joint):
                    yield replace(cls.probe(survey, joint, shape), again=partial(cls.probe, survey, joint))

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """See `NamedEffect.shapes`."""
        return tuple(held.name for held in cls.held if not held.joint)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """Values of the parameters in ``held`` to try on a joint; nothing where the joint cannot have the effect."""
        yield {}

    @classmethod
    @abstractmethod
    def probe(cls, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
        """The effect at some values on a joint."""

    @classmethod
    def entry(cls, model: Model, joint: int, values: Mapping[str, float]) -> EffectEntry:
        """The entry of a configuration with values of all parameters."""
        names = {held.name for held in cls.held if held.joint}
        given = {k: model.names[int(x)] if k in names else float(x) for k, x in values.items()}
        return EffectEntry(effect=cls.id, joint=model.names[joint], parameters=given)

    @property
    def among(self) -> tuple[float, ...]:
        """What tells it from others of its kind on the joint."""
        return tuple(self.shape[held.name] for held in self.held if held.apart)

    @property
    def key(self) -> tuple[str | float, ...]:
        """See `NamedEffect.key`."""
        return self.id, self.owner, *self.among

    def parameters(self, theta: Array, covariance: Array) -> dict[str, Value]:
        """See `NamedEffect.parameters`."""
        errors = np.sqrt(np.diag(covariance))
        return {
            name: (float(value), float(error) if np.isfinite(error) else None)
            for name, value, error in zip(self.made(), theta, errors, strict=True)
        }


def _held(entry: EffectEntry, held: Held, model: Model, joint: int) -> float:
    """The value of a held parameter; a joint's index where it names one."""
    if held.joint:
        index = joint_index(entry, entry.parameters[held.name], model, held.name)
        if index == joint:
            own = shown(model.names[joint])
            raise ConfigError(place(entry), f"{held.name} {own} is the joint itself; name another")
        return float(index)
    if held.most is not None and held.name not in entry.parameters:
        return 0.0
    value = number(entry, held.name)
    if held.most is not None and not 0 <= value <= held.most:
        raise ConfigError(place(entry), f"{held.name} of {value:g} cannot be; give one from 0 to {held.most:g}")
    if held.positive and value < _LEAST:
        raise ConfigError(place(entry), f"{held.name} of {value:g} cannot be; give {_LEAST:g} or more")
    return value

"""`JointTerm` and `DryFriction`: one coefficient times one column on one joint; `JointTerms`: several of them.

The column is all there is to write: forwards it is the torque at the simulated state. Dry friction gives its level
instead, from which both follow: the column is the level times the direction of motion; forwards it is what a joint at
rest can hold. A term is evaluated for several joints at once, ``joint`` being an array and the values in ``shape``
columns; indexing and elementwise arithmetic need no care for that.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.base import Coefficient
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model

_FAST = 0.1  # widths a sample above which the sign changes within it
_SURE = 3.0  # widths of the rounded sign beyond which it is ±1 to half a percent


class JointTerm(JointEffect):
    """One coefficient on one joint.

    Attributes
    ----------
    name
        The coefficient's name (contract section 6).
    unit
        For a revolute joint, and for a prismatic one.
    lower, upper
        What physics allows.
    even
        Whether the coefficient stays as it is when the joint's direction is turned round.

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

    name: str
    unit: tuple[str, str]
    lower: float = 0.0
    upper: float = np.inf
    even: bool = True

    def __init__(self, model: Model, joint: int, prior: float = 0.0, shape: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, shape)
        coefficient = Coefficient(
            effect=self.id,
            owner=self.owner,
            name=self.name,
            unit=self.unit_in(model, joint),
            prior=prior,
            lower=self.lower,
            upper=self.upper,
            even=self.even,
            among=self.among,
        )
        self.coefficients = (coefficient,)
        self.active = tuple(np.arange(int(j == joint)) for j in range(len(model.joints)))

    @classmethod
    def made(cls) -> tuple[str, ...]:
        """See `JointEffect.made`."""
        return (cls.name,)

    @classmethod
    def with_values(cls, model: Model, joint: int, values: Mapping[str, float], shape: Mapping[str, float]) -> Self:
        """See `JointEffect.with_values`."""
        return cls(model, joint, values[cls.name], shape)

    @classmethod
    def probe(cls, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
        """See `JointEffect.probe`."""
        return probe_of(cls.with_values(survey.model, joint, {cls.name: 0.0}, shape), survey, joint, shape)

    def unit_in(self, model: Model, joint: int) -> str:
        """The coefficient's unit on a joint."""
        return self.unit[model.joints[joint].kind == "prismatic"]

    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """See `Effect.write`."""
        out[int(self.joint)][0] = self.column(motion)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.smooth.append((self, float(theta[0])))

    @abstractmethod
    def column(self, motion: Motion) -> Array:
        """Torque per unit of the coefficient, shape (N,); (k, N) for k joints."""


class DryFriction(JointTerm):
    """One coefficient on one joint whose torque is a level times the direction of motion."""

    friction = True

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.dry.append((self, float(theta[0])))

    @abstractmethod
    def level(self, motion: Motion) -> Array:
        """What it takes to move, per unit of the coefficient, shape (N,); (k, N) for k joints."""

    def column(self, motion: Motion) -> Array:
        """The level times the direction of motion, rounded where v is too small to have one.

        The direction is the mean over the time from half a sample before to half a sample after.
        """
        x = motion.v[self.joint] / motion.still[self.joint]
        return mean_within(np.tanh(x), x, log_cosh) * self.level(motion)

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """Where the joint rests: friction there can be anything up to its level."""
        joint = int(self.joint)
        return {joint: np.abs(motion.v[joint]) < _SURE * motion.still[joint]}


def mean_within(f: Array, x: Array, integral: Callable[[Array], Array]) -> Array:
    """Means of a function over the time from half a sample before to half a sample after.

    Parameters
    ----------
    f
        The function at the samples, which is its mean where x hardly changes, shape (N,).
    x
        Its argument, in units in which the function changes over 1 at the fastest, shape (N,).
    integral
        Its integral over x.
    """
    edge = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    change = np.diff(edge)
    fast = np.abs(change) > _FAST
    mean = f.copy()
    mean[fast] = np.diff(integral(edge))[fast] / change[fast]
    return mean


def log_cosh(x: Array) -> Array:
    """The integral of tanh, but for a constant."""
    return np.asarray(np.logaddexp(x, -x))


class JointTerms(JointEffect):
    """Several coefficients on one joint: terms that share their shape values.

    Attributes
    ----------
    kinds
        The terms, in the order of the coefficients. They bear no id.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    prior
        The coefficients before any data; none: 0.
    shape
        Values of the parameters in ``held``.
    """

    kinds: tuple[type[JointTerm], ...] = ()

    def __init__(
        self, model: Model, joint: int, prior: Sequence[float] = (), shape: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(model, joint, shape)
        priors = prior or [0.0] * len(self.kinds)
        self.terms = tuple(kind(model, joint, x, shape) for kind, x in zip(self.kinds, priors, strict=True))
        self.coefficients = tuple(
            replace(term.coefficients[0], effect=self.id, among=self.among) for term in self.terms
        )
        self.active = tuple(np.arange(len(self.terms) * (j == joint)) for j in range(len(model.joints)))

    @classmethod
    def made(cls) -> tuple[str, ...]:
        """See `JointEffect.made`."""
        return tuple(kind.name for kind in cls.kinds)

    @classmethod
    def with_values(cls, model: Model, joint: int, values: Mapping[str, float], shape: Mapping[str, float]) -> Self:
        """See `JointEffect.with_values`."""
        return cls(model, joint, [values[name] for name in cls.made()], shape)

    @classmethod
    def probe(cls, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
        """See `JointEffect.probe`."""
        effect = cls.with_values(survey.model, joint, dict.fromkeys(cls.made(), 0.0), shape)
        return probe_of(effect, survey, joint, shape)

    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """See `Effect.write`."""
        for row, term in zip(out[int(self.joint)], self.terms, strict=True):
            row[:] = term.column(motion)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        for k, term in enumerate(self.terms):
            term.join(theta[k : k + 1], mechanism)

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """See `Effect.undefined`."""
        masks = [mask for term in self.terms for mask in term.undefined(motion).values()]
        return {int(self.joint): np.logical_or.reduce(masks)} if masks else {}


def probe_of(effect: JointEffect, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
    """An effect on a joint that is linear in its coefficients, at values of its other parameters, as a probe."""
    count = len(effect.coefficients)

    def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
        out = [np.empty((count * (j == joint), len(motion.t))) for j in range(len(motion.q))]
        effect.write(motion, out)
        return {joint: out[joint]}

    def entry(c: Array, information: Array) -> EffectEntry:
        made = effect.parameters(c, np.full((count, count), np.inf))
        return effect.entry(survey.model, joint, {**{name: value for name, (value, _) in made.items()}, **shape})

    return Probe(
        effect=effect.id,
        joint=effect.owner,
        link=None,
        columns=columns,
        size=count,
        entry=entry,
        shape=shape,
        lower=tuple(c.lower for c in effect.coefficients),
        upper=tuple(c.upper for c in effect.coefficients),
    )

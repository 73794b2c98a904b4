"""`JointTerm` and `DryFriction`: one coefficient times one column on one joint; `JointTerms`: several of them.

A subclass of `JointTerm` defines `column`, which the fit and the forward model both use.

A subclass of `DryFriction` defines `level` instead, the magnitude of the friction at a velocity. In a fit the column is
the level times the direction of motion. In the forward model the level at v = 0 is the largest torque that holds the
joint at rest; it may be 0. The column of a `DryFriction` is not used there.

A column is evaluated in two ways. In a fit, it is evaluated for the N samples of a log in the order of time. In the
forward model, it is evaluated at one instant of W independent rollouts: `Motion.is_log` is False, ``motion.a`` holds
the velocity, and k joints are evaluated at once, so that ``joint`` is an array and each nonlinear value an array of
shape (k, 1). Indexing and elementwise arithmetic work for both. Code that compares neighbouring samples, or uses the
velocity deadband, must check `Motion.is_log`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.effect import Coefficient
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_FAST = 0.1  # change of x per sample above which f is averaged over the sample
_STRAIGHT = 20.0  # argument beyond which log cosh is straight to the last digit
_SURE = 3.0  # deadbands beyond which the rounded sign is ±1 to half a percent


class JointTerm(JointEffect):
    """One coefficient on one joint.

    Attributes
    ----------
    coefficient_name
        The coefficient's name: a noun or adjective that stands alone in a report, such as "viscous".
    units
        Units of the coefficient on a revolute and on a prismatic joint, such as "N·m·s/rad"; half powers as "s^½".
    lower, upper
        Physical bounds.
    even
        True if the coefficient keeps its sign when the joint's axis is reversed, as friction does; a torque offset
        changes its sign.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    prior
        The coefficient before any data.
    nonlinear_values
        Values of the nonlinear parameters.
    """

    coefficient_name: str
    units: tuple[str, str]
    lower: float = 0.0
    upper: float = np.inf
    even: bool = True

    def __init__(
        self, model: RobotModel, joint: int, prior: float = 0.0, nonlinear_values: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(model, joint, nonlinear_values)
        coefficient = Coefficient(
            effect=self.id,
            owner=self.owner,
            name=self.coefficient_name,
            unit=self.unit_on(model, joint),
            prior=prior,
            lower=self.lower,
            upper=self.upper,
            even=self.even,
            instance=self.instance,
        )
        self.coefficients = (coefficient,)
        self.active = tuple(np.arange(int(j == joint)) for j in range(len(model.joints)))

    @classmethod
    @override
    def linear_parameters(cls) -> tuple[str, ...]:
        return (cls.coefficient_name,)

    @classmethod
    @override
    def with_values(
        cls, model: RobotModel, joint: int, values: Mapping[str, float], nonlinear_values: Mapping[str, float]
    ) -> Self:
        return cls(model, joint, values[cls.coefficient_name], nonlinear_values)

    @classmethod
    @override
    def probe(cls, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
        effect = cls.with_values(summary.model, joint, {cls.coefficient_name: 0.0}, nonlinear_values)
        return linear_probe(effect, summary, joint, nonlinear_values)

    def unit_on(self, model: RobotModel, joint: int) -> str:
        """Unit of the coefficient on a joint."""
        revolute, prismatic = self.units
        return prismatic if model.joints[joint].kind == "prismatic" else revolute

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        out[int(self.joint)][0] = self.column(motion)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.smooth_terms.append((self, float(theta[0])))

    @abstractmethod
    def column(self, motion: Motion) -> Array:
        """Torque per unit of the coefficient, shape (N,); in the forward model of k joints and W rollouts, (k, W)."""


class DryFriction(JointTerm):
    """One coefficient on one joint whose torque is a level times the direction of motion.

    The base class of every friction that jumps, or has an infinite slope, where the velocity changes its sign. The
    forward model then finds exactly when a joint stops; as a `JointTerm`, such a law would be simulated inaccurately.
    Samples at rest are left out of a fit, see `invalid_mask`. Override `column` too if the level changes within a few
    velocity deadbands of v = 0, as `StribeckFriction` does.
    """

    is_friction = True

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.dry_friction_terms.append((self, float(theta[0])))

    @abstractmethod
    def level(self, motion: Motion) -> Array:
        """Magnitude of the friction per unit of the coefficient, shape (N,); in the forward model (k, W).

        Its value at v = 0 is the breakaway torque.
        """

    @override
    def column(self, motion: Motion) -> Array:
        """Level times the direction of motion, with the sign of v smoothed within the velocity deadband.

        The direction is averaged over each sample, the level is that at the sample.
        """
        x = motion.v[self.joint] / motion.velocity_deadband[self.joint]
        direction = sample_mean(np.tanh(x), x, log_cosh)
        return direction * self.level(motion)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples at rest, where friction can have any value up to its level; they are left out of the joint's rows.

        If the level is 0 at v = 0, all samples are good: override it and return {}.
        """
        joint = int(self.joint)
        return {joint: np.abs(motion.v[joint]) < _SURE * motion.velocity_deadband[joint]}


def sample_mean(f: Array, x: Array, integral: Callable[[Array], Array]) -> Array:
    """Mean of a function f(x) over the time from half a sample before to half a sample after each sample of a log.

    Parameters
    ----------
    f
        f(x) at the samples, shape (N,); returned unchanged where x changes by less than 0.1 over the sample.
    x
        Argument of f, shape (N,), such as v divided by the velocity deadband.
    integral
        The integral of f over x.
    """
    edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    change = np.diff(edges)
    fast = np.abs(change) > _FAST
    mean = f.copy()
    mean[fast] = (integral(edges[1:][fast]) - integral(edges[:-1][fast])) / change[fast]
    return mean


def log_cosh(x: Array) -> Array:
    """Integral of tanh, up to a constant."""
    magnitude = np.abs(x)
    integral = magnitude.copy()
    is_curved = magnitude < _STRAIGHT
    integral[is_curved] += np.log1p(np.exp(-2 * magnitude[is_curved]))
    return integral


class JointTerms(JointEffect):
    """Several coefficients on one joint: terms with the same nonlinear values.

    Attributes
    ----------
    term_types
        The terms, in the order of the coefficients. They have no id.

    Parameters
    ----------
    model
        The robot.
    joint
        Index of the joint.
    prior
        The coefficients before any data; empty: 0.
    nonlinear_values
        Values of the nonlinear parameters.
    """

    term_types: tuple[type[JointTerm], ...] = ()

    def __init__(
        self,
        model: RobotModel,
        joint: int,
        prior: Sequence[float] = (),
        nonlinear_values: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(model, joint, nonlinear_values)
        priors = prior or [0.0] * len(self.term_types)
        self.terms = tuple(
            term_type(model, joint, x, nonlinear_values) for term_type, x in zip(self.term_types, priors, strict=True)
        )
        self.coefficients = tuple(
            replace(term.coefficients[0], effect=self.id, instance=self.instance) for term in self.terms
        )
        self.active = tuple(np.arange(len(self.terms) if j == joint else 0) for j in range(len(model.joints)))

    @classmethod
    @override
    def linear_parameters(cls) -> tuple[str, ...]:
        return tuple(term_type.coefficient_name for term_type in cls.term_types)

    @classmethod
    @override
    def with_values(
        cls, model: RobotModel, joint: int, values: Mapping[str, float], nonlinear_values: Mapping[str, float]
    ) -> Self:
        return cls(model, joint, [values[name] for name in cls.linear_parameters()], nonlinear_values)

    @classmethod
    @override
    def probe(cls, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
        zeros = dict.fromkeys(cls.linear_parameters(), 0.0)
        effect = cls.with_values(summary.model, joint, zeros, nonlinear_values)
        return linear_probe(effect, summary, joint, nonlinear_values)

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        for row, term in zip(out[int(self.joint)], self.terms, strict=True):
            row[:] = term.column(motion)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        for k, term in enumerate(self.terms):
            term.add_to_forward_model(theta[k : k + 1], mechanism)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        masks = [mask for term in self.terms for mask in term.invalid_mask(motion).values()]
        return {int(self.joint): np.logical_or.reduce(masks)} if masks else {}


def linear_probe(effect: JointEffect, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
    """Probe of an effect on a joint that is linear in its coefficients, at given nonlinear values."""
    count = len(effect.coefficients)

    def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
        out = [np.empty((len(active), len(motion.t))) for active in effect.active]
        effect.columns(motion, out)
        return {row: own for row, own in enumerate(out) if len(own)}

    def to_entry(c: Array, information: Array) -> EffectEntry:
        parameters = effect.parameters(c, np.full((count, count), np.inf))
        values = {name: value for name, (value, _) in parameters.items()}
        return effect.to_entry(summary.model, joint, {**values, **nonlinear_values})

    is_on_one_row = sum(len(active) > 0 for active in effect.active) == 1
    of_few_values = [parameter.name for parameter in effect.nonlinear_parameters if parameter.choices]
    fitted = [name for name in nonlinear_values if name not in of_few_values]
    return Probe(
        effect=effect.id,
        joint=effect.owner,
        link=None,
        columns=columns,
        coefficient_count=count,
        to_entry=to_entry,
        nonlinear_values=nonlinear_values,
        lower=tuple(c.lower for c in effect.coefficients),
        upper=tuple(c.upper for c in effect.coefficients),
        parameter_count=count + len(fitted),
        column_key=effect.column_key if is_on_one_row else None,
    )

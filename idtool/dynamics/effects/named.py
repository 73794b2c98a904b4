"""`NamedEffect`: an effect that a configuration can name under `effects`.

Its parameters (contract section 6) are of two kinds: those that its coefficients make, which are identified, and those
that are held, on which its columns depend.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.names import nearest, shown, some
from idtool.dynamics.effects.base import Effect
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Survey
from idtool.robot.config import EffectEntry, Uncertain
from idtool.robot.model import Model

Value = tuple[float, float | None]  # and its standard error; None: not known


class NamedEffect(Effect):
    """An effect with an id. What acts on a joint is a `JointEffect`.

    Attributes
    ----------
    id
        Its name in a configuration; none: a base, or a part of another effect.
    means
        What it is, in a few words for people.
    shows
        The motion in which it shows itself.
    contains
        Effects that it can take the place of: their simpler name is the right one unless the data insist.
    upon
        Effects of which one must be on the joint for it to be a change of.
    worth
        Share of a joint's squared residual that it explains at least to be named, where its column holds the residual's
        own noise.
    friction
        Whether it is friction, which may act on the motor's side of a gear that gives way.
    turning
        Whether it shows where a joint turns round, as friction does.
    named
        Whether it is an answer to what a model lacks; what is not is only fitted along, so as not to hide others.
    """

    id: str = ""
    means: str = ""
    shows: str = ""
    contains: tuple[str, ...] = ()
    upon: tuple[str, ...] = ()
    worth: float = 0.0
    friction: bool = False
    turning: bool = False
    named: bool = True

    @classmethod
    def probes(cls, survey: Survey) -> Iterator[Probe]:
        """The ways in which the effect may be missing from a model.

        Parameters
        ----------
        survey
            What was logged.
        """
        yield from ()

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """Parameters that are no coefficients and that a search moves from outside; ``com.0``: the first of a list."""
        return ()

    @classmethod
    def scanned(cls) -> tuple[str, ...]:
        """Names of those that a search finds by trying values, as what they make jumps."""
        return ()

    @classmethod
    @abstractmethod
    def of(cls, entry: EffectEntry, model: Model) -> NamedEffect:
        """The effect that an entry describes, its coefficients' prior being the entry's values.

        Raises
        ------
        ConfigError
            If the entry names what is not there, or a parameter is missing, unknown or out of its range.
        """

    @property
    @abstractmethod
    def key(self) -> tuple[str | float, ...]:
        """Its id, what it acts on, and what tells it from others that act on the same."""

    @abstractmethod
    def parameters(self, theta: Array, covariance: Array) -> dict[str, Value]:
        """The parameters that its coefficients make, with their standard errors.

        Parameters
        ----------
        theta
            The coefficients, shape (m,).
        covariance
            Of their errors, shape (m, m); what is infinite is not known.
        """


def place(entry: EffectEntry) -> str:
    """Where an entry stands, for messages."""
    return f"effects: {entry.effect}"


def check_names(entry: EffectEntry, names: tuple[str, ...]) -> None:
    """That an entry gives all of its effect's parameters and no others.

    Raises
    ------
    ConfigError
        If it does not.
    """
    for given in entry.parameters:
        if given not in names:
            raise ConfigError(place(entry), f"has no parameter {shown(given)}; {nearest(given, names)}")
    missing = [name for name in names if name not in entry.parameters]
    if missing:
        raise ConfigError(place(entry), f"needs the parameters {some(names)}; add {some(missing)}")


def number(entry: EffectEntry, name: str) -> float:
    """A parameter that is a number, alone or with its standard error.

    Raises
    ------
    ConfigError
        If it is something else.
    """
    try:
        return Uncertain.model_validate(entry.parameters[name]).value
    except ValueError:
        raise ConfigError(place(entry), f"{name} is not a number; give one, or value and standard_error") from None


def vector(entry: EffectEntry, name: str, length: int) -> Array:
    """A parameter that is a list of numbers, each as for `number`; shape (length,).

    Raises
    ------
    ConfigError
        If it is something else.
    """
    try:
        return _numbers(entry.parameters[name], length)
    except ValueError:
        raise ConfigError(place(entry), f"{name} is not a list of {length} numbers; give one") from None


def rows(entry: EffectEntry, name: str, length: int) -> Array:
    """A parameter that is a list of lists of numbers; shape (rows, length), one row or more.

    Raises
    ------
    ConfigError
        If it is something else.
    """
    given = entry.parameters[name]
    try:
        if not isinstance(given, list | tuple) or not given:
            raise ValueError
        return np.array([_numbers(row, length) for row in given])
    except ValueError:
        raise ConfigError(place(entry), f"{name} is not a list of lists of {length} numbers; give one") from None


def _numbers(given: Any, length: int) -> Array:
    if not isinstance(given, list | tuple) or len(given) != length:
        raise ValueError
    return np.array([Uncertain.model_validate(x).value for x in given])


def joint_index(entry: EffectEntry, name: Any, model: Model, what: str = "") -> int:
    """Index of the joint of that name; ``what`` is the parameter that names it.

    Raises
    ------
    ConfigError
        If the model has no such joint.
    """
    said = f"{what} {shown(str(name))}".strip()
    if name not in model.names:
        raise ConfigError(place(entry), f"{said} is no moving joint; {nearest(str(name), model.names)}")
    return model.names.index(name)


def plain(values: Mapping[str, Value]) -> dict[str, dict[str, float]]:
    """Parameters as a configuration has them."""
    return {
        name: {"value": value} if error is None else {"value": value, "standard_error": error}
        for name, (value, error) in values.items()
    }

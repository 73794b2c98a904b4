"""Parameters of an entry under `effects`, checked and as numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.names import join_names, printable, suggestion
from idtool.robot.config import EffectEntry, UncertainValue
from idtool.robot.model import RobotModel


def entry_location(entry: EffectEntry) -> str:
    """Location of an entry in the configuration, for messages."""
    return f"effects: {entry.effect}"


def check_parameter_names(entry: EffectEntry, names: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    """Check that an entry gives all parameters of its effect, perhaps the optional ones, and no others.

    Raises
    ------
    ConfigError
        If it does not.
    """
    for given in entry.parameters:
        if given not in (*names, *optional):
            advice = suggestion(given, (*names, *optional))
            raise ConfigError(entry_location(entry), f"has no parameter {printable(given)}; {advice}")
    missing = [name for name in names if name not in entry.parameters]
    if missing:
        raise ConfigError(entry_location(entry), f"needs the parameters {join_names(names)}; add {join_names(missing)}")


def read_number(entry: EffectEntry, name: str) -> float:
    """Value of a parameter that is a number, alone or with its standard error.

    Raises
    ------
    ConfigError
        If it is something else.
    """
    try:
        return UncertainValue.model_validate(entry.parameters[name]).value
    except ValueError:
        message = f"{name} is not a number of possible size; give a number, or value and standard_error"
        raise ConfigError(entry_location(entry), message) from None


def read_vector(entry: EffectEntry, name: str, length: int) -> Array:
    """Values of a parameter that is a list of numbers, each as for `read_number`; shape (length,).

    Raises
    ------
    ConfigError
        If it is something else.
    """
    try:
        return _numbers(entry.parameters[name], length)
    except ValueError:
        message = f"{name} is not a list of {length} numbers"
        raise ConfigError(entry_location(entry), message) from None


def read_rows(entry: EffectEntry, name: str, length: int) -> Array:
    """Values of a parameter that is a list of one or more lists of numbers; shape (rows, length).

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
        message = f"{name} is not a list of lists of {length} numbers"
        raise ConfigError(entry_location(entry), message) from None


def _numbers(given: Any, length: int) -> Array:
    if not isinstance(given, list | tuple) or len(given) != length:
        raise ValueError
    return np.array([UncertainValue.model_validate(x).value for x in given])


def read_joint_index(entry: EffectEntry, name: Any, model: RobotModel, parameter: str = "") -> int:
    """Index of the joint of that name; ``parameter`` is the one that names it, if any.

    Raises
    ------
    ConfigError
        If the model has no such joint.
    """
    if name not in model.joint_names:
        subject = f"{parameter} {printable(str(name))}".strip()
        raise ConfigError(
            entry_location(entry), f"{subject} is not a moving joint; {suggestion(str(name), model.joint_names)}"
        )
    return model.joint_names.index(name)

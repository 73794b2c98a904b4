"""Friction and other terms of the torque equation beside the rigid bodies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator

from idtool.robot.config.base import ConfigRecord, Finite, NonNegative


def _or_bare_number(schema: dict[str, Any]) -> None:
    """Add the bare number to the JSON schema of a value with its standard error."""
    record = dict(schema)
    schema.clear()
    schema["anyOf"] = [record["properties"]["value"], record]


class UncertainValue(ConfigRecord):
    """A number that may have a standard error, both in the same unit."""

    model_config = ConfigDict(json_schema_extra=_or_bare_number)

    value: Finite
    standard_error: NonNegative | None = None

    @model_validator(mode="before")
    @classmethod
    def _bare_number(cls, data: Any) -> Any:
        return data if isinstance(data, Mapping) else {"value": data}


def _parse_term(data: Any) -> Any:
    return data if isinstance(data, bool | UncertainValue) else UncertainValue.model_validate(data)


def _check_dissipative(term: bool | UncertainValue) -> bool | UncertainValue:
    if isinstance(term, UncertainValue) and term.value < 0:
        raise ValueError(f"friction of {term.value:g} would drive the joint; give 0 or more")
    return term


Term = Annotated[bool | UncertainValue, BeforeValidator(_parse_term)]
Dissipation = Annotated[Term, AfterValidator(_check_dissipative)]


class Friction(ConfigRecord):
    """Friction terms of a joint: on, off, or a value [N·m·s/rad, N·m, N·m]."""

    viscous: Dissipation = True
    coulomb: Dissipation = True
    offset: Term = False


def _value(given: Any) -> Any:
    """A parameter, or a list of them, without standard errors."""
    if isinstance(given, Mapping):
        return given["value"]
    return [_value(element) for element in given] if isinstance(given, list) else given


def friction_tag(data: Any) -> str:
    """Tag of the form: terms for all joints alike, or by joint. Told by the keys, so that errors are about one form."""
    if not isinstance(data, Mapping) or not data or set(data) & set(Friction.model_fields):
        return "alike"
    is_by_joint = all(isinstance(terms, Mapping | Friction) for terms in data.values())
    return "by joint" if is_by_joint else "alike"


class EffectEntry(ConfigRecord):
    """An effect of the model; parameters in SI units, each a number or a value with its standard error."""

    free_keys = "parameters"

    effect: str
    joint: str | None = None
    link: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)

    @property
    def values(self) -> dict[str, Any]:
        """Values of the parameters without their standard errors."""
        return {name: _value(given) for name, given in self.parameters.items()}

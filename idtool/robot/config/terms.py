"""Friction and other terms of the torque equation beside the rigid bodies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from idtool.robot.config.base import ConfigRecord, Finite, NonNegative


class UncertainValue(ConfigRecord):
    """A number that may carry its standard error, both in the number's unit."""

    value: Finite
    standard_error: NonNegative | None = None

    @model_validator(mode="before")
    @classmethod
    def _bare_number(cls, data: Any) -> Any:
        return data if isinstance(data, Mapping) else {"value": data}


def _term(data: Any) -> Any:
    return data if isinstance(data, bool | UncertainValue) else UncertainValue.model_validate(data)


def _dissipates(term: bool | UncertainValue) -> bool | UncertainValue:
    if isinstance(term, UncertainValue) and term.value < 0:
        raise ValueError(f"friction of {term.value:g} would drive the joint; give 0 or more")
    return term


Term = Annotated[bool | UncertainValue, BeforeValidator(_term)]
Dissipation = Annotated[Term, AfterValidator(_dissipates)]


class Friction(ConfigRecord):
    """Which friction terms a joint has, or their values [N·m·s/rad, N·m, N·m], as prior for `fit`, as is elsewhere."""

    viscous: Dissipation = True
    coulomb: Dissipation = True
    offset: Term = False


def friction_tag(data: Any) -> str:
    """Terms for all joints alike, or by joint: told apart by the keys, so that errors speak of one of them."""
    if not isinstance(data, Mapping) or not data or set(data) & set(Friction.model_fields):
        return "alike"
    return "by joint" if all(isinstance(terms, Mapping | Friction) for terms in data.values()) else "alike"


class EffectEntry(ConfigRecord):
    """An effect that the model carries; parameters in SI, each a number or a value with its standard error."""

    effect: str
    joint: str | None = None
    link: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)

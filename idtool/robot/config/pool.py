"""Setting of a fit to logs of several robots of one type."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from idtool.robot.config.base import ConfigRecord

FRICTION = "friction"  # all terms of the section of this name


def _as_list(own: object) -> object:
    return [own] if isinstance(own, str) else own


def _not_empty(own: tuple[str, ...]) -> tuple[str, ...]:
    if not own:
        raise ValueError("is empty; list friction, or effects")
    return own


class Pool(ConfigRecord):
    """A fleet: robots of one type, with the same bodies and friction of their own."""

    shared: Literal["bodies"] = "bodies"
    own: Annotated[
        tuple[str, ...],
        BeforeValidator(_as_list),
        AfterValidator(_not_empty),
        Field(json_schema_extra={"type": ["array", "string"]}),
    ] = (FRICTION,)
    robots: dict[str, tuple[str, ...]] = Field(default_factory=dict)

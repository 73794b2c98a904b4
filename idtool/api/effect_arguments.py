"""Effects in a user's arguments: parsed and checked."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from idtool.common.exceptions import ConfigError
from idtool.common.names import printable, suggestion
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.robot.model import RobotModel

EffectAssumption = tuple[str, str | None]


def parse_candidates(effects: Sequence[str]) -> tuple[str, ...]:
    """Ids of the effects to search for, each once.

    Raises
    ------
    ConfigError
        If one is no effect.
    """
    return tuple(dict.fromkeys(_check_effect("--effects", name.strip()) for name in effects))


def parse_assumption(text: str | EffectAssumption, option: str = "--assume") -> EffectAssumption:
    """An effect and the joint or link it acts on, which may have a colon in its name.

    Parameters
    ----------
    text
        ``effect:joint``, ``effect`` or the pair.
    option
        Option that it was given with, for messages.

    Raises
    ------
    ConfigError
        If it is no effect.
    """
    if not isinstance(text, str):
        effect, owner = text
        return _check_effect(option, effect), owner
    effect, colon, name = text.partition(":")
    return _check_effect(option, effect.strip()), name if colon else None


def _check_effect(option: str, effect: str) -> str:
    names = [id for id, kind in effect_types().items() if kind.reportable]
    if effect not in names:
        raise ConfigError(
            option, f"{printable(effect) or 'an empty name'} is not an effect; {suggestion(effect, names)}"
        )
    return effect


def check_assumptions(assumptions: Sequence[EffectAssumption], model: RobotModel, option: str = "--assume") -> None:
    """Check that the robot has the joints and links on which effects are assumed.

    Parameters
    ----------
    assumptions
        The effects.
    model
        The robot.
    option
        Option that they were given with, for messages.

    Raises
    ------
    ConfigError
        If it lacks one.
    """
    for effect, owner in assumptions:
        kind = effect_types()[effect]
        names: Collection[str] = model.names
        what = "joint"
        if issubclass(kind, LinkEffect):
            names = model.robot.links
            what = "link"
        if owner is None and issubclass(kind, LinkEffect | JointEffect):
            raise ConfigError(option, f"{effect} acts on a {what}; give {effect}:{what.upper()}")
        if owner is not None and owner not in names:
            raise ConfigError(
                option,
                f"{printable(owner) or 'an empty name'} is not a {what} of the model; {suggestion(owner, names)}",
            )

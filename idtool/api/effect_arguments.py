"""Effects in a user's arguments: parsed and checked."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from idtool.common.exceptions import ConfigError
from idtool.common.names import join_names, printable, suggestion
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.robot.model import RobotModel

EffectAssumption = tuple[str, str | None]

_MAX_NAMES = 40  # in a message: all effects, and the joints of most robots
_SEPARATOR = re.compile(r"[\s:=,;+]+")  # that may stand between names


def parse_candidates(effects: Sequence[str]) -> tuple[str, ...]:
    """Ids of the effects to search for, each once.

    Raises
    ------
    ConfigError
        If one is no effect.
    """
    return tuple(dict.fromkeys(_check_effect("--effects", name.strip(), name) for name in effects))


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
        return _check_effect(option, effect, effect), owner
    effect, colon, name = text.partition(":")
    return _check_effect(option, effect.strip(), text), name if colon else None


def _check_effect(option: str, effect: str, text: str) -> str:
    """The effect, if there is one of this name; ``text`` is the whole of what was given."""
    names = [id for id, kind in effect_types().items() if kind.reportable]
    if effect in names:
        return effect
    if effect in effect_types():
        raise ConfigError(option, f"{effect} is always included in the fit; it is not an answer, so leave it out")
    name = printable(effect) or "an empty name"
    advice = _intended(option, text, names) + _possible(effect, names)
    raise ConfigError(option, f"{name} is not an effect; {advice}")


def _intended(option: str, text: str, names: Sequence[str]) -> str:
    """Advice if one of the words is an effect, to be put before other advice; empty if not."""
    words = [word for word in _SEPARATOR.split(text) if word]
    effects = [word for word in words if word in names]
    others = [word for word in words if word not in names]
    if option == "--effects" and effects:
        form = f"give effects alone, separated by commas, as in --effects {','.join(effects)}"
        return f"{form}; --assume takes an effect on a joint; " if others else f"{form}; "
    if len(effects) == len(others) == 1:
        return f"give {effects[0]}:{printable(others[0])}; "
    return ""


def _possible(name: str, names: Collection[str]) -> str:
    """The most similar name, if there is one, and all that are possible."""
    hint = suggestion(name, names)
    has_similar = hint.endswith("?")
    return f"{hint} {_available(names)}" if has_similar else _available(names)


def _available(names: Collection[str]) -> str:
    """Clause that lists the names that are possible."""
    return f"available: {join_names(names, _MAX_NAMES)}"


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
        If it lacks one, or an effect acts on the whole robot.
    """
    for effect, owner in assumptions:
        kind = effect_types()[effect]
        is_of_whole_robot = kind.may_act_on_all_joints or not issubclass(kind, LinkEffect | JointEffect)
        if owner is None and is_of_whole_robot:
            continue
        if is_of_whole_robot and not kind.may_act_on_all_joints:
            raise ConfigError(option, f"{effect} acts on the whole robot; give {effect} without a name")
        names: Collection[str] = model.names
        what = "joint"
        if issubclass(kind, LinkEffect):
            names = model.robot.links
            what = "link"
        if owner is None:
            advice = f"give {effect}:{what.upper()}; {_available(names)}"
            raise ConfigError(option, f"{effect} acts on a {what}; {advice}")
        if owner not in names:
            name = printable(owner) or "an empty name"
            raise ConfigError(option, f"{name} is not a {what} of the model; {_possible(owner, names)}")

"""Effects as a user names them, checked."""

from __future__ import annotations

from collections.abc import Sequence

from idtool.common.exceptions import ConfigError
from idtool.common.names import printable, suggestion
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.robot.model import Model

Assumed = tuple[str, str | None]


def known_candidates(given: Sequence[str]) -> tuple[str, ...]:
    """The effects that may be named, each once.

    Raises
    ------
    ConfigError
        If one is no effect.
    """
    return tuple(dict.fromkeys(_known("--effects", name.strip()) for name in given))


def known_assumption(given: str | Assumed) -> Assumed:
    """An effect and what it acts on, which may have a colon in its name.

    Raises
    ------
    ConfigError
        If it is no effect.
    """
    if not isinstance(given, str):
        return _known("--assume", given[0]), given[1]
    effect, colon, name = given.partition(":")
    return _known("--assume", effect.strip()), name if colon else None


def _known(option: str, effect: str) -> str:
    named = [id for id, kind in effect_types().items() if kind.reportable]
    if effect not in named:
        raise ConfigError(option, f"{printable(effect) or 'nothing'} is not an effect; {suggestion(effect, named)}")
    return effect


def check_assumed(assumed: Sequence[Assumed], model: Model) -> None:
    """Whether the robot has what the assumed effects act on.

    Raises
    ------
    ConfigError
        If not.
    """
    for effect, on in assumed:
        kind = effect_types()[effect]
        of_link = issubclass(kind, LinkEffect)
        names, what = (model.robot.links, "link") if of_link else (model.names, "joint")
        if on is None and issubclass(kind, LinkEffect | JointEffect):
            raise ConfigError("--assume", f"{effect} acts on a {what}; give {effect}:{what.upper()}")
        if on is not None and on not in names:
            raise ConfigError(
                "--assume", f"{printable(on) or 'nothing'} is not a {what} of the model; {suggestion(on, names)}"
            )

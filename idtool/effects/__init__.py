"""Every term of the torque equation. A new effect is one new file in this folder that nothing else knows about."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

from idtool.config import Config, EffectEntry, Friction, Uncertain
from idtool.effects.base import Coefficient, Effect
from idtool.effects.joint_term import JointTerm
from idtool.effects.rigid_body import RigidBodies
from idtool.exceptions import ConfigError
from idtool.model import Model
from idtool.names import nearest
from idtool.robot import Joint

__all__ = ["Coefficient", "Effect", "JointTerm", "RigidBodies", "build_effects", "known_effects"]


@cache
def known_effects() -> dict[str, type[JointTerm]]:
    """The effects that can be named in a configuration, by id."""
    found: dict[str, type[JointTerm]] = {}
    for module in pkgutil.iter_modules(__path__):
        for _, member in inspect.getmembers(importlib.import_module(f"{__name__}.{module.name}"), inspect.isclass):
            if issubclass(member, JointTerm) and not inspect.isabstract(member):
                found[member.id] = member
    return found


def build_effects(model: Model, config: Config) -> tuple[Effect, ...]:
    """The terms of a model's torque equation: its rigid bodies, its friction, and what the configuration adds.

    A coefficient's prior is the configuration's value, else the URDF's.

    Raises
    ------
    ConfigError
        If the configuration names an effect or joint that is not known, or gives a parameter that the effect has not.
    """
    terms: dict[tuple[str, int], dict[str, float]] = {}
    for j, joint in enumerate(model.joints):
        for effect, prior in _friction(joint, config.friction_of(joint.name)).items():
            terms[effect, j] = {known_effects()[effect].name: prior}
    for entry in config.effects:
        key = _entry(entry, model)
        terms[key] = _parameters(entry)
    effects: list[Effect] = [RigidBodies(model)]
    for (effect, j), parameters in terms.items():
        kind = known_effects()[effect]
        effects.append(kind(model, j, parameters[kind.name], {name: parameters[name] for name in kind.held}))
    return tuple(effects)


def _friction(joint: Joint, friction: Friction) -> dict[str, float]:
    """Ids of a joint's friction terms and their priors."""
    chosen = {
        "viscous_friction": (friction.viscous, joint.damping),
        "coulomb_friction": (friction.coulomb, joint.friction),
        "torque_offset": (friction.offset, 0.0),
    }
    return {
        effect: term.value if isinstance(term, Uncertain) else urdf for effect, (term, urdf) in chosen.items() if term
    }


def _entry(entry: EffectEntry, model: Model) -> tuple[str, int]:
    """Id and joint of an entry under `effects`."""
    where, known = f"effects: {entry.effect}", known_effects()
    if entry.effect not in known:
        raise ConfigError(where, f"is not an effect of this version; {nearest(entry.effect, known)}")
    if entry.joint is None or entry.link is not None:
        raise ConfigError(where, "acts on a joint; give joint, and no link")
    if entry.joint not in model.names:
        raise ConfigError(where, f"{entry.joint} is no moving joint; {nearest(entry.joint, model.names)}")
    return entry.effect, model.names.index(entry.joint)


def _parameters(entry: EffectEntry) -> dict[str, float]:
    """Values of an entry's parameters."""
    where, kind = f"effects: {entry.effect}", known_effects()[entry.effect]
    names = (kind.name, *kind.held)
    if set(entry.parameters) != set(names):
        raise ConfigError(where, f"needs the parameters {', '.join(names)}, and no other")
    try:
        return {name: Uncertain.model_validate(entry.parameters[name]).value for name in names}
    except ValueError:
        raise ConfigError(where, "has a parameter that is not a number") from None

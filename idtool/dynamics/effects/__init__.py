"""Every term of the torque equation. A new effect is one new file in this folder that nothing else knows about."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

from idtool.common.exceptions import ConfigError
from idtool.common.names import nearest, shown
from idtool.dynamics.effects.base import Coefficient, Effect
from idtool.dynamics.effects.friction import CoulombFriction, TorqueOffset, ViscousFriction
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.named import NamedEffect, place, plain
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.robot.config import Config, EffectEntry, Friction, Uncertain
from idtool.robot.model import Model

__all__ = [
    "Coefficient",
    "Effect",
    "JointTerm",
    "NamedEffect",
    "RigidBodies",
    "build_effects",
    "known_effects",
    "named_effect",
    "plain",
]


@cache
def known_effects() -> dict[str, type[NamedEffect]]:
    """The effects that can be named in a configuration, by id."""
    found: dict[str, type[NamedEffect]] = {}
    for module in pkgutil.iter_modules(__path__):
        for _, member in inspect.getmembers(importlib.import_module(f"{__name__}.{module.name}"), inspect.isclass):
            if issubclass(member, NamedEffect) and member.id and not inspect.isabstract(member):
                found[member.id] = member
    return found


def build_effects(model: Model, config: Config) -> tuple[Effect, ...]:
    """The terms of a model's torque equation: its rigid bodies, its friction, and what the configuration adds.

    A coefficient's prior is the configuration's value, else the URDF's. An entry under `effects` takes the place of the
    same term under `friction`.

    Raises
    ------
    ConfigError
        If the configuration names an effect or joint that is not known, gives a parameter that the effect has not or
        that cannot be, or has the same effect twice.
    """
    for entry in config.effects:
        model = named_effect(entry, model).alter(model)
    found = {effect.key: effect for j in range(len(model.joints)) for effect in _friction(model, j, config)}
    entries: set[tuple[str | float, ...]] = set()
    for entry in config.effects:
        effect = named_effect(entry, model)
        if effect.key in entries:
            on = entry.joint or entry.link
            raise ConfigError(place(entry), f"is there twice{f' for {shown(on)}' if on else ''}; keep one entry")
        entries.add(effect.key)
        found[effect.key] = effect
    return (RigidBodies(model), *sorted(found.values(), key=lambda effect: effect.rank))


def named_effect(entry: EffectEntry, model: Model) -> NamedEffect:
    """The effect that an entry describes.

    Raises
    ------
    ConfigError
        If it is not known, or its entry cannot be used.
    """
    known = known_effects()
    if entry.effect not in known:
        raise ConfigError(place(entry), f"is not an effect of this version; {nearest(entry.effect, known)}")
    return known[entry.effect].of(entry, model)


def _friction(model: Model, j: int, config: Config) -> list[NamedEffect]:
    """A joint's friction terms."""
    joint = model.joints[j]
    friction: Friction = config.friction_of(joint.name)
    chosen: tuple[tuple[type[JointTerm], bool | Uncertain, float], ...] = (
        (ViscousFriction, friction.viscous, joint.damping),
        (CoulombFriction, friction.coulomb, joint.friction),
        (TorqueOffset, friction.offset, 0.0),
    )
    return [kind(model, j, term.value if isinstance(term, Uncertain) else urdf) for kind, term, urdf in chosen if term]

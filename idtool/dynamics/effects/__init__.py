"""Terms of the torque equation, one file each, named by id. A new effect is one new file that nothing else knows of.

No id is known outside this folder: what another place needs to know of an effect is an attribute or a method of it, see
`NamedEffect`.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.common.names import printable, suggestion
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.effects.entry_parameters import entry_location
from idtool.dynamics.effects.foot_compliance import FootCompliance
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.named_effect import NamedEffect, ParameterValue, config_parameters
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.dynamics.effects.wrench_sensor_offset import wrench_sensor_offsets
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import Config, EffectEntry, Friction, UncertainValue
from idtool.robot.model import RobotModel

__all__ = [
    "Coefficient",
    "Effect",
    "JointTerm",
    "NamedEffect",
    "ParameterValue",
    "RigidBodies",
    "build_effects",
    "config_parameters",
    "effect_from_entry",
    "effect_name",
    "effect_types",
    "friction_types",
    "mechanism_of",
    "target_name",
]


@cache
def effect_types() -> dict[str, type[NamedEffect]]:
    """Effects that a configuration can name, by id."""
    types: dict[str, type[NamedEffect]] = {}
    for module in pkgutil.iter_modules(__path__):
        contents = importlib.import_module(f"{__name__}.{module.name}")
        for _, member in inspect.getmembers(contents, inspect.isclass):
            if issubclass(member, NamedEffect) and member.id and not inspect.isabstract(member):
                types[member.id] = member
    return types


def friction_types() -> dict[str, type[JointTerm]]:
    """Effects that a configuration has under `friction` too, by the key there and in its order."""
    types: dict[str, type[JointTerm]] = {}
    for effect_type in effect_types().values():
        if effect_type.friction_key and issubclass(effect_type, JointTerm):
            types[effect_type.friction_key] = effect_type
    return {key: types[key] for key in Friction.model_fields}


def build_effects(model: RobotModel, config: Config) -> tuple[Effect, ...]:
    """Terms of a model's torque equation: its rigid bodies, its friction, and what the configuration adds.

    A coefficient's prior is the configuration's value, else the URDF's. An entry under `effects` replaces the same term
    under `friction`.

    Raises
    ------
    ConfigError
        If the configuration names an unknown effect or joint, gives a parameter that is unknown or out of range, or has
        an effect twice.
    """
    for entry in config.effects:
        model = effect_from_entry(entry, model).modify_model(model)
    effects: dict[tuple[str | float, ...], NamedEffect] = {}
    for joint in range(model.joint_count):
        for term in _friction(model, joint, config):
            effects[term.key] = term
    entry_keys: set[tuple[str | float, ...]] = set()
    for entry in config.effects:
        effect = effect_from_entry(entry, model)
        if effect.key in entry_keys:
            owner = entry.joint or entry.link
            subject = f" for {printable(owner)}" if owner else ""
            raise ConfigError(entry_location(entry), f"is listed twice{subject}; keep one entry")
        entry_keys.add(effect.key)
        effects[effect.key] = effect
    feet = [contact for contact in config.contacts if contact.is_compliant]
    others: list[Effect] = [*wrench_sensor_offsets(model, config)]
    if model.has_floating_base and feet:
        compliance = np.mean([contact.first_compliance for contact in feet])
        others.append(FootCompliance(model, config.contacts, float(compliance)))
    return (RigidBodies(model), *others, *sorted(effects.values(), key=lambda effect: effect.order))


def mechanism_of(effect: Effect, model: RobotModel) -> Mechanism:
    """Forward model of one effect without the rest of the robot; its coefficients are their priors.

    Parameters
    ----------
    effect
        The effect.
    model
        The robot without it.
    """
    mechanism = Mechanism(effect.modify_model(model))
    theta = np.array([c.prior for c in effect.coefficients])
    effect.add_to_forward_model(theta, mechanism)
    return mechanism


def effect_name(effect: str) -> str:
    """An effect's id in plain words."""
    kind = effect_types().get(effect)
    return (kind.label if kind else "") or effect.replace("_", " ")


def target_name(effect: str, joint: str | None, link: str | None) -> str:
    """Joint or link that an effect acts on, or for one on the whole robot what it acts on, such as "the base"."""
    return joint or link or effect_types().get(effect, NamedEffect).whole_robot_owner


def effect_from_entry(entry: EffectEntry, model: RobotModel) -> NamedEffect:
    """The effect that an entry describes.

    Raises
    ------
    ConfigError
        If the effect is unknown, or its entry can't be used.
    """
    types = effect_types()
    if entry.effect not in types:
        raise ConfigError(entry_location(entry), f"is not an effect of this version; {suggestion(entry.effect, types)}")
    return types[entry.effect].from_entry(entry, model)


def _friction(model: RobotModel, joint: int, config: Config) -> list[JointTerm]:
    """Friction terms of a joint."""
    properties = model.joints[joint]
    types = friction_types()
    terms = []
    for key, setting in config.friction_of(properties.name):
        if setting:
            attribute = types[key].urdf_attribute
            urdf_value = getattr(properties, attribute) if attribute else 0.0
            prior = setting.value if isinstance(setting, UncertainValue) else urdf_value
            terms.append(types[key](model, joint, prior))
    return terms

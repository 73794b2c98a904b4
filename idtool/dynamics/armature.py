"""The section `armature` of a configuration: reflected rotor inertias in a few words, as entries under `effects`."""

from __future__ import annotations

from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects import JointTerm, effect_types
from idtool.robot.config import Config, EffectEntry, MeasuredValue
from idtool.robot.model import RobotModel


def with_armature(config: Config, model: RobotModel) -> Config:
    """The configuration with an entry under `effects` for each joint of a model that has an armature.

    Known values remain under `armature`, by joint: they constrain the fit. A value for all joints, and ``auto``, are
    for joints without a rotor and without an entry of their own. The result is the same if it is applied again.

    Raises
    ------
    ConfigError
        If the armature of a joint with a rotor is given.
    """
    if config.armature == {}:
        return config
    rotor_inertia = rotor_inertia_type()
    places = {entry.joint: i for i, entry in enumerate(config.effects) if entry.effect == rotor_inertia.id}
    is_by_joint = isinstance(config.armature, dict)
    entries = list(config.effects)
    known = {}
    for index, joint in enumerate(model.joint_names):
        armature = config.armature_of(joint)
        if armature is None:
            continue
        if not rotor_inertia.may_act_on(model, index):
            if not is_by_joint:
                continue
            what = "is also that of a rotor under rotors, and would count twice; remove one of the two"
            raise ConfigError(f"armature.{joint}", what)
        if joint in places and (armature == "auto" or not is_by_joint):
            continue
        entry = _entry(rotor_inertia, joint, armature)
        if isinstance(armature, MeasuredValue):
            known[joint] = armature
        if joint not in places:
            entries.append(entry)
        elif isinstance(armature, MeasuredValue) and armature.standard_error is None:
            entries[places[joint]] = entry
    return config.model_copy(update={"armature": known, "effects": tuple(entries)})


def rotor_inertia_type() -> type[JointTerm]:
    """The effect that is the reflected inertia of a rotor."""
    return next(kind for kind in effect_types().values() if kind.is_rotor_inertia and issubclass(kind, JointTerm))


def _entry(rotor_inertia: type[JointTerm], joint: str, armature: MeasuredValue | str) -> EffectEntry:
    entry = rotor_inertia.zero_entry(joint)
    if isinstance(armature, MeasuredValue):
        entry.parameters[rotor_inertia.coefficient_name] = armature.value
    return entry

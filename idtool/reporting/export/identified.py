"""`IdentifiedModel`: the model that `idtool fit` wrote, taken apart for simulators that have a place for each part.

Every effect is asked for its forward form, the one that idtool itself simulates: inertias, gravity and position offsets
need no word about which effect they come from; of torque on joints the effect says which elements of simulators it is.
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.dynamics.armature import with_armature
from idtool.dynamics.effects import NamedEffect, RigidBodies, build_effects, mechanism_of
from idtool.dynamics.effects.simulator_element import SimulatorElement
from idtool.dynamics.effects.wrench_sensor_offset import WrenchSensorOffset
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.regressor import LinearModel
from idtool.reporting.export.base import Part
from idtool.robot.config import Config, read_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot, UrdfJoint, read_robot

URDF, CONFIG = "identified.urdf", "model.yaml"
NO_EQUIVALENT = "the simulator does not support it"
OF_SENSORS = "it belongs to the sensors, not to the robot"


@dataclass(frozen=True)
class EffectTorque:
    """Torque of an effect that is a function of the state.

    Attributes
    ----------
    effect
        The effect's id.
    joint
        Name of the joint.
    elements
        Simulator elements that together are this torque; empty: there are none.
    amount
        The effect's first parameter and its unit.
    """

    effect: str
    joint: str
    elements: tuple[SimulatorElement, ...]
    amount: tuple[float, str] | tuple[()]

    def part(self, detail: str) -> Part:
        """A part of the export for this term."""
        return Part(self.effect, self.joint, detail, *self.amount)

    @property
    def not_carried_part(self) -> Part:
        """The part for a simulator without an equivalent."""
        return self.part(NO_EQUIVALENT)


@dataclass(frozen=True)
class IdentifiedModel:
    """An identified model.

    Attributes
    ----------
    robot, config, model
        The URDF, the configuration, and the tree of bodies that they make.
    mechanism
        The model run forwards.
    terms
        Torque on joints that is a function of the state.
    inertias, armatures, tilts, offsets
        Effects that are in the mechanism's ``pi``, ``armature``, ``gravity`` and ``position_offset``.
    others
        Effects that are none of this.
    """

    robot: Robot
    config: Config
    model: RobotModel
    mechanism: Mechanism
    terms: tuple[EffectTorque, ...]
    inertias: tuple[Part, ...]
    armatures: tuple[Part, ...]
    tilts: tuple[Part, ...]
    offsets: tuple[Part, ...]
    others: tuple[Part, ...]

    @property
    def pi(self) -> Array:
        """Inertia parameters of the model's bodies, shape (bodies, 10)."""
        return self.mechanism.pi

    @property
    def gravity(self) -> Array:
        """Gravity in the root link's frame, shape (3,) [m/s²]; with a floating base, in the world."""
        if self.model.has_floating_base:
            return np.asarray(self.config.gravity)
        return self.mechanism.gravity

    def value(self, joint: UrdfJoint) -> float:
        """Position of a joint that does not move [rad or m]: its own or what it follows."""
        scale, value = 1.0, 0.0
        while joint.mimic is not None:
            scale, value = scale * joint.mimic.multiplier, value + scale * joint.mimic.offset
            joint = self.robot.joints[joint.mimic.joint]
        return value + scale * self.config.locked_joints.get(joint.name, 0.0)


def read_identified(folder: Path) -> IdentifiedModel:
    """The model in a folder that `idtool fit` wrote.

    Raises
    ------
    IdtoolError
        If one of its two files is missing or cannot be used.
    """
    for name in (URDF, CONFIG):
        if not (folder / name).is_file():
            raise ModelError(folder / name, "is missing; give the output folder of idtool fit or diagnose")
    return identified_model(read_robot(folder / URDF), read_config(folder / CONFIG))


def identified_model(robot: Robot, config: Config) -> IdentifiedModel:
    """The identified model of a URDF and a configuration.

    Raises
    ------
    IdtoolError
        If they do not go together.
    """
    free = [name for name in robot.joints if name not in config.locked_joints]
    without_effects = build_model(robot, config, config.joints or free)
    config = with_armature(config, without_effects)
    equation = LinearModel(without_effects.names, build_effects(without_effects, config))
    model = next(effect.model for effect in equation.effects if isinstance(effect, RigidBodies))
    sorts = _EffectsByForm(without_effects)
    for effect in equation.effects:
        if isinstance(effect, NamedEffect):
            sorts.add(effect)
        elif isinstance(effect, WrenchSensorOffset):
            offset = effect.coefficients[0]
            sorts.others.append(Part(offset.effect, offset.owner, OF_SENSORS, offset.prior, offset.unit))
    mechanism = equation.mechanism(model, equation.prior)
    return IdentifiedModel(
        robot=robot,
        config=config,
        model=model,
        mechanism=mechanism,
        terms=tuple(sorts.terms),
        inertias=tuple(sorts.inertias),
        armatures=tuple(sorts.armatures),
        tilts=tuple(sorts.tilts),
        offsets=tuple(sorts.offsets),
        others=tuple(sorts.others),
    )


@dataclass
class _EffectsByForm:
    """Effects by the form that they have when the model is run forwards.

    Attributes
    ----------
    model
        The robot without the effects.
    terms, inertias, armatures, tilts, offsets, others
        As in `IdentifiedModel`.
    """

    model: RobotModel
    terms: list[EffectTorque] = field(default_factory=list)
    inertias: list[Part] = field(default_factory=list)
    armatures: list[Part] = field(default_factory=list)
    tilts: list[Part] = field(default_factory=list)
    offsets: list[Part] = field(default_factory=list)
    others: list[Part] = field(default_factory=list)

    def add(self, effect: NamedEffect) -> None:
        """Sort an effect by the changes that it alone makes to the model's forward dynamics."""
        theta = np.array([c.prior for c in effect.coefficients])
        mechanism = mechanism_of(effect, self.model)
        owner = next((name for name in effect.key[1:] if isinstance(name, str) and name), "robot")
        amount = self._amount(effect, theta)
        if any(value for _, value in (*mechanism.smooth_terms, *mechanism.dry_friction_terms)):
            self.terms.append(EffectTorque(effect.id, owner, effect.simulator_elements(theta), amount))
        if mechanism.pi.any() or mechanism.model.bodies is not self.model.bodies:
            self.inertias.append(Part(effect.id, owner, "in the inertials", *amount))
        if mechanism.armature.any():
            self.armatures.append(Part(effect.id, owner, "armature", *amount))
        if (mechanism.gravity != self.model.gravity).any():
            self.tilts.append(Part(effect.id, owner, "gravity", *amount))
        if mechanism.position_offset.any():
            self.offsets.append(Part(effect.id, owner, "ref of the joint", *amount))
        has_hysteresis = any(value for _, value in mechanism.hysteresis_terms)
        if mechanism.torque_sensors or mechanism.torque_delay.any():
            self.others.append(Part(effect.id, owner, OF_SENSORS, *amount))
        elif mechanism.transmissions or mechanism.extra_torques or has_hysteresis:
            self.others.append(Part(effect.id, owner, NO_EQUIVALENT, *amount))

    def _amount(self, effect: NamedEffect, theta: Array) -> tuple[float, str] | tuple[()]:
        """Value and unit of an effect's first parameter; empty without one."""
        parameters = effect.parameters(theta, np.full((len(theta), len(theta)), np.inf))
        for (value, _), coefficient in zip(parameters.values(), effect.coefficients, strict=False):
            return value, coefficient.unit
        return ()

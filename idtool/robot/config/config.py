"""`Config`: everything that a URDF does not contain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, PrivateAttr, Tag

from idtool.common.exceptions import ConfigError
from idtool.common.provenance import InputFile, source_from_bytes
from idtool.common.safe_yaml import parse_yaml, yaml_bytes
from idtool.robot.config.base import ConfigRecord, Finite, Vector, validate_record
from idtool.robot.config.bounds import BoundingEllipsoid, BoundingShape
from idtool.robot.config.estimation import (
    Armature,
    Constraints,
    KnownMasses,
    MeasuredValue,
    Mirror,
    Regularization,
    Solver,
    armature_tag,
)
from idtool.robot.config.example import EXAMPLE
from idtool.robot.config.floating_base import Base, Contact
from idtool.robot.config.limits import JointLimits, limits_tag
from idtool.robot.config.pool import Pool
from idtool.robot.config.rotors import RotorConfig
from idtool.robot.config.signals import Controller, Filter, LogOptions, SimulationOptions
from idtool.robot.config.terms import EffectEntry, Friction, friction_tag
from idtool.robot.config.wrench_sensors import WrenchSensor


def _unique(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is listed twice; list each joint once")
    return names


def _unique_contacts(contacts: tuple[Contact, ...]) -> tuple[Contact, ...]:
    names = [contact.name for contact in contacts]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is listed twice; give each contact a name of its own")
    return contacts


def _unique_sensors(sensors: tuple[WrenchSensor, ...]) -> tuple[WrenchSensor, ...]:
    joints = [sensor.joint for sensor in sensors]
    for joint in joints:
        if joints.count(joint) > 1:
            raise ValueError(f"joint {joint} has two sensors; keep one")
    return sensors


class Config(ConfigRecord):
    """The configuration: everything that a URDF does not contain."""

    example = EXAMPLE

    joints: Annotated[tuple[str, ...], AfterValidator(_unique)] | None = None
    locked_joints: dict[str, Finite] = Field(default_factory=dict)
    gravity: Vector = (0.0, 0.0, -9.81)
    log: LogOptions = LogOptions()
    velocity: Literal["measured", "differentiated", "auto"] = "auto"
    bounding_ellipsoids: dict[str, tuple[BoundingEllipsoid, ...]] = Field(default_factory=dict)
    bounding_shapes: dict[str, tuple[BoundingShape, ...]] = Field(default_factory=dict)
    known_com: dict[str, Vector] = Field(default_factory=dict)
    rotors: dict[str, RotorConfig] = Field(default_factory=dict)
    armature: Annotated[
        Annotated[dict[str, Armature], Tag("by joint")] | Annotated[Armature, Tag("alike")],
        Discriminator(armature_tag),
    ] = Field(default_factory=dict)
    friction: Annotated[
        Annotated[dict[str, Friction], Tag("by joint")] | Annotated[Friction, Tag("alike")],
        Discriminator(friction_tag),
    ] = Friction()
    constraints: Constraints | None = None
    regularization: Regularization = Regularization()
    filter: Filter = Filter()
    known: KnownMasses = KnownMasses()
    mirror: tuple[Mirror, ...] = ()
    effects: tuple[EffectEntry, ...] = ()
    solver: Solver = Solver()
    controller: Controller | None = None
    simulation: SimulationOptions = SimulationOptions()
    limits: Annotated[
        Annotated[dict[str, JointLimits], Tag("by joint")] | Annotated[JointLimits, Tag("alike")],
        Discriminator(limits_tag),
    ] = Field(default_factory=dict)
    base: Base = Base()
    contacts: Annotated[tuple[Contact, ...], AfterValidator(_unique_contacts)] = ()
    wrench_sensors: Annotated[tuple[WrenchSensor, ...], AfterValidator(_unique_sensors)] = ()
    pool: Pool | None = None
    seed: Annotated[int, Field(ge=0)] = 0

    _source: InputFile | None = PrivateAttr(default=None)

    @property
    def source(self) -> InputFile | None:
        """The file it was read from, if any."""
        return self._source

    def require_only_joints(self, feature: str) -> None:
        """Raise ConfigError for a floating base, contacts or wrench sensors, which a feature cannot handle."""
        if self.base.kind != "fixed":
            raise ConfigError("base.kind: floating", f"{feature} needs a fixed base")
        for key in ("contacts", "wrench_sensors"):
            if getattr(self, key):
                raise ConfigError(key, f"are not for {feature}; remove them")

    def without_friction_values(self) -> Config:
        """A copy with the friction terms, but without their values, and without armature and effects."""

        def without_values(friction: Friction) -> Friction:
            return Friction(**{name: term is not False for name, term in friction})

        friction: Friction | dict[str, Friction]
        if isinstance(self.friction, Friction):
            friction = without_values(self.friction)
        else:
            friction = {joint: without_values(terms) for joint, terms in self.friction.items()}
        return self.model_copy(update={"friction": friction, "armature": {}, "effects": ()})

    def friction_of(self, joint: str) -> Friction:
        """The friction terms of one joint; a joint that is not named has the default ones."""
        if isinstance(self.friction, Friction):
            return self.friction
        return self.friction.get(joint, Friction())

    def has_bound(self, body: str) -> bool:
        """True if a body has ellipsoids or shapes as bounds; a rotor also, if they are not in its own entry."""
        return body in self.bounding_ellipsoids or body in self.bounding_shapes

    def armature_of(self, joint: str) -> MeasuredValue | Literal["auto"] | None:
        """Reflected rotor inertia of one joint [kg·m² or kg]; ``auto``: it is estimated; None: it has none."""
        if isinstance(self.armature, dict):
            return self.armature.get(joint)
        return self.armature

    def limits_of(self, joint: str) -> JointLimits:
        """The limits of one joint."""
        if isinstance(self.limits, JointLimits):
            return self.limits
        return self.limits.get(joint, JointLimits())


def parse_config(data: Any, where: str) -> Config:
    """A configuration from plain data.

    Raises
    ------
    ConfigError
        If a key is unknown or a value does not fit; the message names the key.
    """
    if data is None:
        return Config()
    if not isinstance(data, Mapping):
        raise ConfigError(where, "is not a configuration: expected keys such as joints, rotors, filter")
    return validate_record(Config, data, where)


def read_config(path: Path) -> Config:
    """A configuration from a YAML file.

    Raises
    ------
    ConfigError
        If the file or a key in it cannot be used.
    """
    data = yaml_bytes(path)
    config = parse_config(parse_yaml(path, data), str(path))
    config._source = source_from_bytes("configuration", path, data)
    return config

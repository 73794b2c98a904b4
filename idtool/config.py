"""The configuration: YAML into frozen records. An unknown key is an error that names the nearest known one.

Units as in the contract: rad or m, rad/s or m/s, N·m or N, kg, s; a prismatic joint takes the second of each pair.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from idtool.ellipsoid import Ellipsoid
from idtool.exceptions import ConfigError
from idtool.safe_yaml import read_yaml

_MOST = 1e12  # SI, of any number: powers of what is larger are not finite
_LEAST = 1e-6  # of a length: the inverse square of what is smaller is not finite


def _length(x: float) -> float:
    if x < _LEAST:
        raise ValueError(f"input should be at least {_LEAST:g} m")
    return x


Finite = Annotated[float, Field(ge=-_MOST, le=_MOST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=_MOST, allow_inf_nan=False)]
Length = Annotated[Positive, AfterValidator(_length)]
NonNegative = Annotated[float, Field(ge=0, le=_MOST, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Constraints = Literal["none", "semi", "full", "known_com", "com_ellipsoid", "ellipsoid", "shape", "points"]


class Record(BaseModel):
    """Base of the configuration's records: frozen, strict about its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    near = difflib.get_close_matches(str(key), cls.model_fields, n=1, cutoff=0.0)
                    raise ValueError(f"unknown key '{key}'; did you mean '{near[0]}'?")
        return data


class Bounding(Record):
    """A bounding ellipsoid: centre [m], semi-axes [m], roll–pitch–yaw [rad]."""

    center: Vector = (0.0, 0.0, 0.0)
    semi_axes: tuple[Length, Length, Length]
    rpy: Vector = (0.0, 0.0, 0.0)

    def ellipsoid(self) -> Ellipsoid:
        """The same as geometry."""
        return Ellipsoid(self.center, self.semi_axes, self.rpy)


class Placed(Record):
    """A bounding shape's place: centre [m], roll–pitch–yaw [rad]."""

    center: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class BoxBound(Placed):
    """A box with sides of lengths ``size`` [m]."""

    kind: Literal["box"]
    size: tuple[Length, Length, Length]


class CylinderBound(Placed):
    """A cylinder about its own z [m]."""

    kind: Literal["cylinder"]
    radius: Length
    length: Length


class CapsuleBound(Placed):
    """A cylinder about its own z with half a ball on each end; ``length`` is the cylinder's [m]."""

    kind: Literal["capsule"]
    radius: Length
    length: Length


class HullBound(Record):
    """The convex hull of a mesh: ``file``, from the URDF's folder, or else what the URDF gives the link."""

    kind: Literal["hull"]
    file: str | None = None


BoundingShape = Annotated[BoxBound | CylinderBound | CapsuleBound | HullBound, Field(discriminator="kind")]


class Uncertain(Record):
    """A number that may carry its standard error, both in the number's unit."""

    value: Finite
    standard_error: NonNegative | None = None

    @model_validator(mode="before")
    @classmethod
    def _bare_number(cls, data: Any) -> Any:
        return data if isinstance(data, Mapping) else {"value": data}


class Scale(Record):
    """SI per logged unit, by joint."""

    q: dict[str, Finite] = {}
    v: dict[str, Finite] = {}
    tau: dict[str, Finite] = {}
    qcmd: dict[str, Finite] = {}
    vcmd: dict[str, Finite] = {}


class LogOptions(Record):
    """How to read the logs."""

    topic: str | None = None
    columns: dict[str, str] = {}
    scale: Scale = Scale()


class Origin(Record):
    """A frame's place: xyz [m], roll–pitch–yaw [rad]."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class Inertial(Record):
    """Mass [kg], centre of mass [m] and [ixx, ixy, iyy, ixz, iyz, izz] about it [kg·m²]."""

    mass: NonNegative
    com: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite]


class Rotor(Record):
    """A body that spins with a joint, or with a combination of joint velocities.

    A rotor that bears the name of a URDF link on a fixed joint is that link: what is left out here comes from there.
    """

    joint: str | None = None
    gear_ratio: Finite | None = None
    coupling: dict[str, Finite] = {}
    parent: str | None = None
    origin: Origin | None = None
    axis: Vector | None = None
    inertial: Inertial | None = None
    bounding_ellipsoid: Bounding | None = None

    @model_validator(mode="after")
    def _one_drive(self) -> Self:
        if self.coupling and (self.joint or self.gear_ratio is not None):
            raise ValueError("give either joint and gear_ratio, or coupling")
        if not self.coupling and (self.joint is None or self.gear_ratio is None):
            raise ValueError("needs joint and gear_ratio, or coupling: {joint: ratio, ...}")
        if 0.0 in (self.gear_ratio, *self.coupling.values()):
            raise ValueError("a gear ratio of 0 does not move the rotor")
        if self.axis is not None and math.hypot(*self.axis) < _LEAST:
            raise ValueError("axis must not be zero")
        return self

    @property
    def ratios(self) -> dict[str, float]:
        """Rotor angle per joint angle, by joint."""
        if self.coupling:
            return dict(self.coupling)
        if self.joint is None or self.gear_ratio is None:
            raise AssertionError  # ruled out by _one_drive
        return {self.joint: self.gear_ratio}


def _term(data: Any) -> Any:
    return data if isinstance(data, bool | Uncertain) else Uncertain.model_validate(data)


Term = Annotated[bool | Uncertain, BeforeValidator(_term)]


class Friction(Record):
    """Which friction terms a joint has, or their values [N·m·s/rad, N·m, N·m], as prior for `fit`, as is elsewhere."""

    viscous: Term = True
    coulomb: Term = True
    offset: Term = False


def _friction_form(data: Any) -> str:
    """Terms for all joints alike, or by joint: told apart by the keys, so that errors speak of one of them."""
    if not isinstance(data, Mapping) or not data or set(data) & set(Friction.model_fields):
        return "alike"
    return "by joint" if all(isinstance(terms, Mapping | Friction) for terms in data.values()) else "alike"


class Regularization(Record):
    """The prior's kind and weight (27).

    The Euclidean distance is taken in units of each body's own mass and size, or, as the paper has it, in SI units.
    """

    kind: Literal["none", "euclidean", "entropic", "pullback"] = "euclidean"
    weight: NonNegative = 1e-6
    units: Literal["relative", "si"] = "relative"

    @model_validator(mode="after")
    def _units_of_the_euclidean(self) -> Self:
        if self.units == "si" and self.kind in ("entropic", "pullback"):
            raise ValueError(f"units: si is for kind euclidean; {self.kind} does not depend on units")
        return self


class Measured(Record):
    """A positive number measured by other means; with a standard error it is soft, without exact."""

    value: Positive
    standard_error: Positive | None = None

    @model_validator(mode="before")
    @classmethod
    def _bare_number(cls, data: Any) -> Any:
        return data if isinstance(data, Mapping) else {"value": data}


class Known(Record):
    """Masses [kg] by body, and of all bodies of the model together."""

    mass: dict[str, Measured] = {}
    total_mass: Measured | None = None


class Mirror(Record):
    """A body that is a copy of another, equal or mirrored in a plane of the link frames, or a joint with its friction.

    Friction that depends on the direction, an offset, is left to each joint.
    """

    body: str | None = None
    joint: str | None = None
    of: str
    plane: Literal["xy", "xz", "yz"] | None = None

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        if (self.body is None) == (self.joint is None):
            raise ValueError("give either body or joint, and of")
        if self.joint is not None and self.plane is not None:
            raise ValueError("plane is for bodies; friction has none")
        if self.of in (self.body, self.joint):
            raise ValueError(f"{self.of} is a copy of itself; name another")
        return self


class Filter(Record):
    """The zero-phase low-pass. No cut-off: 40 Hz, or a fifth of the sampling rate where that is lower."""

    kind: Literal["butterworth"] = "butterworth"
    cutoff_hz: Positive | None = None
    order: Annotated[int, Field(ge=1, le=8)] = 4


class Solver(Record):
    """The conic solver, or a local one on a manifold of realizable bodies."""

    name: Literal["clarabel", "log_cholesky", "manifold"] = "clarabel"


class Controller(Record):
    """A joint PD controller: kp [N·m/rad], kd [N·m·s/rad] at the joint, delay from command to torque [s]."""

    kp: dict[str, NonNegative]
    kd: dict[str, NonNegative] = {}
    delay: NonNegative = 0.0


class EffectEntry(Record):
    """An effect that the model carries; parameters in SI, each a number or a value with its standard error."""

    effect: str
    joint: str | None = None
    link: str | None = None
    parameters: dict[str, Any] = {}


class Simulation(Record):
    """Rollouts restart from the measured state every window [s]; null: never."""

    window: Positive | None = 1.0


class Config(Record):
    """Everything a URDF does not say."""

    joints: tuple[str, ...] | None = None
    locked_joints: dict[str, Finite] = {}
    gravity: Vector = (0.0, 0.0, -9.81)
    log: LogOptions = LogOptions()
    velocity: Literal["measured", "differentiated", "auto"] = "auto"
    bounding_ellipsoids: dict[str, tuple[Bounding, ...]] = {}
    bounding_shapes: dict[str, tuple[BoundingShape, ...]] = {}
    known_com: dict[str, Vector] = {}
    rotors: dict[str, Rotor] = {}
    friction: Annotated[
        Annotated[dict[str, Friction], Tag("by joint")] | Annotated[Friction, Tag("alike")],
        Discriminator(_friction_form),
    ] = Friction()
    constraints: Constraints | None = None
    regularization: Regularization = Regularization()
    filter: Filter = Filter()
    known: Known = Known()
    mirror: tuple[Mirror, ...] = ()
    effects: tuple[EffectEntry, ...] = ()
    solver: Solver = Solver()
    controller: Controller | None = None
    simulation: Simulation = Simulation()
    seed: int = 0

    def without_friction_values(self) -> Config:
        """The same with the terms that friction has, but neither their values nor effects."""

        def terms(friction: Friction) -> Friction:
            return Friction(**{name: term is not False for name, term in friction})

        friction = self.friction
        plain = terms(friction) if isinstance(friction, Friction) else {j: terms(f) for j, f in friction.items()}
        return self.model_copy(update={"friction": plain, "effects": ()})

    def friction_of(self, joint: str) -> Friction:
        """The friction terms of one joint; a joint that is not named has the default ones."""
        return self.friction if isinstance(self.friction, Friction) else self.friction.get(joint, Friction())


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
    return checked(Config, data, where)


R = TypeVar("R", bound=Record)


def checked(kind: type[R], data: Any, where: str) -> R:
    """A record from plain data.

    Raises
    ------
    ConfigError
        If a key is unknown or a value does not fit; the message names the key.
    """
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"] if part not in ("by joint", "alike", "[key]"))
        message = first["msg"].removeprefix("Value error, ").replace("valid tuple", "list")
        message = message.split(" or instance of ")[0].replace("valid dictionary", "mapping of keys to values")
        raise ConfigError(f"{where}: {key}" if key else where, message[0].lower() + message[1:]) from None


def read_config(path: Path) -> Config:
    """A configuration from a YAML file.

    Raises
    ------
    ConfigError
        If the file or a key in it cannot be used.
    """
    return parse_config(read_yaml(path), str(path))

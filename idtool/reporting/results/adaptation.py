"""Records of `idtool adapt`: adapt.json."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import (
    ByJointOrNone,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    Units,
    Vector,
    field,
)


class CoefficientReport(Record):
    """A coefficient of the torque equation."""

    effect: str = field("Effect that it belongs to.")
    owner: str = field("Body or joint that it belongs to.")
    name: str = field("Its name.")
    unit: str = field("Its unit.")


class AdaptedBody(Record):
    """A body at the end of the logs, in the link's frame."""

    mass: float = field("Mass [kg].")
    com: Vector = field("Centre of mass, shape (3,) [m].")
    inertia_com: Vector = field("Inertia about the centre of mass: [xx, xy, yy, xz, yz, zz] [kg·m²].")
    pi: Vector = field("The ten parameters.")
    realizable: bool = field("Whether some mass density has these parameters.")


class AdaptedFriction(Record):
    """Friction of a joint at the end of the logs; null for a term that the model lacks."""

    viscous: float | None = field("Viscous friction [N·m·s/rad or N·s/m].")
    coulomb: float | None = field("Coulomb friction [N·m or N].")
    offset: float | None = field("Torque offset [N·m or N].")


class FinalEstimate(Record):
    """The estimate at the end of the logs."""

    bodies: Annotated[ReadOnly[AdaptedBody], Keys("body")] = field("The bodies.")
    friction: Annotated[ReadOnly[AdaptedFriction], Keys("joint")] = field("Friction.")


class AdaptationReport(ReproducibleResult):
    """Result of `idtool adapt`."""

    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    bodies: tuple[str, ...] = field("Names of the bodies.")
    coefficients: tuple[CoefficientReport, ...] = field("The columns of `theta`.")
    constraints: Annotated[ReadOnly[str], Keys("body")] = field("Constraint set of each body.")
    forgetting: float | None = field("Time constant of forgetting [s]; null: no forgetting.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    t: Vector = field("Time [s]; the first is 0, before any data.")
    theta: tuple[tuple[float, ...], ...] = field("The coefficients at each time.")
    prediction_rms: ByJointOrNone = field(
        "RMS error of the torque predicted one sample ahead [N·m or N]; null for a row of which nothing was predicted."
    )
    final: FinalEstimate = field("The estimate at the end.")
    samples: int = field("Number of updates.")
    update_hz: float = field("Updates per second of the log: one per row after decimation to the band [Hz].")
    seconds: float = field("Wall time [s].")
    logs: tuple[str, ...] = field("The logs.")
    urdf: str = field("The URDF.")

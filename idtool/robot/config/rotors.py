"""Rotors: bodies that spin with joints, which a URDF cannot describe."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from idtool.robot.config.base import MIN_LENGTH, ConfigRecord, Finite, NonNegative, Vector
from idtool.robot.config.bounds import BoundingEllipsoid


class Origin(ConfigRecord):
    """Origin of a frame: xyz [m], roll–pitch–yaw [rad]."""

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class Inertial(ConfigRecord):
    """Mass [kg], centre of mass [m] and [ixx, ixy, iyy, ixz, iyz, izz] about it [kg·m²]."""

    mass: NonNegative
    com: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite]


class RotorConfig(ConfigRecord):
    """A body that spins with a joint, or with a combination of joint velocities.

    A rotor with the same name as a URDF link on a fixed joint is that link; missing keys are taken from the URDF.
    """

    joint: str | None = None
    gear_ratio: Finite | None = None
    coupling: dict[str, Finite] = Field(default_factory=dict)
    parent: str | None = None
    origin: Origin | None = None
    axis: Vector | None = None
    inertial: Inertial | None = None
    bounding_ellipsoid: BoundingEllipsoid | None = None

    @model_validator(mode="after")
    def _check_drive(self) -> Self:
        if self.coupling and (self.joint or self.gear_ratio is not None):
            raise ValueError("give either joint and gear_ratio, or coupling")
        if not self.coupling and (self.joint is None or self.gear_ratio is None):
            raise ValueError("needs joint and gear_ratio, or coupling: {joint: ratio, ...}")
        if 0.0 in (self.gear_ratio, *self.coupling.values()):
            raise ValueError("a gear ratio of 0 is not possible: the rotor would not move")
        if self.axis is not None and math.hypot(*self.axis) < MIN_LENGTH:
            raise ValueError("axis must not be zero")
        return self

    @property
    def ratios(self) -> dict[str, float]:
        """Rotor angle per joint angle, by joint."""
        if self.coupling:
            return dict(self.coupling)
        if self.joint is None or self.gear_ratio is None:
            raise AssertionError  # ruled out by _check_drive
        return {self.joint: self.gear_ratio}

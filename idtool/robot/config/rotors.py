"""Rotors: bodies that spin with joints, which a URDF cannot describe."""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from idtool.common.arrays import Array
from idtool.robot.config.base import MIN_LENGTH, ConfigRecord, Finite, NonNegative, Positive, Vector
from idtool.robot.config.bounds import BoundingEllipsoid
from idtool.robot.inertia import symmetric_entries

_DENSITY = 1200.0  # kg/m³ of a rotor and the holes in it: by their inertia and mass, those of robots have 500 to 2700
_LENGTH = 0.5  # of a rotor, as a share of its radius
_MARGIN = 1.5  # of the radius of the bounding sphere to that of the disc


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
    Instead of ``inertial``, ``inertia`` about the spin axis is enough [kg·m²].
    """

    joint: str | None = None
    gear_ratio: Finite | None = None
    inertia: Positive | None = None
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
        if self.inertia is not None and self.inertial is not None:
            raise ValueError("give either inertia, about the axis, or inertial")
        return self

    def with_disc(self, axis: Array, is_bounded: bool = False) -> RotorConfig:
        """A copy of a rotor with ``inertia`` that has the ``inertial`` of a typical rotor with it, and its bound.

        That is a solid disc of radius r and length r / 2 about the axis: the mass is ρ π r³ / 2, and the inertia about
        the axis m r² / 2. A sphere about it is the bound, if there is no other.

        Parameters
        ----------
        axis
            Unit vector along the spin axis in the rotor frame, shape (3,).
        is_bounded
            True if the rotor has a bound outside its own entry.
        """
        if self.inertia is None:
            return self
        radius = (2 * self.inertia / (_DENSITY * math.pi * _LENGTH)) ** 0.2
        mass = 2 * self.inertia / radius**2
        across = mass * (3 + _LENGTH**2) * radius**2 / 12
        inertia = across * np.eye(3) + (self.inertia - across) * np.outer(axis, axis)
        xx, xy, yy, xz, yz, zz = symmetric_entries(inertia).tolist()
        bound = self.bounding_ellipsoid
        if bound is None and not is_bounded:
            bound = BoundingEllipsoid(semi_axes=(max(_MARGIN * radius, MIN_LENGTH),) * 3)
        inertial = Inertial(mass=mass, inertia=(xx, xy, yy, xz, yz, zz))
        return self.model_copy(update={"inertia": None, "inertial": inertial, "bounding_ellipsoid": bound})

    @property
    def ratios(self) -> dict[str, float]:
        """Rotor angle per joint angle, by joint."""
        if self.coupling:
            return dict(self.coupling)
        if self.joint is None or self.gear_ratio is None:
            raise AssertionError  # ruled out by _check_drive
        return {self.joint: self.gear_ratio}

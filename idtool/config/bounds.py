"""Bounding ellipsoids and shapes, in the link's frame."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from idtool.config.base import Length, Record, Vector
from idtool.ellipsoid import Ellipsoid


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

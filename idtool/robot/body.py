"""Bodies and frames, of which a `RobotModel` consists.

Letters: q joint coordinates (nv,) [rad or m], pi inertia parameters (10,), R (3, 3) and p (3,) [m] a frame's pose in
another, phi a body's own coordinate [rad or m].
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import parameter_transform, symmetric_matrix
from idtool.robot.shapes import Shape


@dataclass(frozen=True)
class Frame:
    """Rotation R (3, 3) and position p (3,) [m] in a body's frame; body −1 is the root link."""

    body: int
    R: Array
    p: Array

    def compose(self, R: Array, p: Array) -> Frame:
        """The frame whose pose in this one is R (3, 3), p (3,) [m]."""
        return Frame(self.body, self.R @ R, self.p + self.R @ p)

    def transform(self, ellipsoid: Ellipsoid) -> Ellipsoid:
        """An ellipsoid given in this frame, in the body's frame."""
        center = self.p + self.R @ ellipsoid.center
        return Ellipsoid.from_axes(center, ellipsoid.semi_axes, self.R @ ellipsoid.rotation)


@dataclass(frozen=True)
class Member:
    """A URDF link that is part of a body: its own parameters (10,) and its frame in the body's."""

    link: str
    pi: Array
    frame: Frame

    @property
    def pi_in_body(self) -> Array:
        """The link's parameters in the body's frame, shape (10,)."""
        return parameter_transform(self.frame.R, self.frame.p) @ self.pi


@dataclass(frozen=True)
class Body:
    """A rigid body and how it moves.

    Attributes
    ----------
    name
        Name of the link that carries the others, or of the rotor.
    kind
        Link or rotor.
    pi
        Prior inertia parameters in the body's frame, all members together, shape (10,).
    ellipsoids
        Bounding ellipsoids in the body's frame; several stand for their union; none: no bound.
    shapes
        Other bounding shapes in the body's frame, part of the same union.
    com
        Centre of mass in the body's frame where it is known otherwise [m].
    mount
        The body's frame, at phi = 0, in its parent's.
    axis
        Unit vector of the motion in the body's frame, shape (3,).
    prismatic
        True if it moves along the axis, False if about it.
    ratios, offset
        phi = ratios · q + offset; shape (nv,), [rad or m].
    members
        The URDF links it is made of, the one that gives the name first; none for a rotor that is not in the URDF.
    is_base
        True for a floating base.
    first_free_coordinate
        First of the six coordinates of a body that moves freely against its parent, along and about the axes of its own
        frame: a floating base, or what a wrench sensor carries, for which they are 0. None: it moves along an axis.
    """

    name: str
    kind: Literal["link", "rotor"]
    pi: Array
    ellipsoids: tuple[Ellipsoid, ...]
    mount: Frame
    axis: Array
    prismatic: bool
    ratios: Array
    offset: float = 0.0
    members: tuple[Member, ...] = ()
    shapes: tuple[Shape, ...] = ()
    com: tuple[float, float, float] | None = None
    is_base: bool = False
    first_free_coordinate: int | None = None

    def axial_inertia(self, pi: Array) -> float:
        """Moment of inertia about the body's axis [kg·m²] with parameters in its frame, shape (10,)."""
        return float(self.axis @ symmetric_matrix(pi[4:]) @ self.axis)

    def with_mirrored_bounds(self, other: Body, signs: Array) -> Body:
        """The body with the mirror image of another's bounds, in which x, y and z have these signs, shape (3,)."""
        return replace(
            self,
            ellipsoids=tuple(ellipsoid.mirrored(signs) for ellipsoid in other.ellipsoids),
            shapes=tuple(shape.transformed(np.diag(signs), np.zeros(3)) for shape in other.shapes),
        )

    @property
    def bounds(self) -> tuple[Ellipsoid | Shape, ...]:
        """Ellipsoids and shapes that bound its mass; several are their union."""
        return (*self.ellipsoids, *self.shapes)

    @property
    def lumped_links(self) -> tuple[str, ...]:
        """Links with mass that are part of this body under another name."""
        return tuple(member.link for member in self.members[1:] if member.pi.any())

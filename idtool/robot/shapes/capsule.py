"""A capsule: the union of a cylinder and the balls at its ends."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import REALIZABLE, Piece, density_within
from idtool.robot.shapes.base import PosedShape, Vector, disc_points, finest_grid
from idtool.robot.shapes.cylinder import Cylinder


@dataclass(frozen=True)
class Capsule(PosedShape):
    """All points within ``radius`` of a line segment along its own z axis.

    Attributes
    ----------
    center
        Its middle [m].
    radius, length
        Radius, and length of the segment, without the round ends [m], positive.
    rpy
        Roll, pitch and yaw of its own axes, as in URDF [rad].
    """

    center: Vector
    radius: float
    length: float
    rpy: Vector = (0.0, 0.0, 0.0)

    kind: ClassVar[str] = "capsule"
    exact: ClassVar[bool] = Cylinder.exact

    @property
    @override
    def volume(self) -> float:
        return math.pi * self.radius**2 * (self.length + 4 / 3 * self.radius)

    @override
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        local = self.to_local(points)
        local[..., 2] -= np.clip(local[..., 2], -0.5 * self.length, 0.5 * self.length)
        return np.asarray(np.linalg.norm(local, axis=-1) - self.radius <= tolerance * self.size)

    @override
    def grid(self, count: int) -> Array:
        """Points in discs, at least the middle and both tips; see `Shape.grid`."""
        half_length = 0.5 * self.length
        radius = self.radius

        def points(spacing: float) -> Array:
            middle = half_length * np.linspace(-1, 1, 1 + max(1, round(self.length / spacing)))
            height = np.linspace(0, radius, 1 + max(1, round(radius / spacing)))[1:]  # above an end's centre
            width = np.sqrt(np.maximum(radius**2 - height**2, 0))
            levels = np.concatenate([-half_length - height, middle, half_length + height])
            radii = np.concatenate([width, np.full(len(middle), radius), width])
            return disc_points(levels, radii, spacing)

        return self.to_body(finest_grid(points, 2 * (self.length + 2 * radius), count))

    @override
    def pieces(self) -> tuple[Piece, ...]:
        """The pieces of the cylinder, and one for each ball (Cor. 2)."""
        ends = self.to_body(np.array([[0, 0, -0.5], [0, 0, 0.5]]) * self.length)
        balls = [Ellipsoid((x, y, z), (self.radius, self.radius, self.radius)) for x, y, z in ends.tolist()]
        round_ends = [Piece((REALIZABLE, density_within(ball.Q, "mass within its bounding capsule"))) for ball in balls]
        return (*Cylinder(self.center, self.radius, self.length, self.rpy).pieces(), *round_ends)

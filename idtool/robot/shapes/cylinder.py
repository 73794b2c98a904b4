"""A cylinder, by the moment relaxation of Heins & Schoellig (arXiv 2411.07079) with second-order cones' products."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.robot.inequality import REALIZABLE, Inequality, Piece, density_within
from idtool.robot.shapes.base import PosedShape, Vector, disc_points, finest_grid, product_form

_LABEL = "mass within its bounding cylinder"


@dataclass(frozen=True)
class Cylinder(PosedShape):
    """A cylinder around its own z axis.

    With (u, v, w) its coordinates in units of radius, radius and half length, a density on it has moments with J ⪰ 0,
    E[1 − u² − v²] ≥ 0, E[1 − w²] ≥ 0 and ‖E[(1 ± w)(u, v)]‖ ≤ E[1 ± w]: the product of each end's 1 ± w ≥ 0 with
    ‖(u, v)‖ ≤ 1. They also suffice, as for the part of an ellipsoid between two parallel planes (Ye & Zhang 2003;
    Burer & Anstreicher 2013), of which the cylinder is the limit where the ellipsoid's third axis grows.

    Attributes
    ----------
    center
        Its middle [m].
    radius, length
        Radius and length along its own z axis, as in URDF [m], positive.
    rpy
        Roll, pitch and yaw of its own axes, as in URDF [rad].
    """

    center: Vector
    radius: float
    length: float
    rpy: Vector = (0.0, 0.0, 0.0)

    kind: ClassVar[str] = "cylinder"
    exact: ClassVar[bool] = True

    @property
    @override
    def volume(self) -> float:
        return math.pi * self.radius**2 * self.length

    @override
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        local = self.to_local(points)
        beyond_side = np.hypot(local[..., 0], local[..., 1]) - self.radius
        beyond_end = np.abs(local[..., 2]) - 0.5 * self.length
        return np.asarray(np.maximum(beyond_side, beyond_end) <= tolerance * self.size)

    @override
    def grid(self, count: int) -> Array:
        """Points in discs, at least ten; see `Shape.grid`."""

        def points(spacing: float) -> Array:
            levels = self.length * np.linspace(-0.5, 0.5, 1 + max(1, round(self.length / spacing)))
            return disc_points(levels, np.full(len(levels), self.radius), spacing)

        return self.to_body(finest_grid(points, 2 * max(2 * self.radius, self.length), count))

    @override
    def pieces(self) -> tuple[Piece, ...]:
        u, v, w, one = self.affine_coordinates((self.radius, self.radius, 0.5 * self.length))
        side = product_form(one, one) - product_form(u, u) - product_form(v, v)
        ends = product_form(one - w, one + w)
        quadratic = density_within(np.array([side, ends]), _LABEL)
        upper = _second_order_cone(u, v, one + w)
        lower = _second_order_cone(u, v, one - w)
        return (Piece((REALIZABLE, quadratic, upper, lower)),)


def _second_order_cone(u: Array, v: Array, end: Array) -> Inequality:
    """‖E[end (u, v)]‖ ≤ E[end] as the matrix [[e, a, b], [a, e, 0], [b, 0, e]] ⪰ 0."""
    one = np.array([0.0, 0.0, 0.0, 1.0])
    Q = np.array([product_form(end, f) for f in (one, u, v)])
    e, a, b = density_within(Q, _LABEL).G.T  # (10,) each
    zero = np.zeros_like(e)
    G = np.array([[e, a, b], [a, e, zero], [b, zero, e]])
    return Inequality(_LABEL, np.moveaxis(G, -1, 0), np.zeros(3))

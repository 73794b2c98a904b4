"""A box, by the moment relaxation of Heins & Schoellig (arXiv 2411.07079)."""

from __future__ import annotations

from itertools import combinations
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.robot.inequality import REALIZABLE, Piece, density_within
from idtool.robot.shapes.base import PosedShape, Vector, finest_grid, product_form


@dataclass(frozen=True)
class Box(PosedShape):
    """A box.

    With u its coordinates in units of half its sides, a density on it has moments with J ⪰ 0 and E[f] ≥ 0 for every
    product f of two facets' functions 1 ± u_i, and for the four f = 1 ± u₁u₂ ± u₁u₃ ± u₂u₃ whose signs multiply to +1:
    at a corner such an f is 0 or 4, and it is linear in each u_i. These conditions are necessary, not sufficient.

    Attributes
    ----------
    center
        Its middle [m].
    sides
        Lengths of its sides along its own axes [m], positive; ``size`` in the configuration, as in URDF.
    rpy
        Roll, pitch and yaw of those axes, as in URDF [rad].
    """

    center: Vector
    sides: Vector
    rpy: Vector = (0.0, 0.0, 0.0)

    kind: ClassVar[str] = "box"
    exact: ClassVar[bool] = False
    config_names: ClassVar[dict[str, str]] = {"sides": "size"}

    @property
    @override
    def volume(self) -> float:
        return float(np.prod(self.sides))

    @override
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        beyond = np.abs(self.to_local(points)) - 0.5 * np.asarray(self.sides)
        return np.asarray(beyond.max(axis=-1) <= tolerance * self.size)

    @override
    def grid(self, count: int) -> Array:
        """Evenly spaced points, at least the eight corners; see `Shape.grid`."""

        def points(spacing: float) -> Array:
            axes = []
            for side in self.sides:
                intervals = max(1, round(side / spacing))
                axes.append(np.linspace(-0.5 * side, 0.5 * side, 1 + intervals))
            return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

        return self.to_body(finest_grid(points, 2 * max(self.sides), count))

    @override
    def pieces(self) -> tuple[Piece, ...]:
        x, y, z, one = self.affine_coordinates(0.5 * np.asarray(self.sides))
        signs = [(s, t) for s in (1, -1) for t in (1, -1)]
        Q = [product_form(one - u, one + u) for u in (x, y, z)]
        for u, v in combinations((x, y, z), 2):
            Q += [product_form(one + s * u, one + t * v) for s, t in signs]
        xy, xz, yz = product_form(x, y), product_form(x, z), product_form(y, z)
        Q += [product_form(one, one) + s * xy + t * xz + s * t * yz for s, t in signs]
        return (Piece((REALIZABLE, density_within(np.array(Q), "mass within its bounding box"))),)

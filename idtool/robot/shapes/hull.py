"""The convex hull of points, such as a mesh's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.robot.convex import enclosing_planes, enclosing_points, polyhedron_corners, principal_axes
from idtool.robot.ellipsoid import minimum_volume_ellipsoid
from idtool.robot.inequality import REALIZABLE, Piece, density_within
from idtool.robot.shapes.base import Shape, Vector, product_form

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

_MAX_FACES = 52  # of a solid that is simplified: no more than 100 corners
_CONDITION_FACES = 24  # from whose planes the conditions are made: 276 pairs
_ELLIPSOID_TOLERANCE = 1e-3  # of the volume of the ellipsoid around it
_PLASTIC = 0.7548776662466927  # 1/p with p³ = p + 1: multiples of it and of its square fill a square evenly
_MIN_THICKNESS = 0.01  # of the largest extent; a thinner solid is given that thickness


@dataclass(frozen=True)
class Hull(Shape):
    """A convex polyhedron.

    A density on it has moments with J ⪰ 0; E[f g] ≥ 0 for any two f, g ≥ 0 that measure how far a point is from the
    plane of a face, as of a box; and those of a density on the minimum-volume ellipsoid around it (25). These
    conditions are necessary, not sufficient. They admit less than x xᵀ ⪯ Σ λ_i v_i v_iᵀ, true of any point
    x = Σ λ_i v_i between the corners v_i, and take no unknowns beside pi.

    Attributes
    ----------
    vertices
        Its corners [m], shape (n, 3), spanning a volume; `around` finds those of any points.
    Q
        Matrices of the conditions Tr(J Q_i) ≥ 0 that any density on it fulfils, shape (k, 4, 4).
    """

    vertices: tuple[Vector, ...]
    Q: Array = field(compare=False, repr=False)

    kind: ClassVar[str] = "hull"
    exact: ClassVar[bool] = False

    @classmethod
    def around(cls, points: ArrayLike, max_vertices: int = 2 * _MAX_FACES - 4) -> Self:
        """The convex hull of points, shape (n, 3) [m].

        If it has more vertices than ``max_vertices``, a polyhedron around it that has no more: some of its faces'
        planes bound it, so that the solid grows a little. Points in a plane, on a line or alone get a thickness of a
        hundredth of their extent.

        Raises
        ------
        ValueError
            If there are no points or one is not finite.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        if not len(points) or not np.isfinite(points).all():
            raise ValueError("a hull needs at least one point, all of them finite")
        corners = enclosing_points(_thicken(points))
        if len(corners) > max_vertices:
            planes = enclosing_planes(corners, max_vertices // 2 + 2)  # at a corner three of them meet at least
            corners = polyhedron_corners(planes, corners.mean(axis=0))
        return cls(_vectors(corners), _conditions(corners))

    @cached_property
    def _hull(self) -> ConvexHull:
        from scipy.spatial import ConvexHull

        return ConvexHull(np.array(self.vertices))

    @property
    @override
    def volume(self) -> float:
        return float(self._hull.volume)

    @override
    def transformed(self, R: Array, p: Array) -> Self:
        inverse = np.eye(4)
        inverse[:3] = np.column_stack([R.T, -R.T @ p])
        vertices = np.array(self.vertices) @ R.T + p
        return type(self)(_vectors(vertices), inverse.T @ self.Q @ inverse)

    @override
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        planes = self._hull.equations
        beyond = np.asarray(points, dtype=float) @ planes[:, :3].T + planes[:, 3]
        return np.asarray(beyond.max(axis=-1) <= tolerance * self.size)

    @override
    def grid(self, count: int) -> Array:
        """At least its vertices, then one by one the point farthest from all those before; see `Shape.grid`."""
        vertices = np.array(self.vertices)
        candidates = self._lattice(0.5 * (self.volume / max(count, 1)) ** (1 / 3))
        squared_distance = np.min([np.square(candidates - x).sum(axis=1) for x in vertices], axis=0)
        added = []
        for _ in range(count - len(vertices)):
            farthest = candidates[int(squared_distance.argmax())]
            added.append(farthest)
            squared_distance = np.minimum(squared_distance, np.square(candidates - farthest).sum(axis=1))
        return np.concatenate([vertices, np.reshape(added, (-1, 3))])

    def _lattice(self, spacing: float) -> Array:
        """Points inside, on the faces and on the edges, about ``spacing`` apart [m]; shape (n, 3)."""
        corners = self._hull.points
        center = corners.mean(axis=0)
        axes = principal_axes(corners)
        local = (corners - center) @ axes.T
        ticks = [np.arange(x.min(), x.max(), spacing) for x in local.T]
        box = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3) @ axes + center
        points = [box[self.contains(box)]]
        for a, b, c in corners[self._hull.simplices]:
            area = 0.5 * np.linalg.norm(np.cross(b - a, c - a))
            k = np.arange(1, 1 + int(area / spacing**2))[:, None]
            u = k * _PLASTIC % 1  # even in the unit square, which is folded into a triangle
            v = k * _PLASTIC**2 % 1
            is_beyond = u + v > 1
            u = np.where(is_beyond, 1 - u, u)
            v = np.where(is_beyond, 1 - v, v)
            points.append(a + u * (b - a) + v * (c - a))
            for start, end in ((a, b), (b, c), (c, a)):
                count = 2 + int(np.linalg.norm(end - start) / spacing)
                share = np.linspace(0, 1, count)[:, None]
                points.append(start + share * (end - start))
        return np.concatenate(points)

    @override
    def pieces(self) -> tuple[Piece, ...]:
        return (Piece((REALIZABLE, density_within(self.Q, "mass within its hull"))),)

    @override
    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "vertices": [list(vertex) for vertex in self.vertices]}

    @classmethod
    @override
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The hull of any points under ``vertices``; see `Shape.from_dict`."""
        return cls.around(data["vertices"])


def _thicken(points: Array) -> Array:
    """The points or, where they span no volume, copies of them to either side."""
    center = points.mean(axis=0)
    axes = principal_axes(points)
    extent = np.ptp((points - center) @ axes.T, axis=0)
    thickness = _MIN_THICKNESS * max(extent.max(), 1e-3)
    for offset in 0.5 * thickness * axes[extent < thickness]:
        points = np.concatenate([points - offset, points + offset])
    return points


def _conditions(corners: Array) -> Array:
    """The matrices Q of a solid, shape (k, 4, 4)."""
    depth = -enclosing_planes(corners, _CONDITION_FACES)  # below each face, as affine functions
    depth /= (corners @ depth[:, :3].T + depth[:, 3]).max(axis=0)[:, None]  # from 0 at the face to 1
    i, j = np.triu_indices(len(depth), k=1)
    ellipsoid = minimum_volume_ellipsoid(corners, _ELLIPSOID_TOLERANCE).Q
    # Its angles are rounded, so that a corner may be just outside.
    lifted = np.column_stack([corners, np.ones(len(corners))])
    ellipsoid[3, 3] -= np.einsum("ni,ij,nj->n", lifted, ellipsoid, lifted).min()
    return np.concatenate([product_form(depth[i], depth[j]), ellipsoid[None]])


def _vectors(points: Array) -> tuple[Vector, ...]:
    return tuple((x, y, z) for x, y, z in points.tolist())

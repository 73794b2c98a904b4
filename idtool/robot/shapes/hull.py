"""The convex hull of points, such as a mesh's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.robot.convex import enclosing_planes, enclosing_points, polyhedron_corners, principal_axes
from idtool.robot.ellipsoid import minimum_volume_ellipsoid
from idtool.robot.inequality import REALIZABLE, Piece, density_within
from idtool.robot.shapes.base import Shape, Vector, product_form

_MAX_FACES = 52  # of a solid that is simplified: no more than 100 corners
_CONDITION_FACES = 24  # from whose planes the conditions are made: 276 pairs
_ELLIPSOID = 1e-3  # of the volume: how closely the least ellipsoid is sought
_PLASTIC = 0.7548776662466927  # 1/p with p³ = p + 1: multiples of it and of its square fill a square evenly
_FLATTEST = 0.01  # thickness against the largest extent, below which a solid is given that thickness


@dataclass(frozen=True)
class Hull(Shape):
    """A convex polyhedron.

    A density on it has moments with J ⪰ 0; E[f g] ≥ 0 for any two f, g ≥ 0 that measure how far a place is from the
    plane of a face, as of a box; and those of a density on the least ellipsoid around it (25). These conditions are
    necessary, not sufficient. They admit less than x xᵀ ⪯ Σ λ_i v_i v_iᵀ, true of any place x = Σ λ_i v_i between the
    corners v_i, and take no unknowns beside pi.

    Attributes
    ----------
    vertices
        Its corners [m], shape (n, 3), spanning a volume; `around` finds those of any points.
    Q
        The conditions' matrices, Tr(J Q_i) ≥ 0 of any density on it, shape (k, 4, 4).
    """

    vertices: tuple[Vector, ...]
    Q: Array = field(compare=False, repr=False)

    kind: ClassVar[str] = "hull"
    exact: ClassVar[bool] = False

    @classmethod
    def around(cls, points: ArrayLike, most: int = 2 * _MAX_FACES - 4) -> Self:
        """The convex hull of points, shape (n, 3) [m].

        Of more vertices than ``most``, a polyhedron around it that has no more: some of its faces' planes bound it, so
        that the solid grows a little. Points in a plane, on a line or alone get a thickness of a hundredth of their
        extent.

        Raises
        ------
        ValueError
            If there are no points or one is not finite.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        if not len(points) or not np.isfinite(points).all():
            raise ValueError("a hull needs at least one point, all of them finite")
        corners = enclosing_points(_thick(points))
        if len(corners) > most:
            planes = enclosing_planes(corners, most // 2 + 2)  # at a corner three of them meet at least
            corners = polyhedron_corners(planes, corners.mean(axis=0))
        return cls(_vectors(corners), _conditions(corners))

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(np.array(self.vertices))

    @property
    @override
    def volume(self) -> float:
        return float(self._hull.volume)

    @override
    def transformed(self, R: Array, p: Array) -> Self:
        back = np.eye(4)
        back[:3] = np.column_stack([R.T, -R.T @ p])
        return type(self)(_vectors(np.array(self.vertices) @ R.T + p), back.T @ self.Q @ back)

    @override
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        planes = self._hull.equations
        beyond = np.asarray(points, dtype=float) @ planes[:, :3].T + planes[:, 3]
        return np.asarray(beyond.max(axis=-1) <= tolerance * self.size)

    @override
    def grid(self, count: int) -> Array:
        """At least its vertices, then one by one the place farthest from all those before."""
        chosen = np.array(self.vertices)
        places = self._lattice(0.5 * (self.volume / max(count, 1)) ** (1 / 3))
        nearest = np.min([np.square(places - x).sum(axis=1) for x in chosen], axis=0)
        more = []
        for _ in range(count - len(chosen)):
            farthest = int(nearest.argmax())
            more.append(places[farthest])
            nearest = np.minimum(nearest, np.square(places - places[farthest]).sum(axis=1))
        return np.concatenate([chosen, np.reshape(more, (-1, 3))])

    def _lattice(self, spacing: float) -> Array:
        """Places inside, on the faces and on the edges, about ``spacing`` apart [m]; shape (n, 3)."""
        corners = self._hull.points
        middle, axes = corners.mean(axis=0), principal_axes(corners)
        reach = (corners - middle) @ axes.T
        steps = [np.arange(low, high, spacing) for low, high in zip(reach.min(axis=0), reach.max(axis=0), strict=True)]
        inside = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3) @ axes + middle
        places = [inside[self.contains(inside)]]
        for a, b, c in corners[self._hull.simplices]:
            k = np.arange(1, 1 + int(0.5 * np.linalg.norm(np.cross(b - a, c - a)) / spacing**2))[:, None]
            u, v = k * _PLASTIC % 1, k * _PLASTIC**2 % 1  # even in a square, which is folded into a triangle
            u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
            places.append(a + u * (b - a) + v * (c - a))
            for start, end in ((a, b), (b, c), (c, a)):
                share = np.linspace(0, 1, 2 + int(np.linalg.norm(end - start) / spacing))[:, None]
                places.append(start + share * (end - start))
        return np.concatenate(places)

    @override
    def pieces(self) -> tuple[Piece, ...]:
        return (Piece((REALIZABLE, density_within(self.Q, "mass within its hull"))),)

    @override
    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "vertices": [list(vertex) for vertex in self.vertices]}

    @classmethod
    @override
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Takes any points."""
        return cls.around(data["vertices"])


def _thick(points: Array) -> Array:
    """Points, with more where they span no volume."""
    middle = points.mean(axis=0)
    axes = principal_axes(points)
    extent = np.ptp((points - middle) @ axes.T, axis=0)
    least = _FLATTEST * max(extent.max(), 1e-3)
    thin = 0.5 * least * axes[extent < least]
    for offset in thin:
        points = np.concatenate([points - offset, points + offset])
    return points


def _conditions(corners: Array) -> Array:
    """The matrices Q of a solid, shape (k, 4, 4)."""
    inside = -enclosing_planes(corners, _CONDITION_FACES)
    inside /= (corners @ inside[:, :3].T + inside[:, 3]).max(axis=0)[:, None]  # from 0 at the face to 1
    one, other = np.triu_indices(len(inside), k=1)
    ellipsoid, lifted = (
        minimum_volume_ellipsoid(corners, _ELLIPSOID).Q,
        np.column_stack([corners, np.ones(len(corners))]),
    )
    ellipsoid[3, 3] -= np.einsum("ni,ij,nj->n", lifted, ellipsoid, lifted).min()  # what its angles lose by rounding
    return np.concatenate([product_form(inside[one], inside[other]), ellipsoid[None]])


def _vectors(points: Array) -> tuple[Vector, ...]:
    return tuple((x, y, z) for x, y, z in points.tolist())

"""The convex hull of points, such as a mesh's, by point masses (Ayusawa et al.)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from idtool.inequality import Piece, masses
from idtool.shapes.base import Array, Shape, Vector

_MOST_VERTICES = 100
_PLACES = 200  # of point masses, which the solver bears for every body
_PLASTIC = 0.7548776662466927  # 1/p with p³ = p + 1: multiples of it and of its square fill a square evenly
_FLATTEST = 0.01  # thickness against the largest extent, below which a solid is given that thickness


@dataclass(frozen=True)
class Hull(Shape):
    """A convex polyhedron.

    What `pieces` admits are point masses at its vertices and at places inside: an inner approximation, which some
    bodies within the solid do not fulfil, whereas all that fulfil it are realizable on it.

    Attributes
    ----------
    vertices
        Its corners [m], shape (n, 3), spanning a volume; `around` finds those of any points.
    """

    vertices: tuple[Vector, ...]

    kind: ClassVar[str] = "hull"
    exact: ClassVar[bool] = False

    @classmethod
    def around(cls, points: ArrayLike, most: int = _MOST_VERTICES) -> Self:
        """The convex hull of points, shape (n, 3) [m].

        Of more vertices than ``most``, those are kept that are extreme along directions spread evenly, so that the
        solid shrinks a little. Points in a plane, on a line or alone get a thickness of a hundredth of their extent.

        Raises
        ------
        ValueError
            If there are no points or one is not finite.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        if not len(points) or not np.isfinite(points).all():
            raise ValueError("a hull needs at least one point, all of them finite")
        points = _thick(points)
        corners = points[ConvexHull(points).vertices]
        corners = _outermost(corners, most)
        return cls(tuple((x, y, z) for x, y, z in corners.tolist()))

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(np.array(self.vertices))

    @property
    def volume(self) -> float:
        """See `Shape.volume`."""
        return float(self._hull.volume)

    def moved(self, R: Array, p: Array) -> Self:
        """See `Shape.moved`."""
        return type(self)(tuple((x, y, z) for x, y, z in (np.array(self.vertices) @ R.T + p).tolist()))

    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> NDArray[np.bool_]:
        """See `Shape.contains`."""
        planes = self._hull.equations
        beyond = np.asarray(points, dtype=float) @ planes[:, :3].T + planes[:, 3]
        return np.asarray(beyond.max(axis=-1) <= tolerance * self.size)

    def grid(self, count: int) -> Array:
        """See `Shape.grid`; at least its vertices, then one by one the place farthest from all those before."""
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
        middle, axes = corners.mean(axis=0), _axes(corners)
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

    def pieces(self) -> tuple[Piece, ...]:
        """See `Shape.pieces`."""
        return (self._masses,)

    @cached_property
    def _masses(self) -> Piece:
        return masses(self.grid(_PLACES))

    def to_dict(self) -> dict[str, Any]:
        """See `Shape.to_dict`."""
        return {"kind": self.kind, "vertices": [list(vertex) for vertex in self.vertices]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """See `Shape.from_dict`; takes any points."""
        return cls.around(data["vertices"])


def _thick(points: Array) -> Array:
    """Points, with more where they span no volume."""
    middle = points.mean(axis=0)
    axes = _axes(points)
    extent = np.ptp((points - middle) @ axes.T, axis=0)
    least = _FLATTEST * max(extent.max(), 1e-3)
    thin = 0.5 * least * axes[extent < least]
    for offset in thin:
        points = np.concatenate([points - offset, points + offset])
    return points


def _axes(points: Array) -> Array:
    """Directions in which points spread, as rows, shape (3, 3)."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=len(points) < 3)[2])


def _outermost(corners: Array, most: int) -> Array:
    """At most so many of the corners: the extreme ones along directions even in units of the solid's own extents."""
    spread = corners - corners.mean(axis=0)
    local = spread @ _axes(corners).T
    local /= np.ptp(local, axis=0)
    count = 4 * most
    while len(corners) > most:
        k = np.arange(count) + 0.5
        turn, height = np.pi * (1 + math.sqrt(5)) * k, 1 - 2 * k / count  # the golden angle: a spiral on a sphere
        width = np.sqrt(1 - height**2)
        directions = np.stack([width * np.cos(turn), width * np.sin(turn), height])
        kept = np.unique((local @ directions).argmax(axis=0))
        if len(kept) <= most:
            return np.asarray(corners[kept])
        count = int(0.95 * count)
    return corners

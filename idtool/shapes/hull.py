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
from idtool.shapes.base import Array, Shape, Vector, finest

_MOST_VERTICES = 100
_PLACES = 160  # of point masses: what they lack against thrice as many is below the data's error
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
        """See `Shape.grid`; at least its vertices and their mean."""
        corners = np.array(self.vertices)
        middle = corners.mean(axis=0)
        half = np.abs(corners - middle).max(axis=0)

        def points(spacing: float) -> Array:
            axes = [spacing * np.arange(-np.floor(h / spacing), np.floor(h / spacing) + 1) for h in half]
            lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + middle
            return np.concatenate([corners, lattice[self.contains(lattice, tolerance=-1e-3)]])

        return finest(points, 2 * half.max(), count)

    def pieces(self) -> tuple[Piece, ...]:
        """See `Shape.pieces`."""
        return (masses(self.grid(_PLACES)),)

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
    axes = np.linalg.svd(points - middle, full_matrices=len(points) < 3)[2]
    extent = np.ptp((points - middle) @ axes.T, axis=0)
    least = _FLATTEST * max(extent.max(), 1e-3)
    thin = 0.5 * least * axes[extent < least]
    for offset in thin:
        points = np.concatenate([points - offset, points + offset])
    return points


def _outermost(corners: Array, most: int) -> Array:
    """At most so many of the corners: the extreme ones along directions even in units of the solid's own extents."""
    spread = corners - corners.mean(axis=0)
    _, _, axes = np.linalg.svd(spread, full_matrices=False)
    local = spread @ axes.T
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

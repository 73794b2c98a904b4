"""A mass density on boxes, cylinders, capsules, hulls of meshes and ellipsoids, or on a union of them.

The conditions of a box or a hull are necessary, not sufficient (a moment relaxation, Heins & Schoellig, arXiv
2411.07079); those of ellipsoids, cylinders and capsules are both.
"""

from __future__ import annotations

from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import Piece
from idtool.robot.sets.base import ConstraintSet
from idtool.robot.sets.ellipsoid import DensityOnEllipsoid


class DensityOnShape(ConstraintSet):
    """The union of all bounding shapes and ellipsoids."""

    name = "shape"
    tightness = 6

    @override
    def applies_to(self, body: Body) -> bool:
        return bool(body.shapes)

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        return (*DensityOnEllipsoid().pieces(body), *(piece for shape in body.shapes for piece in shape.pieces()))

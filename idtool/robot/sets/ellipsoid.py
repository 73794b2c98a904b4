"""P*_S: some mass density that is zero outside an ellipsoid, or a union of them, has these moments (Thm 4, Cor. 2)."""

from __future__ import annotations

from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import REALIZABLE, Piece, density_within
from idtool.robot.sets.base import ConstraintSet


class DensityOnEllipsoid(ConstraintSet):
    """J(pi) ⪰ 0 and Tr(J(pi) Q) ≥ 0 (25)."""

    name = "ellipsoid"
    tightness = 5

    @override
    def applies_to(self, body: Body) -> bool:
        return bool(body.ellipsoids)

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        return tuple(
            Piece((REALIZABLE, density_within(e.Q, "mass within its bounding ellipsoid"))) for e in body.ellipsoids
        )

"""P*, full consistency: some mass density ρ ≥ 0 has these moments (Def. 4, Thm 3)."""

from __future__ import annotations

from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import REALIZABLE, Piece
from idtool.robot.sets.base import ConstraintSet


class FullyConsistent(ConstraintSet):
    """J(pi) ⪰ 0, 4×4."""

    name = "full"
    tightness = 2

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        return (Piece((REALIZABLE,)),)

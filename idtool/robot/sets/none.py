"""No constraint at all: plain least squares."""

from __future__ import annotations

from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import Piece
from idtool.robot.sets.base import ConstraintSet


class Unconstrained(ConstraintSet):
    """The set of all parameters, R^10."""

    name = "none"
    tightness = 0

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        return (Piece(()),)

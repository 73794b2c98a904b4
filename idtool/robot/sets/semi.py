"""P, physical semi-consistency: m > 0 and a positive definite inertia about the centre of mass (Def. 3, Thm 1)."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import Inequality, Piece
from idtool.robot.inertia import PI_SIZE, spatial_inertia
from idtool.robot.sets.base import ConstraintSet

_SPATIAL = Inequality(
    "positive definite spatial inertia", spatial_inertia(np.eye(PI_SIZE)), np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
)


class SemiConsistent(ConstraintSet):
    """I(pi) ⪰ 0, 6×6."""

    name = "semi"
    tightness = 1

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        return (Piece((_SPATIAL,)),)

"""P* where the centre of mass is known (Cor. 1, (17))."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import Inequality, Piece
from idtool.robot.inertia import J_BASIS, PI_SIZE
from idtool.robot.sets.base import ConstraintSet


class KnownCom(ConstraintSet):
    """Sigma_C = Sigma − m c cᵀ ⪰ 0, 3×3, and m ≥ 0; h = m c is an equality of the problem (`equality_constraints`)."""

    name = "known_com"
    tightness = 3

    @override
    def applies_to(self, body: Body) -> bool:
        return body.com is not None

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        Sigma_C = J_BASIS[:, :3, :3].copy()
        Sigma_C[0] -= np.outer(body.com, body.com)  # type: ignore[arg-type]  # where the set applies
        covariance = Inequality("positive definite covariance (triangle inequalities)", Sigma_C, np.ones(3))
        mass = Inequality("positive mass", np.eye(PI_SIZE)[:, :1], np.zeros(1))
        return (Piece((covariance, mass)),)

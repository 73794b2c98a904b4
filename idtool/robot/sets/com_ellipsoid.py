"""Full consistency with the centre of mass in an ellipsoid (24)."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inequality import REALIZABLE, Inequality, Piece
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets.base import ConstraintSet


class ComInEllipsoid(ConstraintSet):
    """J(pi) ⪰ 0 and C(pi) = [m, (h − m x_s)ᵀ; h − m x_s, m Q_s] ⪰ 0, 4×4 each."""

    name = "com_ellipsoid"
    tightness = 4

    @override
    def applies_to(self, body: Body) -> bool:
        return bool(body.ellipsoids)

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        return tuple(Piece((REALIZABLE, _com_within(ellipsoid))) for ellipsoid in body.ellipsoids)


def _com_within(ellipsoid: Ellipsoid) -> Inequality:
    C = np.zeros((PI_SIZE, 4, 4))
    C[0, 0, 0] = 1
    C[0, 1:, 0] = -np.asarray(ellipsoid.center)
    C[0, 0, 1:] = -np.asarray(ellipsoid.center)
    C[0, 1:, 1:] = ellipsoid.Q_s
    for k in (1, 2, 3):
        C[k, 0, k] = 1
        C[k, k, 0] = 1
    return Inequality("centre of mass in its ellipsoid", C, np.array([0.0, 1.0, 1.0, 1.0]))

"""Non-negative point masses on a grid: a polyhedron within the realizable parameters (Ayusawa et al. 2011)."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.robot.body import Body
from idtool.robot.inequality import Piece, point_masses
from idtool.robot.sets.base import ConstraintSet

_POINTS = 120  # in all of a body's bounds together


class PointMassGrid(ConstraintSet):
    """pi = Σ_k m_k pi(x_k), m_k ≥ 0, at points x_k in the bounding ellipsoids and shapes.

    Bodies that need mass between the points are left out, so it is used only where it is asked for.
    """

    name = "points"
    tightness = 7
    automatic = False

    @override
    def applies_to(self, body: Body) -> bool:
        return bool(body.bounds)

    @override
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        points_per_bound = _POINTS // len(body.bounds)
        points = np.concatenate([bound.grid(points_per_bound) for bound in body.bounds])
        return (point_masses(points),)

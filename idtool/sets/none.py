"""No constraint at all: plain least squares."""

from __future__ import annotations

from idtool.ellipsoid import Ellipsoid
from idtool.sets.base import ConstraintSet, Inequality


class Unconstrained(ConstraintSet):
    """All of R^10."""

    name = "none"
    tightness = 0

    def inequalities(self, ellipsoid: Ellipsoid | None) -> tuple[Inequality, ...]:
        """See `ConstraintSet.inequalities`."""
        return ()

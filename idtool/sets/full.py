"""P*, full consistency: some mass density ρ ≥ 0 has these moments (Def. 4, Thm 3)."""

from __future__ import annotations

import numpy as np

from idtool.ellipsoid import Ellipsoid
from idtool.inertia import BASIS
from idtool.sets.base import ConstraintSet, Inequality

DENSITY = Inequality("positive definite pseudo-inertia (triangle inequalities)", BASIS, np.array([1.0, 1.0, 1.0, 0.0]))


class FullyConsistent(ConstraintSet):
    """J(pi) ⪰ 0, 4×4."""

    name = "full"
    tightness = 2

    def inequalities(self, ellipsoid: Ellipsoid | None) -> tuple[Inequality, ...]:
        """See `ConstraintSet.inequalities`."""
        return (DENSITY,)

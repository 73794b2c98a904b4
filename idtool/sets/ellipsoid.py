"""P*_S: some mass density that is zero outside an ellipsoid has these moments (Thm 4, (25))."""

from __future__ import annotations

import numpy as np

from idtool.ellipsoid import Ellipsoid
from idtool.inertia import BASIS
from idtool.sets.base import ConstraintSet, Inequality
from idtool.sets.full import DENSITY


class DensityOnEllipsoid(ConstraintSet):
    """J(pi) ⪰ 0 and Tr(J(pi) Q) ≥ 0."""

    name = "ellipsoid"
    tightness = 4
    bounded = True

    def inequalities(self, ellipsoid: Ellipsoid | None) -> tuple[Inequality, ...]:
        """See `ConstraintSet.inequalities`."""
        if ellipsoid is None:
            return (DENSITY,)
        trace = np.einsum("kij,ji->k", BASIS, ellipsoid.Q)
        return (DENSITY, Inequality("mass within its bounding ellipsoid", trace[:, None, None], np.zeros(1)))

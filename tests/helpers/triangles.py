"""Triangle inequalities of principal moments of inertia, as an oracle of realizability."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from idtool.robot.inertia import mass_com_inertia


def triangle_margin(pi: ArrayLike) -> float:
    """The smallest of J₁+J₂−J₃ and cyclic over the principal moments about the centre of mass [kg·m²] (13)."""
    moments = np.linalg.eigvalsh(mass_com_inertia(pi)[2])
    return float(moments[0] + moments[1] - moments[2])

"""Check of inertias for simulators: MuJoCo refuses one that no body can have, Drake puts another in its place."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.robot.inertia import mass_com_inertia
from idtool.robot.urdf.reading import Robot

_ROUNDING = 1e-9  # relative


def slack(inertia: Array) -> float:
    """The least of the principal moments and of A + B − C over them [kg·m²].

    Parameters
    ----------
    inertia
        About the centre of mass, shape (3, 3).
    """
    moments = np.linalg.eigvalsh(inertia)
    return float(min(moments[0], moments[0] + moments[1] - moments[2]))


def is_acceptable(pi: Array) -> bool:
    """True if some body, or none at all, has these parameters, shape (10,), up to rounding."""
    mass, _, inertia = mass_com_inertia(pi)
    return mass >= 0 and slack(inertia) >= -_ROUNDING * float(np.abs(inertia).sum())


def unrealizable_error(robot: Robot, name: str) -> ModelError:
    """The error for a body that cannot exist."""
    where = f"{robot.path}: {name}"
    what = "has an inertia that is not physically realizable, so the simulator rejects it"
    return ModelError(where, f"{what}; fit it with constraints: full or tighter")

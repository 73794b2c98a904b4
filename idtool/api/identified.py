"""What a fit found: errors, bodies and friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from idtool.api.records import ReadOnly, frozen, vector
from idtool.common.arrays import Array
from idtool.robot.inertia import symmetric

Errors = ReadOnly[float]


@dataclass(frozen=True)
class Rms:
    """Root mean square torque errors [N·m or N], by joint, and ``overall`` joints and samples.

    Attributes
    ----------
    train
        On what was fitted.
    validation, prior_validation
        Of the identified and the given model on what was held out; None where nothing was.
    """

    train: Errors
    validation: Errors | None
    prior_validation: Errors | None


@dataclass(frozen=True, eq=False)
class Body:
    """An identified link or rotor, in the link's frame.

    Attributes
    ----------
    name
        Its name.
    mass
        [kg].
    com
        Centre of mass, shape (3,) [m].
    inertia_com
        Rotational inertia about it: xx, xy, yy, xz, yz, zz, shape (6,) [kg·m²].
    pi
        The ten inertia parameters, the rotational inertia in them about the frame's origin, shape (10,).
    standard_error
        Of ``pi``, shape (10,); NaN where the data do not determine it.
    realizable
        Whether some body within its bounds has these parameters.
    details
        All that report.json says of it.
    """

    name: str
    mass: float
    com: Array
    inertia_com: Array
    pi: Array
    standard_error: Array
    realizable: bool
    details: ReadOnly[Any] = field(repr=False)

    @property
    def inertia(self) -> Array:
        """Rotational inertia about the centre of mass, shape (3, 3) [kg·m²]."""
        return symmetric(self.inertia_com)

    def __repr__(self) -> str:
        com, moments = (", ".join(f"{x:.4g}" for x in values) for values in (self.com, self.inertia_com[[0, 2, 5]]))
        real = "realizable" if self.realizable else "no body can have this"
        error = f" ± {self.standard_error[0]:.2g}" if self.standard_error[0] >= 0 else ""
        return f"Body {self.name}: {self.mass:.4g}{error} kg at ({com}) m, Ixx, Iyy, Izz {moments} kg·m², {real}"


@dataclass(frozen=True)
class Friction:
    """Friction of a joint; None for a term that the model has not.

    Attributes
    ----------
    viscous
        [N·m·s/rad or N·s/m].
    coulomb, offset
        [N·m or N].
    standard_error
        By term; None where the data do not determine it.
    """

    viscous: float | None
    coulomb: float | None
    offset: float | None
    standard_error: ReadOnly[float | None]


def body_of(name: str, report: Mapping[str, Any]) -> Body:
    """A body from its entry in report.json.

    Parameters
    ----------
    name, report
        Its name and its entry.
    """
    arrays = {key: vector(report[key]) for key in ("com", "inertia_com", "pi", "standard_error")}
    return Body(name, report["mass"], realizable=report["realizable"], details=frozen(report), **arrays)

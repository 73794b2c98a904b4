"""What is demanded of the bodies and known of them beside the logs: sets, prior, measured masses, copies, solver."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from idtool.config.base import NonNegative, Positive, Record
from idtool.config.terms import Uncertain

Constraints = Literal["none", "semi", "full", "known_com", "com_ellipsoid", "ellipsoid", "shape", "points"]


class Regularization(Record):
    """The prior's kind and weight (27).

    The Euclidean distance is taken in units of each body's own mass and size, or, as the paper has it, in SI units.
    """

    kind: Literal["none", "euclidean", "entropic", "pullback"] = "euclidean"
    weight: NonNegative = 1e-6
    units: Literal["relative", "si"] = "relative"

    @model_validator(mode="after")
    def _units_of_the_euclidean(self) -> Self:
        if self.units == "si" and self.kind in ("entropic", "pullback"):
            raise ValueError(f"units: si is for kind euclidean; {self.kind} does not depend on units")
        return self


class Measured(Uncertain):
    """A positive number measured by other means; with a standard error it is soft, without exact."""

    value: Positive
    standard_error: Positive | None = None


class Known(Record):
    """Masses [kg] by body, and of all bodies of the model together."""

    mass: dict[str, Measured] = Field(default_factory=dict)
    total_mass: Measured | None = None


class Mirror(Record):
    """A body that is a copy of another, equal or mirrored in a plane of the link frames, or a joint with its friction.

    Friction that depends on the direction, an offset, is left to each joint.
    """

    body: str | None = None
    joint: str | None = None
    of: str
    plane: Literal["xy", "xz", "yz"] | None = None

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        if (self.body is None) == (self.joint is None):
            raise ValueError("give either body or joint, and of")
        if self.joint is not None and self.plane is not None:
            raise ValueError("plane is for bodies; friction has none")
        if self.of in (self.body, self.joint):
            raise ValueError(f"{self.of} is a copy of itself; name another")
        return self


class Solver(Record):
    """The conic solver, or a local one on a manifold of realizable bodies."""

    name: Literal["clarabel", "log_cholesky", "manifold"] = "clarabel"

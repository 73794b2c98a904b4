"""Settings of the estimation: constraint sets, prior, known masses, copies, solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from idtool.robot.config.base import MAX_VALUE, ConfigRecord, NonNegative, NoTruthValue, Positive
from idtool.robot.config.terms import UncertainValue

_MASS_PRECISION = 5.0  # with an automatic weight

Constraints = Literal["none", "semi", "full", "known_com", "com_ellipsoid", "ellipsoid", "shape", "points"]


def _weight_tag(data: Any) -> str:
    """Tag of the form in which a weight is given, for messages that name its key alone."""
    return "[auto]" if data == "auto" else "[number]"


Weight = Annotated[
    Annotated[Literal["auto"], Tag("[auto]")] | Annotated[NonNegative, Tag("[number]")], Discriminator(_weight_tag)
]


class Regularization(ConfigRecord):
    """The prior's kind and weight (27); the weight ``auto`` is chosen by cross-validation.

    The prior's masses are taken as ``mass_precision`` times more accurate than its inertias: with 5, relative standard
    errors of 6 % and 30 %, for example. The default is 5 with the weight ``auto``, and 1 with a number, which leaves
    the distance unchanged. The Euclidean distance is in units of each body's own mass and size or, as in the paper, in
    SI units.
    """

    kind: Literal["none", "euclidean", "entropic", "pullback"] = "entropic"
    weight: Weight = "auto"
    mass_precision: Annotated[float, Field(ge=1, le=MAX_VALUE, allow_inf_nan=False), NoTruthValue] | None = None
    units: Literal["relative", "si"] = "relative"

    @property
    def is_automatic(self) -> bool:
        """True if the weight is to be chosen from the data."""
        return self.weight == "auto" and self.kind != "none"

    @property
    def mass_precision_factor(self) -> float:
        """Ratio of the prior's relative standard errors, an inertia's over a mass's; 1 or more."""
        if self.units == "si":
            return 1.0
        if self.mass_precision is not None:
            return self.mass_precision
        return _MASS_PRECISION if self.is_automatic else 1.0

    @property
    def numeric_weight(self) -> float:
        """The weight as a number.

        Raises
        ------
        ValueError
            If it is still to be chosen from the data.
        """
        if self.is_automatic:
            raise ValueError("the weight is auto; choose a number with regularization_path before you build a problem")
        return 0.0 if self.weight == "auto" else self.weight

    def with_weight(self, weight: float) -> Self:
        """A copy with a number as its weight and the same factor of ``mass_precision``."""
        return self.model_copy(update={"weight": weight, "mass_precision": self.mass_precision_factor})

    def fixed_or_weak(self) -> Regularization:
        """Itself if the weight is a number, else the paper's weak prior, which needs no choice of weight."""
        if self.weight != "auto":
            return self
        return WEAK_PRIOR if self.is_automatic else self.with_weight(0.0)

    @model_validator(mode="after")
    def _check_units(self) -> Self:
        if self.units == "si" and self.kind in ("entropic", "pullback"):
            raise ValueError(f"units: si is only for kind: euclidean; {self.kind} does not depend on units")
        if self.units == "si" and self.weight == "auto":
            raise ValueError("units: si needs a number for the weight; auto is only for relative units")
        return self


WEAK_PRIOR = Regularization(kind="euclidean", weight=1e-6)


class MeasuredValue(UncertainValue):
    """A known positive number; a soft constraint with a standard error, exact without."""

    value: Positive
    standard_error: Positive | None = None


Armature = Annotated[
    Annotated[Literal["auto"], Tag("[auto]")] | Annotated[MeasuredValue, Tag("[number]")], Discriminator(_weight_tag)
]


def armature_tag(data: Any) -> str:
    """Tag of the form: one reflected inertia for all joints alike, which may have a standard error, or by joint."""
    is_value = isinstance(data, Mapping) and not isinstance(data.get("value", {}), Mapping)
    return "by joint" if isinstance(data, Mapping) and not is_value else "alike"


class KnownMasses(ConfigRecord):
    """Masses [kg] by body, and of all bodies of the model together."""

    mass: dict[str, MeasuredValue] = Field(default_factory=dict)
    total_mass: MeasuredValue | None = None


class Mirror(ConfigRecord):
    """A body that is an equal or mirrored copy of another, or a joint with the same friction as another.

    The torque offset (direction-dependent friction) is not copied.
    """

    body: str | None = None
    joint: str | None = None
    of: str
    plane: Literal["xy", "xz", "yz"] | None = None

    @model_validator(mode="after")
    def _check_copy(self) -> Self:
        if (self.body is None) == (self.joint is None):
            raise ValueError("give `of`, and either `body` or `joint`")
        if self.joint is not None and self.plane is not None:
            raise ValueError("plane is only for bodies, not for joints")
        if self.of in (self.body, self.joint):
            raise ValueError(f"{self.of} cannot be a copy of itself; name another")
        return self


class Solver(ConfigRecord):
    """The conic solver, a solver of cvxpy, or a local solver on a manifold of realizable bodies."""

    name: Literal["clarabel", "cvxpy", "log_cholesky", "manifold"] = "clarabel"
    backend: str | None = None

    @model_validator(mode="after")
    def _check_backend(self) -> Self:
        if self.backend is not None and self.name != "cvxpy":
            raise ValueError(f"backend is only for name: cvxpy; remove it for {self.name}")
        return self

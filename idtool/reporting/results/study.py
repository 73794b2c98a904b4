"""Records of `idtool study`: study.json."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import (
    ByJointOrNone,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    SampleCounts,
    Units,
    Vector,
    field,
)


class StudyErrors(Record):
    """RMS torque errors by joint, null where nothing is known of its torque; `overall` is the RMS over all others."""

    train: ByJointOrNone = field("Error on the fitted data [N·m or N].")
    validation: ByJointOrNone = field("Error on held-out data.")


class SetReport(Record):
    """The fit within one constraint set."""

    rms: StudyErrors = field("RMS torque errors within the filter's band.")
    seconds: float = field("Solution time [s].")
    objective: float = field("Cost at the solution.")
    duality_gap: float = field("Bound on the relative distance to the minimum cost.")
    iterations: int = field("Iterations of the solver.")
    lmi: str = field("Inequalities for one body.")
    violations: int = field("Number of bodies that are not realizable.")
    worst_margin: float = field(
        "Smallest eigenvalue of the pseudo-inertia of the worst body, in units of its mass and size."
    )
    masses: Annotated[ReadOnly[float], Keys("body")] = field("Identified masses [kg].")


class EstimatorReport(Record):
    """The fit with one prior or local solver."""

    rms: StudyErrors = field("RMS torque errors within the filter's band.")
    seconds: float = field("Solution time [s].")
    duality_gap: float = field("Bound on the relative distance to the minimum cost.")
    iterations: int = field("Iterations of the solver.")
    status: str = field("Status at the end.")
    note: str | None = field("Remark.")


class LearningCurve(Record):
    """Validation error as a function of the number of samples."""

    median: Vector = field("Median over the draws [N·m or N].")
    lower: Vector = field("Lower quartile.")
    upper: Vector = field("Upper quartile.")


class Advantage(Record):
    """Advantage of a set over the first one."""

    advantage: Vector = field("Mean over the draws of log(error of the first set / error of this set).")
    advantage_error: Vector = field("Standard error of that mean.")


class LearningCurves(Record):
    """Errors as functions of the number of samples."""

    counts: tuple[int, ...] = field("Numbers of samples.")
    draws: int = field("Draws for each count.")
    unit_overall: str = field("Unit of the curves.")
    curves: Annotated[ReadOnly[LearningCurve], Keys("set")] = field("RMS validation error over all joints.")
    advantage: Annotated[ReadOnly[Advantage], Keys("set")] = field("Advantage over the first set.")
    violation: Annotated[ReadOnly[Vector], Keys("set")] = field("Median of the worst body's violation.")


class Convergence(Record):
    """The online estimate over time."""

    t: Vector = field("Time [s].")
    error: Annotated[ReadOnly[Vector], Keys("set")] = field("Parameter error, relative to that of the prior.")
    time_to_10_percent: Annotated[ReadOnly[float | None], Keys("set")] = field(
        "Time after which the error remains below a tenth [s]; null: never."
    )
    forgetting: float | None = field("Time constant of forgetting [s]; null: no forgetting.")


class StudyReport(ReproducibleResult):
    """Result of `idtool study`."""

    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    samples: SampleCounts = field("Number of samples used.")
    sets: Annotated[ReadOnly[SetReport], Keys("set")] = field("Results by constraint set.")
    estimators: Annotated[ReadOnly[EstimatorReport], Keys("estimator")] = field("Results by prior and local solver.")
    learning: LearningCurves = field("Errors as functions of the number of samples.")
    adaptation: Convergence = field("The online estimate; empty for logs that were reduced.")
    logs: tuple[str, ...] = field("The logs.")
    urdf: str = field("The URDF.")
    seconds: float = field("Wall time [s].")

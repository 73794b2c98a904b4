"""Records of `idtool study`: study.json."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import (
    ByJoint,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    Samples,
    Units,
    Vector,
    field,
)


class StudyErrors(Record):
    """RMS torque errors by joint, and `overall` joints and samples."""

    train: ByJoint = field("On the data that were fitted [N·m or N].")
    validation: ByJoint = field("On held-out data.")


class SetReport(Record):
    """The fit within one constraint set."""

    rms: StudyErrors = field("RMS torque errors within the filter's band.")
    seconds: float = field("Time of the solution [s].")
    objective: float = field("Cost at the solution.")
    duality_gap: float = field("Bound on the relative distance to the least cost.")
    iterations: int = field("Iterations of the solver.")
    lmi: str = field("Inequalities for one body.")
    violations: int = field("Bodies that no material could have.")
    worst_margin: float = field("Least eigenvalue of the worst body, in units of its mass and size.")
    masses: Annotated[ReadOnly[float], Keys("body")] = field("Identified masses [kg].")


class EstimatorReport(Record):
    """The fit with one prior or local solver."""

    rms: StudyErrors = field("RMS torque errors within the filter's band.")
    seconds: float = field("Time of the solution [s].")
    duality_gap: float = field("Bound on the relative distance to the least cost.")
    iterations: int = field("Iterations of the solver.")
    status: str = field("How it ended.")
    note: str | None = field("What to know of it.")


class LearningCurve(Record):
    """Validation error against the number of samples."""

    median: Vector = field("Median over the draws [N·m or N].")
    lower: Vector = field("Lower quartile.")
    upper: Vector = field("Upper quartile.")


class Advantage(Record):
    """Advantage of a set over the first one."""

    advantage: Vector = field("Mean over the draws of log(error of the first set / error of this set).")
    advantage_error: Vector = field("Standard error of that mean.")


class Learning(Record):
    """Errors against the number of samples."""

    counts: tuple[int, ...] = field("Sample counts.")
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
        "Time from which on the error stays below a tenth [s]; null: never."
    )
    forgetting: float | None = field("Time constant of forgetting [s]; null: none.")


class StudyReport(ReproducibleResult):
    """Result of `idtool study`."""

    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    samples: Samples = field("Samples used.")
    sets: Annotated[ReadOnly[SetReport], Keys("set")] = field("All constraint sets.")
    estimators: Annotated[ReadOnly[EstimatorReport], Keys("estimator")] = field("All priors and local solvers.")
    learning: Learning = field("Errors against the number of samples.")
    adaptation: Convergence = field("The online estimate.")
    logs: tuple[str, ...] = field("The logs.")
    urdf: str = field("The URDF.")
    seconds: float = field("Wall time [s].")

"""Records of `idtool excite`."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import (
    ByJoint,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    Term,
    Units,
    Vector,
    field,
)


class MotionPart(Record):
    """A part of the trajectory."""

    pattern: str = field("Its pattern.")
    start: float = field("When it begins [s].")
    end: float = field("When it ends [s].")


class Criteria(Record):
    """All criteria of a motion; null where a combination is not determined."""

    d: float | None = field("D-optimality: mean logarithm of the relative standard errors.")
    a: float | None = field("A-optimality: mean relative standard error.")
    e: float | None = field("E-optimality: standard error of the worst combination.")
    condition: float | None = field("Condition number.")


class ExpectedParameter(Record):
    """A combination that the torque depends on, and how well the motion will determine it."""

    name: str = field("The combination as text.")
    terms: tuple[Term, ...] = field("What it is the sum of.")
    unit: str = field("Its unit.")
    prior: float = field("Value of the prior.")
    standard_error: float | None = field("Standard error to expect; null: not determined.")
    relative: float | None = field("Standard error over the prior; null for a prior that is next to zero.")
    logged_standard_error: float | None = field("Standard error with the logs of `--log` alone.")
    favoured: bool = field("Whether `--favour` names it.")


class ExpectedBody(Record):
    """How well the motion will determine a body."""

    standard_error: Vector = field("Of the ten parameters; null where no motion determines one by itself.")


class ExpectedTerm(Record):
    """How well the motion will determine friction or another effect."""

    prior: float = field("Value of the prior.")
    standard_error: float | None = field("Standard error to expect; null: not determined.")
    unit: str = field("Its unit.")


class JointLimitsReport(Record):
    """Limits that the motion keeps to."""

    position: tuple[float, float] = field("Lower and upper position [rad or m].")
    velocity: float = field("Velocity [rad/s or m/s].")
    acceleration: float = field("Acceleration [rad/s² or m/s²].")
    effort: float | None = field("Torque or force [N·m or N]; null: unlimited.")


class LimitUtilization(Record):
    """Largest share of each limit that is used."""

    position: float = field("Of the position range.")
    velocity: float = field("Of the velocity.")
    acceleration: float = field("Of the acceleration.")
    effort: float = field("Of the effort.")


class Clearance(Record):
    """The links that come nearest to each other."""

    links: tuple[str, ...] = field("The two links.")
    distance: float | None = field("Their least distance [m].")
    t: float | None = field("When [s].")
    wanted: float = field("Distance that was asked for [m].")


class JointCurves(Record):
    """A joint's motion and predicted torque, for drawing."""

    q: Vector = field("Position [rad or m].")
    v: Vector = field("Velocity [rad/s or m/s].")
    a: Vector = field("Acceleration [rad/s² or m/s²].")
    tau: Vector = field("Predicted torque or force [N·m or N].")


class ExcitationCurves(Record):
    """The motion and its predicted torque, for drawing."""

    t: Vector = field("Time [s].")
    joints: Annotated[ReadOnly[JointCurves], Keys("joint")] = field("By joint.")


class ExcitationReport(ReproducibleResult):
    """Result of `idtool excite`."""

    file: str | None = field("The log that was written; null where none was.")
    urdf: str = field("The URDF.")
    logs: tuple[str, ...] = field("Logs of `--log`.")
    seed: int = field("Seed of what is drawn.")
    samples: int = field("Samples of the log.")
    joints: tuple[str, ...] = field("Joints.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    duration: float = field("Duration [s].")
    rate_hz: float = field("Samples per second [Hz].")
    highest_hz: float = field("Highest frequency of the pattern [Hz].")
    parts: tuple[MotionPart, ...] = field("Parts of the motion.")
    home: ByJoint = field("Pose at start and end [rad or m].")
    noise: ByJoint = field("RMS torque noise that standard errors are computed with [N·m or N].")
    criterion: str = field("`d`, `a`, `e` or `condition`.")
    criteria: Annotated[ReadOnly[Criteria], Keys("motion")] = field(
        "Criteria of a `random` motion, of the `design` and, with `--log`, of what is `logged`."
    )
    base_parameters: tuple[ExpectedParameter, ...] = field("What the torque depends on.")
    bodies: Annotated[ReadOnly[ExpectedBody], Keys("body")] = field("Standard errors of bodies.")
    terms: Annotated[ReadOnly[Annotated[ReadOnly[ExpectedTerm], Keys("term")]], Keys("joint")] = field(
        "Standard errors of friction and other effects."
    )
    limits: Annotated[ReadOnly[JointLimitsReport], Keys("joint")] = field("Limits that are kept.")
    use: Annotated[ReadOnly[LimitUtilization], Keys("joint")] = field("Share of the limits that is used.")
    clearance: Clearance | None = field("Nearest links; null without geometry.")
    evaluations: int = field("Evaluations of the search.")
    interrupted: bool = field("Whether Ctrl-C ended the search.")
    curves: ExcitationCurves = field("The motion, for drawing.")

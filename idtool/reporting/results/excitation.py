"""Records of `idtool excite`."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import (
    ByJoint,
    ByParameter,
    CombinationTerm,
    Interval,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    Units,
    Vector,
    field,
)


class MotionPart(Record):
    """A part of the trajectory."""

    pattern: str = field("Its pattern.")
    start: float = field("Start [s].")
    end: float = field("End [s].")


class Criteria(Record):
    """All criteria of a motion; null if a combination is not determined."""

    d: float | None = field("D-optimality: geometric mean of the relative standard errors.")
    a: float | None = field("A-optimality: root mean square of the relative standard errors.")
    e: float | None = field("E-optimality: relative standard error of the worst combination.")
    condition: float | None = field("Condition number.")


class ExpectedParameter(Record):
    """A base parameter, and how well the motion will determine it."""

    name: str = field("The combination as text.")
    terms: tuple[CombinationTerm, ...] = field("Terms of the combination.")
    unit: str = field("Its unit.")
    prior: float = field("Value of the prior.")
    standard_error: float | None = field("Expected standard error; null: not determined.")
    relative: float | None = field("Standard error divided by the prior; null for a prior close to zero.")
    logged_standard_error: float | None = field("Standard error with only the logs of `--log`.")
    favoured: bool = field("Whether `--favour` names it.")


class ExpectedBody(Record):
    """Expected standard errors of a body."""

    standard_error: Vector = field(
        "Standard errors of the ten parameters; null if no motion determines a parameter by itself."
    )


class ExpectedTerm(Record):
    """Expected standard error of friction or another effect."""

    prior: float = field("Value of the prior.")
    standard_error: float | None = field("Expected standard error; null: not determined.")
    unit: str = field("Its unit.")


class JointLimitsReport(Record):
    """Limits of the motion."""

    position: tuple[float, float] = field("Lower and upper position [rad or m].")
    velocity: float = field("Velocity [rad/s or m/s].")
    acceleration: float = field("Acceleration [rad/s² or m/s²].")
    effort: float | None = field("Torque or force [N·m or N]; null: unlimited.")


class LimitUtilization(Record):
    """Largest fraction of each limit that the motion uses."""

    position: float = field("Fraction of half the position range, measured from its middle.")
    velocity: float = field("Fraction of the velocity limit.")
    acceleration: float = field("Fraction of the acceleration limit.")
    effort: float = field("Fraction of the effort limit.")


class Clearance(Record):
    """The closest pair of links."""

    links: tuple[str, ...] = field("The two links.")
    distance: float | None = field("Smallest distance between them [m].")
    t: float | None = field("Time of the smallest distance [s].")
    wanted: float = field("Requested distance [m].")


class FootLoadReport(Record):
    """Loads of a foot that stays on the ground, at their worst."""

    friction_coefficient: float = field("Largest friction coefficient that the foot needs.")
    min_force: float = field("Smallest normal force on the foot [N].")
    pressure: float | None = field(
        "Largest distance of the centre of pressure from the middle of the sole, as a fraction of half its size; null "
        "for a point."
    )


class StandingReport(Record):
    """The ground and the base, for a robot that stands."""

    friction_coefficient: float = field("Friction coefficient of the ground, given by `--ground-friction`.")
    feet: Annotated[ReadOnly[FootLoadReport], Keys("contact")] = field("Loads of the feet.")
    base: Annotated[ReadOnly[Interval], Keys("direction")] = field(
        "Smallest and largest displacement [m] and rotation [rad] of the base from the stance."
    )
    tightest: str = field("The limit of which the motion uses the largest fraction, with the margins of the design.")
    tightest_use: float = field("This fraction.")


class ExplanationEffect(Record):
    """An effect with the parameters for which the trajectory was designed."""

    effect: str = field("Its id, see [Effects](effects.md).")
    joint: str | None = field("The joint it acts on; null if it has none.")
    link: str | None = field("The link it acts on; null if it has none.")
    parameters: ByParameter = field("Its parameters.")
    units: Annotated[ReadOnly[str | None], Keys("parameter")] = field("Units of the parameters; null: none.")


class ExplanationReport(Record):
    """One of the two explanations of `--decide`."""

    name: str = field("As given on the command line.")
    source: str = field("Origin of the parameters: `configuration`, `logs`, `typical size`, or the given file.")
    effects: tuple[ExplanationEffect, ...] = field("Its effects.")


class SeparationReport(Record):
    """Difference of the two explanations, after the wrong one is fitted to the torque of the right one."""

    joint: str = field("The joint on which they differ most, relative to its noise.")
    difference: float = field("RMS difference of the torque on this joint [N·m or N].")
    noise: float = field("RMS torque noise of this joint [N·m or N].")
    significance: float = field("Difference on all joints in standard errors.")


class DecisionReport(SeparationReport):
    """Difference of two explanations on the designed trajectory, beside that on the ordinary one and on the logs."""

    a: ExplanationReport = field("The first explanation.")
    b: ExplanationReport = field("The second explanation.")
    ordinary: SeparationReport = field("The difference on the trajectory without `--decide`.")
    logged: SeparationReport | None = field("The difference on the logs of `--log` alone; null without any.")


class JointCurves(Record):
    """A joint's motion and predicted torque, for plots."""

    q: Vector = field("Position [rad or m].")
    v: Vector = field("Velocity [rad/s or m/s].")
    a: Vector = field("Acceleration [rad/s² or m/s²].")
    tau: Vector = field("Predicted torque or force [N·m or N].")


class ExcitationCurves(Record):
    """The motion and its predicted torque, for plots."""

    t: Vector = field("Time [s].")
    joints: Annotated[ReadOnly[JointCurves], Keys("joint")] = field("Curves by joint.")


class ExcitationReport(ReproducibleResult):
    """Result of `idtool excite`."""

    file: str | None = field("The log that was written; null if none was.")
    urdf: str = field("The URDF.")
    logs: tuple[str, ...] = field("Logs of `--log`.")
    seed: int = field("Seed of the random draws.")
    samples: int = field("Number of samples.")
    joints: tuple[str, ...] = field("Joints.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    duration: float = field("Duration [s].")
    rate_hz: float = field("Samples per second [Hz].")
    highest_hz: float = field("Highest frequency of the pattern [Hz].")
    parts: tuple[MotionPart, ...] = field("Parts of the motion.")
    home: ByJoint = field("Pose at start and end [rad or m].")
    noise: ByJoint = field("RMS torque noise assumed for the standard errors [N·m or N].")
    criterion: str = field("`d`, `a`, `e` or `condition`.")
    criteria: Annotated[ReadOnly[Criteria], Keys("motion")] = field(
        "Criteria of a `random` motion, of the `design` and, with `--log`, of the existing logs (`logged`)."
    )
    base_parameters: tuple[ExpectedParameter, ...] = field("Base parameters.")
    bodies: Annotated[ReadOnly[ExpectedBody], Keys("body")] = field("Standard errors of bodies.")
    terms: Annotated[ReadOnly[Annotated[ReadOnly[ExpectedTerm], Keys("term")]], Keys("joint")] = field(
        "Standard errors of friction and other effects."
    )
    limits: Annotated[ReadOnly[JointLimitsReport], Keys("joint")] = field("Limits of the joints.")
    use: Annotated[ReadOnly[LimitUtilization], Keys("joint")] = field("Fraction of the limits that the motion uses.")
    clearance: Clearance | None = field("Closest pair of links; null without geometry.")
    standing: StandingReport | None = field("The ground and the base with `--stand`; null without it.")
    decide: DecisionReport | None = field(
        "How well the trajectory, with the logs of `--log`, distinguishes two explanations; null without `--decide`."
    )
    evaluations: int = field("Number of evaluations in the search.")
    interrupted: bool = field("Whether Ctrl-C ended the search.")
    curves: ExcitationCurves = field("The motion, for plots.")

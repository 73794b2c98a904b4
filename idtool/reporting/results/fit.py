"""Records of `idtool fit`: report.json."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from idtool.common.arrays import Array
from idtool.common.number_text import short_number
from idtool.reporting.results.base import (
    ByJoint,
    ByJointOrNone,
    ByKindOrNone,
    ByParameter,
    CombinationTerm,
    Interval,
    Keys,
    LinkEllipsoid,
    OffsetsByLog,
    ReadOnly,
    Record,
    ReproducibleResult,
    SampleCounts,
    Sentences,
    Units,
    Vector,
    field,
)
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.results.verdict import REASONS_TEXT, VERDICT_TEXT, VerdictLevel, VerdictReason
from idtool.robot.inertia import symmetric_matrix


class TorqueErrors(Record):
    """RMS torque errors by joint, null where nothing is known of its torque; `overall` is the RMS over all others."""

    train: ByJointOrNone = field("Error of the identified model on the fitted data [N·m or N].")
    validation: ByJointOrNone | None = field(
        "Error of the identified model on the held-out data; null if nothing was held out."
    )
    prior_validation: ByJointOrNone | None = field("Error of the original URDF on the held-out data.")


class ErrorsByKind(Record):
    """Errors of `rms` by kind of row: `joints` is the RMS over all joints; of a force or moment, of its length."""

    train: ByKindOrNone = field("Error of the identified model on the fitted data [N·m or N].")
    validation: ByKindOrNone | None = field("Error of the identified model on the held-out data.")
    prior_validation: ByKindOrNone | None = field("Error of the original URDF on the held-out data.")


class CorrelatedParameter(Record):
    """A coefficient that is correlated with another one."""

    of: str = field("Body or joint that the coefficient belongs to.")
    what: str = field("The coefficient's name.")
    correlation: float = field("Correlation of the two.")


class ParameterSource(Record):
    """Source of a parameter's value: data, constraints or prior."""

    on: Literal["data", "combination", "constraints", "prior"] = field(
        "Main source; `combination`: the data determine it only together with others."
    )
    data: float = field("Share of the data; the three shares sum to one.")
    constraints: float = field("Share of the constraints.")
    prior: float = field("Share of the prior.")
    range: tuple[float | None, float | None] = field(
        "Range within the constraints in which the cost is at most 1 % above the minimum; null: unbounded."
    )
    moves_with: tuple[CorrelatedParameter, ...] = field("Coefficients that are correlated with it.")
    combinations: tuple[int, ...] = field(
        "Indices into `base_parameters.parameters` of the combinations it is part of."
    )
    text: str = field("Summary as a sentence.")


class UnionPart(Record):
    """One part of a body within a union of ellipsoids; the body is the sum of its parts."""

    mass: float = field("Mass [kg].")
    pi: Vector = field("The ten parameters.")


class PointMasses(Record):
    """Point masses within the bounds that have exactly the body's parameters: a proof that it is realizable."""

    masses: Vector = field("Masses [kg].")
    points: tuple[tuple[float, float, float], ...] = field("Positions in the link frame [m].")


class BodyReport(Record):
    """An identified link or rotor, in the link's frame."""

    kind: Literal["link", "rotor"] = field("`link` or `rotor`.")
    mass: float = field("Mass [kg].")
    com: Vector = field("Centre of mass, shape (3,) [m].")
    inertia_com: Vector = field("Inertia about the centre of mass: [xx, xy, yy, xz, yz, zz] [kg·m²].")
    pi: Vector = field("The ten parameters [m, mc_x, mc_y, mc_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz].")
    standard_error: Vector = field(
        "Standard error of each parameter, from the data alone; null if they do not determine it."
    )
    interval: tuple[Interval | None, ...] = field(
        "95 % interval of each parameter; null if the data do not determine it."
    )
    rests_on: tuple[ParameterSource, ...] | None = field(
        "Where each of the ten parameters comes from; null with `--quick`."
    )
    min_eig_pseudo_inertia: float = field(
        "Smallest eigenvalue of the pseudo-inertia J(π); positive for a realizable body."
    )
    ellipsoid_margin: float | None = field(
        "Tr(J Q) [kg]; for a union, the smallest value of its parts; null without an ellipsoid."
    )
    realizable: bool = field("Whether some mass density within the bounds has these parameters.")
    identifiable: tuple[bool, ...] = field("Whether the data determine each parameter.")
    constraints: str = field("Constraint set of the body.")
    copy_of: str | None = field("Body of which it is a copy (`mirror`).")
    lumped: tuple[str, ...] = field("Links on fixed or locked joints that are part of it.")
    prior: Vector = field("The ten parameters of the prior.")
    ellipsoids: tuple[LinkEllipsoid, ...] = field("Its bounding ellipsoids.")
    shapes: tuple[dict[str, Any], ...] = field("Its other bounding shapes, each as in `bounding_shapes`.")
    deviation_ellipsoid: LinkEllipsoid | None = field(
        "Standard-deviation ellipsoid of the mass distribution; some mass lies on or outside it. Null if m < 0."
    )
    split: tuple[UnionPart, ...] | None = field("Parts of the body within a union of ellipsoids; null without a union.")
    witness: PointMasses | None = field(
        "Point masses that prove realizability; null if it is not realizable, and for bounds other than ellipsoids."
    )
    violations: Sentences = field("Reasons why the body is not realizable, one sentence each.")

    @property
    def inertia(self) -> Array:
        """Inertia about the centre of mass, shape (3, 3) [kg·m²]."""
        return symmetric_matrix(self.inertia_com)

    def __repr__(self) -> str:
        com = ", ".join(short_number(x) for x in self.com)
        moments = ", ".join(short_number(x) for x in self.inertia_com[[0, 2, 5]])
        existence = "realizable" if self.realizable else "not realizable"
        error = f" ± {short_number(self.standard_error[0], 2)}" if self.standard_error[0] >= 0 else ""
        mass = f"{short_number(self.mass)}{error} kg"
        return f"{self.kind.capitalize()}: {mass} at ({com}) m, Ixx, Iyy, Izz {moments} kg·m², {existence}"


class FrictionErrors(Record):
    """Standard errors of a joint's friction; null if the data do not determine it or the model lacks the term."""

    viscous: float | None = field("Viscous friction.")
    coulomb: float | None = field("Coulomb friction.")
    offset: float | None = field("Torque offset.")


class FrictionReport(Record):
    """Friction of a joint; null for a term that the model lacks."""

    viscous: float | None = field("Viscous friction [N·m·s/rad or N·s/m].")
    coulomb: float | None = field("Coulomb friction [N·m or N].")
    offset: float | None = field("Torque offset [N·m or N].")
    standard_error: FrictionErrors = field("Standard errors.")


class EffectReport(Record):
    """An effect and its parameters."""

    effect: str = field("Its id, see [Effects](effects.md).")
    joint: str | None = field("The joint it acts on; null if it has none.")
    link: str | None = field("The link it acts on; null if it has none.")
    parameters: ByParameter = field("Its parameters, identified or given.")
    standard_error: ByParameter = field("Standard errors of the identified parameters; null: given, or undetermined.")
    units: Annotated[ReadOnly[str | None], Keys("parameter")] = field("Units of the parameters; null: none.")


class FrictionIntervals(Record):
    """95 % intervals of a joint's friction; null if the data do not determine it."""

    viscous: Interval | None = field("Viscous friction.")
    coulomb: Interval | None = field("Coulomb friction.")
    offset: Interval | None = field("Torque offset.")


class ReflectedInertia(Record):
    """A rotor's inertia reflected to a joint."""

    reflected_inertia: float = field("Inertia about the spin axis times the gear ratio squared [kg·m²].")
    standard_error: float | None = field("Standard error; null if the data do not determine it.")
    interval: Interval | None = field("95 % interval; null if the data do not determine it.")


class ControllerDelay(Record):
    """Delay from command to torque."""

    delay: float = field("Delay in the model [s].")
    given: float | None = field("Delay in the configuration [s]; null for `auto`.")
    fitted: float | None = field(
        "Delay estimated from the data [s]; null if they do not determine it, and with `--quick` for a given delay."
    )
    standard_error: float | None = field("Standard error of `fitted` [s].")
    known_friction_standard_error: float | None = field(
        "Standard error of `fitted` if viscous friction were known [s]."
    )
    correlation: float | None = field("Correlation of the delay with viscous friction.")
    contradicted: bool | None = field("Whether the data contradict `given`.")
    text: str | None = field("Summary as a sentence.")


class ControllerGainsReport(Record):
    """Fitted gains of a joint's controller."""

    kp: float | None = field("Position gain [N·m/rad or N/m]; null if it was given.")
    kp_standard_error: float | None = field("Standard error of `kp` for a known scale; null if it was given.")
    kd: float | None = field("Velocity gain [N·m·s/rad or N·s/m]; null if it was given.")
    kd_standard_error: float | None = field("Standard error of `kd` for a known scale; null if it was given.")
    scale: Literal["logged_torque", "given_gain", "known_values", "prior"] = field(
        "What fixed the common scale of gains, friction and masses; `prior`: the masses of the prior."
    )


class UncertaintyReport(Record):
    """Method of the standard errors, and the standard error of the predicted torque."""

    confidence: float = field("Confidence level of the intervals: 0.95.")
    blocks: int = field(
        "Number of time blocks for the standard errors; 0 if there are too few blocks, so that the standard errors are "
        "computed from the number of independent samples."
    )
    block_seconds: float = field("Length of a block [s].")
    correlated_beyond_blocks: bool = field(
        "Whether the residual is correlated over more than the longest possible block."
    )
    bootstrap_ratio: float | None = field("Median ratio of bootstrap to analytic standard errors.")
    independent_samples: ByJoint = field("Equivalent number of independent samples.")
    torque_standard_error: ByJoint = field(
        "RMS standard error of the predicted torque due to parameter errors [N·m or N]."
    )
    torque_standard_error_largest: ByJoint = field("Largest standard error of the predicted torque [N·m or N].")
    torque_undetermined: ByJoint = field("Fraction of the samples whose torque the fitted data do not determine.")


class BaseParameter(Record):
    """A combination of coefficients that the torque depends on."""

    name: str = field("The combination as text.")
    terms: tuple[CombinationTerm, ...] = field("Terms of the combination.")
    unit: str = field("Its unit.")
    value: float = field("Its value.")
    standard_error: float | None = field("Standard error; null if these logs do not determine it.")
    interval: Interval | None = field("95 % interval; null if the data do not determine it.")
    pull: float | None = field(
        "Distance between the fit and the estimate from the data alone, in standard errors; null if undetermined."
    )


class BaseParametersResult(Record):
    """The combinations of coefficients that the torque depends on."""

    of: int = field("Number of coefficients.")
    structural: int = field("Number of combinations that some motion determines.")
    determined: int = field("Number of combinations that these logs determine.")
    held_away: int = field(
        "Number of combinations that prior or constraints keep away from the estimate from the data alone."
    )
    parameters: tuple[BaseParameter, ...] = field("All combinations.")


class BiasParameter(Record):
    """A combination by least squares and by instrumental variables."""

    name: str = field("The combination as text.")
    unit: str = field("Its unit.")
    ls: float = field("Value by least squares.")
    iv: float = field("Value by instrumental variables.")
    standard_error: float = field("Standard error of the difference.")
    differs: bool = field(
        "Whether the two differ significantly: by more than chance, and least squares outside the 95 % interval of the "
        "other."
    )


class BiasReport(Record):
    """Comparison of least squares and instrumental variables, which are not biased by noise in q and v."""

    method: str = field("Method of the fit.")
    instruments: str = field(
        "Source of the instruments: simulation under the logged command (`closed_loop`) or `smoothed` motion."
    )
    iterations: int = field("Iterations of the instrumental-variables fit.")
    weak: tuple[str, ...] = field("Joints whose instruments are weak.")
    parameters: tuple[BiasParameter, ...] = field("Combinations that both methods determine.")


class RepeatedParameter(Record):
    """A combination of coefficients, identified from each log."""

    name: str = field("The combination as text.")
    unit: str = field("Its unit.")
    value: tuple[float | None, ...] = field("Value by log; null if the log does not determine it.")
    standard_error: tuple[float | None, ...] = field("Standard error by log.")
    ratio: float | None = field("Scatter divided by the scatter expected from the standard errors.")
    agrees: bool = field("Whether chance can explain the scatter, with so many combinations and time blocks.")


class RepeatabilityReport(Record):
    """Comparison of several logs."""

    logs: tuple[str, ...] = field("The logs.")
    agree: bool = field("Whether all combinations agree.")
    odd_one_out: str | None = field("The log that differs from all others, if there is one.")
    cross_rms: tuple[tuple[float, ...], ...] = field(
        "RMS error of the model fitted to one log (row) on another log (column), in units of the noise."
    )
    parameters: tuple[RepeatedParameter, ...] = field("All combinations.")


class PathPointReport(Record):
    """The fit with one weight of the prior."""

    weight: float = field("Weight of the prior.")
    train_error: float | None = field("RMS residual on the fitted data, in units of the noise.")
    validation_error: float | None = field(
        "RMS residual on the blocks left out, in units of the noise; null if the logs are too short."
    )
    total_mass: float | None = field("Total mass [kg].")
    distance: float | None = field("Distance from the prior, Σ d(π, π̂).")


class AutomaticWeight(Record):
    """Automatic choice of the weight of the prior."""

    limit: Literal["validation", "significance", "range", "untested"] = field("Criterion that limits the weight.")
    reason: str = field("Summary as a sentence.")
    best: float | None = field("Weight with the smallest error on the blocks left out; null if the logs are too short.")
    standard_error: float | None = field("Standard error of the squared error at that weight.")
    chosen: PathPointReport = field("The fit with the chosen weight.")
    weaker: PathPointReport = field("The fit with a tenth of the chosen weight.")
    stronger: PathPointReport = field("The fit with ten times the chosen weight.")
    path: tuple[PathPointReport, ...] = field("The fits with all weights that were tried.")


class RegularizationReport(Record):
    """The prior's kind and weight, as in the configuration."""

    kind: str = field("Kind of distance.")
    weight: float = field("Its weight.")
    mass_precision: float = field("How many times more accurate the URDF's masses are assumed to be than its inertias.")
    units: str = field("`relative` or `si`.")
    automatic: AutomaticWeight | None = field("How the weight was chosen; null if it was given.")


class KnownValue(Record):
    """A known value, and the identified one."""

    what: str = field("The quantity.")
    value: float = field("Its value.")
    standard_error: float | None = field("Its standard error; null: exact.")
    identified: float = field("Identified value.")


class WholeRobotReport(Record):
    """Mass and centre of mass of a robot with a floating base, all joints at position 0."""

    mass: float = field("Mass of all bodies [kg].")
    mass_standard_error: float | None = field("Its standard error [kg]; null if the data do not determine it.")
    prior_mass: float = field("That of the prior [kg].")
    com: Vector = field("Centre of mass in the root link's frame [m].")
    com_standard_error: tuple[float | None, float | None, float | None] = field(
        "Standard errors of its coordinates [m]; null if the data do not determine one."
    )
    prior_com: Vector = field("That of the prior [m].")


class FootComplianceReport(Record):
    """Compliance of the balls of the feet, the same for all."""

    value: float = field("Compliance, the inverse of the stiffness [m/N].")
    standard_error: float | None = field("Its standard error [m/N]; null if the data do not determine it.")


class OffsetInLog(Record):
    """Reading of a sensor of force and moment without load in one log."""

    offset: list[float] = field("Force [N] and moment [N·m] at the beginning of the log, along the axes of the sensor.")
    standard_error: list[float | None] = field("Standard errors; null if the data do not determine one.")
    drift: list[float] | None = field(
        "Its change along the part of the log that was fitted [N, N·m]; null if the model has no drift."
    )
    drift_standard_error: list[float | None] | None = field("Standard errors of the drift.")


class WrenchSensorReport(Record):
    """Reading of a sensor of force and moment without load."""

    offset: list[float] = field("Force [N] and moment [N·m], along the axes of the sensor; the mean over the logs.")
    standard_error: list[float | None] = field("Standard errors; null if the data do not determine one.")
    by_log: Annotated[ReadOnly[OffsetInLog], Keys("log")] = field(
        "Offset in each log that was fitted; the same in all of them with `common_offset`."
    )


class SolverReport(Record):
    """Solution of the optimization problem."""

    name: str = field("Solver.")
    status: str = field("Status at the end.")
    objective: float = field("Cost at the solution.")
    duality_gap: float = field("No admissible parameters have a cost that is lower by more than this fraction.")
    iterations: int = field("Iterations.")
    seconds: float = field("Time in the solver [s].")
    violation: float = field("Largest violation of an inequality; not positive if all are satisfied.")
    parameter_error: float | None = field(
        "Bound on the distance of any parameter from the optimum, in units of its body's mass and size; null: unknown."
    )


class FleetRobotReport(Record):
    """One robot of a fleet."""

    logs: tuple[str, ...] = field("Its logs.")
    samples: int = field("Number of samples used for the fit.")
    rms: float = field(
        "RMS torque error of the fleet's model with the robot's own friction, of all joints; on held-out data if all "
        "robots have some, else on the training data [N·m or N]."
    )
    rms_alone: float = field("The same of a model that was fitted to its logs alone.")
    friction: Annotated[ReadOnly[FrictionReport], Keys("joint")] = field("Its friction.")
    outliers: tuple[str, ...] = field("How it differs from the other robots.")


class FleetReport(Record):
    """Robots of one type whose logs were fitted together."""

    shared: str = field("What they share: `bodies`.")
    own: tuple[str, ...] = field("What each has of its own: `friction`, or effects.")
    robots: Annotated[ReadOnly[FleetRobotReport], Keys("robot")] = field("The robots.")


class FitReport(ReproducibleResult):
    """Result of `idtool fit`."""

    verdict: VerdictLevel = field(VERDICT_TEXT)
    verdict_reasons: tuple[VerdictReason, ...] = field(REASONS_TEXT)
    next: Sentences = field("Suggested next steps, one sentence each.")
    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    samples: SampleCounts = field("Number of samples used.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    method: str = field("`ls` (least squares) or `iv` (instrumental variables).")
    rms: TorqueErrors = field("RMS torque errors within the filter's band.")
    rms_by_kind: ErrorsByKind | None = field(
        "RMS errors of the joints, of the force and moment on a floating base (`base_force`, `base_moment`), and of "
        "each wrench sensor (`<joint>_force`, `<joint>_moment`); null if there are only joints."
    )
    rms_raw: TorqueErrors = field("RMS torque errors against the torque as logged.")
    nrms: ByJointOrNone = field(
        "`rms.validation` (or `train`) divided by the standard deviation of the measured torque."
    )
    simulation: Simulation | None = field("Forward simulation; null if it was skipped.")
    noise_floor: ByJointOrNone | None = field(
        "RMS error in the band due to noise and to friction at standstill, which no model can predict, from the "
        "residual's spectrum, and `overall`; null for joints that move too little. Null with `--quick` and for logs "
        "that were reduced [N·m or N]."
    )
    noise: ByJoint = field("Torque noise used to weight the joint's equation [N·m or N].")
    bodies: Annotated[ReadOnly[BodyReport], Keys("body")] = field("Identified links and rotors.")
    whole_robot: WholeRobotReport | None = field("Mass and centre of mass of the whole robot; null with a fixed base.")
    foot_compliance: FootComplianceReport | None = field(
        "Compliance of the feet of a robot with a floating base; null if none of them is a ball that gives way."
    )
    wrench_sensors: Annotated[ReadOnly[WrenchSensorReport], Keys("joint")] = field(
        "Wrench sensors whose offset was identified, by the fixed joint that they are at."
    )
    wrench_sensor_offsets: OffsetsByLog = field(
        "Offsets of the wrench sensors in logs that are used for validation only, by the identified model [N, N·m]; "
        "estimated from these logs themselves."
    )
    friction: Annotated[ReadOnly[FrictionReport], Keys("joint")] = field("Identified friction.")
    friction_intervals: Annotated[ReadOnly[FrictionIntervals], Keys("joint")] = field("95 % intervals of friction.")
    fleet: FleetReport | None = field(
        "Robots of the fleet, with the setting `pool`; `friction` is then their mean. Null without it."
    )
    effects: tuple[EffectReport, ...] = field("Effects besides rigid bodies and friction.")
    rotors: Annotated[ReadOnly[Annotated[ReadOnly[ReflectedInertia], Keys("joint")]], Keys("rotor")] = field(
        "Reflected inertia at each joint that drives the rotor."
    )
    controller: ControllerDelay | None = field(
        "Delay from command to torque; null if the log contains the torque of every joint."
    )
    controller_gains: Annotated[ReadOnly[ControllerGainsReport], Keys("joint")] = field(
        "Fitted gains, of joints with `kp: fit` or `kd: fit` in the configuration."
    )
    controller_gains_text: str | None = field("Summary of the fitted gains; null if all were given.")
    uncertainty: UncertaintyReport = field("How standard errors were computed.")
    base_parameters: BaseParametersResult | None = field("Base parameters; null with `--quick`.")
    bias: BiasReport | None = field("Comparison of least squares and instrumental variables; null if it was skipped.")
    repeatability: RepeatabilityReport | None = field("Comparison of the logs; null for one log.")
    regularization: RegularizationReport = field("The prior.")
    known: tuple[KnownValue, ...] = field("Known values.")
    solver: SolverReport = field("The solution.")
    seconds: Annotated[ReadOnly[float], Keys("stage")] = field("Wall time by stage [s].")
    logs: tuple[str, ...] = field("The logs.")
    urdf: str = field("The URDF.")

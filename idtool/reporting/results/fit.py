"""Records of `idtool fit`: report.json."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from idtool.common.arrays import Array
from idtool.reporting.results.base import (
    ByJoint,
    ByJointOrNone,
    Ellipsoid,
    Interval,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    Samples,
    Sentences,
    Term,
    Units,
    Vector,
    field,
)
from idtool.reporting.results.rollouts import Simulation
from idtool.robot.inertia import symmetric_matrix


class TorqueErrors(Record):
    """RMS torque errors by joint, and `overall` joints and samples."""

    train: ByJoint = field("Of the identified model on the data that were fitted [N·m or N].")
    validation: ByJoint | None = field("Of the identified model on the held-out data; null where nothing was held out.")
    prior_validation: ByJoint | None = field("Of the URDF as given on the held-out data.")


class CorrelatedParameter(Record):
    """A coefficient that the data tie to another."""

    of: str = field("Body or joint that the coefficient belongs to.")
    what: str = field("The coefficient's name.")
    correlation: float = field("Correlation with it.")


class ParameterSource(Record):
    """What a parameter's value rests on: data, constraints, prior."""

    on: Literal["data", "combination", "constraints", "prior"] = field(
        "Where most of it comes from; `combination`: the data determine it only together with others."
    )
    data: float = field("Share that comes from the data; the three shares sum to one.")
    constraints: float = field("Share that comes from the constraints.")
    prior: float = field("Share that comes from the prior.")
    range: tuple[float | None, float | None] = field(
        "Interval that the constraints allow at a cost 1 % above the least; null: no end."
    )
    moves_with: tuple[CorrelatedParameter, ...] = field("Coefficients that are correlated with it.")
    combinations: tuple[int, ...] = field(
        "Indices into `base_parameters.parameters` of the combinations it is part of."
    )
    text: str = field("The same as a sentence.")


class UnionPart(Record):
    """One of the bodies that a body within a union of ellipsoids is the sum of."""

    mass: float = field("Mass [kg].")
    pi: Vector = field("The ten parameters.")


class PointMasses(Record):
    """Point masses within the bounds that have exactly the body's parameters: a proof that it can exist."""

    masses: Vector = field("Masses [kg].")
    points: tuple[tuple[float, float, float], ...] = field("Their places in the link's frame [m].")


class BodyReport(Record):
    """An identified link or rotor, in the link's frame."""

    kind: Literal["link", "rotor"] = field("`link` or `rotor`.")
    mass: float = field("Mass [kg].")
    com: Vector = field("Centre of mass, shape (3,) [m].")
    inertia_com: Vector = field("Inertia about the centre of mass: [xx, xy, yy, xz, yz, zz] [kg·m²].")
    pi: Vector = field("The ten parameters [m, mc_x, mc_y, mc_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz].")
    standard_error: Vector = field("Standard error of each, from the data alone; null where they do not determine it.")
    interval: tuple[Interval | None, ...] = field("95 % interval of each; null likewise.")
    rests_on: tuple[ParameterSource, ...] | None = field("What each of the ten rests on; null with `--quick`.")
    min_eig_pseudo_inertia: float = field(
        "Least eigenvalue of the pseudo-inertia J(π); positive if a body can have it."
    )
    ellipsoid_margin: float | None = field(
        "Tr(J Q) [kg]; of a union, the least over its parts; null without an ellipsoid."
    )
    realizable: bool = field("Whether some mass density within the bounds has these parameters.")
    identifiable: tuple[bool, ...] = field("Whether the data determine each parameter.")
    constraints: str = field("The constraint set it was identified in.")
    copy_of: str | None = field("The body that it copies (`mirror`).")
    lumped: tuple[str, ...] = field("Links on fixed or locked joints that are part of it.")
    prior: Vector = field("The ten parameters of the prior.")
    ellipsoids: tuple[Ellipsoid, ...] = field("Its bounding ellipsoids.")
    shapes: tuple[dict[str, Any], ...] = field("Its other bounding shapes, each as in `bounding_shapes`.")
    deviation_ellipsoid: Ellipsoid | None = field(
        "Standard-deviation ellipsoid of its mass; some mass lies on or beyond it. Null for a mass below zero."
    )
    split: tuple[UnionPart, ...] | None = field("Within a union, the parts that it is the sum of; else null.")
    witness: PointMasses | None = field(
        "Point masses that prove it; null for a body that cannot exist, and within shapes other than ellipsoids."
    )
    violations: Sentences = field("Why it cannot exist, one sentence each.")

    @property
    def inertia(self) -> Array:
        """Inertia about the centre of mass, shape (3, 3) [kg·m²]."""
        return symmetric_matrix(self.inertia_com)

    def __repr__(self) -> str:
        com = ", ".join(f"{x:.4g}" for x in self.com)
        moments = ", ".join(f"{x:.4g}" for x in self.inertia_com[[0, 2, 5]])
        existence = "realizable" if self.realizable else "no body can have this"
        error = f" ± {self.standard_error[0]:.2g}" if self.standard_error[0] >= 0 else ""
        mass = f"{self.mass:.4g}{error} kg"
        return f"{self.kind.capitalize()}: {mass} at ({com}) m, Ixx, Iyy, Izz {moments} kg·m², {existence}"


class FrictionErrors(Record):
    """Standard errors of a joint's friction; null where the data do not determine it or the model lacks the term."""

    viscous: float | None = field("Of viscous friction.")
    coulomb: float | None = field("Of Coulomb friction.")
    offset: float | None = field("Of the torque offset.")


class FrictionReport(Record):
    """Friction of a joint; null for a term that the model lacks."""

    viscous: float | None = field("Viscous friction [N·m·s/rad or N·s/m].")
    coulomb: float | None = field("Coulomb friction [N·m or N].")
    offset: float | None = field("Torque offset [N·m or N].")
    standard_error: FrictionErrors = field("Their standard errors.")


class FrictionIntervals(Record):
    """95 % intervals of a joint's friction; null where the data do not determine it."""

    viscous: Interval | None = field("Of viscous friction.")
    coulomb: Interval | None = field("Of Coulomb friction.")
    offset: Interval | None = field("Of the torque offset.")


class ReflectedInertia(Record):
    """A rotor's inertia as a joint feels it."""

    reflected_inertia: float = field("Inertia about the spin axis times the gear ratio squared [kg·m²].")
    standard_error: float | None = field("Standard error; null where the data do not determine it.")
    interval: Interval | None = field("95 % interval; null likewise.")


class ControllerDelay(Record):
    """The delay from command to torque."""

    delay: float = field("Delay of the model [s].")
    given: float | None = field("Delay in the configuration [s]; null for `auto`.")
    fitted: float | None = field(
        "Delay that the data show [s]; null where they do not, and with `--quick` where given."
    )
    standard_error: float | None = field("Standard error of `fitted` [s].")
    known_friction_standard_error: float | None = field("The same if viscous friction were known [s].")
    correlation: float | None = field("Correlation of the delay with viscous friction.")
    contradicted: bool | None = field("Whether the data contradict `given`.")
    text: str | None = field("The same as a sentence.")


class UncertaintyReport(Record):
    """How standard errors were found, and the error of the predicted torque."""

    confidence: float = field("Confidence of the intervals, 0.95.")
    blocks: int = field(
        "Blocks of time that standard errors come from; 0: too few, independent samples are counted instead."
    )
    block_seconds: float = field("Length of a block [s].")
    correlated_beyond_blocks: bool = field("Whether the residual is correlated for longer than a block can last.")
    bootstrap_ratio: float | None = field("Median ratio of resampled to analytic standard errors.")
    independent_samples: ByJoint = field("Independent samples that the log is worth.")
    torque_standard_error: ByJoint = field(
        "RMS error of the predicted torque due to the parameters' errors [N·m or N]."
    )
    torque_standard_error_largest: ByJoint = field("The largest such error [N·m or N].")
    torque_undetermined: ByJoint = field("Share of the samples whose torque the fitted data do not determine.")


class BaseParameter(Record):
    """A combination of coefficients that the torque depends on."""

    name: str = field("The combination as text.")
    terms: tuple[Term, ...] = field("What it is the sum of.")
    unit: str = field("Its unit.")
    value: float = field("Its value.")
    standard_error: float | None = field("Standard error; null where these logs do not determine it.")
    interval: Interval | None = field("95 % interval; null likewise.")
    pull: float | None = field("Distance between the fit and the data alone, in standard errors; null likewise.")


class BaseParameters(Record):
    """The combinations of coefficients that the torque depends on."""

    of: int = field("Number of coefficients.")
    structural: int = field("Combinations that some motion determines.")
    determined: int = field("Combinations that these logs determine.")
    held_away: int = field("Combinations that prior or constraints hold away from what the data say.")
    parameters: tuple[BaseParameter, ...] = field("All combinations.")


class BiasParameter(Record):
    """A combination by least squares and by instrumental variables."""

    name: str = field("The combination as text.")
    unit: str = field("Its unit.")
    ls: float = field("Value by least squares.")
    iv: float = field("Value by instrumental variables.")
    standard_error: float = field("Standard error of the difference.")
    differs: bool = field("Whether the two differ by more than chance.")


class BiasReport(Record):
    """Least squares against instrumental variables, which noise in q and v does not bias."""

    method: str = field("Method of the fit.")
    instruments: str = field(
        "Where instruments come from: the model under the logged command (`closed_loop`) or the motion (`smoothed`)."
    )
    iterations: int = field("Iterations of the instrumental-variables fit.")
    weak: tuple[str, ...] = field("Joints whose instruments are weak.")
    parameters: tuple[BiasParameter, ...] = field("All combinations that both determine.")


class RepeatedParameter(Record):
    """A combination as each log determines it."""

    name: str = field("The combination as text.")
    unit: str = field("Its unit.")
    value: tuple[float | None, ...] = field("Value by log; null where the log does not determine it.")
    standard_error: tuple[float | None, ...] = field("Standard error by log.")
    ratio: float | None = field("Scatter over what the standard errors predict.")
    agrees: bool = field("Whether chance explains the scatter.")


class RepeatabilityReport(Record):
    """Several logs against each other."""

    logs: tuple[str, ...] = field("The logs.")
    agree: bool = field("Whether all combinations agree.")
    odd_one_out: str | None = field("The log that differs from all others, if there is one.")
    cross_rms: tuple[tuple[float, ...], ...] = field(
        "RMS error of the model of one log (row) on another (column), in units of the noise."
    )
    parameters: tuple[RepeatedParameter, ...] = field("All combinations.")


class PathPointReport(Record):
    """The fit with one weight of the prior."""

    weight: float = field("Weight of the prior.")
    train_error: float | None = field("RMS residual on the fitted data, in units of the noise.")
    validation_error: float | None = field("RMS residual on blocks left out; null where logs are too short.")
    total_mass: float | None = field("Total mass [kg].")
    distance: float | None = field("Distance from the prior, Σ d(π, π̂).")


class AutomaticWeight(Record):
    """How the weight of the prior was chosen."""

    limit: Literal["validation", "significance", "range", "untested"] = field("Criterion that limits the weight.")
    reason: str = field("The same as a sentence.")
    best: float | None = field("Weight with the least error on blocks left out; null where logs are too short.")
    standard_error: float | None = field("Standard error of that error squared.")
    chosen: PathPointReport = field("The chosen weight.")
    weaker: PathPointReport = field("A tenth of it.")
    stronger: PathPointReport = field("Ten times it.")
    path: tuple[PathPointReport, ...] = field("All weights that were tried.")


class RegularizationReport(Record):
    """The prior's kind and weight, as in the configuration."""

    kind: str = field("Kind of distance.")
    weight: float = field("Its weight.")
    mass_precision: float = field("How many times better the URDF's masses are believed than its inertias.")
    units: str = field("`relative` or `si`.")
    automatic: AutomaticWeight | None = field("How the weight was chosen; null where it was given.")


class KnownValue(Record):
    """Something that was known otherwise, and what was identified."""

    what: str = field("What is known.")
    value: float = field("Its value.")
    standard_error: float | None = field("Its standard error; null: exact.")
    identified: float = field("What was identified.")


class SolverReport(Record):
    """How the optimization problem was solved."""

    name: str = field("Solver.")
    status: str = field("How it ended.")
    objective: float = field("Cost at the solution.")
    duality_gap: float = field("No parameters in the constraint sets have a cost lower by more than this share.")
    iterations: int = field("Iterations.")
    seconds: float = field("Time in the solver [s].")
    violation: float = field("Largest violation of an inequality, at most 0.")
    parameter_error: float | None = field(
        "Bound on the distance of any parameter from the optimum, in units of its body's mass and size; null: unknown."
    )


class FitReport(ReproducibleResult):
    """Result of `idtool fit`."""

    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    samples: Samples = field("Samples used.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    method: str = field("`ls` (least squares) or `iv` (instrumental variables).")
    rms: TorqueErrors = field("RMS torque errors within the filter's band.")
    rms_raw: TorqueErrors = field("RMS torque errors against the torque as logged.")
    nrms: ByJointOrNone = field("`rms.validation` (or `train`) over the standard deviation of the measured torque.")
    simulation: Simulation | None = field("The model run forwards; null where it was not.")
    noise: ByJoint = field("Torque noise by which a joint's equation was weighted [N·m or N].")
    bodies: Annotated[ReadOnly[BodyReport], Keys("body")] = field("Identified links and rotors.")
    friction: Annotated[ReadOnly[FrictionReport], Keys("joint")] = field("Identified friction.")
    friction_intervals: Annotated[ReadOnly[FrictionIntervals], Keys("joint")] = field("95 % intervals of friction.")
    rotors: Annotated[ReadOnly[Annotated[ReadOnly[ReflectedInertia], Keys("joint")]], Keys("rotor")] = field(
        "Reflected inertia at each joint that a rotor turns with."
    )
    controller: ControllerDelay | None = field(
        "Delay from command to torque; null where every joint has its torque in the log."
    )
    uncertainty: UncertaintyReport = field("How standard errors were found.")
    base_parameters: BaseParameters | None = field("What the torque depends on; null with `--quick`.")
    bias: BiasReport | None = field("Least squares against instrumental variables; null where it was left out.")
    repeatability: RepeatabilityReport | None = field("Logs against each other; null for one log.")
    regularization: RegularizationReport = field("The prior.")
    known: tuple[KnownValue, ...] = field("What was known otherwise.")
    solver: SolverReport = field("The solution.")
    seconds: Annotated[ReadOnly[float], Keys("stage")] = field("Wall time by stage [s].")
    warnings: Sentences = field("What a user should know, one sentence each.")
    logs: tuple[str, ...] = field("The logs.")
    urdf: str = field("The URDF.")

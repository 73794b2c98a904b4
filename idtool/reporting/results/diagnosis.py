"""Records of `idtool diagnose`: diagnosis.json."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from idtool.dynamics.effects.named_effect import Cause
from idtool.reporting.results.base import (
    ByJointOrNone,
    Keys,
    NoticeReport,
    ReadOnly,
    Record,
    ReproducibleResult,
    SampleCounts,
    Sentences,
    Units,
    Vector,
    field,
)
from idtool.reporting.results.fit import (
    BodyReport,
    EffectReport,
    FrictionIntervals,
    FrictionReport,
    KnownValue,
    ReflectedInertia,
    SolverReport,
)
from idtool.reporting.results.verdict import VERDICT_TEXT, VerdictLevel, VerdictReason

ByState = Annotated[ReadOnly[Vector], Keys("state")]


class ErrorLevel(Record):
    """RMS errors of a model by joint, null where its torque is not known; `overall` is the RMS over all others."""

    train: ByJointOrNone = field("Torque error on the fitted data [N·m or N].")
    validation: ByJointOrNone | None = field("Torque error on held-out data; null if nothing was held out.")
    simulation: ByJointOrNone | None = field(
        "Position error of the rollouts [rad or m]; null if nothing was simulated."
    )

    @property
    def torque(self) -> ByJointOrNone:
        """Torque errors on the held-out data, or on the fitted data if nothing was held out."""
        return self.train if self.validation is None else self.validation


class Location(Record):
    """Joints, times and region in which model and data disagree."""

    joints: tuple[str, ...] = field("The joints.")
    windows: tuple[tuple[float, float], ...] = field("Time windows [s].")
    region: str = field("Description of the region where the residual was concentrated.")


class CandidateReport(Record):
    """A candidate effect."""

    effect: str = field("Its id, see [Effects](effects.md).")
    joint: str | None = field("The joint it acts on; null if it has none.")
    link: str | None = field("The link it acts on; null if it has none.")
    score: float | None = field(
        "Fraction of the mean square residual that the effect explains on data to which it was not fitted."
    )
    standard_error: float | None = field("Standard error of the score.")
    parameters: int = field("Number of parameters.")
    reason: str = field("Why it was not chosen.")


class PartReport(Record):
    """Size of an effect on a part of the data."""

    part: str = field("The log, or `first half` or `second half` of the only one.")
    parameter: str = field("The parameter that is the effect's size.")
    value: float = field("Its value from this part alone.")
    standard_error: float = field("Its standard error.")


class ResidualBins(Record):
    """A joint's residual torque in bins of a quantity."""

    mean: Vector = field("Mean in each bin [N·m or N].")
    deviation: Vector = field("Standard deviation about the mean.")


class EffectProfileReport(Record):
    """A joint's residual torque against what causes an effect, for plots."""

    joint: str = field("The joint whose torque it is.")
    cause: Cause = field(
        "What it is drawn against: a state of the joint, the torque that the model predicts and its rate [N·m/s or "
        "N/s], the distance since the joint's last reversal, or the time since the start of the first log."
    )
    cause_joint: str = field("The joint whose state or torque that is.")
    period: float | None = field("Period to which the position is reduced [rad or m]; null: it is not.")
    in_direction_of_motion: bool = field("Whether the torques are multiplied by the sign of the joint's velocity.")
    values: Vector = field("Mean of the cause in each bin.")
    before: ResidualBins = field("Residual of the model before the step.")
    after: ResidualBins = field("Residual of the model after the step.")
    effect_torque: Vector | None = field(
        "Mean torque of the effect in each bin [N·m or N]; null if it is not a function of the cause."
    )


class Evidence(Record):
    """Evidence for a step."""

    score: float | None = field(
        "Fraction of the mean square residual that the effect explains on data to which it was not fitted."
    )
    standard_error: float | None = field("Standard error of the score.")
    significance: float | None = field("Gain in standard errors.")
    pair: bool = field("Whether the data cannot distinguish it from the first alternative.")
    separate: str = field("Experiment that would distinguish the two effects; empty without a pair.")
    simulation_before: ByJointOrNone | None = field(
        "Position error of rollouts of the model before the step [rad or m]."
    )
    simulation_after: ByJointOrNone | None = field(
        "Position error of rollouts of the model after the step; that of the model with all steps is in `after`."
    )
    rollout_worse: tuple[str, ...] = field(
        "Joints whose simulation is worse although the torque of all joints together is predicted better."
    )
    assumed: bool = field("Whether the user gave the effect with `--assume`; else it was found.")
    sentence: str = field("Description of the step.")
    doubt: str = field("Reason for doubt, such as a size that differs between logs; empty: none.")
    parts: tuple[PartReport, ...] = field(
        "Size of the effect on each log by itself, or on the two halves of the only one; empty if not known."
    )


class StepReport(EffectReport):
    """An effect that was added to the model."""

    effect: str = field("Its id, see [Effects](effects.md), or `unknown`.")
    where: Location = field("Where model and data disagreed.")
    evidence: Evidence = field("Evidence for the effect.")
    validation_rms_before: ByJointOrNone = field("Held-out torque error before the step [N·m or N].")
    validation_rms_after: ByJointOrNone = field("Held-out torque error after the step.")
    alternatives: tuple[CandidateReport, ...] = field("Candidates that explain nearly as much.")
    rejected: tuple[CandidateReport, ...] = field("All other candidates.")
    profile: EffectProfileReport | None = field("Residual against what causes the effect; null for `unknown`.")

    @property
    def sentence(self) -> str:
        """Description of the step."""
        return self.evidence.sentence


class DataFault(Record):
    """A fault of the logs."""

    fault: str = field("Its id, see [Reading a diagnosis](howto/diagnosis.md#data-faults).")
    joint: str | None = field(
        "The joint; `imu`, `pose` or the name of a foot for a fault of these; null: the log, or all joints."
    )
    detail: str = field("What was observed, and what to do.")
    undone: bool = field("Whether idtool corrects it, so that no action is needed.")


class ResidualMap(Record):
    """A joint's residual against its state, for plots."""

    against: ByState = field("Centres of the bins of `position`, `velocity`, `torque`, `acceleration` and `time`.")
    mean: ByState = field(
        "Mean of the residual in each bin [N·m or N]; without the samples at which the direction of friction is not "
        "known, or the play of a backlash is open."
    )
    rms: ByState = field("RMS of the residual in each bin.")
    frequency: Vector = field("Frequencies [Hz].")
    density: Vector = field("Amplitude density at each frequency.")
    angle: Vector = field("Periods per turn of the joint.")
    amplitude: Vector = field("Amplitude at each number of periods.")


class ResidualMaps(Record):
    """Residuals before and after the diagnosis."""

    before: Annotated[ReadOnly[ResidualMap], Keys("joint")] = field("Residuals of the original model.")
    after: Annotated[ReadOnly[ResidualMap], Keys("joint")] = field("Residuals of the model with the effects.")


class ComparedParameter(Record):
    """A parameter in the simulator and on the robot."""

    simulator: Any = field(
        "Value in the simulator; null: the simulator has no such effect, or its logs do not show the value."
    )
    simulator_standard_error: Any = field("Its standard error; null: not known.")
    robot: Any = field("Value on the robot; null: the robot has no such effect, or its logs do not show the value.")
    robot_standard_error: Any = field("Its standard error; null: not known.")
    unit: str | None = field("Unit; null: none.")


class ChangeReport(Record):
    """A change to make in the simulator, or a difference that needs none."""

    effect: str = field(
        "Id of the effect, see [Effects](effects.md); `rigid_body` for the inertia of a link, `command_delay` for the "
        "controller's delay."
    )
    joint: str | None = field("The joint it acts on; null if it has none.")
    link: str | None = field("The link it acts on; null if it has none.")
    parameters: Annotated[ReadOnly[ComparedParameter], Keys("parameter")] = field("Its parameters.")
    share: float | None = field(
        "Fraction of the removed mean square torque error that returns without this change; for `rigid_body`, without "
        "the inertia of all links; null for `command_delay`."
    )
    reason: str = field("Why it need not be made; empty for a change to make.")


class LogPairReport(Record):
    """A log of the robot, and the simulator's under the same commands."""

    log: str = field("The robot's log.")
    simulation: str = field("The simulator's log.")
    offset: float = field("Time in the robot's log, from its start, at which the simulator's log starts [s].")
    seconds: float = field("Duration of the overlap [s].")
    torque_rms: ByJointOrNone | None = field(
        "RMS difference of the logged torques [N·m or N]; null if one of the logs has none."
    )
    position_rms: ByJointOrNone = field("RMS difference of the logged positions [rad or m].")


class AgainstReport(Record):
    """The robot against its simulator."""

    pairs: tuple[LogPairReport, ...] = field("The logs in pairs.")
    changes: tuple[ChangeReport, ...] = field(
        "Changes to make in the simulator, the one that closes most of the gap first."
    )
    unchanged: tuple[ChangeReport, ...] = field("Effects that need no change.")
    torque_before: ByJointOrNone = field("Torque error of the simulator's model on the robot's logs [N·m or N].")
    torque_after: ByJointOrNone = field("Torque error of the simulator's model with the changes.")
    position_before: ByJointOrNone | None = field(
        "Position error of rollouts of the simulator's model on the robot's logs [rad or m]; null if not simulated."
    )
    position_after: ByJointOrNone | None = field("Position error of rollouts with the changes.")
    simulator_rms: ByJointOrNone = field("Torque error of the simulator's model on the simulator's own logs.")
    simulator_effects: tuple[EffectReport, ...] = field("Effects found in the simulator, besides friction.")
    inconclusive: str = field(
        "Why the comparison is not conclusive, so that its changes may be wrong or missing; empty if it is conclusive."
    )
    advice: str = field("What to do for a conclusive comparison; empty if it is conclusive.")
    summary: str = field("The difference as sentences.")


class DiagnosisReport(ReproducibleResult):
    """Result of `idtool diagnose`."""

    urdf: str = field("The URDF.")
    logs: tuple[str, ...] = field("The logs.")
    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    inertia: Literal["refit", "fixed"] = field("Whether inertia was identified again at every step or kept fixed.")
    verdict: Literal["no_disagreement", "explained", "partly_explained", "unexplained"] = field(
        "The verdict; never `no_disagreement` if the noise floor is not known, and at most `partly_explained` if the "
        "comparison with a simulator is not conclusive."
    )
    model_verdict: VerdictLevel = field(f"Verdict on the model with the effects: {VERDICT_TEXT}")
    verdict_reasons: tuple[VerdictReason, ...] = field(
        "What was judged, one entry each; `model_verdict` is the worst of their levels."
    )
    searched: tuple[str, ...] | None = field("Effects that were searched for; null: all.")
    stopped: str = field("Why the search ended before it was complete; empty if it was complete.")
    before: ErrorLevel = field("Errors of the model without the effects.")
    after: ErrorLevel = field("Errors of the model with the effects.")
    noise_floor: ByJointOrNone = field(
        "Noise floor: torque error that no model can go below [N·m or N]; null if it is not known."
    )
    gap_closed: ByJointOrNone = field("(before − after) / (before − noise floor); null if there was almost no gap.")
    rollout_worse: tuple[str, ...] = field(
        "Joints whose simulation is worse although the torque of all joints together is predicted better."
    )
    steps: tuple[StepReport, ...] = field("Effects that were added, in order.")
    removed: Sentences = field("Effects that were added and removed again, one sentence each.")
    data_faults: tuple[DataFault, ...] = field("Faults of the logs.")
    samples: SampleCounts = field("Number of samples used.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    friction: Annotated[ReadOnly[FrictionReport], Keys("joint")] = field("Friction of the final model.")
    friction_intervals: Annotated[ReadOnly[FrictionIntervals], Keys("joint")] = field("95 % intervals of friction.")
    rotors: Annotated[ReadOnly[Annotated[ReadOnly[ReflectedInertia], Keys("joint")]], Keys("rotor")] = field(
        "Reflected inertia of the final model's rotors."
    )
    bodies: Annotated[ReadOnly[BodyReport], Keys("body")] = field("Bodies of the final model.")
    known: tuple[KnownValue, ...] = field("Known values.")
    solver: SolverReport = field("The final model's solution.")
    residual_maps: ResidualMaps = field("Residuals for plots.")
    against: AgainstReport | None = field("The robot against its simulator; null without `--against`.")
    seconds: float = field("Wall time [s].")
    summary: str = field("The verdict as sentences.")
    next: Sentences = field("Suggested next steps, one sentence each.")

    @property
    def lesser_faults(self) -> tuple[DataFault, ...]:
        """Data faults that are no problems, which the verdict names; those first that idtool does not correct."""
        problems = {(notice.code, notice.subject) for notice in self.notices if notice.severity == "problem"}
        lesser = [fault for fault in self.data_faults if (fault.fault, fault.joint) not in problems]
        return tuple(sorted(lesser, key=lambda fault: fault.undone))

    @property
    def further_notices(self) -> tuple[NoticeReport, ...]:
        """Notices that are not about a data fault."""
        faults = {(fault.fault, fault.joint) for fault in self.data_faults}
        return tuple(notice for notice in self.notices if (notice.code, notice.subject) not in faults)

"""Records of `idtool compare`: comparison.json."""

from __future__ import annotations

from typing import Annotated, Literal

from idtool.reporting.results.base import (
    ByJointOrNone,
    Interval,
    Keys,
    ReadOnly,
    Record,
    ReproducibleResult,
    SampleCounts,
    Sentences,
    Units,
    Vector,
    field,
)
from idtool.reporting.results.fit import FrictionReport
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.results.verdict import REASONS_TEXT, VERDICT_TEXT, VerdictLevel, VerdictReason

Answer = Literal["agree", "differ", "unknown"]
ParameterKind = Literal["base", "body", "friction", "rotor", "effect", "whole_robot", "controller"]


class ComparedResult(Record):
    """One of the two results."""

    report: str = field("Its report.json.")
    idtool: str = field("Version of idtool that made it.")
    versions: Annotated[ReadOnly[str], Keys("library")] = field("Versions of Python and of the main libraries.")
    verdict: VerdictLevel = field(VERDICT_TEXT)
    verdict_reasons: tuple[VerdictReason, ...] = field(REASONS_TEXT)
    urdf: str = field("The URDF.")
    logs: tuple[str, ...] = field("The logs.")
    joints: tuple[str, ...] = field("Joints, in the order of the torque equation.")
    units: Units = field("Unit of torque or force: `N·m` or `N`.")
    samples: SampleCounts = field("Number of samples used.")
    band_hz: float = field("Cut-off of the low-pass [Hz].")
    held_out: bool = field("Whether the errors are those on held-out data; false: on the fitted data.")
    rms: ByJointOrNone = field("RMS torque errors within the filter's band, with `overall` [N·m or N].")
    nrms: ByJointOrNone = field("`rms` divided by the standard deviation of the measured torque.")
    noise_floor: ByJointOrNone | None = field(
        "Error due to noise and to friction at standstill, which no model can predict [N·m or N]; null: not known."
    )
    simulation: Simulation | None = field("Forward simulation; null if it was skipped.")
    friction: Annotated[ReadOnly[FrictionReport], Keys("joint")] = field("Identified friction.")
    determined: int | None = field("Number of base parameters that its logs determine; null with `--quick`.")


class ComparedValue(Record):
    """A parameter in one of the two results."""

    value: float = field("Its value in the model; of the controller's delay, the fitted one.")
    estimate: float | None = field(
        "Estimate from the data alone, without prior and constraints; of effects and of the whole robot, the value in "
        "the model. Null if the data do not determine it."
    )
    standard_error: float | None = field(
        "Standard error of the estimate, enlarged if the logs of this result scatter more than theirs predict."
    )
    interval: Interval | None = field("95 % interval, as in report.json; null if the data do not determine it.")
    rests_on: Literal["data", "combination", "constraints", "prior"] | None = field(
        "Main source of the value in the model; null: not a parameter of a body, or `--quick`."
    )


class ComparedParameter(Record):
    """A parameter in both results."""

    kind: ParameterKind = field(
        "`base`: a base parameter, what the data determine; `body`: one of the ten parameters of a body; `friction`; "
        "`rotor`: reflected inertia at a joint; `effect`; `whole_robot`; `controller`."
    )
    of: str = field("Body, joint or effect; of a base parameter, the combination as text.")
    what: str = field("The parameter's name.")
    owners: tuple[str, ...] = field("Bodies and joints that it involves; of a base parameter, those of all its terms.")
    unit: str = field("Its unit.")
    a: ComparedValue | None = field("In the first result; null if its model lacks it.")
    b: ComparedValue | None = field("In the second result; null if its model lacks it.")
    difference: float | None = field("Second estimate minus the first; null if they cannot be compared.")
    standard_error: float | None = field("Standard error of the difference.")
    p_value: float | None = field("Probability of a difference so large by chance (Welch's test).")
    differs: bool | None = field("Whether they differ by more than chance; null: this cannot be told.")
    reason: str = field("Why this cannot be told; empty otherwise.")

    @property
    def difference_in_errors(self) -> float | None:
        """The difference in its standard errors; None if the two cannot be compared."""
        if self.difference is None or not self.standard_error:
            return None
        return self.difference / self.standard_error


class BodyValues(Record):
    """A body in one of the two results, in the link's frame."""

    mass: float = field("Mass [kg].")
    com: Vector = field("Centre of mass, shape (3,) [m].")
    inertia_com: Vector = field("Inertia about the centre of mass: [xx, xy, yy, xz, yz, zz] [kg·m²].")


class ComparedBody(Record):
    """A link or rotor in both results."""

    a: BodyValues | None = field("In the first result; null if it lacks the body.")
    b: BodyValues | None = field("In the second result; null if it lacks the body.")


class Setting(Record):
    """A setting, file or version that differs between the results."""

    name: str = field("Key of the configuration, or what it is.")
    a: str | None = field("In the first result; null: none.")
    b: str | None = field("In the second result; null: none.")


class ComparisonReport(ReproducibleResult):
    """Result of `idtool compare`."""

    answer: Answer = field(
        "`agree`: no parameter that both results determine differs by more than chance; `differ`: some do; `unknown`: "
        "no parameter could be compared."
    )
    summary: str = field("The answer as one sentence.")
    compared: int = field("Number of parameters that the answer is about: those that the data of both determine.")
    differing: int = field("How many of them differ by more than chance.")
    not_compared: int = field("How many others are part of both models, but not determined by the data of both.")
    false_discoveries: float = field("Largest expected fraction of false ones among those that differ.")
    p_limit: float | None = field("Largest p-value of those that differ; null if none does.")
    detectable: float | None = field(
        "Difference of one parameter that has an even chance to be found, relative to its value: the median of the "
        "compared parameters that are clearly not zero; null if there is none."
    )
    same_logs: bool = field("Whether a log was used for both, so that they are not independent.")
    joints: tuple[str, ...] = field("Joints of both.")
    joints_only_in_a: tuple[str, ...] = field("Joints of the first result that the second lacks.")
    joints_only_in_b: tuple[str, ...] = field("Joints of the second result that the first lacks.")
    a: ComparedResult = field("The first result.")
    b: ComparedResult = field("The second result.")
    parameters: tuple[ComparedParameter, ...] = field("All parameters of the two models.")
    bodies: Annotated[ReadOnly[ComparedBody], Keys("body")] = field("Bodies of the two models.")
    settings: tuple[Setting, ...] = field("Settings, files and versions that differ.")
    logs_in_both: Sentences = field("Logs with the same content in both.")

    @property
    def all_joints(self) -> tuple[str, ...]:
        """Joints of at least one of the results."""
        return self.joints + self.joints_only_in_a + self.joints_only_in_b

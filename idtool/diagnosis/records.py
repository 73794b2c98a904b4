"""Records of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.notice import Notice
from idtool.dynamics.effects import effect_name, target_name
from idtool.dynamics.effects.named_effect import Cause
from idtool.estimation.fit import Fit
from idtool.robot.config import EffectEntry

RIGID_BODY = "rigid_body"  # effect of a change of the inertia parameters of a body
COMMAND_DELAY = "command_delay"  # effect of a change of the delay of the controller

Verdict = Literal["no_disagreement", "explained", "partly_explained", "unexplained"]


@dataclass(frozen=True)
class ErrorSummary:
    """Rms errors of a model by joint, and ``overall``.

    Attributes
    ----------
    train, validation
        Torque errors in the band [N·m or N]; validation is None without held-out data.
    simulation
        Errors of the joint positions in rollouts [rad or m]; None if the model was not simulated.
    torque_squares_by_second
        Sum over all joints of the squared errors of ``torque`` within each second of the logs, shape (s,); None if it
        is not known.
    """

    train: Mapping[str, float]
    validation: Mapping[str, float] | None
    simulation: Mapping[str, float] | None
    torque_squares_by_second: Array | None = field(default=None, compare=False)

    @property
    def torque(self) -> Mapping[str, float]:
        """Torque errors on the held-out data if there are any, else on the training data."""
        return self.train if self.validation is None else self.validation


@dataclass(frozen=True)
class ResidualLocation:
    """Location of a disagreement between model and data.

    Attributes
    ----------
    joints
        The joints that disagree.
    windows
        Time intervals that contain most of the residual [s], shape (k, 2); empty: it is everywhere in the log.
    region
        Region of the state, in words.
    """

    joints: tuple[str, ...]
    windows: tuple[tuple[float, float], ...]
    region: str


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried, and the result.

    Attributes
    ----------
    effect, joint, link
        Id of the effect and what it acts on; joint and link are None if it has none.
    score
        Share of the mean square residual that it explains on data not used for fitting, of 1.
    standard_error
        Standard error of the score, from blocks.
    parameters
        Number of parameters.
    reason
        Reason why it was rejected, a plain sentence; empty for one that was added.
    """

    effect: str
    joint: str | None
    link: str | None
    score: float
    standard_error: float
    parameters: int
    reason: str = ""

    @property
    def target(self) -> str:
        """Joint or link that it acts on, or what it acts on of the whole robot."""
        return target_name(self.effect, self.joint, self.link)

    @property
    def words(self) -> str:
        """Effect and what it acts on, such as "Stribeck friction on elbow"."""
        return f"{effect_name(self.effect)} on {self.target}"

    @property
    def significance(self) -> float:
        """Score in standard errors."""
        return self.score / max(self.standard_error, 1e-12)


@dataclass(frozen=True)
class PartEstimate:
    """Size of an effect on a part of the data.

    Attributes
    ----------
    part
        Name of the part: a log, or "first half" or "second half" of the only one.
    parameter
        The parameter that is its size.
    value, standard_error
        Estimate from this part alone.
    """

    part: str
    parameter: str
    value: float
    standard_error: float


@dataclass(frozen=True)
class EffectProfile:
    """Residual torque of one joint in bins of what causes an effect.

    Attributes
    ----------
    joint
        Name of the joint whose torque it is: the effect's own, or the one on which the effect explains most.
    cause, cause_joint
        Quantity that the torque is drawn against, see `NamedEffect.cause`, and the joint that it is of.
    period
        Period to which a position is reduced [rad or m]; None: it is not.
    in_direction_of_motion
        True if the torques are multiplied by the sign of the joint's velocity.
    values
        Mean of the cause in each bin, ascending, shape (k,).
    mean_before, mean_after
        Mean residual without and with the effect [N·m or N], shape (k,).
    deviation_before, deviation_after
        Standard deviation of the residual about its mean [N·m or N], shape (k,).
    effect_torque
        Mean torque of the effect, in units of the measured torque, shape (k,); None where it is no function of the
        cause.
    """

    joint: str
    cause: Cause
    cause_joint: str
    period: float | None
    in_direction_of_motion: bool
    values: Array
    mean_before: Array
    deviation_before: Array
    mean_after: Array
    deviation_after: Array
    effect_torque: Array | None


@dataclass(frozen=True)
class DiagnosisStep:
    """An effect that was added, or ``unknown`` for the remaining residual.

    Attributes
    ----------
    chosen
        The effect.
    entry
        Its entry in model.yaml; None for ``unknown``.
    parameters, standard_error
        Values and standard errors by parameter name; an error is None if it is not known.
    location
        Location of the residual that it explains.
    significance
        Its held-out gain in standard errors.
    pair
        True if the data cannot distinguish it from the first of the alternatives.
    distinguishing_experiment
        Experiment that would distinguish the two, a plain sentence; empty unless ``pair``.
    alternatives
        Other effects with nearly the same gain, the best first.
    rejected
        All others that were tried, with reasons.
    before, after
        Errors without and with it.
    sentence
        The result, for people.
    doubt
        Reason to doubt it, a plain sentence; empty if there is none.
    parts
        Its size on each log by itself, or on the two halves of the only one; empty if it could not be estimated there.
    profile
        Residual against what causes the effect, for drawing; None for ``unknown``.
    is_assumed
        True if the user gave the effect.
    """

    chosen: Candidate
    entry: EffectEntry | None
    parameters: Mapping[str, Any]
    standard_error: Mapping[str, Any]
    location: ResidualLocation
    significance: float
    pair: bool
    distinguishing_experiment: str
    alternatives: tuple[Candidate, ...]
    rejected: tuple[Candidate, ...]
    before: ErrorSummary
    after: ErrorSummary
    sentence: str
    doubt: str = ""
    parts: tuple[PartEstimate, ...] = ()
    profile: EffectProfile | None = None
    is_assumed: bool = False


@dataclass(frozen=True)
class ResidualProfile:
    """Residual torque of one joint by state, for drawing.

    Attributes
    ----------
    against
        Centres of the bins of ``position``, ``velocity``, ``acceleration``, ``torque`` and ``time``, shape (k,) each.
    mean, rms
        Of the residual in each bin, by the same names [N·m or N], shape (k,).
    frequency, density
        Amplitude density over time frequency [Hz; N·m/√Hz], shape (f,).
    angle, amplitude
        Amplitude over periods per turn of the joint [N·m], shape (a,).
    """

    against: Mapping[str, Array]
    mean: Mapping[str, Array]
    rms: Mapping[str, Array]
    frequency: Array
    density: Array
    angle: Array
    amplitude: Array


ProfilesByJoint = Mapping[str, ResidualProfile]


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    Attributes
    ----------
    first, last
        Fits of the model without and with the effects.
    faults
        Faults of the data.
    steps
        In the order in which the effects were added; an ``unknown`` comes last.
    removed
        Effects that were added and removed again, a plain sentence each.
    before, after
        Errors of the two models.
    floor
        Noise floor, rms by joint and ``overall`` [N·m or N].
    is_floor_known
        False if the floor was not determined, and all of the error counts as noise.
    verdict
        Summary: how much of the disagreement is explained.
    searched
        Ids of the effects that were searched for; None: all.
    stopped
        Reason why the search ended before it was complete, a clause; empty if it was complete.
    maps_before, maps_after
        Residuals by joint.
    notices
        Notices for the user.
    seconds
        Wall time.
    """

    first: Fit
    last: Fit
    faults: tuple[Notice, ...]
    steps: tuple[DiagnosisStep, ...]
    removed: tuple[str, ...]
    before: ErrorSummary
    after: ErrorSummary
    floor: Mapping[str, float]
    is_floor_known: bool
    verdict: Verdict
    searched: tuple[str, ...] | None
    stopped: str
    maps_before: ProfilesByJoint
    maps_after: ProfilesByJoint
    notices: tuple[Notice, ...]
    seconds: float

"""What a diagnosis consists of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.estimation.fit import Fit
from idtool.robot.config import EffectEntry

Verdict = Literal["no_disagreement", "explained", "partly_explained", "unexplained"]


@dataclass(frozen=True)
class Level:
    """Errors of a model: rms by joint, and ``overall``.

    Attributes
    ----------
    train, validation
        Of the torque in the band [N·m or N]; validation is None where nothing was held out.
    simulation
        Of the joint positions in rollouts [rad or m]; None where the model was not simulated.
    """

    train: Mapping[str, float]
    validation: Mapping[str, float] | None
    simulation: Mapping[str, float] | None


@dataclass(frozen=True)
class Where:
    """Where a disagreement lives.

    Attributes
    ----------
    joints
        Those that disagree.
    windows
        Stretches of the log in which most of it lies [s], shape (k, 2); none: all along.
    region
        In which region of state, in words.
    """

    joints: tuple[str, ...]
    windows: tuple[tuple[float, float], ...]
    region: str


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried and what it came to.

    Attributes
    ----------
    effect, joint, link
        What it is; joint and link are None where it has none.
    score
        Share of the disagreement's power that it explains on data not used for fitting, of 1.
    standard_error
        Of the score, from blocks.
    parameters
        How many it has.
    reason
        Why it lost, a plain sentence; empty for one that was taken.
    """

    effect: str
    joint: str | None
    link: str | None
    score: float
    standard_error: float
    parameters: int
    reason: str = ""

    @property
    def on(self) -> str:
        """What it acts on."""
        return self.joint or self.link or "all joints"


@dataclass(frozen=True)
class Step:
    """An effect that was added, or ``unknown`` for what is left.

    Attributes
    ----------
    chosen
        The effect.
    entry
        As model.yaml has it; None for ``unknown``.
    parameters, standard_error
        By name, as in the contract; an error is None where it is not known.
    where
        Where the disagreement was that it explains.
    significance
        Its held-out gain in standard errors.
    pair
        Whether the data cannot tell it from the first of the alternatives.
    separate
        Which experiment would tell them apart, a plain sentence; empty where it is no pair.
    alternatives
        The others that came near, the best first.
    rejected
        All others that were tried, with why each lost.
    before, after
        Errors without and with it.
    sentence
        What was found, for people.
    doubt
        What speaks against it, a plain sentence; empty where nothing does.
    """

    chosen: Candidate
    entry: EffectEntry | None
    parameters: Mapping[str, Any]
    standard_error: Mapping[str, Any]
    where: Where
    significance: float
    pair: bool
    separate: str
    alternatives: tuple[Candidate, ...]
    rejected: tuple[Candidate, ...]
    before: Level
    after: Level
    sentence: str
    doubt: str = ""


@dataclass(frozen=True)
class Residual:
    """What a model leaves of the torque of one joint, by state, for drawing.

    Attributes
    ----------
    against
        By what it is binned: ``position``, ``velocity``, ``acceleration``, ``torque``, ``time``: centres of the bins,
        shape (k,).
    mean, rms
        By the same name, of the residual in each bin [N·m or N], shape (k,).
    frequency, density
        Its amplitude density over time frequency [Hz; N·m/√Hz], shape (f,).
    angle, amplitude
        Its amplitude over periods per turn of the joint [N·m], shape (a,).
    """

    against: Mapping[str, Array]
    mean: Mapping[str, Array]
    rms: Mapping[str, Array]
    frequency: Array
    density: Array
    angle: Array
    amplitude: Array


@dataclass(frozen=True)
class Diagnosis:
    """What was found.

    Attributes
    ----------
    first, last
        The model without and with the effects, fitted.
    faults
        Of the data.
    steps
        In the order in which the effects were added; an ``unknown`` comes last.
    removed
        What was added and taken out again, a plain sentence each.
    before, after
        Errors of the two models.
    floor
        What no model could come below, rms by joint and ``overall`` [N·m or N].
    verdict
        How much is explained.
    maps_before, maps_after
        Residuals by joint.
    notices
        What a user should know.
    seconds
        Wall time.
    """

    first: Fit
    last: Fit
    faults: tuple[Notice, ...]
    steps: tuple[Step, ...]
    removed: tuple[str, ...]
    before: Level
    after: Level
    floor: Mapping[str, float]
    verdict: Verdict
    maps_before: Mapping[str, Residual]
    maps_after: Mapping[str, Residual]
    notices: tuple[Notice, ...]
    seconds: float

"""Selection of the best of the fitted effects, and of those that the data cannot distinguish from it.

The *gain* of a candidate is the reduction of the squared residual in cross-validation. Blocks of time are left out in
turn, and their gains are summed. It is in units of the noise variance.

Rows that follow one another are correlated. *Inflation* is the number of rows that are worth one independent row. A
gain by chance is that many times larger than with independent rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.number_text import short_number
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import ScreenedProbe, screen_probes, sum_standard_error
from idtool.diagnosis.trial import TrialFit, with_nonlinear_parameters_free
from idtool.dynamics.effects import effect_types, target_name
from idtool.dynamics.effects.probe import Probe
from idtool.estimation.dataset.experiment import Progress

MIN_SIGNIFICANCE = 5.0  # standard errors of an effect; squared, its least gain: some thousand candidates compete
_GAIN_PER_PARAMETER = 4.0  # that each further parameter must add
MIN_SHARE = 0.1  # of a joint's squared residual, that an effect must explain
_MIN_DIFFERENCE_SIGNIFICANCE = 2.0  # standard errors by which the gains of two candidates must differ
MAX_SIMPLER_LOSS = 0.03  # of the best gain, that a simpler explanation may lack
_MAX_RIVAL_GAIN_RATIO = 0.5  # of a rival's gain with the winner in the model to its gain without
_MIN_NEAR_GAIN_RATIO = 0.8  # of two gains whose difference may be due to chance
_MAX_RESIDUAL_RATIO = 1.1  # of two squared residuals that are as good as the same


class ProbeKey(NamedTuple):
    """What a probe stands for, whatever its other nonlinear values.

    Attributes
    ----------
    subject
        The effect and the joint or link that it acts on.
    log
        File name of the log in which it acts; empty: in all.
    other_joints
        Indices of the other joints that it involves.
    """

    subject: tuple[str, str]
    log: str
    other_joints: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class FittedCandidate:
    """An effect fitted together with the whole model.

    Attributes
    ----------
    screened
        Result of the screening.
    trial
        Fit of the model with it.
    gains
        Gain in each block by the fit, shape (F,).
    """

    screened: ScreenedProbe
    trial: TrialFit
    gains: Array

    @property
    def probe(self) -> Probe:
        """The hypothesis."""
        return self.screened.probe

    @property
    def gain(self) -> float:
        """Gain over all blocks."""
        return float(self.gains.sum())

    @property
    def standard_error(self) -> float:
        """Standard error of the gain, from the blocks."""
        return sum_standard_error(self.gains)

    @property
    def cv_squared_error(self) -> float:
        """Squared cross-validation error of the model with the effect."""
        return self.trial.linearized.total_cv_squared_error


@dataclass(frozen=True)
class Screening:
    """Result of the screening of all candidates.

    Attributes
    ----------
    reference
        Model that the candidates were compared with, the parameters of its effects being free.
    screened
        All probes, each with its gain.
    failed
        Records of the candidates that could not be screened, with reasons.
    inflation
        Number of rows that are worth one independent row.
    """

    reference: LinearizedFit
    screened: Sequence[ScreenedProbe]
    failed: Sequence[Candidate]
    inflation: float


@dataclass(frozen=True)
class FullFits:
    """Result of the fits of the best candidates with the whole model.

    Attributes
    ----------
    finalists
        Candidates that were accepted, the largest gain first.
    rejected
        Records of those that turned out to be no explanation, with reasons.
    failed
        Records of those that could not be fitted, with reasons.
    gains
        Gain of each candidate that could be fitted.
    """

    finalists: Sequence[FittedCandidate]
    rejected: Sequence[Candidate]
    failed: Sequence[Candidate]
    gains: Mapping[ProbeKey, float]


@dataclass(frozen=True)
class SelectionStep:
    """Outcome of one round.

    Attributes
    ----------
    base
        Model that was to be improved.
    winner
        The best effect; None if none is worthwhile.
    indistinguishable
        Effects that the data cannot distinguish from it, the best first.
    runners_up
        Other finalists that explain the same part of the residual; without a winner, all finalists.
    rejected
        Records of all candidates that are no finalists, with reasons; empty if all joints are quiet.
    inflation
        Number of rows that are worth one independent row; if all joints are quiet, for white noise.
    failed
        Those of ``rejected`` that could not be screened or fitted.
    screening
        Screening of all candidates, from which pairs are formed if no single effect is worthwhile. None if there is a
        winner, so that no pair is needed, and if none was tried.
    has_tried
        False if all joints are quiet, so that no candidate was tried.
    substitutes
        Keys of the candidates that may explain as much as the winner, itself among them, or as the effects that are to
        be replaced; those that were skipped may, too. None if there is nothing to replace.
    """

    base: LinearizedFit
    winner: FittedCandidate | None
    indistinguishable: tuple[FittedCandidate, ...]
    runners_up: tuple[FittedCandidate, ...]
    rejected: tuple[Candidate, ...]
    inflation: float
    failed: tuple[Candidate, ...] = ()
    screening: Screening | None = None
    has_tried: bool = True
    substitutes: frozenset[ProbeKey] | None = None

    def alternatives(self) -> tuple[Candidate, ...]:
        """Records of the finalists that compete with the winner, the best first."""
        finalists = (*self.indistinguishable, *self.runners_up)
        return tuple(fitted_record(candidate, self.base) for candidate in finalists)


def probe_key(probe: Probe) -> ProbeKey:
    """Key of a probe."""
    other_joints = [probe.nonlinear_values[name] for name in effect_types()[probe.effect].joint_parameters()]
    return ProbeKey(probe.subject, probe.log, tuple(other_joints))


def probe_target(probe: Probe) -> tuple[str, str]:
    """Effect and what it acts on, as in a `Candidate`."""
    return probe.effect, target_name(probe.effect, probe.joint, probe.link)


def is_reportable(effect: str) -> bool:
    """True if an effect is an answer of a diagnosis."""
    return effect_types()[effect].reportable


def block_gains(before: LinearizedFit, after: LinearizedFit) -> Array:
    """Reduction of the squared residual of each block, shape (F,); both fits have the same rows."""
    return np.asarray(before.cv_squared_error - after.cv_squared_error)


def explained_share(gain: float, base: LinearizedFit, joint_count: int) -> float:
    """Gain as a share of the squared residual of as many joints.

    In units of the noise, every joint has about the same, so that each has an equal part of the total.
    """
    return float(gain / base.total_cv_squared_error * base.joint_count / joint_count)


def best_by_key(screened: Iterable[ScreenedProbe]) -> dict[ProbeKey, ScreenedProbe]:
    """Probe with the largest gain for each key."""
    best: dict[ProbeKey, ScreenedProbe] = {}
    for candidate in screened:
        key = probe_key(candidate.probe)
        if key not in best or candidate.gain > best[key].gain:
            best[key] = candidate
    return best


def select_best(
    base: LinearizedFit,
    screening: Screening,
    fits: FullFits,
    movable: Sequence[int],
    progress: Progress,
    min_share: float = MIN_SHARE,
) -> SelectionStep:
    """Best of the finalists, with the reasons why other candidates were rejected.

    Parameters
    ----------
    base
        Model that they are to improve.
    screening
        Result of the screening of all candidates.
    fits
        Result of the fits of the best ones.
    movable
        Indices of the model's effects whose nonlinear parameters may be moved.
    progress
        Callback for the stage and its progress, from 0 to 1.
    min_share
        Share of a joint's squared residual that an effect must explain.
    """
    finalists = fits.finalists
    inflation = screening.inflation
    worthwhile = [candidate for candidate in finalists if _is_worth_adding(candidate, base, inflation, min_share)]
    rejected = _all_rejected(base, screening, fits)
    failed = _reportable([*screening.failed, *fits.failed])
    if not worthwhile:
        return SelectionStep(base, None, (), tuple(finalists), rejected, inflation, failed, screening)

    winner = _simplest_of_best(worthwhile)
    rivals = _rivals(finalists, winner, movable, progress)
    indistinguishable = []
    runners_up = []
    for rival in rivals:
        is_alike = _is_indistinguishable(rival, winner)
        if rival in worthwhile and is_alike and not _generalizes(rival, winner):
            indistinguishable.append(rival)
        else:
            runners_up.append(rival)
    likeliest = _likeliest(winner, indistinguishable)
    alike = [candidate for candidate in (winner, *indistinguishable) if candidate is not likeliest]
    return SelectionStep(base, likeliest, tuple(alike), tuple(runners_up), rejected, inflation, failed)


def _all_rejected(base: LinearizedFit, screening: Screening, fits: FullFits) -> tuple[Candidate, ...]:
    """Records of all candidates that are no finalists: with those already judged, those that the screening rejects."""
    rejected = [*fits.rejected, *screening.failed, *fits.failed]
    judged = {(candidate.effect, candidate.target) for candidate in rejected}
    judged |= {probe_target(candidate.probe) for candidate in fits.finalists}
    for candidate in best_by_key(screening.screened).values():
        if probe_target(candidate.probe) not in judged:
            rejected.append(_rejected_by_screening(candidate, base, screening.inflation))
    return _reportable(rejected)


def _reportable(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Those of the candidates whose effects are answers of a diagnosis."""
    return tuple(candidate for candidate in candidates if is_reportable(candidate.effect))


def _simplest_of_best(worthwhile: Sequence[FittedCandidate]) -> FittedCandidate:
    """Simplest of the candidates that are as good as the best."""
    best = worthwhile[0]
    equals = [candidate for candidate in worthwhile if _is_as_good(candidate, best)]
    # an effect that can imitate another one is chosen only if that is not as good
    specific = [candidate for candidate in equals if not any(_generalizes(candidate, other) for other in equals)]
    return min(specific or equals, key=lambda candidate: (candidate.probe.complexity, -candidate.gain))


def _likeliest(winner: FittedCandidate, indistinguishable: Sequence[FittedCandidate]) -> FittedCandidate:
    """The winner, or in its place the common friction of the same joint, if the data cannot distinguish the two.

    Every joint has viscous and dry friction, and few have anything else that resembles it.
    """
    for candidate in (winner, *indistinguishable):
        kind = effect_types()[candidate.probe.effect]
        if candidate.probe.joint == winner.probe.joint and kind.is_friction and kind.is_commonplace:
            return candidate
    return winner


def _is_worth_adding(candidate: FittedCandidate, base: LinearizedFit, inflation: float, min_share: float) -> bool:
    """`is_worthwhile` of a candidate's gain."""
    probe = candidate.probe
    return is_worthwhile(candidate.gain, base, inflation, probe.joint is not None, probe.complexity, min_share)


def is_worthwhile(
    gain: float,
    base: LinearizedFit,
    inflation: float,
    on_joint: bool,
    parameter_count: int,
    min_share: float = MIN_SHARE,
) -> bool:
    """True if a gain is not due to chance, and large enough for an effect.

    Parameters
    ----------
    gain
        Gain of the effect.
    base
        The model without it.
    inflation
        Number of rows that are worth one independent row.
    on_joint
        True if it acts on a single joint.
    parameter_count
        Number of its parameters.
    min_share
        Share of the squared residual of its joints that it must explain.
    """
    min_gain = inflation * (MIN_SIGNIFICANCE**2 + _GAIN_PER_PARAMETER * (parameter_count - 1))
    joint_count = 1 if on_joint else base.joint_count
    return gain > min_gain and explained_share(gain, base, joint_count) > min_share


def _is_as_good(candidate: FittedCandidate, best: FittedCandidate) -> bool:
    """True if a candidate lacks little of the best gain, and no more than chance explains."""
    return best.gain - candidate.gain <= MAX_SIMPLER_LOSS * best.gain and not _gains_differ(candidate, best)


def _is_indistinguishable(a: FittedCandidate, b: FittedCandidate) -> bool:
    """True if two candidates' gains differ little and by no more than chance, or what they leave is nearly the same."""
    smaller, larger = sorted((a.cv_squared_error, b.cv_squared_error))
    is_same_residual = larger < _MAX_RESIDUAL_RATIO * smaller
    is_near = min(a.gain, b.gain) > _MIN_NEAR_GAIN_RATIO * max(a.gain, b.gain)
    return is_same_residual or (is_near and not _gains_differ(a, b))


def _rivals(
    finalists: Sequence[FittedCandidate], winner: FittedCandidate, movable: Sequence[int], progress: Progress
) -> list[FittedCandidate]:
    """Finalists that explain the same part of the residual as the winner: with it in the model, they gain far less."""
    others = [candidate for candidate in finalists if candidate is not winner and is_reportable(candidate.probe.effect)]
    if not others:
        return []
    probes = [candidate.probe for candidate in others]
    reference = with_nonlinear_parameters_free(winner.trial.linearized, movable, progress)
    with_winner = screen_probes(reference, probes, progress, "comparing candidates")
    rivals = []
    for candidate, rescreened in zip(others, with_winner, strict=True):
        if rescreened.gain < _MAX_RIVAL_GAIN_RATIO * candidate.screened.gain:
            rivals.append(candidate)
    return rivals


def _generalizes(a: FittedCandidate, b: FittedCandidate) -> bool:
    """True if the first candidate can imitate the second, and so never explains less by itself."""
    return a.probe.joint == b.probe.joint and b.probe.effect in effect_types()[a.probe.effect].generalizes


def _gains_differ(a: FittedCandidate, b: FittedCandidate) -> bool:
    """True if the gains of two candidates differ by more than chance, by the scatter of the difference over blocks."""
    difference = b.gains - a.gains
    return bool(abs(difference.sum()) > _MIN_DIFFERENCE_SIGNIFICANCE * sum_standard_error(difference))


def _rejected_by_screening(candidate: ScreenedProbe, base: LinearizedFit, inflation: float) -> Candidate:
    """Record of a candidate that the screening rejected."""
    share = explained_share(candidate.gain, base, _joint_count(candidate.probe, base))
    if not candidate.probe.is_feasible(candidate.c):
        reason = "its parameters have a sign or size that is physically impossible"
    elif candidate.entry is None:
        reason = "its parameters are out of range"
    elif candidate.gain < MIN_SIGNIFICANCE**2 * inflation:
        reason = "explains no more of the data not used for fitting than expected by chance"
    else:
        reason = f"explains {_percentage(min(share, 1.0))} % of the residual on its joint, less than another effect"
    return screened_record(candidate, base, reason)


def screened_record(candidate: ScreenedProbe, base: LinearizedFit, reason: str) -> Candidate:
    """Record of a candidate that was only screened."""
    probe = candidate.probe
    score, error = _scores(candidate.gain, candidate.standard_error, probe, base)
    return Candidate(probe.effect, probe.joint, probe.link, score, error, probe.complexity, reason)


def fitted_record(candidate: FittedCandidate, base: LinearizedFit) -> Candidate:
    """Record of a fitted candidate."""
    probe = candidate.probe
    score, error = _scores(candidate.gain, candidate.standard_error, probe, base)
    return Candidate(probe.effect, probe.joint, probe.link, score, error, probe.complexity)


def _scores(gain: float, standard_error: float, probe: Probe, base: LinearizedFit) -> tuple[float, float]:
    """Gain and its standard error as shares of the residual of the joints that a probe acts on, at most 1."""
    joint_count = _joint_count(probe, base)
    score = explained_share(gain, base, joint_count)
    error = explained_share(standard_error, base, joint_count)
    excess = max(score, 1.0)  # a gain can exceed the average joint's residual
    return score / excess, error / excess


def _joint_count(probe: Probe, base: LinearizedFit) -> int:
    """Number of joints that a probe acts on."""
    return 1 if probe.joint else base.joint_count


def _percentage(share: float) -> str:
    """A share as a percentage, without an exponent."""
    percentage = 100 * share
    return f"{percentage:.0f}" if percentage >= 10 else short_number(percentage, 2)

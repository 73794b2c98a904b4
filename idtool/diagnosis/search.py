"""Candidates compete: all are screened to first order, and the best are fitted whole; see `contest`."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.diagnosis.linearized_fit import LinearizedFit, held_out
from idtool.diagnosis.model_selection import (
    SURE,
    WORTH,
    FittedCandidate,
    Place,
    SelectionStep,
    chosen,
    is_answer,
    place_of,
    recorded,
    saved,
)
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import Found, screened
from idtool.diagnosis.survey import survey
from idtool.diagnosis.trial import FAILURES, Trial, is_fixed, reason_of, tried, value_of
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.probe import Probe
from idtool.estimation.dataset.experiment import Progress

_CONTENDERS = 7  # that are tried more finely
_FINALISTS = 5  # that are fitted whole
_NEAR = 0.4  # of the best gain that a finalist has at least
_WORSE = 1.01  # times the squared residual of held-out data
_HARMS = 0.2  # of what it saves, that an effect costs elsewhere
DETERMINED = 2.5  # standard errors that a shape value is at least from nothing
_MATTERS = 1e-4  # of the first squared residual of a joint, below which the names found so far are no better known
_SMALL = 3e-3  # of a joint's rms torque: what less is left is as good as none
_EDGE = 1.02  # of a range's end, within which a shape value is at it
_FINE = 7  # values between neighbours in a finer search


def searched(
    here: LinearizedFit,
    first: LinearizedFit,
    progress: Progress,
    effects: Sequence[str] | None,
    bursts: tuple[tuple[float, float], ...] = (),
    worth: float = WORTH,
    skipped: Container[Place] = (),
) -> SelectionStep:
    """Look for the effect that explains most of what a model leaves.

    Parameters
    ----------
    here
        The model.
    first
        The model without any of the effects found.
    progress
        Told the stage and how far it has come.
    effects
        Ids of those that may be; None: all.
    bursts
        Stretches of time in which the residual is out of the ordinary [s].
    worth
        Share of a joint's squared residual that an effect must explain.
    skipped
        What is not tried, by `place_of`.
    """
    probes = [probe for probe in _probes(here, effects, bursts) if place_of(probe) not in skipped]
    found = screened(here, probes, progress)
    inflation = _inflation(here, found)
    best = _best(found)
    contenders = sorted(best.values(), key=lambda one: -one.gain)[:_CONTENDERS]
    best |= _best(screened(here, list(_finer(contenders, found)), progress, "looking closer"), best)
    ranked = sorted(best.values(), key=lambda one: -one.gain)
    fitted: list[FittedCandidate] = []
    rejected: list[Candidate] = []
    failed: list[Candidate] = []
    for one in ranked[:_FINALISTS]:
        if one.gain < max([SURE**2 * inflation, *(_NEAR * other.found.gain for other in fitted)]):
            break
        try:
            own = _fitted(here, one, progress)
        except FAILURES as failure:
            failed.append(recorded(one, here, unfitted(failure)))
            continue
        if reason := _against(own, here, first):
            rejected.append(recorded(one, here, reason))
        else:
            fitted.append(own)
    fitted.sort(key=lambda one: -one.gain)
    choice = chosen(here, fitted, [*rejected, *failed], found, inflation, progress, worth)
    return replace(choice, failed=tuple(one for one in failed if is_answer(one.effect)))


def assumed(
    here: LinearizedFit, progress: Progress, effect: str, on: str | None, bursts: tuple[tuple[float, float], ...] = ()
) -> SelectionStep:
    """An effect where it can be at all, and there where it explains most, whatever it explains.

    Parameters
    ----------
    here
        The model.
    progress
        Told the stage and how far it has come.
    effect
        Its id.
    on
        The joint or link; None: any.
    bursts
        Stretches of time in which the residual is out of the ordinary [s].
    """
    probes = [probe for probe in _probes(here, (effect,), bursts) if on is None or probe.subject[1] == on]
    found = screened(here, probes, progress)
    winner = None
    for one in sorted(found, key=lambda one: (not one.allowed, -one.gain)):
        try:
            winner = _fitted(here, one, progress)
        except FAILURES:
            continue
        break
    return SelectionStep(here, winner, (), (), (), _inflation(here, found))


def _probes(here: LinearizedFit, effects: Sequence[str] | None, bursts: tuple[tuple[float, float], ...]) -> list[Probe]:
    """All hypotheses."""
    seen = survey(here, bursts, is_fixed(here.experiment))
    kinds = {id: kind for id, kind in effect_types().items() if effects is None or id in effects or not kind.reportable}
    probes = [probe for kind in kinds.values() for probe in kind.probes(seen)]
    return [
        probe for probe in probes if not _waits(probe, [x for x in kinds[probe.effect].requires if x in kinds], seen)
    ]


def _waits(probe: Probe, upon: Sequence[str], seen: DataSummary) -> bool:
    """Whether an effect is a change of others, none of which is there, though they may be."""
    return bool(upon) and not any(seen.has_effect(effect, probe.subject[1]) for effect in upon)


def _inflation(here: LinearizedFit, found: Iterable[Found]) -> float:
    """The median over all that was tried, at least that of white noise through the filter."""
    redundancy = here.experiment.runs[0].signals.low_pass.redundancy
    seen = [one.inflation for one in found if np.isfinite(one.inflation) and one.inflation > 0]
    return float(max(np.median(seen), redundancy)) if seen else redundancy


def _best(
    found: Iterable[Found], so_far: Mapping[tuple[str, ...], Found] | None = None
) -> dict[tuple[str, ...], Found]:
    """The best by effect and place, of those that physics allows."""
    best = dict(so_far or {})
    for one in found:
        if one.allowed and one.gain > 0:
            place = place_of(one.probe)
            if place not in best or one.gain > best[place].gain:
                best[place] = one
    return best


def _finer(contenders: Sequence[Found], found: Sequence[Found]) -> Iterable[Probe]:
    """Shape values between the neighbours of the best."""
    for one in contenders:
        joints = effect_types()[one.probe.effect].joint_parameters()
        for name in (n for n in one.probe.nonlinear_values if n not in joints):
            values = sorted({f.probe.nonlinear_values[name] for f in found if place_of(f.probe) == place_of(one.probe)})
            if len(values) == 1:
                continue
            at = values.index(one.probe.nonlinear_values[name])
            low, high = values[max(at - 1, 0)], values[min(at + 1, len(values) - 1)]
            for value in np.linspace(low, high, _FINE + 2)[1:-1]:
                yield one.probe.at({**one.probe.nonlinear_values, name: float(value)})


def _fitted(here: LinearizedFit, one: Found, progress: Progress) -> FittedCandidate:
    """A candidate in the model; raises as `tried`, and where no such effect can be."""
    if one.entry is None:
        raise ConfigError("effects", "it is beyond what such an effect can be")
    entries = (*here.experiment.config.effects, one.entry)
    trial = tried(here, entries, [len(entries) - 1], progress)
    return FittedCandidate(one, trial, saved(here, trial.linearized))


def unfitted(failure: Exception) -> str:
    """Why a candidate lost that cannot be fitted."""
    return f"cannot be fitted together with the rest of the model: {reason_of(failure)}"


def _against(one: FittedCandidate, here: LinearizedFit, first: LinearizedFit) -> str:
    """Why what was fitted is no explanation; nothing where it may be one."""
    if not _stands(one.trial, here):
        return "is held at its bound, or beyond what it can be, the rest of the model being fitted with it"
    if loose := _loose(one.trial):
        return f"its {loose} is not determined by the data"
    if -np.minimum(one.gains, 0).sum() > _HARMS * np.maximum(one.gains, 0).sum():
        return "helps in some stretches of the log and harms in others"
    own, joint = one.trial.linearized.experiment.equation, one.found.probe.joint
    on = [joint is None or name == joint for name in own.joints]
    if held_out(one.trial.linearized, own)[on].sum() > _WORSE * held_out(here, own)[on].sum():  # none where nothing was
        return "makes the held-out data worse"
    if not _matters(one.trial.linearized, here, first):
        return "explains less than what was found before is uncertain by, or next to nothing of the torque"
    return ""


def _loose(trial: Trial) -> str:
    """The first shape value of the newest effect that is no larger than its error, or at the end of its range."""
    last = len(trial.entries) - 1
    entry = trial.entries[last]
    for held in effect_types()[entry.effect].nonlinear_parameters:
        error, value = trial.errors.get((last, held.name)), value_of(entry, held.name)
        if error is None or not isinstance(value, float) or held.optional_maximum is not None:
            continue
        most = held.max_standard_error
        if most is None:
            most = value / DETERMINED if held.positive else np.inf
        low, high = trial.ranges.get((last, held.name), (-np.inf, np.inf))
        if held.open_ended:
            most = high = np.inf
        if not (error < most and low * _EDGE < value < high / _EDGE):
            return held.name
    return ""


def _stands(trial: Trial, here: LinearizedFit) -> bool:
    """Whether, fitted whole, a coefficient of the effect is within its bounds, and not held there."""
    keys = {c.key for c in here.experiment.equation.coefficients}
    equation, theta = trial.linearized.experiment.equation, trial.linearized.estimate.theta
    new = [(c, x) for c, x in zip(equation.coefficients, theta, strict=True) if c.key not in keys]
    return not new or (any(x > c.lower + 1e-9 for c, x in new) and all(x < c.upper for c, x in new))


def _matters(there: LinearizedFit, here: LinearizedFit, first: LinearizedFit) -> bool:
    """Whether on some joint a model saves more than a small share of what there was to explain at first.

    A strong effect that is known to a hundredth leaves a hundredth of itself, which is no effect of its own.
    """
    saves = (here.s - there.s).sum(axis=0) * np.square(here.noise)
    least = _MATTERS * first.s.sum(axis=0) * np.square(first.noise)
    return bool((saves > np.maximum(least, here.rows.sum(axis=0) * np.square(_SMALL * here.size))).any())

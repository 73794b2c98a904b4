"""Candidates compete: all are screened to first order, the best are fitted whole, and one is chosen, or none.

A gain counts in squared residual on blocks of time that were not fitted to, in units of the noise. Rows repeat each
other, so it takes ``inflation`` times more of it than of independent rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.diagnosis.ground import Ground, held_out
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import Found, screened
from idtool.diagnosis.survey import survey
from idtool.diagnosis.trial import Trial, is_fixed, tried, value_of
from idtool.effects import known_effects
from idtool.effects.probe import Probe
from idtool.experiment import Progress

Array = NDArray[np.float64]

SURE = 5.0  # standard errors of noise that a gain must be worth: some thousand candidates compete
_EACH = 4.0  # more for each further parameter
WORTH = 0.05  # of the squared residual of a joint that an effect must explain
_CONTENDERS = 7  # that are tried more finely
_FINALISTS = 5  # that are fitted whole
_NEAR = 0.4  # of the best gain that a finalist has at least
_EQUAL = 2.0  # standard errors within which two gains are the same
_AS_GOOD = 0.03  # of the best gain that a simpler explanation may lack
_WORSE = 1.01  # times the squared residual of held-out data
_HARMS = 0.5  # of what it saves, that an effect costs elsewhere
_DETERMINED = 2.5  # standard errors that a shape value is at least from nothing
_FREE = ("time_constant",)  # a change that has only begun has any
_GONE = 0.5  # of what a rival explained before, that it may explain with the winner there
_NEARLY = 0.8  # of the better gain, that one which chance may tell from it has
_SAME = 1.1  # of the squared residual that the better of two leaves
_FINE = 7  # values between neighbours in a finer search


@dataclass(frozen=True)
class Contender:
    """An effect that was fitted whole.

    Attributes
    ----------
    found
        What the screening said.
    trial
        The model with it.
    gains
        What it saves of each block's squared residual, shape (F,).
    """

    found: Found
    trial: Trial
    gains: Array

    @property
    def gain(self) -> float:
        """Over all blocks."""
        return float(self.gains.sum())


@dataclass(frozen=True)
class Choice:
    """The outcome of one round.

    Attributes
    ----------
    here
        The model that it was about.
    winner
        None: nothing pays.
    equals
        What the data cannot tell from it, the best first.
    others
        The other finalists.
    lost
        Why each effect that was tried lost.
    inflation
        How many rows are worth one independent one.
    """

    here: Ground
    winner: Contender | None
    equals: tuple[Contender, ...]
    others: tuple[Contender, ...]
    lost: tuple[Candidate, ...]
    inflation: float

    def alternatives(self) -> Iterator[Candidate]:
        """What came near, the best first."""
        for one in (*self.equals, *self.others):
            yield candidate(one, self.here)


def searched(
    here: Ground,
    progress: Progress,
    effects: Sequence[str] | None,
    bursts: tuple[tuple[float, float], ...] = (),
    on: str | None = None,
    forced: bool = False,
) -> Choice:
    """Look for the effect that explains most of what a model leaves.

    Parameters
    ----------
    here
        The model.
    progress
        Told the stage and how far it has come.
    effects
        Ids of those that may be; None: all.
    bursts
        Stretches of time in which the residual is out of the ordinary [s].
    on
        The joint or link; None: any.
    forced
        Whether the best is taken even where it does not pay.
    """
    seen = survey(here, bursts, is_fixed(here.experiment))
    kinds = [kind for name, kind in known_effects().items() if effects is None or name in effects]
    probes = [probe for kind in kinds for probe in kind.probes(seen)]
    probes = [probe for probe in probes if on is None or probe.on[1] == on]
    found = screened(here, probes, progress)
    inflation = _inflation(here, found)
    best = _best(found)
    contenders = sorted(best.values(), key=lambda one: -one.gain)[:_CONTENDERS]
    best |= _best(screened(here, list(_finer(contenders, found)), progress, "looking closer"), best)
    if forced:
        return Choice(here, _forced(here, found, progress), (), (), (), inflation)
    ranked = sorted(best.values(), key=lambda one: -one.gain)
    least = max(_NEAR * ranked[0].gain if ranked else 0.0, SURE**2 * inflation)
    finalists = [one for one in ranked if one.gain >= least][:_FINALISTS]
    fitted, failed = [], []
    for one in finalists:
        own, reason = _fitted(here, one, progress)
        if own is not None:
            fitted.append(own)
        else:
            failed.append(_record(one, here, reason))
    fitted.sort(key=lambda one: -one.gain)
    return _chosen(here, fitted, failed, found, inflation, progress)


def _forced(here: Ground, found: Iterable[Found], progress: Progress) -> Contender | None:
    """The best of those that can be at all, whatever it explains."""
    for one in sorted(found, key=lambda one: (not one.allowed, -one.gain)):
        if one.entry is not None:
            entries = (*here.experiment.config.effects, one.entry)
            trial = tried(here, entries, [len(entries) - 1], progress)
            if trial is not None:
                return Contender(one, trial, saved(here, trial.ground))
    return None


def _inflation(here: Ground, found: Iterable[Found]) -> float:
    """The median over all that was tried, at least that of white noise through the filter."""
    redundancy = here.experiment.runs[0].signals.low_pass.redundancy
    seen = [one.inflation for one in found if np.isfinite(one.inflation) and one.inflation > 0]
    return float(max(np.median(seen), redundancy)) if seen else redundancy


def _place(probe: Probe) -> tuple[str, ...]:
    """What an effect is on; other sources are other effects."""
    return (*probe.on, *(f"{probe.shape[name]:g}" for name in ("source",) if name in probe.shape))


def _best(
    found: Iterable[Found], so_far: Mapping[tuple[str, ...], Found] | None = None
) -> dict[tuple[str, ...], Found]:
    """The best by effect and place, of those that physics allows."""
    best = dict(so_far or {})
    for one in found:
        if one.allowed and one.gain > 0:
            place = _place(one.probe)
            if place not in best or one.gain > best[place].gain:
                best[place] = one
    return best


def _finer(contenders: Sequence[Found], found: Sequence[Found]) -> Iterable[Probe]:
    """Shape values between the neighbours of the best."""
    for one in contenders:
        for name in (n for n in one.probe.shape if n not in ("source",)):
            values = sorted({f.probe.shape[name] for f in found if _place(f.probe) == _place(one.probe)})
            at = values.index(one.probe.shape[name])
            low, high = values[max(at - 1, 0)], values[min(at + 1, len(values) - 1)]
            for value in np.linspace(low, high, _FINE + 2)[1:-1]:
                yield one.probe.at({**one.probe.shape, name: float(value)})


def _fitted(here: Ground, one: Found, progress: Progress) -> tuple[Contender | None, str]:
    """A candidate in the model; None where it is no explanation, and why."""
    entry = one.entry
    if entry is None:
        return None, "comes out beyond what such an effect can be"
    entries = (*here.experiment.config.effects, entry)
    trial = tried(here, entries, [len(entries) - 1], progress)
    if trial is None:
        return None, "cannot be fitted together with the rest of the model"
    if not _stands(trial, here):
        return None, "is held at its bound, the rest of the model being fitted with it"
    if loose := _loose(trial):
        return None, f"its {loose} is not determined by the data"
    own = trial.ground.experiment.equation
    worse = held_out(trial.ground, own).sum() > _WORSE * held_out(here, own).sum()
    gains = saved(here, trial.ground)
    if -np.minimum(gains, 0).sum() > _HARMS * np.maximum(gains, 0).sum():
        return None, "helps in some stretches of the log and harms in others"
    if worse:  # and not where nothing was held out
        return None, "makes the held-out data worse"
    return Contender(one, trial, gains), ""


def _loose(trial: Trial) -> str:
    """The first shape value of the newest effect that is no larger than what it may be off by."""
    last = len(trial.entries) - 1
    entry = trial.entries[last]
    for held in getattr(known_effects()[entry.effect], "held", ()):
        error = trial.errors.get((last, held.name))
        value = value_of(entry, held.name)
        if error is None or not isinstance(value, float) or held.name in _FREE:
            continue
        most = held.error if held.error is not None else value / _DETERMINED if held.positive else np.inf
        if not error < most:
            return str(held.name)
    return ""


def _stands(trial: Trial, here: Ground) -> bool:
    """Whether, fitted whole, a coefficient of the effect is not held at its bound."""
    keys = {c.key for c in here.experiment.equation.coefficients}
    equation, theta = trial.ground.experiment.equation, trial.ground.estimate.theta
    new = [(c, x) for c, x in zip(equation.coefficients, theta, strict=True) if c.key not in keys]
    return not new or any(x > c.lower + 1e-9 for c, x in new)


def saved(before: Ground, after: Ground) -> Array:
    """What a model saves of another's squared residual on each block, shape (F,); both of the same rows."""
    return np.asarray(before.left() - after.left())


def share(gain: float, here: Ground, joints: int) -> float:
    """A gain as a share of the squared residual of so many joints."""
    return float(gain / here.left().sum() * here.s.shape[1] / joints)


def _chosen(
    here: Ground,
    fitted: Sequence[Contender],
    failed: Sequence[Candidate],
    found: Sequence[Found],
    inflation: float,
    progress: Progress,
) -> Choice:
    worthy = [one for one in fitted if _pays(one, here, inflation)]
    known = {(one.effect, one.on) for one in failed} | {_named(one.found.probe) for one in fitted}
    screened_out = [one for one in _best_of_all(found).values() if _named(one.probe) not in known]
    lost = (*failed, *(_lost(one, here, inflation) for one in screened_out))
    if not worthy:
        return Choice(here, None, (), tuple(fitted), lost, inflation)
    top = worthy[0]
    equals = [one for one in worthy if _as_good(one, top)]
    equals = [one for one in equals if not any(_contains(one, other) for other in equals)] or equals
    winner = min(equals, key=lambda one: (one.found.probe.parameters, -one.gain))
    rivals = _rivals([one for one in fitted if one is not winner], winner, progress)
    alike = [one for one in rivals if one in worthy and _alike(one, winner) and not _contains(one, winner)]
    others = tuple(one for one in rivals if one not in alike)
    return Choice(here, winner, tuple(alike), others, lost, inflation)


def _pays(one: Contender, here: Ground, inflation: float) -> bool:
    probe = one.found.probe
    return worthwhile(one.gain, here, inflation, probe.joint is not None, probe.parameters)


def worthwhile(gain: float, here: Ground, inflation: float, on_joint: bool, parameters: int) -> bool:
    """Whether a gain is no chance, and large enough to have an effect for it."""
    least = inflation * (SURE**2 + _EACH * (parameters - 1))
    return gain > least and share(gain, here, 1 if on_joint else here.s.shape[1]) > WORTH


def _as_good(one: Contender, top: Contender) -> bool:
    """Whether a contender is as good as the best but for what chance explains."""
    return top.gain - one.gain <= _AS_GOOD * top.gain and not _apart(one, top)


def _alike(one: Contender, other: Contender) -> bool:
    """Whether the data do not tell two contenders apart, by chance or since both leave as good as the same."""
    left = sorted(float(x.trial.ground.left().sum()) for x in (one, other))
    near = min(one.gain, other.gain) > _NEARLY * max(one.gain, other.gain)
    return (near and not _apart(one, other)) or left[1] < _SAME * left[0]


def _rivals(others: Sequence[Contender], winner: Contender, progress: Progress) -> list[Contender]:
    """Those that explain the same: with the winner in the model, most of what they explained is gone."""
    if not others:
        return []
    again = screened(winner.trial.ground, [one.found.probe for one in others], progress, "comparing explanations")
    return [one for one, now in zip(others, again, strict=True) if now.gain < _GONE * one.found.gain]


def _contains(one: Contender, other: Contender) -> bool:
    """Whether one can take the place of the other, and so explains no less by itself."""
    a, b = one.found.probe, other.found.probe
    return a.joint == b.joint and b.effect in known_effects()[a.effect].contains


def _apart(one: Contender, other: Contender) -> bool:
    difference = other.gains - one.gains
    error = np.sqrt(len(difference)) * difference.std(ddof=1)
    return bool(abs(difference.sum()) > _EQUAL * error)


def _best_of_all(found: Iterable[Found]) -> dict[tuple[str, ...], Found]:
    best: dict[tuple[str, ...], Found] = {}
    for one in found:
        place = _place(one.probe)
        if place not in best or one.gain > best[place].gain:
            best[place] = one
    return best


def _lost(one: Found, here: Ground, inflation: float) -> Candidate:
    """Why a candidate did not come further, as far as the screening tells."""
    probe = one.probe
    part = share(one.gain, here, 1 if probe.joint else here.s.shape[1])
    if not probe.allowed(one.c):
        reason = "comes out with a sign or size that physics does not allow"
    elif one.entry is None:
        reason = "comes out beyond what such an effect can be"
    elif one.gain < SURE**2 * inflation:
        reason = "explains no more of data it was not fitted to than chance would"
    else:
        reason = f"explains {100 * part:.2g} % of what is left on its joint, less than another"
    return _record(one, here, reason)


def _named(probe: Probe) -> tuple[str, str]:
    return probe.effect, probe.joint or probe.link or "all joints"


def _record(one: Found, here: Ground, reason: str) -> Candidate:
    """A candidate that was only screened, for the record."""
    probe = one.probe
    score, error = _scores(one.gain, one.standard_error, probe, here)
    return Candidate(probe.effect, probe.joint, probe.link, score, error, probe.parameters, reason)


def _scores(gain: float, error: float, probe: Probe, here: Ground) -> tuple[float, float]:
    """A gain and its standard error as shares of what is left of the joints that it reaches, 1 at the most."""
    joints = 1 if probe.joint else here.s.shape[1]
    parts = share(gain, here, joints), share(error, here, joints)
    most = max(parts[0], 1.0)
    return parts[0] / most, parts[1] / most


def candidate(one: Contender, here: Ground) -> Candidate:
    """A contender for the record."""
    probe = one.found.probe
    error = float(np.sqrt(len(one.gains)) * one.gains.std(ddof=1))
    score, error = _scores(one.gain, error, probe, here)
    return Candidate(probe.effect, probe.joint, probe.link, score, error, probe.parameters)

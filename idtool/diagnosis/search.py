"""Candidates compete: all are screened to first order, the best are fitted whole, and one is chosen, or none.

A gain counts in squared residual on blocks of time that were not fitted to, in units of the noise. Rows repeat each
other, so it takes ``inflation`` times more of it than of independent rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from idtool.config import EffectEntry
from idtool.diagnosis.ground import Ground
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import Found, screened
from idtool.diagnosis.survey import survey
from idtool.diagnosis.trial import Trial, tried
from idtool.effects import known_effects
from idtool.effects.probe import Probe
from idtool.experiment import Progress

Array = NDArray[np.float64]

SURE = 5.0  # standard errors of noise that a gain must be worth: some thousand candidates compete
WORTH = 0.01  # of the squared residual of a joint that an effect must explain
_CONTENDERS = 7  # that are tried more finely
_FINALISTS = 5  # that are fitted whole
_NEAR = 0.4  # of the best gain that a finalist has at least
_EQUAL = 2.0  # standard errors within which two gains are the same
_AS_GOOD = 0.03  # of the best gain that a simpler explanation may lack
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

    winner: Contender | None
    equals: tuple[Contender, ...]
    others: tuple[Contender, ...]
    lost: tuple[Candidate, ...]
    inflation: float


def searched(
    here: Ground, progress: Progress, effects: Sequence[str] | None, bursts: tuple[tuple[float, float], ...] = ()
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
    """
    seen = survey(here, bursts)
    kinds = [kind for name, kind in known_effects().items() if effects is None or name in effects]
    probes = [probe for kind in kinds for probe in kind.probes(seen)]
    found = screened(here, probes, progress)
    inflation = _inflation(here, found)
    best = _best(found)
    contenders = sorted(best.values(), key=lambda one: -one.gain)[:_CONTENDERS]
    best |= _best(screened(here, list(_finer(contenders, found)), progress, "looking closer"), best)
    ranked = sorted(best.values(), key=lambda one: -one.gain)
    most = ranked[0].gain if ranked else 0.0
    least = max(_NEAR * most, SURE**2 * inflation)
    finalists = [one for one in ranked if one.gain >= least][:_FINALISTS]
    fitted = [own for one in finalists if (own := _fitted(here, one, progress)) is not None]
    fitted.sort(key=lambda one: -one.gain)
    return _chosen(here, fitted, found, inflation)


def _inflation(here: Ground, found: Iterable[Found]) -> float:
    """The median over all that was tried, at least that of white noise through the filter."""
    redundancy = here.experiment.runs[0].signals.low_pass.redundancy
    seen = [one.inflation for one in found if np.isfinite(one.inflation) and one.inflation > 0]
    return float(max(np.median(seen), redundancy)) if seen else redundancy


def _place(probe: Probe) -> tuple[str, ...]:
    """What an effect is on; other sources are other effects."""
    return (*probe.on, *(f"{probe.shape[name]:g}" for name in ("source",) if name in probe.shape))


def _best(found: Iterable[Found], so_far: Mapping[tuple[str, ...], Found] | None = None) -> dict[tuple[str, ...], Found]:
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


def _fitted(here: Ground, one: Found, progress: Progress) -> Contender | None:
    """A candidate in the model."""
    entry = one.entry
    if entry is None:
        return None
    entries = (*here.experiment.config.effects, entry)
    trial = tried(here, entries, [len(entries) - 1], progress)
    if trial is None or not _stands(trial, entry, here):
        return None
    return Contender(one, trial, saved(here, trial.ground))


def _stands(trial: Trial, entry: EffectEntry, here: Ground) -> bool:
    """Whether, fitted whole, a coefficient of the effect is not held at its bound."""
    keys = {c.key for c in here.experiment.equation.coefficients}
    equation, theta = trial.ground.experiment.equation, trial.ground.estimate.theta
    new = [(c, x) for c, x in zip(equation.coefficients, theta, strict=True) if c.key not in keys]
    return not new or any(x > c.lower + 1e-9 for c, x in new)


def saved(before: Ground, after: Ground) -> Array:
    """What a model saves of another's squared residual on each block, shape (F,), for as many rows."""
    rows = before.rows.sum(axis=1) / np.maximum(after.rows.sum(axis=1), 1)
    return np.asarray(before.left() - rows * after.left())


def share(gain: float, here: Ground, joints: int) -> float:
    """A gain as a share of the squared residual of so many joints."""
    return gain / float(here.left().sum()) * here.s.shape[1] / joints


def _chosen(here: Ground, fitted: Sequence[Contender], found: Sequence[Found], inflation: float) -> Choice:
    worthy = [one for one in fitted if _pays(one, here, inflation)]
    lost = tuple(_lost(one, here, inflation) for one in _best_of_all(found).values())
    if not worthy:
        return Choice(None, (), tuple(fitted), lost, inflation)
    top = worthy[0]
    equals = [one for one in worthy if _as_good(one, top)]
    winner = min(equals, key=lambda one: (one.found.probe.parameters, -one.gain))
    alike = [one for one in worthy if one is not winner and _alike(one, winner)]
    others = tuple(one for one in fitted if one is not winner and one not in alike)
    return Choice(winner, tuple(alike), others, lost, inflation)


def _pays(one: Contender, here: Ground, inflation: float) -> bool:
    joints = 1 if one.found.probe.joint else here.s.shape[1]
    return one.gain > SURE**2 * inflation and share(one.gain, here, joints) > WORTH


def _as_good(one: Contender, top: Contender) -> bool:
    """Whether a contender is as good as the best but for what chance explains."""
    return top.gain - one.gain <= _AS_GOOD * top.gain and not _apart(one, top)


def _alike(one: Contender, other: Contender) -> bool:
    return not _apart(one, other) and min(one.gain, other.gain) > 0.8 * max(one.gain, other.gain)


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
    error = share(one.standard_error, here, 1 if probe.joint else here.s.shape[1])
    return Candidate(probe.effect, probe.joint, probe.link, part, error, probe.parameters, reason)


def candidate(one: Contender, here: Ground, reason: str = "") -> Candidate:
    """A contender for the record."""
    probe, joints = one.found.probe, 1 if one.found.probe.joint else here.s.shape[1]
    error = float(np.sqrt(len(one.gains)) * one.gains.std(ddof=1))
    scores = share(one.gain, here, joints), share(error, here, joints)
    return replace(Candidate(probe.effect, probe.joint, probe.link, *scores, probe.parameters), reason=reason)

"""Round after round: the effect that pays most is added, all is fitted anew, and what no longer pays is taken out.

Torque that is held over a sample is recorded half of one early, and every log is off by as much in one way or another.
So a delay of all joints within a sample is fitted along, without a name: left in, it looks like a soft joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.localization import bursts
from idtool.diagnosis.model_selection import (
    WORTH,
    FittedCandidate,
    Place,
    SelectionStep,
    candidate,
    is_answer,
    place_of,
    saved,
    worthwhile,
)
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.search import DETERMINED, assumed, searched, unfitted
from idtool.diagnosis.trial import FAILURES, Key, tried, with_effects
from idtool.diagnosis.words import superseded
from idtool.dynamics.effects import effect_types
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry

APART = 0.04  # s from reversals
_MORE = 4.0  # times the information, that a joint must show away from reversals: standard errors are halved
_LESS = 0.5  # times the information, that every joint must keep
_MOST = 0.5  # of the squared residual with that around reversals, that an effect must explain to have its place there
_POLISHES = 3  # steps of all shape values after an effect was added


@dataclass
class Added:
    """An effect in the model, with what spoke for it.

    Attributes
    ----------
    entry
        As a configuration has it.
    choice
        The round that chose it.
    chosen
        It, for the record.
    errors
        Standard errors of its shape values, by name.
    """

    entry: EffectEntry
    choice: SelectionStep
    chosen: Candidate
    errors: dict[str, float] = field(default_factory=dict)


class Search:
    """Adds effects, and takes out those that later ones have made superfluous.

    Attributes
    ----------
    here
        The model so far.
    added
        The effects found, in their order.
    removed
        What was taken out again, a plain sentence each.
    last
        The round that found nothing more.
    rounded
        Joints whose friction is another around reversals, which were left aside in the end.
    failed
        By effect and what it acts on, why the model could not be fitted with it.

    Parameters
    ----------
    experiment
        Model and data.
    effects
        Ids of the effects that may be; None: all.
    most
        How many are added at the most.
    progress
        Told the stage and how far it has come.
    """

    def __init__(self, experiment: Experiment, effects: Sequence[str] | None, most: int, progress: Progress) -> None:
        self._effects, self._most, self.progress = effects, most, progress
        self.added: list[Added] = []
        self.removed: list[str] = []
        self.last: SelectionStep | None = None
        self.rounded: tuple[str, ...] = ()
        self.failed: dict[tuple[str, str], str] = {}
        self._skipped: set[Place] = set()
        self._plain = experiment.config.effects
        self._dt = max(run.signals.log.dt for run in experiment.runs)
        self._within: tuple[EffectEntry, ...] = ()
        self.here = linearize_fit(experiment, progress)
        self._settled([])
        self.first = self.here

    @property
    def _given(self) -> tuple[EffectEntry, ...]:
        """What was there before anything was found."""
        return (*self._plain, *self._within)

    @property
    def named(self) -> list[Added]:
        """The effects found that are an answer, in their order."""
        return [one for one in self.added if is_answer(one.entry.effect)]

    def assume(self, effect: str, on: str | None) -> None:
        """Add an effect whatever it explains.

        Raises
        ------
        ConfigError
            If it cannot be there.
        """
        choice = assumed(self.here, self.progress, effect, on, self._bursts())
        if choice.winner is None or self._add(choice, choice.winner):
            what = f"{effect}:{on or 'any joint'} cannot be there"
            raise ConfigError("--assume", f"{what}; leave it out, or name another joint")

    def run(self) -> None:
        """Add what pays, until nothing more does; where it is quieter away from reversals, there.

        Around a reversal no robot's friction is as a law with a sign has it, nor a simulator's that rounds it off. What
        that leaves must not hide what is smaller, nor count as unknown; and what has its place there, such as Stribeck
        friction, has a name only where it explains most of it.
        """
        if self._quieter():
            self._apart(APART)
            self._rounds()
            self._apart(0.0)
            self._rounds(_MOST)
        else:
            self._rounds()
        self.rounded = self._quieter()
        if self.rounded:
            self._apart(APART)
            self._rounds()
        self._trim()

    def _apart(self, apart: float) -> None:
        """Look at rows so far from reversals [s]."""
        self.here = linearize_fit(self.here.experiment, self.progress, apart=apart)
        self._settled([one.entry for one in self.added])

    def _quieter(self) -> tuple[str, ...]:
        """Joints of which the rows away from reversals tell far more; none where those of another tell less."""
        try:
            away = linearize_fit(self.here.experiment, self.progress, apart=APART)
        except FAILURES:
            return ()
        told, told_away = (one.rows.sum(axis=0) / np.square(one.noise) for one in (self.here, away))
        if (told_away < _LESS * told).any():
            return ()
        return tuple(np.array(away.experiment.equation.joints)[told_away > _MORE * told].tolist())

    def _rounds(self, worth: float = WORTH) -> None:
        seen: set[frozenset[tuple[str, str | None]]] = set()
        while len(self.named) < self._most:
            effects = self._effects if worth == WORTH else self._turning()
            found = searched(self.here, self.first, self.progress, effects, self._bursts(), worth, self._skipped)
            self.last = found
            self.failed |= {(one.effect, one.on): one.reason for one in found.failed}
            if found.winner is None:
                break
            if failure := self._add(found, found.winner):
                self._skip(found.winner, failure)
                continue
            self._prune()
            state = frozenset((one.chosen.effect, one.chosen.on) for one in self.added)
            if state in seen:
                break
            seen.add(state)

    def _turning(self) -> tuple[str, ...]:
        """Ids of the effects that may be and have their place around reversals."""
        own = [name for name, kind in effect_types().items() if kind.is_friction or kind.acts_at_reversals]
        return tuple(name for name in own if self._effects is None or name in self._effects)

    def _bursts(self) -> tuple[tuple[float, float], ...]:
        if any(effect_types()[one.chosen.effect].acts_in_bursts for one in self.added):
            return ()
        return bursts(self.here.experiment, self.here.estimate.theta, self.progress)

    def _add(self, choice: SelectionStep, winner: FittedCandidate) -> Exception | None:
        """Add an effect; why it could not be, if so."""
        self.added.append(Added(winner.trial.entries[-1], choice, candidate(winner, self.here)))
        failure = self._settled([one.entry for one in self.added])
        if failure:
            self.added.pop()
        return failure

    def _skip(self, one: FittedCandidate, failure: Exception) -> None:
        """Try a candidate no more."""
        self._skipped.add(place_of(one.found.probe))
        chosen = candidate(one, self.here)
        self.failed[chosen.effect, chosen.on] = unfitted(failure)

    def leave_out(self, one: Added, failure: Exception) -> None:
        """Take out an effect with which the whole model cannot be fitted."""
        self.added = [other for other in self.added if other is not one]
        self.failed[one.chosen.effect, one.chosen.on] = unfitted(failure)
        self._settled([other.entry for other in self.added])

    def _settled(self, added: Sequence[EffectEntry]) -> Exception | None:
        """`_settle`, or leave all as it was and give the reason."""
        before = self.here, self._within
        try:
            self._settle(added)
        except FAILURES as failure:
            self.here, self._within = before
            return failure
        return None

    def _settle(self, added: Sequence[EffectEntry]) -> None:
        """Fit all anew, shape values together, the joints weighed by what is left now."""
        background = _background([*self._plain, *added])
        errors: Mapping[Key, float] = {}
        for within in (self._within or background, ()) if background else ((),):
            errors = self._fitted([*within, *added])
            self._within = self.here.experiment.config.effects[len(self._plain) :][: len(within)]
            if all(effect_types()[one.effect].is_background(one, self._dt) for one in self._within):
                break  # more of it is to be named
        first = len(self._given)
        found = self.here.experiment.config.effects[first:]
        for i, (one, entry) in enumerate(zip(self.added, found, strict=True)):
            one.entry = entry
            one.errors = {name: x for (k, name), x in errors.items() if k == first + i}

    def _fitted(self, entries: Sequence[EffectEntry]) -> Mapping[Key, float]:
        """Fit with other effects beside those of the configuration; standard errors of their shape values."""
        first = len(self._plain)
        experiment = with_effects(self.here.experiment, [*self._plain, *entries], self.here.theta)
        self.here = linearize_fit(experiment, self.progress, apart=self.here.apart)
        moving = range(first, first + len(entries))
        if not entries:
            return {}
        trial = tried(self.here, experiment.config.effects, moving, self.progress, _POLISHES)
        self.here = trial.linearized
        return trial.errors

    def _prune(self) -> None:
        """Take out what no longer pays."""
        i = 0
        while len(self.added) > 1 and i < len(self.added) - 1:
            others = [one.entry for k, one in enumerate(self.added) if k != i]
            if self._needed(self.added[i], [*self._given, *others]):
                i += 1
                continue
            out = self.added.pop(i)
            if self._settled(others):  # the rest cannot be fitted without it
                self.added.insert(i, out)
                i += 1
                continue
            if is_answer(out.chosen.effect):
                self.removed.append(superseded(out.chosen, self.added[-1].chosen))

    def _trim(self) -> None:
        """Leave out what an effect need not have and the data do not tell."""
        entries = [_trimmed(one) for one in self.added]
        if any(entry is not one.entry for entry, one in zip(entries, self.added, strict=True)):
            self._settled(entries)

    def _needed(self, one: Added, others: Sequence[EffectEntry]) -> bool:
        """Whether an effect still pays beside the others, on the rows that they know."""
        now, theta = self.here, self.here.theta
        try:
            if now.apart != one.choice.here.apart:
                now = linearize_fit(now.experiment, self.progress, apart=one.choice.here.apart)
            without = linearize_fit(with_effects(now.experiment, others, theta), self.progress, now, own_rows=True)
            here = linearize_fit(now.experiment, self.progress, without)
        except FAILURES:  # nothing speaks against it
            return True
        gain, of = float(saved(without, here).sum()), one.chosen
        return worthwhile(gain, without, one.choice.inflation, of.joint is not None, of.parameters)

    def entries(self, count: int) -> list[EffectEntry]:
        """The configuration's effects with the first found, shape values with their errors."""
        return [*self._plain, *(_with_errors(one) for one in self.named[:count])]

    def final(self) -> Experiment:
        """The model with all that was found."""
        return with_effects(self.here.experiment, self.entries(len(self.named)), self.here.estimate.theta)


def _background(entries: Sequence[EffectEntry]) -> tuple[EffectEntry, ...]:
    """Effects of which every log has a little, less those that are among the entries."""
    present = {(entry.effect, entry.joint, entry.link) for entry in entries}
    every = [kind.background_entry() for kind in effect_types().values()]
    return tuple(one for one in every if one is not None and (one.effect, one.joint, one.link) not in present)


def _trimmed(one: Added) -> EffectEntry:
    """An effect without those of its parameters that may be left out and are not told from 0."""
    held = effect_types()[one.entry.effect].nonlinear_parameters
    free = [x.name for x in held if x.optional_maximum is not None and x.name in one.entry.parameters]
    unsure = [name for name in free if not float(one.entry.parameters[name]) > DETERMINED * one.errors.get(name, 0.0)]
    kept = {name: value for name, value in one.entry.parameters.items() if name not in unsure}
    return one.entry.model_copy(update={"parameters": kept}) if unsure else one.entry


def _with_errors(one: Added) -> EffectEntry:
    given = {name: _uncertain(one, name, value) for name, value in one.entry.parameters.items()}
    return one.entry.model_copy(update={"parameters": given})


def _uncertain(one: Added, name: str, value: Any) -> Any:
    """A shape value, or a list of them, with what it may be off by."""
    if isinstance(value, list):
        return [_uncertain(one, f"{name}.{k}", x) for k, x in enumerate(value)]
    error = one.errors.get(name, 0.0)
    known = isinstance(value, float) and np.isfinite(error) and error > 0
    return {"value": value, "standard_error": error} if known else value

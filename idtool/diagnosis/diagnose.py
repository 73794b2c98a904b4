"""The diagnosis: residual → where → name → add → smaller residual, until what is left is noise or has no name."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from idtool.config import EffectEntry
from idtool.diagnosis.faults import faults
from idtool.diagnosis.floor import Floor, noise_floor
from idtool.diagnosis.ground import ground
from idtool.diagnosis.level import level
from idtool.diagnosis.records import Candidate, Diagnosis, Level, Step, Verdict, Where
from idtool.diagnosis.screen import screened
from idtool.diagnosis.search import SURE, Choice, Contender, candidate, saved, searched, share, worthwhile
from idtool.diagnosis.survey import survey
from idtool.diagnosis.trial import tried, with_effects, with_fixed_inertia
from idtool.diagnosis.unknown import UNKNOWN, unnamed
from idtool.diagnosis.where import bursts, located, residual_maps, unexplained
from idtool.diagnosis.words import sentence, separating
from idtool.effects import named_effect
from idtool.exceptions import ConfigError
from idtool.experiment import Experiment, Progress
from idtool.fit import Fit, fit

Array = NDArray[np.float64]

_POLISHES = 3  # steps of all shape values after an effect was added
_STRUCTURED = 0.05  # of a joint's squared residual, that a function of any form explains: it has structure
_SLOW = 25.0  # times the noise's power where the motion's is: it has structure
_NEAR = 1.5  # of the noise floor, that a residual may be and count as noise


@dataclass(frozen=True)
class Options:
    """What a user asks for.

    Attributes
    ----------
    inertia
        ``refit`` or ``fixed``: whether the inertia parameters are identified or the URDF's.
    effects
        Ids of the effects that may be; None: all.
    most
        How many are added at the most.
    assumed
        Effects to start with, each with the joint or link that it is on; None: where it explains most.
    simulated
        Whether to run the models forwards too.
    """

    inertia: str = "refit"
    effects: tuple[str, ...] | None = None
    most: int = 12
    assumed: tuple[tuple[str, str | None], ...] = ()
    simulated: bool = True


@dataclass
class _Added:
    """An effect in the model, with what spoke for it."""

    entry: EffectEntry
    choice: Choice
    chosen: Candidate
    errors: dict[str, float] = field(default_factory=dict)


def diagnose(experiment: Experiment, options: Options, progress: Progress) -> Diagnosis:
    """Find, name and add what a model lacks.

    Parameters
    ----------
    experiment
        Model and data.
    options
        What is asked for.
    progress
        Told the stage and how far it has come.

    Raises
    ------
    IdtoolError
        If the logs or the model cannot be used, or an effect cannot be where it is assumed.
    """
    started = time.perf_counter()
    wrong = faults(experiment, progress)
    if options.inertia == "fixed":
        experiment = with_fixed_inertia(experiment)
    search = _Search(experiment, options, progress)
    search.run()
    first = fit(experiment, progress, options.simulated)
    last = fit(search.final(), progress, options.simulated) if search.added else first
    structure = _structure(search)
    floor = noise_floor(last.experiment, last.estimate.theta, progress).less(np.array([one.score for one in structure]))
    steps = [*_steps(search, first), *_unknown(search, structure, floor, last)]
    joints = experiment.equation.joints
    before, after = (_of(one) for one in (first, last))
    return Diagnosis(
        first=first,
        last=last,
        faults=wrong,
        steps=tuple(steps),
        removed=tuple(search.removed),
        before=before,
        after=after,
        floor={**dict(zip(joints, floor.rms.tolist(), strict=True)), "overall": float(np.sqrt(np.mean(floor.rms**2)))},
        verdict=_verdict(steps),
        maps_before=residual_maps(first.experiment, first.estimate.theta, progress),
        maps_after=residual_maps(last.experiment, last.estimate.theta, progress),
        warnings=(),
        seconds=time.perf_counter() - started,
    )


def _of(one: Fit) -> Level:
    """The errors of a fitted model."""
    joints = one.experiment.equation.joints
    held_out = one.validation.errors["identified"]
    run = one.simulation
    moved = None if run is None or "identified" in run.failed else run.departures["identified"].rmse(joints, "position")
    return Level(one.train.errors["identified"].rms(joints), held_out.rms(joints) if held_out.samples else None, moved)


class _Search:
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
    """

    def __init__(self, experiment: Experiment, options: Options, progress: Progress) -> None:
        self.options, self.progress = options, progress
        self.given = experiment.config.effects
        self.first = self.here = ground(experiment, progress)
        self.added: list[_Added] = []
        self.removed: list[str] = []
        self.last: Choice | None = None

    def run(self) -> None:
        """Until nothing more pays."""
        for assumed in self.options.assumed:
            choice = searched(self.here, self.progress, (assumed[0],), self._bursts(), assumed[1], forced=True)
            if choice.winner is None:
                on = assumed[1] or "any joint"
                raise ConfigError("--assume", f"{assumed[0]}:{on} cannot be there; leave it out, or name another joint")
            self._add(choice, choice.winner)
        seen: set[frozenset[tuple[str, str | None]]] = set()
        while len(self.added) < self.options.most:
            self.last = searched(self.here, self.progress, self.options.effects, self._bursts())
            if self.last.winner is None:
                break
            self._add(self.last, self.last.winner)
            self._prune()
            state = frozenset((one.chosen.effect, one.chosen.on) for one in self.added)
            if state in seen:
                break
            seen.add(state)

    def _bursts(self) -> tuple[tuple[float, float], ...]:
        if any(one.chosen.effect == "external_contact" for one in self.added):
            return ()
        return bursts(self.here.experiment, self.here.estimate.theta, self.progress)

    def _add(self, choice: Choice, winner: Contender) -> None:
        chosen = candidate(winner, self.here)
        entries = winner.trial.entries
        self.added.append(_Added(entries[-1], choice, chosen))
        self._settle([*self.given, *(one.entry for one in self.added[:-1]), entries[-1]])

    def _settle(self, entries: Sequence[EffectEntry]) -> None:
        """Fit all anew, shape values together, the joints weighed by what is left now."""
        there = ground(with_effects(self.here.experiment, entries, self.here.theta), self.progress)
        first = len(self.given)
        trial = tried(there, entries, range(first, len(entries)), self.progress, _POLISHES)
        self.here = trial.ground if trial is not None else there
        found = self.here.experiment.config.effects[first:]
        for i, (one, entry) in enumerate(zip(self.added, found, strict=True)):
            one.entry = entry
            if trial is not None:
                one.errors = {name: x for (k, name), x in trial.errors.items() if k == first + i}

    def _prune(self) -> None:
        """Take out what no longer pays."""
        i = 0
        while len(self.added) > 1 and i < len(self.added) - 1:
            others = [one.entry for k, one in enumerate(self.added) if k != i]
            entries = [*self.given, *others]
            if self._needed(self.added[i], entries):
                i += 1
                continue
            out = self.added.pop(i)
            by = self.added[-1].chosen
            what = f"{out.chosen.effect} on {out.chosen.on} was taken out again"
            self.removed.append(f"{what}: with {by.effect} on {by.on} it pays no more")
            self._settle(entries)

    def _needed(self, one: _Added, others: Sequence[EffectEntry]) -> bool:
        """Whether an effect still pays beside the others, on the rows that they know."""
        theta = self.here.theta
        without = ground(with_effects(self.here.experiment, others, theta), self.progress, self.here, own_rows=True)
        here = ground(self.here.experiment, self.progress, without)
        gain, of = float(saved(without, here).sum()), one.chosen
        return worthwhile(gain, without, one.choice.inflation, of.joint is not None, of.parameters)

    def entries(self, count: int) -> list[EffectEntry]:
        """The configuration's effects with the first found, shape values with their errors."""
        return [*self.given, *(_with_errors(one) for one in self.added[:count])]

    def final(self) -> Experiment:
        """The model with all that was found."""
        return with_effects(self.here.experiment, self.entries(len(self.added)), self.here.estimate.theta)


def _with_errors(one: _Added) -> EffectEntry:
    given = {
        name: {"value": value, "standard_error": error}
        for name, error in one.errors.items()
        if isinstance(value := one.entry.parameters[name], float) and np.isfinite(error) and error > 0
    }
    return one.entry.model_copy(update={"parameters": {**one.entry.parameters, **given}})


def _steps(search: _Search, first: Fit) -> list[Step]:
    """What was found, step by step, with the shape values of the end."""
    steps: list[Step] = []
    experiment, theta, before = first.experiment, first.estimate.theta, _of(first)
    for k, one in enumerate(search.added):
        found = ground(with_effects(search.here.experiment, search.entries(k + 1), search.here.theta), search.progress)
        after = level(found.experiment, found.estimate.theta, search.options.simulated, search.progress)
        where = located(experiment, theta, found.experiment, found.estimate.theta, search.progress)
        values, errors = _parameters(one, search)
        alike = tuple(candidate(c, one.choice.here) for c in one.choice.equals)
        step = Step(
            chosen=one.chosen,
            entry=one.entry,
            parameters=values,
            standard_error=errors,
            where=where,
            significance=one.chosen.score / max(one.chosen.standard_error, 1e-12),
            pair=bool(alike),
            separate=separating(one.chosen, alike[0]) if alike else "",
            alternatives=(*one.choice.alternatives(),),
            rejected=one.choice.lost,
            before=before,
            after=after,
            sentence="",
        )
        units = first.experiment.model.units
        steps.append(replace(step, sentence=sentence(step, units)))
        experiment, theta, before = found.experiment, found.estimate.theta, after
    return steps


def _parameters(one: _Added, search: _Search) -> tuple[dict[str, object], dict[str, object]]:
    """Values and standard errors by name, as the whole model has them."""
    equation = search.here.experiment.equation
    key = named_effect(one.entry, search.here.experiment.model).key
    values = {name: _value(x) for name, x in one.entry.parameters.items()}
    errors: dict[str, object] = {name: one.errors.get(name) for name in values}
    for effect, first, last in zip(equation.effects, equation.offsets()[:-1], equation.offsets()[1:], strict=True):
        if getattr(effect, "key", None) == key and last > first:
            theta, ways = search.here.estimate.theta[first:last], search.here.ways[first:last]
            total = search.here.B.sum(axis=0) + search.here.held
            spread = one.choice.inflation * ways @ np.linalg.solve(total, ways.T)
            for name, (value, error) in effect.parameters(theta, spread).items():  # type: ignore[attr-defined]
                values[name], errors[name] = value, error
    return values, errors


def _value(given: object) -> object:
    return given["value"] if isinstance(given, Mapping) else given


def _structure(search: _Search) -> list[Candidate]:
    """What a function of any form explains of what is left, by joint; a share of 0 where it is no more than chance."""
    here = search.here
    inflation = search.last.inflation if search.last is not None else 1.0
    found = screened(here, list(unnamed(survey(here))), search.progress, "looking for what has no name")
    said = []
    for name in here.experiment.equation.joints:
        best = max((one for one in found if one.probe.joint == name), key=lambda one: one.gain)
        sure = best.gain > SURE**2 * inflation
        part, error = (share(x, here, 1) if sure else 0.0 for x in (best.gain, best.standard_error))
        said.append(Candidate(UNKNOWN, name, None, min(part, 1.0), error, 0))
    return said


def _unknown(search: _Search, structure: Sequence[Candidate], floor: Floor, last: Fit) -> list[Step]:
    """What is structured and has no name, a step a joint."""
    rms = dict(zip(last.experiment.equation.joints, floor.rms.tolist(), strict=True))
    lost = search.last.lost if search.last is not None else ()
    now, units, where, steps = _of(last), last.experiment.model.units, None, []
    for j, chosen in enumerate(structure):
        slow = floor.slow[j] > _SLOW and floor.residual[j] > _NEAR * floor.noise[j]
        if chosen.score > _STRUCTURED or slow:
            where = where or unexplained(last.experiment, last.estimate.theta, rms, search.progress)
            own, sure = replace(where, joints=(chosen.on,)), chosen.score / max(chosen.standard_error, 1e-12)
            step = Step(chosen, None, {}, {}, own, sure, False, "", (), lost, now, now, "")
            steps.append(replace(step, sentence=sentence(step, units)))
    return steps


def _verdict(steps: Sequence[Step]) -> Verdict:
    named = any(step.entry is not None for step in steps)
    left = any(step.entry is None for step in steps)
    if named:
        return "partly_explained" if left else "explained"
    return "unexplained" if left else "no_disagreement"


__all__ = ["Options", "Where", "diagnose"]

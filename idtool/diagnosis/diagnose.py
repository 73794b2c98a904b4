"""The diagnosis: residual → where → name → add → smaller residual, until what is left is noise or has no name."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.notice import Notice, unique
from idtool.diagnosis.data_faults import find_data_faults
from idtool.diagnosis.floor import Floor, noise_floor
from idtool.diagnosis.level import level
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.localization import localize_residual, residual_maps, unexplained
from idtool.diagnosis.model_selection import SURE, candidate, share
from idtool.diagnosis.records import Candidate, Diagnosis, Level, Step, Verdict, Where
from idtool.diagnosis.rounds import APART, Added, Search
from idtool.diagnosis.screen import screened
from idtool.diagnosis.survey import survey
from idtool.diagnosis.trial import FAILURES, with_effects, with_fixed_inertia
from idtool.diagnosis.unknown import UNKNOWN, unnamed
from idtool.diagnosis.words import aside, doubted, sentence, separating
from idtool.dynamics.effects import effect_from_entry
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.fit import Fit, fit

_STRUCTURED = 0.1  # of a joint's squared residual, that a function of any form explains: it has structure
_SMALL = 3e-3  # of a joint's rms torque: structure of less is no matter
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
    experiment, delay, _ = with_delay(experiment, progress)
    wrong = find_data_faults(experiment, progress)
    if options.inertia == "fixed":
        experiment = with_fixed_inertia(experiment)
    search = Search(experiment, options.effects, options.most, progress)
    for effect, on in options.assumed:
        search.assume(effect, on)
    search.run()
    first = fit(experiment, progress, options.simulated)
    last = _last(search, first, options.simulated)
    structure = _structure(search)
    floor = _floor(search, structure)
    named = doubted(_steps(search, first, last, options.simulated), experiment.model)
    steps = [*named, *_unknown(search, structure, floor, last)]
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
        notices=unique([*(delay.notices if delay else ()), *_doubts(steps), *_search_notices(search)]),
        seconds=time.perf_counter() - started,
    )


def _last(search: Search, first: Fit, simulated: bool) -> Fit:
    """The model with all effects that it can be fitted with."""
    while search.named:
        try:
            return fit(search.final(), search.progress, simulated)
        except FAILURES as failure:
            search.leave_out(search.named[-1], failure)
    return first


def _of(one: Fit) -> Level:
    """The errors of a fitted model."""
    joints = one.experiment.equation.joints
    held_out = one.validation.errors["identified"]
    run = one.simulation
    moved = None if run is None or "identified" in run.failed else run.errors["identified"].rmse(joints, "position")
    return Level(one.train.errors["identified"].rms(joints), held_out.rms(joints) if held_out.samples else None, moved)


def _steps(search: Search, first: Fit, last: Fit, simulated: bool) -> list[Step]:
    """What was found, step by step, with the shape values of the end."""
    steps: list[Step] = []
    experiment, theta, before = first.experiment, first.estimate.theta, _of(first)
    for k, one in enumerate(search.named):
        found = _so_far(search, k + 1, last)
        after = level(found.experiment, found.estimate.theta, simulated, search.progress)
        where = localize_residual(experiment, theta, found.experiment, found.estimate.theta, search.progress)
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


def _so_far(search: Search, count: int, last: Fit) -> LinearizedFit | Fit:
    """The model with the effects that were found first; with all of them, where those alone cannot be fitted."""
    experiment = with_effects(search.here.experiment, search.entries(count), search.here.theta)
    try:
        return linearize_fit(experiment, search.progress)
    except FAILURES:
        return last


def _parameters(one: Added, search: Search) -> tuple[dict[str, object], dict[str, object]]:
    """Values and standard errors by name, as the whole model has them."""
    equation = search.here.experiment.equation
    key = effect_from_entry(one.entry, search.here.experiment.model).key
    values = {name: _value(x) for name, x in one.entry.parameters.items()}
    errors: dict[str, object] = {name: _error(one, name, value) for name, value in values.items()}
    for effect, first, last in zip(equation.effects, equation.offsets()[:-1], equation.offsets()[1:], strict=True):
        if getattr(effect, "key", None) == key and last > first:
            theta, ways = search.here.estimate.theta[first:last], search.here.ways[first:last]
            total = search.here.B.sum(axis=0) + search.here.held
            spread = one.choice.inflation * ways @ np.linalg.solve(total, ways.T)
            for name, (value, error) in effect.parameters(theta, spread).items():  # type: ignore[attr-defined]
                values[name], errors[name] = value, error
    return values, errors


def _error(one: Added, name: str, value: object) -> object:
    """What a shape value, or each of a list, may be off by; None where it is not known."""
    if isinstance(value, list) and any(f"{name}.{k}" in one.errors for k in range(len(value))):
        return [one.errors.get(f"{name}.{k}") for k in range(len(value))]
    return one.errors.get(name)


def _value(given: object) -> object:
    return given["value"] if isinstance(given, Mapping) else given


def _structure(search: Search) -> list[Candidate]:
    """What a function of any form explains of what is left, by joint; a share of 0 where it is no more than chance."""
    here = search.here
    inflation = search.last.inflation if search.last is not None else 1.0
    found = screened(here, list(unnamed(survey(here))), search.progress, "looking for what has no name")
    said = []
    for name in here.experiment.equation.joints:
        best = max((one for one in found if one.probe.joint == name), key=lambda one: one.gain)
        j = here.experiment.equation.joints.index(name)
        size = np.sqrt(max(best.gain, 0.0) / here.rows[:, j].sum()) * here.noise[j] / here.size[j]
        sure = best.gain > SURE**2 * inflation and size > _SMALL
        part, error = (share(x, here, 1) if sure else 0.0 for x in (best.gain, best.standard_error))
        said.append(Candidate(UNKNOWN, name, None, min(part, 1.0), error, 0))
    return said


def _floor(search: Search, structure: Sequence[Candidate]) -> Floor:
    """The noise floor, by what is left where it is clear of reversals, less what is known to be structure of that."""
    here = search.here
    floor = noise_floor(here.experiment, here.estimate.theta, search.progress, here.apart)
    return floor.less(np.array([one.score for one in structure]))


def _unknown(search: Search, structure: Sequence[Candidate], floor: Floor, last: Fit) -> list[Step]:
    """What is structured and has no name, a step a joint."""
    rms = dict(zip(last.experiment.equation.joints, floor.rms.tolist(), strict=True))
    slow = (floor.slow > _SLOW) & (floor.residual > np.maximum(_NEAR * floor.noise, _SMALL * search.here.size))
    left = [one for one, whole in zip(structure, slow.tolist(), strict=True) if one.score > _STRUCTURED or whole]
    where = unexplained(last.experiment, last.estimate.theta, rms, search.progress) if left else {}
    lost, now = search.last.lost if search.last is not None else (), _of(last)
    steps = []
    for chosen in left:
        there = where.get(chosen.on, Where((chosen.on,), (), ""))
        sure = chosen.score / max(chosen.standard_error, 1e-12)
        step = Step(chosen, None, {}, {}, there, sure, False, "", (), lost, now, now, "")
        steps.append(replace(step, sentence=sentence(step, last.experiment.model.units)))
    return steps


def _doubts(steps: Sequence[Step]) -> Iterator[Notice]:
    """What speaks against the effects that were added."""
    for step in steps:
        if step.doubt:
            yield Notice("effect_doubtful", "warning", None, step.doubt)


def _search_notices(search: Search) -> Iterator[Notice]:
    """What a reader should know of the search."""
    for one in search.added:
        if one not in search.named:
            yield Notice("effect_fitted_along", "note", one.entry.joint, aside(one.entry))
    there = {(one.chosen.effect, one.chosen.on) for one in search.added}
    for (effect, on), reason in search.failed.items():
        if (effect, on) not in there:
            yield Notice("effect_failed", "warning", None, f"{effect} on {on} {reason}")
    if search.rounded:
        message = (
            f"within {1e3 * APART:.0f} ms of reversals friction on {', '.join(search.rounded)} is not what its level "
            "and direction give, as where a simulator rounds it off: such moments were left aside in the end"
        )
        yield Notice("reversals_left_aside", "warning", None, message)


def _verdict(steps: Sequence[Step]) -> Verdict:
    named = any(step.entry is not None for step in steps)
    left = any(step.entry is None for step in steps)
    if named:
        return "partly_explained" if left or any(step.doubt for step in steps) else "explained"
    return "unexplained" if left else "no_disagreement"

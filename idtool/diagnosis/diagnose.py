"""Diagnosis: find, name and add the effects that a model lacks, until only noise or unknown structure remains."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from idtool.common.arrays import Mask
from idtool.common.notice import Notice, unique
from idtool.diagnosis.confirmation import estimate_on_parts, linear_parameters
from idtool.diagnosis.data_faults import find_data_faults
from idtool.diagnosis.doubts import doubt_about
from idtool.diagnosis.effect_profile import effect_profile
from idtool.diagnosis.effect_search import REVERSAL_MARGIN, EffectSearch
from idtool.diagnosis.error_summary import errors_of_fit, evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.generic_probes import UNKNOWN, generic_probes
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.localization import localize_residual, localize_unexplained
from idtool.diagnosis.model_selection import MIN_SIGNIFICANCE, explained_share, fitted_record, is_reportable
from idtool.diagnosis.noise_floor import NoiseFloor, estimate_noise_floor
from idtool.diagnosis.records import (
    Candidate,
    Diagnosis,
    DiagnosisStep,
    ErrorSummary,
    PartEstimate,
    ProfilesByJoint,
    ResidualLocation,
    Verdict,
)
from idtool.diagnosis.residual_maps import residual_maps
from idtool.diagnosis.residual_series import residual_series
from idtool.diagnosis.screen import screen_probes
from idtool.diagnosis.stages import Stages
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import FAILURES, with_effects, with_fixed_inertia
from idtool.diagnosis.unbiased_delay import with_unbiased_delay
from idtool.diagnosis.words import distinguishing_experiment, fitted_along_sentence, step_sentence, with_doubts
from idtool.estimation.dataset.batch_cache import BatchCache
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.fit import Fit, fit
from idtool.robot.config import EffectEntry

_STRUCTURED_SHARE = 0.1  # of a joint's squared residual, explained by a generic function: it has structure
_NEGLIGIBLE = 3e-3  # of a joint's rms torque: a smaller residual does not matter
_SLOW_POWER = 25.0  # ratio of the residual's power to the noise's at the motion's frequencies: it has structure
_MAX_INCREASE = 1.0005  # ratio of the held-out errors of all joints together, with an effect and without it
_MAX_FLOOR_RATIO = 1.3  # of the noise floor, up to which a residual is explained
_NEAR_NOISE = 1.5  # times the noise, up to which a residual counts as noise


@dataclass(frozen=True)
class Options:
    """Options of a diagnosis.

    Attributes
    ----------
    inertia
        ``refit`` or ``fixed``: whether the inertia parameters are identified or the URDF's.
    effects
        Ids of the effects to try; None: all.
    max_effects
        Number of effects that are added at most.
    assumed
        Effects to start with, each with its joint or link; None: where it explains most.
    simulate
        True to simulate the models too.
    budget
        Time after which the search stops with what it has found [s]; None: no limit.
    """

    inertia: str = "refit"
    effects: tuple[str, ...] | None = None
    max_effects: int = 12
    assumed: tuple[tuple[str, str | None], ...] = ()
    simulate: bool = True
    budget: float | None = None


def diagnose(experiment: Experiment, options: Options, progress: Progress) -> Diagnosis:
    """Find, name and add the effects that a model lacks.

    Parameters
    ----------
    experiment
        Model and data.
    options
        Options.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    IdtoolError
        If the logs or the model cannot be used, or an effect cannot be where it is assumed.
    """
    started = time.perf_counter()
    experiment, delay = with_unbiased_delay(experiment, progress)
    experiment = replace(experiment, cache=BatchCache())
    before_search = Stages(interrupted=False)
    no_faults: tuple[Notice, ...] = ()
    faults = before_search.run("the check of the data", partial(find_data_faults, experiment, progress), no_faults)
    if options.inertia == "fixed":
        experiment = with_fixed_inertia(experiment)
    search = EffectSearch(experiment, options.effects, options.max_effects, progress, options.budget)
    for effect, target in options.assumed:
        search.assume(effect, target)
    search.run()

    stages = Stages(interrupted=search.is_interrupted)
    first = _fitted(experiment, progress, options.simulate, stages)
    simulate = first.simulation is not None
    if not options.assumed:
        stages.run("the order of the steps", lambda: _remove_harmful(search, first), None, is_short=True)
    last = _fit_with_effects(search, first, simulate, stages)
    none = [Candidate(UNKNOWN, name, None, 0.0, 0.0, 0) for name in experiment.equation.joints]
    structure = stages.run("the search for unknown effects", lambda: _structure(search), none)
    errors_of_last = errors_of_fit(last)
    remaining = stages.run("the error of all effects together", lambda: _remaining_errors(search), errors_of_last)
    floor = stages.run("the noise floor", lambda: _noise_floor(search, structure), _residual_as_floor(remaining))
    steps = with_doubts(_steps(search, first, last, simulate, stages), experiment.model)
    steps = _confirmed(steps, search, floor, remaining, stages)
    steps += _unknown_steps(search, structure, floor, remaining, last, stages)
    no_maps: ProfilesByJoint = {}
    maps_before = stages.run("the residual map", partial(_maps, first, progress), no_maps)
    maps_after = stages.run("the residual map", partial(_maps, last, progress), no_maps)
    delay_notices = delay.notices if delay else ()
    skipped = [*before_search.notices, *stages.notices]
    return Diagnosis(
        first=first,
        last=last,
        faults=faults,
        steps=tuple(steps),
        removed=tuple(search.removed),
        before=errors_of_fit(first),
        after=errors_of_fit(last),
        floor=_reported_floor(floor, remaining, errors_of_fit(last)),
        verdict=_verdict(steps),
        maps_before=maps_before,
        maps_after=maps_after,
        notices=unique([*delay_notices, *_doubt_notices(steps), *_search_notices(search), *skipped]),
        seconds=time.perf_counter() - started,
    )


def _fitted(experiment: Experiment, progress: Progress, simulate: bool, stages: Stages) -> Fit:
    """Fitted model, simulated too if that is wanted and nothing prevents it."""
    fitted = None
    if simulate:
        fitted = stages.run("the simulation", partial(fit, experiment, progress, simulate=True), None)
    return fitted or fit(experiment, progress)


def _maps(model: Fit, progress: Progress) -> ProfilesByJoint:
    """Residual maps of a fitted model."""
    return residual_maps(model.experiment, model.estimate.theta, progress)


def _remaining_errors(search: EffectSearch) -> ErrorSummary:
    """Errors of the model with all effects, those included that are not named."""
    current = search.current
    return evaluate_errors(current.experiment, current.estimate.theta, False, search.progress)


def _residual_as_floor(errors: ErrorSummary) -> NoiseFloor:
    """Noise floor that is not known: all of the residual may be noise."""
    rms = np.array([value for _, value in _by_joint(errors.torque)])
    return NoiseFloor(rms, rms, rms, np.ones(len(rms)))


def _remove_harmful(search: EffectSearch, first: Fit) -> None:
    """Order the effects so that each lowers the held-out error, and remove those that lower it in no place.

    A right but small effect may increase the error as long as the largest one is missing. Effects that lower it only
    together stay, in any order.
    """
    moves = 0
    while search.reported:
        harmful = _first_harmful(search, errors_of_fit(first))
        if harmful is None:
            return
        count = len(search.reported)
        if harmful is not search.reported[-1] and moves < count**2:
            search.move_to_end(harmful)
            moves += 1
            continue
        if moves >= count**2:
            harmful = _harmful_in_the_end(search)
            if harmful is None:
                return
        search.remove(harmful, "it increases the error on the held-out data")
        moves = 0


def _first_harmful(search: EffectSearch, before: ErrorSummary) -> AddedEffect | None:
    """First effect with which the held-out error is larger than without it; None if there is none."""
    error_before = before.torque["overall"]
    for k, effect in enumerate(search.reported):
        error = _overall_error(search, search.model.entries(k + 1))
        if error > _MAX_INCREASE * error_before:
            return effect
        error_before = error
    return None


def _harmful_in_the_end(search: EffectSearch) -> AddedEffect | None:
    """Effect without which the model with all others has the least held-out error; None if that is with it."""
    entries = search.model.entries(len(search.reported))
    least_error = _overall_error(search, entries)
    harmful = None
    first = len(entries) - len(search.reported)
    for k, effect in enumerate(search.reported, first):
        error = _overall_error(search, [*entries[:k], *entries[k + 1 :]])
        if error < least_error:
            least_error = error
            harmful = effect
    return harmful


def _overall_error(search: EffectSearch, entries: Sequence[EffectEntry]) -> float:
    """Rms torque error of the model with some effects on the held-out data, over all joints [N·m]."""
    experiment = with_effects(search.current.experiment, entries, search.current.theta)
    fitted = linearize_fit(experiment, search.progress)
    errors = evaluate_errors(fitted.experiment, fitted.estimate.theta, False, search.progress)
    return errors.torque["overall"]


def _confirmed(
    steps: Sequence[DiagnosisStep], search: EffectSearch, floor: NoiseFloor, remaining: ErrorSummary, stages: Stages
) -> list[DiagnosisStep]:
    """Steps with the size of their effects on parts of the data, and doubts about those that are not confirmed."""
    if not steps:
        return []
    entries = [effect.entry for effect in search.reported]
    inflation = float(np.median([effect.selection.inflation for effect in search.reported]))
    estimate = partial(estimate_on_parts, search.current, entries, inflation, search.progress)
    unconfirmed: list[list[PartEstimate]] = [[] for _ in entries]
    parts = stages.run("the confirmation on parts of the data", estimate, unconfirmed)
    floor_rms = dict(zip(search.current.experiment.equation.joints, floor.rms.tolist(), strict=True))
    floor_rms["overall"] = float(np.sqrt(np.mean(np.square(floor.rms))))
    confirmed = []
    for step, estimates in zip(steps, parts, strict=True):
        with_parts = replace(step, parts=tuple(estimates))
        doubt = step.doubt or doubt_about(with_parts, floor_rms, remaining.torque)
        confirmed.append(replace(with_parts, doubt=doubt))
    return confirmed


def _fit_with_effects(search: EffectSearch, first: Fit, simulate: bool, stages: Stages) -> Fit:
    """Fit with all effects found; those with which it fails are removed, the newest first."""
    while search.reported:
        try:
            return _fitted(search.model.final_experiment(), search.progress, simulate, stages)
        except FAILURES as failure:
            search.remove_failed(search.reported[-1], failure)
    return first


def _steps(search: EffectSearch, first: Fit, last: Fit, simulate: bool, stages: Stages) -> list[DiagnosisStep]:
    """Steps of the diagnosis, with the nonlinear parameters of the final model."""
    steps: list[DiagnosisStep] = []
    previous: LinearizedFit | Fit = first
    before = errors_of_fit(first)
    of_last: tuple[LinearizedFit | Fit, ErrorSummary] = (last, errors_of_fit(last))
    for k, effect in enumerate(search.reported):
        current, after = of_last
        if k + 1 < len(search.reported):
            fit_first = partial(_fit_with_first_effects, search, k + 1)
            current, after = stages.run("the error of a step", fit_first, of_last, is_short=True)
        if simulate and current is not last:
            theta = current.estimate.theta
            errors_with_simulation = partial(evaluate_errors, current.experiment, theta, True, search.progress)
            after = stages.run("the simulation", errors_with_simulation, after)
        steps.append(_step(effect, search, previous, current, before, after, stages))
        previous = current
        before = after
    return steps


def _step(
    effect: AddedEffect,
    search: EffectSearch,
    previous: LinearizedFit | Fit,
    current: LinearizedFit | Fit,
    errors_before: ErrorSummary,
    errors_after: ErrorSummary,
    stages: Stages,
) -> DiagnosisStep:
    """Step that adds an effect; ``previous`` and ``current`` are the fits without and with it."""
    models = (previous.experiment, previous.estimate.theta, current.experiment, current.estimate.theta)
    locate = partial(localize_residual, *models, search.progress)
    nowhere = ResidualLocation((effect.chosen.target,) if effect.chosen.joint else (), (), "")
    location = stages.run("the location of a residual", locate, nowhere)
    draw = partial(effect_profile, effect.entry, *models, search.progress)
    profile = stages.run("the picture of a step", draw, None)
    parameters, errors = _parameters(effect, search)
    selection = effect.selection
    alike = [fitted_record(candidate, selection.base) for candidate in selection.indistinguishable]
    step = DiagnosisStep(
        chosen=effect.chosen,
        entry=effect.entry,
        parameters=parameters,
        standard_error=errors,
        location=location,
        significance=effect.chosen.significance,
        pair=bool(alike),
        distinguishing_experiment=distinguishing_experiment(effect.chosen, alike[0]) if alike else "",
        alternatives=selection.alternatives(),
        rejected=selection.rejected,
        before=errors_before,
        after=errors_after,
        sentence="",
        profile=profile,
    )
    return replace(step, sentence=step_sentence(step, current.experiment.model.units))


def _fit_with_first_effects(search: EffectSearch, count: int) -> tuple[LinearizedFit | Fit, ErrorSummary]:
    """Fit with the first effects found, and its errors."""
    experiment = with_effects(search.current.experiment, search.model.entries(count), search.current.theta)
    fitted = linearize_fit(experiment, search.progress)
    return fitted, evaluate_errors(fitted.experiment, fitted.estimate.theta, False, search.progress)


def _parameters(effect: AddedEffect, search: EffectSearch) -> tuple[dict[str, object], dict[str, object]]:
    """Values and standard errors of an effect's parameters by name, in the final model."""
    values: dict[str, object] = {}
    errors: dict[str, object] = {}
    for name, value in effect.entry.values.items():
        values[name] = value
        errors[name] = _nonlinear_error(effect, name, value)
    linear = linear_parameters(search.current, effect.entry, effect.selection.inflation)
    for name, (value, error) in linear.items():
        values[name] = value
        errors[name] = error
    return values, errors


def _nonlinear_error(effect: AddedEffect, name: str, value: object) -> object:
    """Standard error of a nonlinear parameter, or of each element of a list; None if it is not known."""
    if isinstance(value, list):
        errors = [effect.errors.get(f"{name}.{k}") for k in range(len(value))]
        if any(error is not None for error in errors):
            return errors
    return effect.errors.get(name)


def _structure(search: EffectSearch) -> list[Candidate]:
    """Share of each joint's residual that generic functions explain; 0 if it is within chance."""
    base = search.current
    joints = base.experiment.equation.joints
    inflation = search.last_round.inflation if search.last_round is not None else 1.0
    stage = "looking for unknown effects"
    residual = residual_series(base.experiment, [(base.experiment.equation, base.theta)], search.progress, stage)
    probes = list(generic_probes(summarize_data(base), residual))
    screened = screen_probes(base, probes, search.progress, stage)
    structure = []
    for j, name in enumerate(joints):
        own = [candidate for candidate in screened if candidate.probe.joint == name]
        best = max(own, key=lambda candidate: candidate.gain)
        explained_rms = np.sqrt(max(best.gain, 0.0) / base.row_counts[:, j].sum()) * base.noise[j]
        is_structure = best.gain > MIN_SIGNIFICANCE**2 * inflation and explained_rms / base.rms_torque[j] > _NEGLIGIBLE
        score = error = 0.0
        if is_structure:
            score = min(explained_share(best.gain, base, 1), 1.0)
            error = explained_share(best.standard_error, base, 1)
        structure.append(Candidate(UNKNOWN, name, None, score, error, 0))
    return structure


def _noise_floor(search: EffectSearch, structure: Sequence[Candidate]) -> NoiseFloor:
    """Noise floor by the residual away from reversals, without what is known to be structure."""
    fitted = search.current
    floor = estimate_noise_floor(fitted.experiment, fitted.estimate.theta, search.progress, fitted.reversal_margin)
    scores = np.array([candidate.score for candidate in structure])
    return floor.without_structure(scores).with_coloured_noise(scores == 0)


def _reported_floor(floor: NoiseFloor, remaining: ErrorSummary, after: ErrorSummary) -> dict[str, float]:
    """Noise floor by joint, and ``overall``, of a model without the effects that are only included in the fit.

    Parameters
    ----------
    floor
        Noise floor of the model with them.
    remaining, after
        Errors of the models with and without them.
    """
    squares = {}
    for (name, with_them), rms in zip(_by_joint(remaining.torque), floor.rms.tolist(), strict=True):
        squares[name] = rms**2 + max(after.torque[name] ** 2 - with_them**2, 0.0)
    overall = float(np.mean(list(squares.values())))
    return {name: float(np.sqrt(square)) for name, square in {**squares, "overall": overall}.items()}


def _by_joint(errors: Mapping[str, float]) -> list[tuple[str, float]]:
    """Errors by joint, without ``overall``."""
    return [(name, value) for name, value in errors.items() if name != "overall"]


def _unknown_steps(
    search: EffectSearch,
    structure: Sequence[Candidate],
    floor: NoiseFloor,
    remaining: ErrorSummary,
    last: Fit,
    stages: Stages,
) -> list[DiagnosisStep]:
    """Steps of the joints whose residual is above the noise floor, or has structure that no effect explains."""
    is_unexplained = _is_unexplained(search, structure, floor, remaining)
    unknown = [candidate for candidate, is_own in zip(structure, is_unexplained, strict=True) if is_own]
    if not unknown:
        return []

    floor_rms = dict(zip(last.experiment.equation.joints, floor.rms.tolist(), strict=True))
    locate = partial(localize_unexplained, last.experiment, last.estimate.theta, floor_rms, search.progress)
    nowhere: dict[str, ResidualLocation] = {}
    locations = stages.run("the location of a residual", locate, nowhere)
    errors = errors_of_fit(last)
    steps = []
    for candidate in unknown:
        step = DiagnosisStep(
            chosen=candidate,
            entry=None,
            parameters={},
            standard_error={},
            location=locations.get(candidate.target, ResidualLocation((candidate.target,), (), "")),
            significance=candidate.significance,
            pair=False,
            distinguishing_experiment="",
            alternatives=(),
            rejected=search.last_round.rejected if search.last_round is not None else (),
            before=errors,
            after=errors,
            sentence="",
        )
        steps.append(replace(step, sentence=step_sentence(step, last.experiment.model.units)))
    return steps


def _is_unexplained(
    search: EffectSearch, structure: Sequence[Candidate], floor: NoiseFloor, remaining: ErrorSummary
) -> Mask:
    """Mask of the joints whose residual is more than noise, shape (nv,)."""
    negligible = _NEGLIGIBLE * search.current.rms_torque
    has_structure = np.array([candidate.score > _STRUCTURED_SHARE for candidate in structure])
    has_slow_power = floor.slow_power_ratio > _SLOW_POWER
    is_above_noise = floor.residual > np.maximum(_NEAR_NOISE * floor.noise, negligible)
    rms = np.array([value for _, value in _by_joint(remaining.torque)])
    is_above_floor = (rms > _MAX_FLOOR_RATIO * floor.rms) & (rms > negligible)
    return has_structure | (has_slow_power & is_above_noise) | is_above_floor


def _doubt_notices(steps: Sequence[DiagnosisStep]) -> Iterator[Notice]:
    """Notices about reasons to doubt the effects that were added."""
    for step in steps:
        if step.doubt:
            yield Notice("effect_doubtful", "warning", None, step.doubt)


def _search_notices(search: EffectSearch) -> Iterator[Notice]:
    """Notices about the search."""
    for effect in search.added:
        if not is_reportable(effect.entry.effect):
            yield Notice("effect_fitted_along", "note", effect.entry.joint, fitted_along_sentence(effect.entry))
    added = {(effect.chosen.effect, effect.chosen.target) for effect in search.added}
    for (effect_id, target), reason in search.failed.items():
        if (effect_id, target) not in added:
            yield Notice("effect_failed", "warning", None, f"{effect_id} on {target} {reason}")
    if search.stopped:
        message = f"{search.stopped}; the effects found by then are reported"
        yield Notice("search_interrupted", "warning", None, message, "run it again for the rest")
    if search.reversal_joints:
        sizes = []
        for name, (rms, rms_away) in search.reversal_joints.items():
            sizes.append(f"{name} ({rms:.3g} RMS with these samples, {rms_away:.3g} without)")
        message = (
            f"within {1e3 * REVERSAL_MARGIN:.0f} ms of reversals, friction does not follow Coulomb's law on "
            f"{', '.join(sizes)}, as if a simulator smoothed the friction; these samples were excluded in the last "
            "steps of the search"
        )
        yield Notice("reversals_left_aside", "warning", None, message)


def _verdict(steps: Sequence[DiagnosisStep]) -> Verdict:
    has_named = any(step.entry is not None for step in steps)
    has_unknown = any(step.entry is None for step in steps)
    has_doubt = any(step.doubt for step in steps)
    if not has_named:
        return "unexplained" if has_unknown else "no_disagreement"
    return "partly_explained" if has_unknown or has_doubt else "explained"

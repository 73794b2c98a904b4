"""Diagnosis: find, name and add the effects that a model lacks, until only noise or unknown structure remains."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np

from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice, unique
from idtool.common.number_text import short_number
from idtool.common.processes import Background
from idtool.diagnosis.confirmation import estimate_on_parts
from idtool.diagnosis.data_faults import find_data_faults
from idtool.diagnosis.data_faults.torque_scale import check_torques
from idtool.diagnosis.doubts import doubt_about
from idtool.diagnosis.effect_order import StepFits, order_effects
from idtool.diagnosis.effect_profile import effect_profile
from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.error_summary import errors_of_fit, evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.localization import localize_residual, localize_unexplained
from idtool.diagnosis.model_selection import fitted_record, is_reportable
from idtool.diagnosis.quiet_joints import quiet_joints
from idtool.diagnosis.records import (
    Diagnosis,
    DiagnosisStep,
    ErrorSummary,
    PartEstimate,
    ProfilesByJoint,
    ResidualLocation,
    Verdict,
)
from idtool.diagnosis.residual_maps import residual_maps
from idtool.diagnosis.reversal_rows import REVERSAL_MARGIN
from idtool.diagnosis.stages import Stages
from idtool.diagnosis.trial import FAILURES, with_fixed_inertia
from idtool.diagnosis.unbiased_delay import with_unbiased_delay
from idtool.diagnosis.unexplained import (
    RemainingResidual,
    no_structure,
    residual_as_floor,
    residual_structure,
    structured_noise_floor,
)
from idtool.diagnosis.words import distinguishing_experiment, fitted_along_sentence, step_sentence, with_doubts
from idtool.dynamics.effects import effect_from_entry, effect_name
from idtool.estimation.dataset.batch_cache import BatchCache
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.estimation.fit import Fit, fit, simulate_fit, with_simulation

_NOISE_FLOOR = "the noise floor"  # name of a stage


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
    check_torques(experiment)
    experiment, controller_notices = with_unbiased_delay(experiment, progress)
    experiment = replace(experiment, cache=BatchCache())
    model = with_fixed_inertia(experiment) if options.inertia == "fixed" else experiment
    first = fit(model, progress)
    no_notices: tuple[Notice, ...] = ()
    check = Background(partial(find_data_faults, experiment))
    can_simulate = options.simulate and model.has_only_joints
    with check, _begin_simulation(first, can_simulate) as simulation:
        search = _run_search(model, options, progress)
        stages = Stages(interrupted=search.is_interrupted)
        faults = stages.run("the check of the data", partial(check.result, progress), no_notices)
        first = _with_simulation(first, simulation, progress, stages)
    before = errors_of_fit(first)
    simulate = first.simulation is not None  # without that of the first model, there is nothing to compare with
    step_fits = StepFits(search, first)
    if not options.assumed:
        order = partial(order_effects, search, step_fits)
        stages.run("the order of the steps", order, None, is_short=True)

    last = _fit_with_effects(search, step_fits)
    with _begin_simulation(last, simulate and last is not first) as simulation:
        remaining = _remaining_residual(search, errors_of_fit(last), stages)
        last = _with_simulation(last, simulation, progress, stages)
    after = errors_of_fit(last)
    steps = with_doubts(_steps(search, step_fits, last, simulate, stages), experiment.model)
    steps = _confirmed(steps, search, remaining, faults, stages)
    unknown_steps = _unknown_steps(search, remaining, last, stages)
    check_held_out = partial(_held_out_notices, search, unknown_steps)
    held_out_notices = stages.run("the check of the held-out data", check_held_out, no_notices)
    if unknown_steps:
        search.note_limit()
    steps += unknown_steps
    no_maps: ProfilesByJoint = {}
    maps_before = stages.run("the residual map", partial(_maps, first, progress), no_maps)
    maps_after = stages.run("the residual map", partial(_maps, last, progress), no_maps)
    short_data = () if stages.has_skipped(_NOISE_FLOOR) else tuple(_short_data_notices(remaining))
    return Diagnosis(
        first=first,
        last=last,
        faults=faults,
        steps=tuple(steps),
        removed=tuple(search.removed),
        before=before,
        after=after,
        floor=remaining.reported_floor(after),
        is_floor_known=remaining.is_known,
        verdict=_verdict(steps, remaining.is_known, is_complete=not search.stopped),
        searched=options.effects,
        stopped=search.stopped,
        maps_before=maps_before,
        maps_after=maps_after,
        notices=unique(
            [
                *controller_notices,
                *_doubt_notices(steps),
                *held_out_notices,
                *_search_notices(search),
                *stages.notices,
                *short_data,
            ]
        ),
        seconds=time.perf_counter() - started,
    )


def _run_search(experiment: Experiment, options: Options, progress: Progress) -> EffectSearch:
    """Search for effects that has ended, begun with the assumed ones."""
    search = EffectSearch(experiment, options.effects, options.max_effects, progress, options.budget)
    for effect, target in options.assumed:
        search.assume(effect, target)
    search.run()
    return search


def _begin_simulation(fitted: Fit, is_wanted: bool) -> Background[RolloutEvaluation | None] | nullcontext[None]:
    """Simulation of a fitted model beside what comes next, if it is wanted."""
    return Background(partial(simulate_fit, fitted)) if is_wanted else nullcontext()


def _with_simulation(
    fitted: Fit, simulation: Background[RolloutEvaluation | None] | None, progress: Progress, stages: Stages
) -> Fit:
    """Fitted model with the result of its simulation, unless something prevents it."""
    if simulation is None:
        return fitted
    rollouts = stages.run("the simulation", partial(simulation.result, progress), None)
    return fitted if rollouts is None else with_simulation(fitted, rollouts)


def _maps(model: Fit, progress: Progress) -> ProfilesByJoint:
    """Residual maps of a fitted model."""
    return residual_maps(model.experiment, model.estimate.theta, progress)


def _remaining_residual(search: EffectSearch, after: ErrorSummary, stages: Stages) -> RemainingResidual:
    """Residual of the model with all effects; ``after`` are the errors of the reported model."""
    current = search.current
    inflation = search.last_round.inflation if search.last_round is not None else 1.0
    find_structure = partial(residual_structure, current, inflation, search.progress)
    without_structure = no_structure(current.experiment.equation.joints)
    structure = stages.run("the search for unknown effects", find_structure, without_structure)
    evaluate = partial(evaluate_errors, current.experiment, current.estimate.theta, False, search.progress)
    errors = stages.run("the error of all effects together", evaluate, after)
    estimate_floor = partial(structured_noise_floor, current, structure, search.progress)
    floor = stages.run(_NOISE_FLOOR, estimate_floor, residual_as_floor(errors))
    is_known = structure is not without_structure and floor.is_estimated
    return RemainingResidual(errors, structure, floor, is_known)


def _confirmed(
    steps: Sequence[DiagnosisStep],
    search: EffectSearch,
    remaining: RemainingResidual,
    faults: Sequence[Notice],
    stages: Stages,
) -> list[DiagnosisStep]:
    """Steps with the size of their effects on parts of the data, and doubts about those that are not confirmed."""
    if not steps:
        return []
    entries = [effect.entry for effect in search.reported]
    estimate = partial(estimate_on_parts, search.current, entries, search.progress)
    unconfirmed: list[list[PartEstimate]] = [[] for _ in entries]
    parts = stages.run("the confirmation on parts of the data", estimate, unconfirmed)
    floor = remaining.floor_by_joint()
    model = search.current.experiment.model
    confirmed = []
    for step, estimates in zip(steps, parts, strict=True):
        with_parts = replace(step, parts=tuple(estimates))
        units = effect_from_entry(step.entry, model).parameter_units() if step.entry is not None else {}
        doubt = step.doubt or doubt_about(with_parts, units, floor, remaining.errors.torque, faults)
        confirmed.append(replace(with_parts, doubt=doubt))
    return confirmed


def _fit_with_effects(search: EffectSearch, fits: StepFits) -> Fit:
    """Fit with all effects found; those with which it fails are removed, the newest first."""
    while search.reported:
        try:
            return fits.of(search.reported)
        except FAILURES as failure:
            fits.forget()
            search.remove_failed(search.reported[-1], failure)
    return fits.first


def _steps(search: EffectSearch, fits: StepFits, last: Fit, simulate: bool, stages: Stages) -> list[DiagnosisStep]:
    """Steps of the diagnosis, with the nonlinear parameters of the final model."""
    steps: list[DiagnosisStep] = []
    previous = fits.first
    before = errors_of_fit(fits.first)
    for count, effect in enumerate(search.reported, 1):
        current = last
        if count < len(search.reported):
            fit_first = partial(fits.of, search.reported[:count])
            current = stages.run("the error of a step", fit_first, last, is_short=True)
        after = errors_of_fit(current)
        if simulate and current is not last:
            theta = current.estimate.theta
            errors_with_simulation = partial(evaluate_errors, current.experiment, theta, True, search.progress)
            after = stages.run("the simulation", errors_with_simulation, after)
        step = _step(
            effect=effect,
            search=search,
            last=last,
            previous=previous,
            current=current,
            errors_before=before,
            errors_after=after,
            stages=stages,
        )
        steps.append(step)
        previous = current
        before = after
    return steps


def _step(
    effect: AddedEffect,
    search: EffectSearch,
    last: Fit,
    previous: Fit,
    current: Fit,
    errors_before: ErrorSummary,
    errors_after: ErrorSummary,
    stages: Stages,
) -> DiagnosisStep:
    """Step that adds an effect; ``previous`` and ``current`` are the fits without and with it, ``last`` the final."""
    models = (previous.experiment, previous.estimate.theta, current.experiment, current.estimate.theta)
    locate = partial(localize_residual, *models, search.progress)
    nowhere = ResidualLocation((effect.chosen.target,) if effect.chosen.joint else (), (), "")
    location = stages.run("the location of a residual", locate, nowhere)
    draw = partial(effect_profile, effect.entry, *models, search.progress)
    profile = stages.run("the picture of a step", draw, None)
    parameters, errors = _parameters(effect, last)
    selection = effect.selection
    alike = [fitted_record(candidate, selection.base) for candidate in selection.indistinguishable]
    experiment = current.experiment
    distinguishing = distinguishing_experiment(effect.chosen, alike[0], experiment) if alike else ""
    step = DiagnosisStep(
        chosen=effect.chosen,
        entry=effect.entry,
        parameters=parameters,
        standard_error=errors,
        location=location,
        significance=effect.chosen.significance,
        pair=bool(alike),
        distinguishing_experiment=distinguishing,
        alternatives=selection.alternatives(),
        rejected=selection.rejected,
        before=errors_before,
        after=errors_after,
        sentence="",
        profile=profile,
        is_assumed=effect.is_assumed,
    )
    return replace(step, sentence=step_sentence(step, experiment.model))


def _parameters(effect: AddedEffect, last: Fit) -> tuple[dict[str, object], dict[str, object]]:
    """Values and standard errors of an effect's parameters by name, in the final model."""
    values: dict[str, object] = {}
    errors: dict[str, object] = {}
    for name, value in effect.entry.values.items():
        values[name] = value
        errors[name] = _nonlinear_error(effect, name, value)
    for name, (value, error) in last.effect_parameters(effect.entry).items():
        values[name] = value
        errors[name] = error
    return values, errors


def _nonlinear_error(effect: AddedEffect, name: str, value: object) -> object:
    """Standard error of a nonlinear parameter, or of each element of a list; None if it is not known."""
    if isinstance(value, list):
        errors = [_finite_error(effect, f"{name}.{k}") for k in range(len(value))]
        if any(error is not None for error in errors):
            return errors
    return _finite_error(effect, name)


def _finite_error(effect: AddedEffect, name: str) -> float | None:
    """Standard error of a nonlinear number; None if it is not known, or the data do not determine the number."""
    error = effect.errors.get(name, np.inf)
    return error if np.isfinite(error) else None


def _unknown_steps(
    search: EffectSearch, remaining: RemainingResidual, last: Fit, stages: Stages
) -> list[DiagnosisStep]:
    """Steps of the joints whose residual is above the noise floor, or has structure that no effect explains."""
    is_unexplained = remaining.is_unexplained(search.current.rms_torque)
    unknown = [candidate for candidate, is_step in zip(remaining.structure, is_unexplained, strict=True) if is_step]
    if not unknown:
        return []

    floor = dict(zip(last.experiment.equation.joints, remaining.floor.rms.tolist(), strict=True))
    locate = partial(localize_unexplained, last.experiment, last.estimate.theta, floor, search.progress)
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
        steps.append(replace(step, sentence=step_sentence(step, last.experiment.model)))
    return steps


def _doubt_notices(steps: Sequence[DiagnosisStep]) -> Iterator[Notice]:
    """Notices about reasons to doubt the effects that were added."""
    for step in steps:
        if step.doubt:
            yield Notice("effect_doubtful", "warning", None, step.doubt)


def _held_out_notices(search: EffectSearch, unknown_steps: Sequence[DiagnosisStep]) -> tuple[Notice, ...]:
    """Notice about joints with an unknown residual of which the training data contain nothing."""
    if not unknown_steps or not search.current.experiment.has_held_out:
        return ()
    quiet = quiet_joints(search.current, search.progress)
    joints = [step.chosen.target for step in unknown_steps if step.chosen.target in quiet]
    if not joints:
        return ()
    where = join_names(joints)
    message = f"the held-out data disagree with the model on {where}, but the training data do not show why"
    advice = "give another log, or another --holdout: the training data need such motion and torque too"
    return (Notice("only_held_out_disagrees", "warning", None, message, advice),)


def _short_data_notices(remaining: RemainingResidual) -> Iterator[Notice]:
    """Notice about data in which the noise cannot be estimated."""
    if not remaining.floor.is_estimated:
        message = "the noise floor is not known: the joints move for too short a time to estimate the noise"
        yield Notice("noise_floor_unknown", "warning", None, message, "log for longer; 30 s are usually enough")


def _search_notices(search: EffectSearch) -> Iterator[Notice]:
    """Notices about the search."""
    for effect in search.added:
        if not is_reportable(effect.entry.effect):
            yield Notice(
                "effect_fitted_along",
                "note",
                effect.entry.joint,
                fitted_along_sentence(effect.entry, search.current.experiment.model),
            )
    added = {(effect.chosen.effect, effect.chosen.target) for effect in search.added}
    for (effect_id, target), reason in search.failed.items():
        if (effect_id, target) not in added:
            yield Notice("effect_failed", "warning", None, f"{effect_name(effect_id)} on {target} {reason}")
    if search.stopped:
        yield _stopped_notice(search)
    if search.reversal_joints:
        sizes = []
        for name, (rms, rms_away) in search.reversal_joints.items():
            sizes.append(f"{name} ({short_number(rms)} RMS with these samples, {short_number(rms_away)} without)")
        message = (
            f"within {1e3 * REVERSAL_MARGIN:.0f} ms of reversals, friction does not follow Coulomb's law on "
            f"{', '.join(sizes)}, as if a simulator smoothed the friction; these samples were excluded in the last "
            "steps of the search"
        )
        yield Notice("reversals_left_aside", "warning", None, message)


def _stopped_notice(search: EffectSearch) -> Notice:
    """Notice about a search that ended before it was complete."""
    if not search.reported:
        found = "no effect had been found by then"
    elif len(search.reported) == 1:
        found = "the effect found by then is reported"
    else:
        found = "the effects found by then are reported"
    return Notice("search_interrupted", "warning", None, f"{search.stopped}; {found}", search.advice)


def _verdict(steps: Sequence[DiagnosisStep], is_floor_known: bool, is_complete: bool) -> Verdict:
    """Verdict; nothing agrees as long as the noise floor is not known, nor is all explained by half a search."""
    has_named = any(step.entry is not None for step in steps)
    has_unknown = any(step.entry is None for step in steps)
    has_doubt = any(step.doubt for step in steps)
    if not has_named:
        return "unexplained" if has_unknown or not is_floor_known else "no_disagreement"
    is_explained = is_floor_known and is_complete and not (has_unknown or has_doubt)
    return "explained" if is_explained else "partly_explained"

"""One round of the search: all candidates are screened to first order, and the best are fitted with the whole model.

`model_selection` chooses among them.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.diagnosis.held_out_error import held_out_mean_squares
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import (
    MIN_SHARE,
    MIN_SIGNIFICANCE,
    FittedCandidate,
    ProbeKey,
    SelectionStep,
    best_by_key,
    block_gains,
    is_reportable,
    probe_key,
    screened_record,
    select_best,
)
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import ScreenedProbe, screen_probes
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import (
    FAILURES,
    TrialFit,
    failure_reason,
    fit_trial,
    has_fixed_inertia,
    parameter_value,
)
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.data_summary import Burst, DataSummary
from idtool.dynamics.effects.probe import Probe
from idtool.estimation.dataset.experiment import Progress

Bursts = tuple[Burst, ...]

_REFINED = 7  # candidates that are tried on a finer grid
_MAX_FINALISTS = 5  # candidates that are fitted with the whole model
_MIN_FINALIST_GAIN = 0.4  # of the best gain
_MAX_VALIDATION_RATIO = 1.01  # ratio of the squared residuals of held-out data, with an effect and without it
_MAX_LOSS = 0.2  # of its gains in some blocks, that an effect may lose in others
MIN_PARAMETER_SIGNIFICANCE = 2.5  # standard errors that a nonlinear parameter is at least from zero
_MIN_SAVED_SHARE = 1e-4  # of a joint's squared residual without any effect: those found are known no better
_NEGLIGIBLE = 3e-3  # of a joint's rms torque: a smaller residual counts as zero
_RANGE_EDGE = 1.02  # ratio to a range's end, up to which a value is at the end
_AT_BOUND = 1e-9  # distance from a bound, up to which a coefficient is at it
_MAX_STEPS = 5  # of the fit of a candidate for which one step is not enough
_FINE_VALUES = 7  # between the neighbours of a value in the grid


def find_best_effect(
    base: LinearizedFit,
    initial: LinearizedFit,
    progress: Progress,
    effects: Sequence[str] | None,
    bursts: Bursts = (),
    min_share: float = MIN_SHARE,
    skipped: Container[ProbeKey] = (),
) -> SelectionStep:
    """Search for the effect that explains most of a model's residual: one round.

    Parameters
    ----------
    base
        The model.
    initial
        The model without any of the effects found.
    progress
        Callback for the stage and its progress, from 0 to 1.
    effects
        Ids of the effects to try; None: all.
    bursts
        Time intervals in which the residual is unusually large.
    min_share
        Share of a joint's squared residual that an effect must explain.
    skipped
        Keys of candidates that are not tried.
    """
    summary = summarize_data(base, bursts, has_fixed_inertia(base.experiment))
    candidates, failed = _candidate_probes(summary, effects)
    probes = [probe for probe in candidates if probe_key(probe) not in skipped]
    screened = screen_probes(base, probes, progress)
    failed += _screening_failures(base, screened)
    inflation = _median_inflation(base, screened)
    best = best_by_key(_promising(screened))
    to_refine = _by_gain(best.values())[:_REFINED]
    refined = screen_probes(base, list(_refined_probes(to_refine, screened)), progress, "fitting candidates")
    best = best_by_key([*best.values(), *_promising(refined)])

    finalists: list[FittedCandidate] = []
    rejected: list[Candidate] = []
    for candidate in _by_gain(best.values())[:_MAX_FINALISTS]:
        best_gain = max((finalist.screened.gain for finalist in finalists), default=0.0)
        if candidate.gain < max(MIN_SIGNIFICANCE**2 * inflation, _MIN_FINALIST_GAIN * best_gain):
            break
        try:
            finalist, objection = _fit_and_judge(candidate, base, initial, summary, progress)
        except FAILURES as failure:
            failed.append(screened_record(candidate, base, not_fitted_reason(failure)))
            continue
        if objection:
            rejected.append(screened_record(candidate, base, objection))
        else:
            finalists.append(finalist)
    finalists.sort(key=lambda finalist: -finalist.gain)
    step = select_best(base, finalists, [*rejected, *failed], screened, inflation, progress, min_share)
    return replace(step, failed=tuple(candidate for candidate in failed if is_reportable(candidate.effect)))


def _fit_and_judge(
    candidate: ScreenedProbe, base: LinearizedFit, initial: LinearizedFit, summary: DataSummary, progress: Progress
) -> tuple[FittedCandidate, str]:
    """Candidate fitted with the whole model, and the reason why it is no explanation; empty if it may be one."""
    fitted = _fit_candidate(base, candidate, progress)
    objection = _objection(fitted, base, initial, summary)
    neighbours = _movable_on_joint(base, candidate.probe.joint)
    if objection and neighbours:  # without the candidate, their parameters may have imitated it
        try:
            refitted = _fit_candidate(base, candidate, progress, neighbours)
        except FAILURES:
            return fitted, objection
        return refitted, _objection(refitted, base, initial, summary)
    return fitted, objection


def fit_assumed_effect(
    base: LinearizedFit, progress: Progress, effect: str, target: str | None, bursts: Bursts = ()
) -> SelectionStep:
    """Fit of an effect where it explains most, however little that is.

    Parameters
    ----------
    base
        The model.
    progress
        Callback for the stage and its progress, from 0 to 1.
    effect
        Id of the effect.
    target
        The joint or link; None: any.
    bursts
        Time intervals in which the residual is unusually large.
    """
    summary = summarize_data(base, bursts, has_fixed_inertia(base.experiment))
    candidates, _ = _candidate_probes(summary, (effect,))
    probes = [probe for probe in candidates if probe.effect == effect]  # unreported ones are among the candidates
    if target is not None:
        probes = [probe for probe in probes if probe.subject[1] == target]
    screened = screen_probes(base, probes, progress)
    winner = None
    for candidate in sorted(screened, key=lambda one: (not one.is_possible, -one.gain)):
        try:
            winner = _fit_candidate(base, candidate, progress)
        except FAILURES:
            continue
        break
    return SelectionStep(base, winner, (), (), (), _median_inflation(base, screened))


def _candidate_probes(summary: DataSummary, effects: Sequence[str] | None) -> tuple[list[Probe], list[Candidate]]:
    """Hypotheses of all effects that may be missing, and the effects that cannot be tried, with reasons.

    Effects that are fitted without being reported are always among them.
    """
    kinds = {}
    for id, kind in effect_types().items():
        if effects is None or id in effects or not kind.reportable:
            kinds[id] = kind
    probes: list[Probe] = []
    failed = []
    for kind in kinds.values():
        required = [effect for effect in kind.requires if effect in kinds]
        try:
            own = list(kind.probes(summary))
        except FAILURES as failure:
            failed.append(Candidate(kind.id, None, None, 0.0, 0.0, 0, not_fitted_reason(failure)))
            continue
        for probe in own:
            _, owner = probe.subject
            if not required or any(summary.has_effect(effect, owner) for effect in required):
                probes.append(probe)
    return probes, failed


def _screening_failures(base: LinearizedFit, screened: Sequence[ScreenedProbe]) -> list[Candidate]:
    """Effects of which no probe could be evaluated, with the reason of the first."""
    evaluated = {probe_key(one.probe) for one in screened if not one.failure}
    failures: dict[ProbeKey, Candidate] = {}
    for one in screened:
        key = probe_key(one.probe)
        if one.failure and key not in evaluated and key not in failures:
            failures[key] = screened_record(one, base, not_fitted_reason(one.failure))
    return list(failures.values())


def _median_inflation(base: LinearizedFit, screened: Iterable[ScreenedProbe]) -> float:
    """Median inflation over all probes, at least that of white noise through the filter."""
    redundancy = base.experiment.runs[0].signals.low_pass.redundancy
    inflations = [probe.inflation for probe in screened if np.isfinite(probe.inflation) and probe.inflation > 0]
    return float(max(np.median(inflations), redundancy)) if inflations else redundancy


def _promising(screened: Iterable[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes that explain something and that physics allows."""
    return [candidate for candidate in screened if candidate.is_possible and candidate.gain > 0]


def _by_gain(screened: Iterable[ScreenedProbe]) -> list[ScreenedProbe]:
    return sorted(screened, key=lambda candidate: -candidate.gain)


def _refined_probes(candidates: Sequence[ScreenedProbe], screened: Sequence[ScreenedProbe]) -> Iterator[Probe]:
    """Probes at nonlinear values about those of the candidates, up to the next ones that were screened."""
    for candidate in candidates:
        probe = candidate.probe
        alike = [other.probe for other in screened if probe_key(other.probe) == probe_key(probe)]
        joint_parameters = effect_types()[probe.effect].joint_parameters()
        for name, value in probe.nonlinear_values.items():
            grid = sorted({other.nonlinear_values[name] for other in alike})
            if name in joint_parameters or len(grid) == 1:
                continue
            position = grid.index(value)
            low = grid[max(position - 1, 0)]
            high = grid[min(position + 1, len(grid) - 1)]
            spaced = np.geomspace if low > 0 else np.linspace
            for refined in spaced(low, high, _FINE_VALUES + 2)[1:-1]:
                yield probe.at({**probe.nonlinear_values, name: float(refined)})


def _fit_candidate(
    base: LinearizedFit, candidate: ScreenedProbe, progress: Progress, neighbours: Sequence[int] = ()
) -> FittedCandidate:
    """Candidate fitted with the whole model; raises as `fit_trial`, and if there is no such effect.

    Parameters
    ----------
    base
        The model.
    candidate
        The candidate.
    progress
        Callback for the stage and its progress, from 0 to 1.
    neighbours
        Indices of the model's effects whose nonlinear parameters are moved with those of the candidate.
    """
    if candidate.entry is None:
        raise ConfigError("effects", "its parameters are out of range")
    entries = (*base.experiment.config.effects, candidate.entry)
    moving = [*neighbours, len(entries) - 1]
    trial = fit_trial(base, entries, moving, progress, _MAX_STEPS if neighbours else 1)
    if _undetermined_parameter(trial):  # it may be determined closer to the optimum
        trial = fit_trial(base, trial.entries, moving, progress, _MAX_STEPS)
    return FittedCandidate(candidate, trial, block_gains(base, trial.linearized))


def _movable_on_joint(base: LinearizedFit, joint: str | None) -> list[int]:
    """Indices of the model's effects on a joint that have nonlinear parameters to move along a gradient."""
    movable = []
    for i, entry in enumerate(base.experiment.config.effects):
        if joint is not None and entry.joint == joint and effect_types()[entry.effect].gradient_parameters():
            movable.append(i)
    return movable


def not_fitted_reason(failure: Exception) -> str:
    """Reason why a candidate that cannot be fitted was rejected."""
    return f"cannot be fitted together with the rest of the model: {failure_reason(failure)}"


def _objection(candidate: FittedCandidate, base: LinearizedFit, initial: LinearizedFit, summary: DataSummary) -> str:
    """Reason why a fitted candidate is no explanation; empty if it may be one."""
    fit = candidate.trial.linearized
    if reason := _implausibility(candidate, summary):
        return reason
    if not _is_within_bounds(fit, base):
        return "reaches its bounds when fitted with the rest of the model"
    if parameter := _undetermined_parameter(candidate.trial):
        return f"its {parameter} is not determined by the data"
    loss = -np.minimum(candidate.gains, 0).sum()
    if loss > _MAX_LOSS * np.maximum(candidate.gains, 0).sum():
        return "reduces the error in some parts of the log and increases it in others"
    if _worsens_validation(candidate, base):
        return "increases the error on the held-out data"
    if not _is_relevant(fit, base, initial):
        return (
            "explains less than the uncertainty of the effects that were found before, or only a negligible part of "
            "the torque"
        )
    return ""


def _implausibility(candidate: FittedCandidate, summary: DataSummary) -> str:
    """Reason why no robot has such an effect, as a clause; empty if one may."""
    fit = candidate.trial.linearized
    entry = candidate.trial.entries[-1]
    values = dict(entry.values)
    found = fit.find_effect(entry)
    if found is not None:
        effect, part = found
        theta = fit.estimate.theta[part]
        unknown_covariance = np.full((len(theta), len(theta)), np.inf)
        linear = effect.parameters(theta, unknown_covariance)
        values |= {name: value for name, (value, _) in linear.items()}
    return effect_types()[entry.effect].implausibility(values, entry.joint, summary)


def _worsens_validation(candidate: FittedCandidate, base: LinearizedFit) -> bool:
    """True if an effect increases the error on held-out data of the joints it acts on; False without such data."""
    equation = candidate.trial.linearized.experiment.equation
    joint = candidate.probe.joint
    is_reached = [joint is None or name == joint for name in equation.joints]
    variance = np.square(base.noise)
    with_effect = held_out_mean_squares(candidate.trial.linearized, equation) / variance
    without = held_out_mean_squares(base, equation) / variance
    # False without held-out data, where both are NaN
    return bool(with_effect[is_reached].sum() > _MAX_VALIDATION_RATIO * without[is_reached].sum())


def _undetermined_parameter(trial: TrialFit) -> str:
    """First nonlinear parameter of the newest effect with too large an error or at an end of its range; empty if none.

    Optional and open-ended parameters need not be determined.
    """
    last = len(trial.entries) - 1
    entry = trial.entries[last]
    for parameter in effect_types()[entry.effect].nonlinear_parameters:
        error = trial.errors.get((last, parameter.name))
        value = parameter_value(entry, parameter.name)
        if error is None or not isinstance(value, float):
            continue
        if parameter.open_ended or parameter.optional_maximum is not None:
            continue
        max_error = np.inf
        if parameter.max_standard_error is not None:
            max_error = parameter.max_standard_error
        elif parameter.positive:
            max_error = value / MIN_PARAMETER_SIGNIFICANCE
        low, high = trial.ranges.get((last, parameter.name), (-np.inf, np.inf))
        is_inside = low * _RANGE_EDGE < value < high / _RANGE_EDGE
        if not (error < max_error and is_inside):
            return parameter.name
    return ""


def _is_within_bounds(fit: LinearizedFit, base: LinearizedFit) -> bool:
    """True if, fitted as a whole, the new coefficients are within their bounds, and not all at the lower one.

    One with every coefficient at its lower bound is not there at all.
    """
    base_keys = {c.key for c in base.experiment.equation.coefficients}
    new = []
    for c, value in zip(fit.experiment.equation.coefficients, fit.estimate.theta, strict=True):
        if c.key not in base_keys:
            new.append((c, value))
    if not new:
        return True
    is_present = any(value > c.lower + _AT_BOUND for c, value in new)
    return is_present and all(value < c.upper for c, value in new)


def _is_relevant(fit: LinearizedFit, base: LinearizedFit, initial: LinearizedFit) -> bool:
    """True if on some joint an effect explains more than what the effects found before leave by their uncertainty.

    A strong effect whose size is known to a hundredth leaves a hundredth of itself, which is no effect of its own.
    """
    saved = (base.sse - fit.sse).sum(axis=0) * np.square(base.noise)
    uncertain = _MIN_SAVED_SHARE * initial.sse.sum(axis=0) * np.square(initial.noise)
    negligible = base.row_counts.sum(axis=0) * np.square(_NEGLIGIBLE * base.rms_torque)
    return bool((saved > np.maximum(uncertain, negligible)).any())

"""One round of the search: all candidates are screened to first order, and the best are fitted with the whole model.

`model_selection` chooses among them.

The *gain* of a candidate is the reduction of the squared residual by it in cross-validation, summed over the blocks of
time that are left out in turn, in units of the noise variance. Rows that follow one another are correlated: *inflation*
is the number of rows that are worth one independent row. A gain by chance is that many times larger than with
independent rows.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.diagnosis.held_out_error import held_out_mean_squares, lowers_held_out_likelihood
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import (
    MIN_SHARE,
    MIN_SIGNIFICANCE,
    FittedCandidate,
    FullFits,
    ProbeKey,
    Screening,
    SelectionStep,
    best_by_key,
    block_gains,
    is_reportable,
    probe_key,
    screened_record,
    select_best,
)
from idtool.diagnosis.noise_gain import noise_gain_with_probe
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
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import Probe
from idtool.estimation.dataset.experiment import Progress

Bursts = tuple[Burst, ...]

_MAX_REFINED = 7  # candidates that are screened again on a finer grid
_STARTS_ON_GRID = 3  # probes that are refined of a candidate whose residual jumps with its parameters
_REFINEMENTS = 2  # times, since the best value of a parameter depends on that of another
_REFINEMENT_POINTS = 7  # values that are screened again between the neighbours of a value in the grid
_MAX_FULL_FITS = 5  # candidates that are fitted with the whole model, those that are then rejected included
_MIN_GAIN_RATIO = 0.4  # to the gain of the best accepted candidate, for a candidate to be fitted
_MIN_FIRST_ORDER_GAIN_RATIO = 0.2  # likewise, where a fit may explain much more than the screening
_MAX_GAUSS_NEWTON_STEPS = 5  # of the fit of a candidate for which one step is not enough
_MAX_HELD_OUT_RATIO = 1.01  # ratio of the squared residuals of held-out data, with an effect and without it
_MAX_LOSS_SHARE = 0.2  # of its gains in some blocks, that an effect may lose in others
MIN_PARAMETER_SIGNIFICANCE = 2.5  # standard errors that a nonlinear parameter is at least from zero
# of a joint's squared residual without any effect: the effects found are assumed accurate to 1 %, squared 1e-4
_MIN_SAVED_SHARE = 1e-4
_MIN_SHARE_OF_TORQUE = 5e-3  # of a joint's rms torque, that an effect must have to be named
_MIN_SHARE_FITTED_ALONG = 3e-3  # likewise, to be only included in the fit
_RANGE_EDGE_RATIO = 1.02  # ratio to an end of a range, up to which a value is at that end
_BOUND_TOLERANCE = 1e-9  # distance from a bound, up to which a coefficient is at it


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
    screening = _screen_all(base, summary, effects, skipped, progress)
    candidates = _refine(base, screening.screened, progress)
    fits = _fit_best_candidates(base, initial, candidates, summary, screening.inflation, progress)
    return select_best(base, screening, fits, progress, min_share)


def _screen_all(
    base: LinearizedFit,
    summary: DataSummary,
    effects: Sequence[str] | None,
    skipped: Container[ProbeKey],
    progress: Progress,
) -> Screening:
    """All candidates but the skipped ones, screened on the effects' own grids of nonlinear values."""
    candidates, not_built = _candidate_probes(summary, effects)
    probes = [probe for probe in candidates if probe_key(probe) not in skipped]
    screened = screen_probes(base, probes, progress)
    failed = [*not_built, *_screening_failures(base, screened)]
    return Screening(screened, failed, _row_inflation(base, screened))


def _refine(base: LinearizedFit, screened: Sequence[ScreenedProbe], progress: Progress) -> list[ScreenedProbe]:
    """Best probe of each promising candidate, the largest gain first; the best candidates on a finer grid."""
    promising = _promising(screened)
    refined: list[ScreenedProbe] = []
    for _ in range(_REFINEMENTS):
        starts = [start for start in _refinement_starts(promising) if start not in refined]
        finer_probes = list(_refined_probes(starts, screened))
        promising += _promising(screen_probes(base, finer_probes, progress, "fitting candidates"))
        refined += starts
    return _by_gain(best_by_key(promising).values())


def _refinement_starts(promising: Sequence[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes about which the grid is refined: the best of each of the best candidates.

    Of a candidate whose residual jumps with its parameters, there are several, since a coarse grid may miss the best.
    """
    starts = []
    for best in _by_gain(best_by_key(promising).values())[:_MAX_REFINED]:
        key = probe_key(best.probe)
        of_candidate = _by_gain(one for one in promising if probe_key(one.probe) == key)
        count = _STARTS_ON_GRID if _is_searched_on_grid(best.probe.effect) else 1
        starts += of_candidate[:count]
    return starts


def _is_searched_on_grid(effect: str) -> bool:
    """True if the residual jumps with parameters of an effect, so that they are searched for on a grid."""
    kind = effect_types()[effect]
    return issubclass(kind, JointEffect) and bool(kind.grid_parameters())


def _fit_best_candidates(
    base: LinearizedFit,
    initial: LinearizedFit,
    candidates: Sequence[ScreenedProbe],
    summary: DataSummary,
    inflation: float,
    progress: Progress,
) -> FullFits:
    """Candidates fitted with the whole model, until their gain is due to chance or far below that of an accepted one.

    Parameters
    ----------
    base, initial
        The model, and the model without any of the effects found.
    candidates
        The candidates, the largest gain first.
    summary
        The robot and its data.
    inflation
        Number of rows that are worth one independent row.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    finalists: list[FittedCandidate] = []
    rejected: list[Candidate] = []
    failed: list[Candidate] = []
    min_gain = MIN_SIGNIFICANCE**2 * inflation
    significant = []
    for candidate in candidates:
        if candidate.gain < min_gain:
            break
        true_gain = _without_cancelled_noise(candidate, base)
        if true_gain.gain < min_gain:
            rejected.append(screened_record(candidate, base, "explains only noise of the measured torque"))
        else:
            significant.append(true_gain)

    best_gain = 0.0
    for candidate in _by_gain(significant)[:_MAX_FULL_FITS]:
        if candidate.gain < _min_gain_ratio(candidate) * best_gain:
            continue
        try:
            fitted, objection = _fit_and_judge(candidate, base, initial, summary, progress)
        except FAILURES as failure:
            failed.append(screened_record(candidate, base, not_fitted_reason(failure)))
            continue
        if objection:
            rejected.append(screened_record(candidate, base, objection))
        else:
            finalists.append(fitted)
            best_gain = max(best_gain, candidate.gain)
    finalists.sort(key=lambda finalist: -finalist.gain)
    return FullFits(finalists, rejected, failed)


def _min_gain_ratio(candidate: ScreenedProbe) -> float:
    """Least ratio of a candidate's gain to that of the best accepted one, for it to be fitted."""
    is_first_order = effect_types()[candidate.probe.effect].is_screened_to_first_order
    return _MIN_FIRST_ORDER_GAIN_RATIO if is_first_order else _MIN_GAIN_RATIO


def _without_cancelled_noise(candidate: ScreenedProbe, base: LinearizedFit) -> ScreenedProbe:
    """Candidate with the most that its gains can be without noise of the measured torque that it cancels."""
    if not effect_types()[candidate.probe.effect].uses_measured_torque:
        return candidate
    noise_gain = noise_gain_with_probe(base.experiment, base.theta, base.noise, candidate.probe, candidate.c)
    # the rest of a joint's squared residual, in units of the noise that is left with the candidate
    least_sse = np.maximum(base.sse - np.maximum(candidate.gains, 0)[:, None], 0)
    loss = least_sse @ (1 / np.square(noise_gain) - 1)
    return replace(candidate, gains=candidate.gains - loss)


def _fit_and_judge(
    candidate: ScreenedProbe, base: LinearizedFit, initial: LinearizedFit, summary: DataSummary, progress: Progress
) -> tuple[FittedCandidate, str]:
    """Candidate fitted with the whole model, and the reason why it is rejected, as a clause; empty if it is accepted.

    A candidate that would be rejected is fitted again together with the nonlinear parameters of the other effects on
    its joint: these were found without the candidate, and may imitate it.
    """
    fitted = _fit_candidate(base, candidate, progress)
    objection = _objection(fitted, base, initial, summary)
    others = _movable_on_joint(base, candidate.probe.joint)
    if not objection or not others:
        return fitted, objection
    try:
        refitted = _fit_candidate(base, candidate, progress, others)
    except FAILURES:
        return fitted, objection
    return refitted, _objection(refitted, base, initial, summary)


def fit_assumed_effect(
    base: LinearizedFit, progress: Progress, effect: str, target: str | None, bursts: Bursts = ()
) -> SelectionStep:
    """Fit one given effect at the joint or link where it explains most, without requiring that it explain anything.

    Its nonlinear values are not screened on a finer grid, which serves the comparison of candidates: the fit moves them
    from the best values of the grid.

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
            break
        except FAILURES:
            continue
    return SelectionStep(base, winner, (), (), (), _row_inflation(base, screened))


def _candidate_probes(summary: DataSummary, effects: Sequence[str] | None) -> tuple[list[Probe], list[Candidate]]:
    """Probes of all effects that may be missing, and records of the effects whose probes cannot be built.

    Effects that are fitted without being reported are always among them.

    Parameters
    ----------
    summary
        The robot and its data.
    effects
        Ids of the effects to try; None: all.
    """
    searched = {}
    for effect_id, effect_type in effect_types().items():
        if effects is None or effect_id in effects or not effect_type.reportable:
            searched[effect_id] = effect_type
    probes: list[Probe] = []
    failed = []
    for effect_type in searched.values():
        # an effect outside the search would never be added: waiting for it would exclude the one that requires it
        required = [effect for effect in effect_type.requires if effect in searched]
        try:
            effect_probes = list(effect_type.probes(summary))
        except FAILURES as failure:
            failed.append(Candidate(effect_type.id, None, None, 0.0, 0.0, 0, not_fitted_reason(failure)))
            continue
        for probe in effect_probes:
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


def _row_inflation(base: LinearizedFit, screened: Iterable[ScreenedProbe]) -> float:
    """Number of rows that are worth one independent row: the median over all probes.

    It is at least that of white noise after the filter.
    """
    redundancy = base.experiment.runs[0].signals.low_pass.redundancy
    inflations = [probe.inflation for probe in screened if np.isfinite(probe.inflation) and probe.inflation > 0]
    return float(max(np.median(inflations), redundancy)) if inflations else redundancy


def _promising(screened: Iterable[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes that explain something and that physics allows."""
    return [candidate for candidate in screened if candidate.is_possible and candidate.gain > 0]


def _by_gain(screened: Iterable[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes in the order of their gains, the largest first."""
    return sorted(screened, key=lambda candidate: -candidate.gain)


def _refined_probes(candidates: Sequence[ScreenedProbe], screened: Sequence[ScreenedProbe]) -> Iterator[Probe]:
    """Probes of the candidates on a finer grid: of each, with one nonlinear value changed at a time.

    A parameter that names another joint, one of which a single value was screened, and one whose value is not of the
    grid any more, is not changed.

    Parameters
    ----------
    candidates
        The candidates.
    screened
        All probes that were screened: their values are the grid.
    """
    for candidate in candidates:
        probe = candidate.probe
        alike = [other.probe for other in screened if probe_key(other.probe) == probe_key(probe)]
        joint_parameters = effect_types()[probe.effect].joint_parameters()
        for name, value in probe.nonlinear_values.items():
            grid = sorted({other.nonlinear_values[name] for other in alike})
            if name in joint_parameters or len(grid) == 1 or value not in grid:
                continue
            for refined in _refined_values(value, grid):
                yield probe.at({**probe.nonlinear_values, name: refined})


def _refined_values(value: float, grid: Sequence[float]) -> list[float]:
    """Values between the neighbours of a value in an ascending grid; at an end of the grid, it is its own neighbour."""
    position = grid.index(value)
    low = grid[max(position - 1, 0)]
    high = grid[min(position + 1, len(grid) - 1)]
    spaced = np.geomspace if low > 0 else np.linspace
    inner = spaced(low, high, _REFINEMENT_POINTS + 2)[1:-1]
    return [float(x) for x in inner]


def _fit_candidate(
    base: LinearizedFit, candidate: ScreenedProbe, progress: Progress, others: Sequence[int] = ()
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
    others
        Indices of the model's effects whose nonlinear parameters are moved with those of the candidate.
    """
    if candidate.entry is None:
        raise ConfigError("effects", "its parameters are out of range")
    entries = (*base.experiment.config.effects, candidate.entry)
    moving = [*others, len(entries) - 1]
    trial = fit_trial(base, entries, moving, progress, max_steps=_MAX_GAUSS_NEWTON_STEPS if others else 1)
    if _undetermined_parameter(trial):  # it may be determined closer to the optimum
        trial = fit_trial(base, trial.entries, moving, progress, max_steps=_MAX_GAUSS_NEWTON_STEPS)
    return FittedCandidate(candidate, trial, block_gains(base, trial.linearized))


def _movable_on_joint(base: LinearizedFit, joint: str | None) -> list[int]:
    """Indices of the model's effects on a joint that have nonlinear parameters to move along a gradient."""
    movable = []
    for i, entry in enumerate(base.experiment.config.effects):
        if joint is not None and entry.joint == joint and effect_types()[entry.effect].gradient_parameters():
            movable.append(i)
    return movable


def not_fitted_reason(failure: Exception) -> str:
    """Reason why a candidate is rejected that cannot be fitted, as a clause."""
    return f"cannot be fitted together with the rest of the model: {failure_reason(failure)}"


def _objection(candidate: FittedCandidate, base: LinearizedFit, initial: LinearizedFit, summary: DataSummary) -> str:
    """Reason why the fitted candidate is rejected, as a clause; empty if it is accepted."""
    fit = candidate.trial.linearized
    if reason := _implausibility(candidate, summary):
        return reason
    if not _is_within_bounds(fit, base):
        return "reaches its bounds when fitted with the rest of the model"
    if parameter := _undetermined_parameter(candidate.trial):
        return f"its {parameter} is not determined by the data"
    loss = -np.minimum(candidate.gains, 0).sum()
    if loss > _MAX_LOSS_SHARE * np.maximum(candidate.gains, 0).sum():
        return "reduces the error in some parts of the log and increases it in others"
    if _worsens_held_out_error(candidate, base):
        return "increases the error on the held-out data"
    min_share = _MIN_SHARE_OF_TORQUE if is_reportable(candidate.probe.effect) else _MIN_SHARE_FITTED_ALONG
    if not _is_relevant(fit, base, initial, min_share):
        return (
            "explains less than the uncertainty of the effects that were found before, or only a negligible part of "
            "the torque"
        )
    return ""


def _implausibility(candidate: FittedCandidate, summary: DataSummary) -> str:
    """Reason why the fitted candidate is rejected as one that no robot has, as a clause; empty if it is accepted."""
    fit = candidate.trial.linearized
    entry = candidate.trial.entries[-1]
    values = dict(entry.values)
    effect_and_slice = fit.find_effect(entry)
    if effect_and_slice is not None:
        effect, part = effect_and_slice
        theta = fit.estimate.theta[part]
        unknown_covariance = np.full((len(theta), len(theta)), np.inf)
        linear = effect.parameters(theta, unknown_covariance)
        values |= {name: value for name, (value, _) in linear.items()}
    return effect_types()[entry.effect].implausibility(values, entry.joint, summary)


def _worsens_held_out_error(candidate: FittedCandidate, base: LinearizedFit) -> bool:
    """True if an effect increases the error on held-out data of the joints it acts on; False without such data."""
    if effect_types()[candidate.probe.effect].is_undefined_where_it_acts:
        # the impacts of the teeth shake the other joints too
        return lowers_held_out_likelihood(base, candidate.trial.linearized)
    equation = candidate.trial.linearized.experiment.equation
    joint = candidate.probe.joint
    is_acted_on = [joint is None or name == joint for name in equation.joints]
    variance = np.square(base.noise)
    with_effect = held_out_mean_squares(candidate.trial.linearized, equation) / variance
    without = held_out_mean_squares(base, equation) / variance
    # False without held-out data, where both are NaN
    return bool(with_effect[is_acted_on].sum() > _MAX_HELD_OUT_RATIO * without[is_acted_on].sum())


def _undetermined_parameter(trial: TrialFit) -> str:
    """First nonlinear parameter of the newest effect that the data do not determine; empty if there is none.

    Its standard error is too large, or its value is at an end of its range. Optional and open-ended parameters need not
    be determined, and those that were not moved cannot be judged.
    """
    last = len(trial.entries) - 1
    entry = trial.entries[last]
    for parameter in effect_types()[entry.effect].nonlinear_parameters:
        key = (last, parameter.name)
        value = parameter_value(entry, parameter.name)
        need_not_be_determined = parameter.open_ended or parameter.optional_maximum is not None
        if need_not_be_determined or key not in trial.errors or not isinstance(value, float):
            continue
        is_precise = trial.errors[key] < _max_standard_error(parameter, value)
        low, high = trial.ranges.get(key, (-np.inf, np.inf))  # of these, only positive ones have one
        is_inside = low * _RANGE_EDGE_RATIO < value < high / _RANGE_EDGE_RATIO
        if not (is_precise and is_inside):
            return parameter.name
    return ""


def _max_standard_error(parameter: NonlinearParameter, value: float) -> float:
    """Standard error from which a value of a nonlinear parameter is undetermined; infinite if any finite one passes."""
    if parameter.max_standard_error is not None:
        return parameter.max_standard_error
    if parameter.positive:
        return value / MIN_PARAMETER_SIGNIFICANCE
    return np.inf


def _is_within_bounds(fit: LinearizedFit, base: LinearizedFit) -> bool:
    """True if every new coefficient is below its upper bound, and at least one is above its lower bound.

    New are those that the base does not have; True if there are none. Some may be at their lower bound, as a part of an
    effect that is absent; if all are, the effect itself is absent.
    """
    base_keys = {c.key for c in base.experiment.equation.coefficients}
    new = []
    for c, value in zip(fit.experiment.equation.coefficients, fit.estimate.theta, strict=True):
        if c.key not in base_keys:
            new.append((c, value))
    if not new:
        return True
    is_present = any(value > c.lower + _BOUND_TOLERANCE for c, value in new)
    return is_present and all(value < c.upper for c, value in new)


def _is_relevant(fit: LinearizedFit, base: LinearizedFit, initial: LinearizedFit, min_share: float) -> bool:
    """True if the squared residual of some joint falls by more than two shares of what the joint has.

    One is a share of the squared residual in the initial model: a strong effect whose size is known to a hundredth
    leaves a hundredth of itself, which is no effect of its own. The other is that of a torque of ``min_share`` of the
    joint's rms torque.
    """
    # both in units of the base's noise: a fit that uses or rescales the measured torque has another noise of its own
    saved = (base.sse - fit.sse).sum(axis=0) * np.square(base.noise)
    uncertain = _MIN_SAVED_SHARE * initial.sse.sum(axis=0) * np.square(initial.noise)
    negligible = base.row_counts.sum(axis=0) * np.square(min_share * base.rms_torque)
    return bool((saved > np.maximum(uncertain, negligible)).any())

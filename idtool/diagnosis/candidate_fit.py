"""Candidates fitted together with the whole model, and the reasons for which they are then rejected.

The screening that chose them is of first order, with the rest of the model fixed. In the fit, a candidate may turn out
to be negligible, implausible or not determined by the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.diagnosis.held_out_error import held_out_mean_squares, lowers_held_out_likelihood
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.model_selection import FittedCandidate, block_gains, is_reportable
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.diagnosis.screen import ScreenedProbe
from idtool.diagnosis.trial import FAILURES, TrialFit, fit_trial, on_rows_of, parameter_value
from idtool.dynamics.effects import NamedEffect, effect_types
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import EffectEntry

_MAX_GAUSS_NEWTON_STEPS = 5  # of the fit of a candidate for which one step is not enough
_MIN_SHARE_OF_SCREENED_GAIN = 0.8  # that a fit must reach; otherwise, other effects are fitted anew with it
MIN_REPLACING_GAIN_RATIO = 0.75  # of a candidate's screened gain to the gain of the effects that it is to replace
_MAX_HELD_OUT_RATIO = 1.01  # ratio of the squared residuals of held-out data, with an effect and without it
_MAX_LOSS_SHARE = 0.2  # largest ratio of the loss in some blocks to the gain in others
_MIN_CONCENTRATION = 4.0  # ratio of the mean squared residual where an effect is undefined to that elsewhere
_MIN_PARAMETER_SIGNIFICANCE = 2.5  # least ratio of an optional parameter to its standard error, to be kept
_ACCURACY_OF_EFFECTS = 0.01  # share of a strong effect's torque that its model leaves at best
MIN_SHARE_OF_TORQUE = 5e-3  # of its joint's rms torque, that a reported effect must explain
_MIN_SHARE_OF_TORQUE_RELAXED = 3e-3  # the same for an effect that is not reported, or that explains `NEARLY_ALL`
_MIN_SHARE_OF_TORQUE_AT_ALL = 1e-3  # the same for an effect that leaves nothing above the noise
NEARLY_ALL = 0.9  # of a joint's squared residual above its noise
_TOO_SMALL = "explains less than the uncertainty of the effects found before, or a negligible part of the torque"
_RANGE_EDGE_RATIO = 1.02  # ratio to an end of a range, within which a value counts as at that end
_BOUND_TOLERANCE = 1e-9  # distance from a bound, up to which a coefficient is at it


def fit_and_judge(
    candidate: ScreenedProbe,
    base: LinearizedFit,
    initial: LinearizedFit,
    summary: DataSummary,
    movable: Sequence[int],
    replaced_gain: float,
    progress: Progress,
) -> tuple[FittedCandidate, str]:
    """Fit of a candidate with the whole model, and the reason why it is rejected.

    The nonlinear parameters of the other effects were found without the candidate, and may imitate it. If it is
    rejected, or gains clearly less than the screening predicted, they are fitted anew together with it, unless it
    promises much less than what it is to replace. Nor are they if it gains what the screening, with these parameters
    free, predicted, and is rejected because the data do not determine its own: they would do so even less.

    Parameters
    ----------
    candidate
        The candidate.
    base, initial
        The model, and the model without any of the effects found.
    summary
        The robot and its data.
    movable
        Indices of the model's effects whose nonlinear parameters may be moved.
    replaced_gain
        Gain of the effects that it is to replace; 0: none.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    The fit, and the reason as a clause; empty if the candidate is accepted.

    Raises
    ------
    As `fit_candidate`, if the candidate cannot be fitted with the other effects as they are.
    """
    fitted = fit_candidate(base, candidate, progress)
    reason = rejection_reason(fitted, base, initial, summary, progress)
    imitators = possible_imitators(base, candidate.probe.joint, movable)
    gains_as_predicted = fitted.gain > _MIN_SHARE_OF_SCREENED_GAIN * candidate.gain
    is_undetermined = bool(_undetermined_parameter(fitted.trial, len(fitted.trial.entries) - 1, initial))
    is_final = gains_as_predicted and (not reason or is_undetermined)
    may_replace = max(fitted.gain, candidate.gain) > MIN_REPLACING_GAIN_RATIO * replaced_gain
    if is_final or not imitators or not may_replace:
        return fitted, reason
    try:
        refitted = fit_candidate(base, candidate, progress, imitators)
    except FAILURES:
        return fitted, reason
    reason_of_refitted = rejection_reason(refitted, base, initial, summary, progress)
    if reason_of_refitted and not reason:
        return fitted, reason
    return refitted, reason_of_refitted


def fit_candidate(
    base: LinearizedFit, candidate: ScreenedProbe, progress: Progress, imitators: Sequence[int] = ()
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
    imitators
        Indices of the model's effects whose nonlinear parameters are moved with those of the candidate.
    """
    if candidate.entry is None:
        raise ConfigError("effects", "its parameters are out of range")
    entries = (*base.experiment.config.effects, candidate.entry)
    newest = len(entries) - 1
    optimized = [*imitators, newest]
    max_steps = 1  # the screening has found the candidate's own values already
    if imitators:
        max_steps = _MAX_GAUSS_NEWTON_STEPS
    trial = fit_trial(base, entries, optimized, progress, max_steps=max_steps)
    if not imitators and _undetermined_parameter(trial, newest):  # it may be determined closer to the optimum
        trial = fit_trial(base, trial.entries, optimized, progress, max_steps=_MAX_GAUSS_NEWTON_STEPS)
    if _undetermined_parameter(trial, newest):  # it may be determined if there is nothing else to determine
        simpler = without_insignificant_parameters(trial.entries[-1], _errors_of_effect(trial, newest))
        if simpler is not trial.entries[-1]:
            simpler_entries = (*trial.entries[:-1], simpler)
            trial = fit_trial(base, simpler_entries, optimized, progress, max_steps=_MAX_GAUSS_NEWTON_STEPS)
    trial = on_rows_of(base, trial, progress)
    return FittedCandidate(candidate, trial, block_gains(base, trial.linearized))


def without_insignificant_parameters(entry: EffectEntry, errors: Mapping[str, float]) -> EffectEntry:
    """Entry of an effect without the optional parameters that do not differ significantly from 0.

    Parameters
    ----------
    entry
        The entry.
    errors
        Standard errors of its nonlinear parameters.

    Returns
    -------
    The same object if there are none.
    """
    undetermined = []
    for name in _optional_parameters(entry):
        least = _MIN_PARAMETER_SIGNIFICANCE * errors.get(name, 0.0)
        if not float(entry.parameters[name]) > least:
            undetermined.append(name)
    return _without(entry, undetermined)


def without_optional_parameters(entry: EffectEntry) -> EffectEntry:
    """Entry of an effect without its optional parameters; the same object if it has none."""
    return _without(entry, _optional_parameters(entry))


def _optional_parameters(entry: EffectEntry) -> list[str]:
    """Names of the optional parameters that an entry has."""
    kind = effect_types()[entry.effect]
    optional = [parameter.name for parameter in kind.nonlinear_parameters if parameter.optional_maximum is not None]
    return [name for name in optional if name in entry.parameters]


def _without(entry: EffectEntry, names: Sequence[str]) -> EffectEntry:
    """Entry without some parameters; the same object without names."""
    if not names:
        return entry
    parameters = {name: value for name, value in entry.parameters.items() if name not in names}
    return entry.model_copy(update={"parameters": parameters})


def _errors_of_effect(trial: TrialFit, index: int) -> dict[str, float]:
    """Standard errors, by name, of those nonlinear parameters of an effect that were moved.

    Parameters
    ----------
    trial
        The fit.
    index
        Index of the effect in its entries.
    """
    return {name: error for (i, name), error in trial.standard_errors.items() if i == index}


def possible_imitators(base: LinearizedFit, joint: str | None, movable: Sequence[int]) -> list[int]:
    """Indices of the effects whose parameters may have been fitted to what a candidate on a joint would explain.

    They act on the same joint or on several, and have parameters to move.

    Parameters
    ----------
    base
        The model.
    joint
        The candidate's joint; None: it acts on several.
    movable
        Indices of the model's effects whose nonlinear parameters may be moved.
    """
    imitators = []
    for i in movable:
        entry = base.experiment.config.effects[i]
        kind = effect_types()[entry.effect]
        if joint is not None and entry.joint is not None and entry.joint != joint:
            continue
        if kind.gradient_parameters() or (issubclass(kind, JointEffect) and kind.grid_parameters()):
            imitators.append(i)
    return imitators


def rejection_reason(
    candidate: FittedCandidate,
    base: LinearizedFit,
    initial: LinearizedFit,
    summary: DataSummary,
    progress: Progress,
    new_count: int = 1,
) -> str:
    """Reason why a fitted candidate is rejected, as a clause; empty if it is accepted.

    Parameters
    ----------
    candidate
        The candidate.
    base, initial
        The model without it, and the model without any of the effects found.
    summary
        The robot and its data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    new_count
        Number of effects that the model has in addition to the base: those at the end of its entries.
    """
    trial = candidate.trial
    fit = trial.linearized
    count = len(trial.entries)
    for index in range(count - new_count, count):
        reason = implausibility(fit, trial.entries[index], summary)
        if reason:
            return reason
        if not _is_present_within_bounds(fit, trial.entries[index]):
            return "reaches its bounds when fitted with the rest of the model"
        parameter = _undetermined_parameter(trial, index, initial)
        if parameter:
            return f"its {parameter} is not determined by the data"
    if effect_types()[candidate.probe.effect].is_undefined_where_it_acts:
        # its torque is known so roughly there that it may increase the error of a part
        if not _is_concentrated_where_undefined(fit, base, str(candidate.probe.joint), progress):
            return "acts where the residual is not much larger than elsewhere"
    elif _increases_error_in_parts(candidate):
        return "reduces the error in some parts of the log and increases it in others"
    if _worsens_held_out_error(candidate, base):
        return "increases the error on the held-out data"
    return _TOO_SMALL if _is_too_small(candidate, base, initial, progress) else ""


def _increases_error_in_parts(candidate: FittedCandidate) -> bool:
    """True if what an effect loses in some blocks is much beside what it gains in others."""
    loss = -np.minimum(candidate.gains, 0).sum()
    gain = np.maximum(candidate.gains, 0).sum()
    return bool(loss > _MAX_LOSS_SHARE * gain)


def _is_concentrated_where_undefined(
    fit: LinearizedFit,
    base: LinearizedFit,
    joint: str,
    progress: Progress,
) -> bool:
    """True if a joint's residual without an effect is much larger at the rows where the effect is undefined.

    A backlash is undefined while its teeth are apart. It acts just then. A residual that is as large while they touch
    has another cause.

    Parameters
    ----------
    fit, base
        The models with the effect and without it.
    joint
        Name of the joint.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    reference = replace(base, row_experiment=fit.experiment)  # whose rows are those where the effect is defined
    base_where_defined = linearize_fit(base.experiment, progress, reference)
    j = base.experiment.equation.joints.index(joint)

    defined_count = base_where_defined.row_counts.sum(axis=0)[j]
    undefined_count = base.row_counts.sum(axis=0)[j] - defined_count
    if undefined_count == 0:
        return False
    defined_squares = base_where_defined.sse.sum(axis=0)[j]
    undefined_squares = base.sse.sum(axis=0)[j] - defined_squares

    mean_square_where_defined = defined_squares / defined_count
    mean_square_where_undefined = undefined_squares / undefined_count
    return bool(mean_square_where_undefined > _MIN_CONCENTRATION * mean_square_where_defined)


def _is_too_small(candidate: FittedCandidate, base: LinearizedFit, initial: LinearizedFit, progress: Progress) -> bool:
    """True if an effect explains a negligible part of the torque."""
    fit = candidate.trial.linearized
    joint = candidate.probe.joint
    if _explains_enough(fit, base, initial, MIN_SHARE_OF_TORQUE):
        return False
    if not is_reportable(candidate.probe.effect):
        return not _explains_enough(fit, base, initial, _MIN_SHARE_OF_TORQUE_RELAXED)
    # without the noise floor, which takes time
    if joint is None or not _explains_enough(fit, base, initial, _MIN_SHARE_OF_TORQUE_AT_ALL):
        return True
    explained = explained_share_above_noise(base, fit, joint, progress)
    return not _explains_enough(fit, base, initial, _min_share_of_torque(explained))


def _min_share_of_torque(explained: float) -> float:
    """Share of a joint's rms torque that a reported effect must explain: the less it leaves, the smaller it may be.

    Parameters
    ----------
    explained
        Share of the joint's squared residual above the noise that it explains.
    """
    if explained <= NEARLY_ALL:
        return MIN_SHARE_OF_TORQUE
    unexplained = max(1 - explained, 0.0)
    rms_ratio = np.sqrt(unexplained / (1 - NEARLY_ALL))
    return max(_MIN_SHARE_OF_TORQUE_RELAXED * float(rms_ratio), _MIN_SHARE_OF_TORQUE_AT_ALL)


def implausibility(fit: LinearizedFit, entry: EffectEntry, summary: DataSummary) -> str:
    """Reason why no robot has an effect with the parameters of a fit, as a clause; empty if one may have it."""
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


def _undetermined_parameter(trial: TrialFit, index: int, initial: LinearizedFit | None = None) -> str:
    """First nonlinear parameter of an effect that the data do not determine; empty if there is none.

    Its standard error is too large, or its value is at an end of its range.

    Parameters
    ----------
    trial
        The fit.
    index
        Index of the effect in its entries.
    initial
        The model without any of the effects found, beside whose effects a parameter may have no influence; None: all
        parameters must have some.
    """
    entry = trial.entries[index]
    imprecise = imprecise_parameter(entry, _errors_of_effect(trial, index), initial)
    if imprecise:
        return imprecise
    for parameter in effect_types()[entry.effect].nonlinear_parameters:
        key = (index, parameter.name)
        value = parameter_value(entry, parameter.name)
        if key in trial.standard_errors and _must_be_determined(parameter) and isinstance(value, float):
            low, high = trial.ranges.get(key, (-np.inf, np.inf))  # only positive parameters have one
            if not low * _RANGE_EDGE_RATIO < value < high / _RANGE_EDGE_RATIO:
                return parameter.name
    return ""


def imprecise_parameter(entry: EffectEntry, errors: Mapping[str, float], initial: LinearizedFit | None = None) -> str:
    """First nonlinear parameter of an effect whose standard error is too large; empty if there is none.

    Parameters
    ----------
    entry
        The entry.
    errors
        Standard errors of its nonlinear parameters; those that were not moved cannot be judged, and have none.
    initial
        As for `_undetermined_parameter`.
    """
    for parameter in effect_types()[entry.effect].nonlinear_parameters:
        if initial is not None and _is_arbitrary(parameter, entry, initial):
            continue
        value = parameter_value(entry, parameter.name)
        error = errors.get(parameter.name)
        if error is None or not _must_be_determined(parameter) or not isinstance(value, float):
            continue
        if not error < _max_standard_error(parameter, value):
            return parameter.name
    return ""


def _is_arbitrary(parameter: NonlinearParameter, entry: EffectEntry, initial: LinearizedFit) -> bool:
    """True if a parameter has no influence beside the effects of the model that the search began with."""
    effects = initial.experiment.equation.effects
    subjects = [effect.key[:2] for effect in effects if isinstance(effect, NamedEffect)]
    return (parameter.arbitrary_beside, entry.joint) in subjects


def _must_be_determined(parameter: NonlinearParameter) -> bool:
    """False for optional and open-ended parameters."""
    return not parameter.open_ended and parameter.optional_maximum is None


def _max_standard_error(parameter: NonlinearParameter, value: float) -> float:
    """Standard error from which a nonlinear parameter is undetermined; infinite if every finite one will do."""
    if parameter.max_standard_error is not None:
        return parameter.max_standard_error
    if parameter.positive:
        return parameter.max_relative_error * value
    return np.inf


def _is_present_within_bounds(fit: LinearizedFit, entry: EffectEntry) -> bool:
    """True if an effect's coefficients are below their upper bounds, and at least one is above its lower bound.

    At its lower bound, a coefficient is absent. Parts of an effect may be; if all are, so is the effect. True for an
    effect without coefficients.
    """
    effect_and_slice = fit.find_effect(entry)
    if effect_and_slice is None:
        return True
    _, part = effect_and_slice
    own = list(zip(fit.experiment.equation.coefficients[part], fit.estimate.theta[part], strict=True))
    is_present = any(value > c.lower + _BOUND_TOLERANCE for c, value in own)
    return is_present and all(value < c.upper - _BOUND_TOLERANCE for c, value in own)


def _explains_enough(fit: LinearizedFit, base: LinearizedFit, initial: LinearizedFit, min_share: float) -> bool:
    """True if the squared residual of some joint falls by more than both of two thresholds.

    - The squared residual that the effects found are expected to leave of the initial one. What is left of a strong
      effect is no effect of its own.
    - The square of a share, ``min_share``, of the joint's rms torque.
    """
    # each fit counts in units of its own noise: one that uses or rescales the measured torque has another one
    decrease = (base.sse - fit.sse).sum(axis=0) * np.square(base.noise)
    initial_squares = initial.sse.sum(axis=0) * np.square(initial.noise)
    uncertain = _ACCURACY_OF_EFFECTS**2 * initial_squares
    negligible = base.row_counts.sum(axis=0) * np.square(min_share * base.rms_torque)
    is_enough = decrease > np.maximum(uncertain, negligible)
    return bool(is_enough.any())


def explained_share_above_noise(before: LinearizedFit, after: LinearizedFit, joint: str, progress: Progress) -> float:
    """Share of a joint's squared residual above the noise that one fit removes from another.

    Parameters
    ----------
    before, after
        The fits, without and with what is to explain it.
    joint
        Name of the joint.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    The share, of 1; 0 if the noise of the joint is not known, or nothing is above it.
    """
    floors = []
    for fit in (before, after):
        floors.append(estimate_noise_floor(fit.experiment, fit.theta, progress, fit.reversal_margin))
    j = after.experiment.equation.joints.index(joint)
    if not all(floor.is_joint_estimated[j] for floor in floors):
        return 0.0
    square_before, square_after = (float(floor.residual[j]) ** 2 for floor in floors)
    noise_square = min(float(floor.noise[j]) for floor in floors) ** 2
    above_noise = square_before - noise_square
    return (square_before - square_after) / above_noise if above_noise > 0 else 0.0

"""`TrialFit`: a model with further effects, fitted as a whole, with their nonlinear parameters at the optimum.

Nonlinear parameters are found by variable projection (Golub & Pereyra 1973, in the form of Kaufman 1975): Gauss-Newton
steps on the residual that the best linear coefficients leave. The derivative of the residual with respect to a
parameter is one more column. `screen_probes` evaluates it as any other. This gives the step and its standard error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import product

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import IdtoolError
from idtool.data.signals import Motion
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.screen import ScreenedProbe, screen_probes, with_free_parameters
from idtool.diagnosis.summarize_data import summarize_data
from idtool.dynamics.effects import build_effects, effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe, joined_probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel, OperatingPoint
from idtool.estimation.dataset.equality_constraints import Constraint, equality_constraints
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry, Regularization
from idtool.robot.inertia import PI_SIZE

ParameterKey = tuple[int, str]  # place in the configuration's effects, and name of the parameter
Range = tuple[float, float]
GridPoint = tuple[int, ...]  # number of shortest steps from the start, by parameter

FAILURES = (IdtoolError, ArithmeticError, ValueError, RuntimeError)  # raised where a model cannot be fitted

_RELATIVE_DIFFERENCE = 1e-3  # of a value: step of a finite difference
_MIN_DIFFERENCE_SCALE = 0.1  # a smaller value counts as this in a finite difference
_MAX_SIGN_CHANGE_SIZE = 0.1  # of a value that may change its sign in a Gauss-Newton step
_MAX_RELATIVE_STEP = 0.7  # of a value, in one Gauss-Newton step
_MIN_STEP_REFERENCE = 1e-3  # a smaller value counts as this in the limit of a step
_STEP_LENGTHS = (1.0, 0.3)  # of a Gauss-Newton step, tried in turn
_MIN_RELATIVE_DECREASE = 1e-4  # of the squared error in an iteration, that makes another one worthwhile
_RANGE_MARGIN = 2.0  # ratio by which a range exceeds the values that the search tries, at both ends
_GRID_RATIO = 1.05  # of values one shortest step apart in a grid search
_GRID_SHARE_STEP = 0.04  # shortest step of a value between 0 and a maximum, as a share of that
_PATTERN_STRIDES = (2, 1)  # of the pattern search in turn, in shortest steps
_MAX_GRID_MOVES = 8  # of each stride
_NEAR_BEST_RATIO = 0.9  # to the largest gain, from which a value is as good as the best
_UNBOUNDED: Range = (-np.inf, np.inf)
_FIXED_INERTIA = "--inertia fixed"


def failure_reason(failure: Exception) -> str:
    """Reason of a failure, without the file or key that it is about."""
    if isinstance(failure, IdtoolError):
        return failure.what
    if isinstance(failure, np.linalg.LinAlgError):
        return "its equations have no solution"
    return f"its evaluation failed ({type(failure).__name__})"


def not_fitted_reason(failure: Exception) -> str:
    """Reason why a candidate is rejected that cannot be fitted, as a clause."""
    return f"cannot be fitted together with the rest of the model: {failure_reason(failure)}"


@dataclass(frozen=True)
class TrialFit:
    """Fit of a model with further effects.

    Attributes
    ----------
    linearized
        The fit.
    standard_errors
        Standard errors of the nonlinear parameters that were optimized; infinite if the data do not determine them.
    ranges
        Ranges within which they were kept; parameters without one may have any value.
    """

    linearized: LinearizedFit
    standard_errors: Mapping[ParameterKey, float]
    ranges: Mapping[ParameterKey, Range]

    @property
    def entries(self) -> tuple[EffectEntry, ...]:
        """The configuration's effects."""
        return self.linearized.experiment.config.effects


def with_effects(experiment: Experiment, entries: Sequence[EffectEntry], theta: Array | None = None) -> Experiment:
    """Logs and robot of an experiment with other effects in the torque equation; fixed inertia stays fixed.

    Parameters
    ----------
    experiment
        Model and data.
    entries
        The effects, in place of the configuration's own.
    theta
        The experiment's coefficients, shape (p,), for effects that depend on the rest of the model; None: those of its
        operating point.

    Raises
    ------
    ConfigError
        If an effect cannot be in the model, as with a parameter that is out of range.
    """
    operating_point = experiment.equation.operating_point
    if theta is not None:
        operating_point = {c.key: float(x) for c, x in zip(experiment.equation.coefficients, theta, strict=True)}
    return with_effects_at(experiment, entries, operating_point)


def with_effects_at(
    experiment: Experiment, entries: Sequence[EffectEntry], operating_point: OperatingPoint
) -> Experiment:
    """`with_effects` with the coefficients, by key, for effects that depend on the rest of the model."""
    config = experiment.config.model_copy(update={"effects": tuple(entries)})
    effects = build_effects(experiment.model, config)
    equation = LinearModel(experiment.model.names, effects, operating_point, experiment.equation.contacts)
    equalities = equality_constraints(config, experiment.model, equation)
    changed = replace(experiment, config=config, equation=equation, equalities=equalities)
    return with_fixed_inertia(changed) if has_fixed_inertia(experiment) else changed


def with_fixed_inertia(experiment: Experiment) -> Experiment:
    """Experiment with the bodies' parameters known to be those of the URDF."""
    coefficient_count = len(experiment.equation.coefficients)
    body_parameter_count = PI_SIZE * len(experiment.model.bodies)
    prior = experiment.equation.prior
    equalities = experiment.equalities
    identity = np.eye(coefficient_count)
    inertia = []
    for i in equalities.free:
        if i < body_parameter_count:
            inertia.append(Constraint(_FIXED_INERTIA, identity[i], float(prior[i])))
    # constraints on the bodies alone would contradict the fixed values, or repeat them
    others = [constraint for constraint in equalities.constraints if constraint.row[body_parameter_count:].any()]
    no_prior = Regularization(kind="none", weight=0)
    config = experiment.config.model_copy(update={"constraints": "none", "regularization": no_prior})
    values = equalities.K @ prior[equalities.free]
    return replace(
        experiment,
        config=config,
        equation=replace(experiment.equation, known_bodies=values[:body_parameter_count]),
        equalities=replace(equalities, constraints=(*others, *inertia)),
    )


def has_fixed_inertia(experiment: Experiment) -> bool:
    """True if the bodies' parameters are fixed at the URDF's."""
    return any(constraint.label == _FIXED_INERTIA for constraint in experiment.equalities.constraints)


def fit_trial(
    base: LinearizedFit,
    entries: Sequence[EffectEntry],
    optimized: Sequence[int],
    progress: Progress,
    max_steps: int = 1,
) -> TrialFit:
    """Fit a model with other effects, on the rows and in the units of another fit.

    First, parameters with which the columns jump are searched for on a grid, effect by effect. Then those on which the
    columns depend smoothly take Gauss-Newton steps, all together.

    With an effect that is undefined where it acts, such as a play, the fit has rows of its own. Call `on_rows_of` to
    compare it with others.

    Parameters
    ----------
    base
        The fit that the new one is compared with.
    entries
        All effects of the model.
    optimized
        Indices of the effects whose nonlinear parameters are optimized; the others keep their values.
    progress
        Callback for the stage and its progress, from 0 to 1.
    max_steps
        Number of Gauss-Newton steps at most.

    Raises
    ------
    IdtoolError, LinAlgError
        If it cannot be fitted; see `FAILURES`.
    """
    current = linearize_fit(with_effects(base.experiment, entries, base.theta), progress, base)
    standard_errors: dict[ParameterKey, float] = {}
    ranges = _parameter_ranges(base, entries, optimized)
    for i in optimized:
        kind = effect_types()[entries[i].effect]
        if issubclass(kind, JointEffect) and kind.grid_parameters():
            current, grid_errors = _grid_search(current, i, kind, progress)
            standard_errors |= grid_errors

    for _ in range(max_steps):
        initial_error = current.total_cv_squared_error
        if len(optimized) > 1:
            current = _step_of_linear_effects(current, optimized, ranges, progress)
        keys = _gradient_keys(current.experiment.config.effects, optimized)
        if not keys:
            break
        current, step_errors = _gauss_newton_step(current, keys, ranges, progress)
        standard_errors |= step_errors
        decrease = initial_error - current.total_cv_squared_error
        if not decrease > _MIN_RELATIVE_DECREASE * initial_error:
            break
    return TrialFit(current, standard_errors, ranges)


def on_rows_of(base: LinearizedFit, trial: TrialFit, progress: Progress) -> TrialFit:
    """Trial whose fit is on the rows of another one, so that their residuals can be compared.

    A fit with an effect that is undefined where it acts has fewer rows of its own. Its smaller residual would count as
    explained.

    Parameters
    ----------
    base
        The fit to compare with.
    trial
        The trial.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    if trial.linearized.row_experiment is base.row_experiment:
        return trial
    return replace(trial, linearized=linearize_fit(trial.linearized.experiment, progress, base))


def _parameter_ranges(
    base: LinearizedFit, entries: Sequence[EffectEntry], optimized: Sequence[int]
) -> dict[ParameterKey, Range]:
    """Ranges of the nonlinear parameters that have one.

    That of a positive parameter is about all values that the search tries, that of an optional one begins at 0.
    """
    summary = summarize_data(base)
    ranges: dict[ParameterKey, Range] = {}
    for i in optimized:
        kind = effect_types()[entries[i].effect]
        joint = entries[i].joint
        if not issubclass(kind, JointEffect) or joint is None:
            continue
        trials = list(kind.trial_values(summary, summary.model.names.index(joint)))
        names = trials[0] if trials else ()
        for name in names:
            if _is_positive(kind.id, name):
                values = [trial[name] for trial in trials]
                ranges[i, name] = (min(values) / _RANGE_MARGIN, max(values) * _RANGE_MARGIN)
        for parameter in kind.nonlinear_parameters:
            if parameter.optional_maximum is not None:
                ranges[i, parameter.name] = (0.0, parameter.optional_maximum)
    return ranges


def with_nonlinear_parameters_free(base: LinearizedFit, movable: Sequence[int], progress: Progress) -> LinearizedFit:
    """Model of which the parameters of some effects, given by their indices, are free to first order, for a screening.

    They were found without the candidates, and may imitate them.
    """
    probe = _movable_parameter_probe(base, movable)
    if probe is None:
        return base
    try:
        return with_free_parameters(base, probe, progress)
    except FAILURES:
        return base


def _movable_parameter_probe(current: LinearizedFit, optimized: Sequence[int]) -> Probe | None:
    """Probe of the parameters of some effects that a fit optimizes; None if there are none.

    Its columns are the derivatives of the torque with respect to them.

    Parameters
    ----------
    current
        The fit.
    optimized
        Indices of the effects.
    """
    entries = current.experiment.config.effects
    probes = []
    others = []
    for i in optimized:
        linear = effect_types()[entries[i].effect].coefficients_of(entries[i], current.experiment.model)
        if linear is None:
            others.append(i)
        else:
            probes.append(linear[0])
    keys = _gradient_keys(entries, others)
    if keys:
        probes.append(_parameter_probe(current, keys, _parameter_ranges(current, entries, others)))
    return reduce(joined_probe, probes) if probes else None


def _gradient_keys(entries: Sequence[EffectEntry], optimized: Sequence[int]) -> list[ParameterKey]:
    """Numeric parameters that are moved along a gradient."""
    keys = []
    for i in optimized:
        for name in effect_types()[entries[i].effect].gradient_parameters():
            if isinstance(parameter_value(entries[i], name), float):
                keys.append((i, name))
    return keys


def parameter_value(entry: EffectEntry, name: str) -> object:
    """Value of a parameter without its standard error; None if the entry does not have the parameter.

    ``com.0`` names the first element of the list ``com``.
    """
    name, _, index = name.partition(".")
    value = entry.values.get(name)
    return value[int(index)] if index and value is not None else value


def _numeric_value(entry: EffectEntry, name: str) -> float:
    """Value of a parameter known to be a number."""
    value = parameter_value(entry, name)
    if not isinstance(value, int | float):
        raise TypeError(f"{name} of {entry.effect} is not a number")
    return float(value)


def _with_value(entry: EffectEntry, name: str, value: float) -> EffectEntry:
    """Entry with another value of a parameter; ``com.0`` as in `parameter_value`."""
    name, _, index = name.partition(".")
    changed: object = value
    if index:
        changed = [value if k == int(index) else x for k, x in enumerate(entry.parameters[name])]
    return entry.model_copy(update={"parameters": {**entry.parameters, name: changed}})


def _step_of_linear_effects(
    current: LinearizedFit, optimized: Sequence[int], ranges: Mapping[ParameterKey, Range], progress: Progress
) -> LinearizedFit:
    """Fit after a step of each effect whose torque is linear in coefficients; the same fit if no step helps.

    It moves what no gradient does, such as the inertia of a payload.

    Parameters
    ----------
    current
        The fit.
    optimized
        Indices of the effects whose nonlinear parameters are optimized.
    ranges
        Ranges of the nonlinear parameters.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    for i in optimized:
        others = [j for j in optimized if j != i]
        current = _step_of_linear_effect(current, i, others, ranges, progress)
    return current


def _step_of_linear_effect(
    current: LinearizedFit, i: int, others: Sequence[int], ranges: Mapping[ParameterKey, Range], progress: Progress
) -> LinearizedFit:
    """Fit after a step of an effect's coefficients and the other effects' parameters; the same if no step helps.

    Parameters
    ----------
    current, ranges, progress
        As for `_step_of_linear_effects`.
    i
        Index of the effect. If its torque is not linear in coefficients, there is no step.
    others
        Indices of the other effects.
    """
    entries = current.experiment.config.effects
    linear = effect_types()[entries[i].effect].coefficients_of(entries[i], current.experiment.model)
    if linear is None:
        return current
    own_probe, coefficients = linear
    keys = _gradient_keys(entries, others)
    probe = joined_probe(own_probe, _parameter_probe(current, keys, ranges)) if keys else own_probe
    (screened,) = screen_probes(current, [probe], progress, "optimizing nonlinear parameters")
    count = own_probe.coefficient_count
    information = screened.marginal_information(slice(0, count))
    coefficient_step = screened.c[:count]
    parameter_step = screened.c[count:]

    for length in _STEP_LENGTHS:
        own_entry = own_probe.to_entry(coefficients + length * coefficient_step, information)
        if own_entry is None:
            continue
        changed = _moved_entries(current, keys, length * parameter_step, ranges)
        changed[i] = own_entry
        better = _better_fit(current, changed, progress)
        if better is not None:
            return better
    return current


def _gauss_newton_step(
    current: LinearizedFit, keys: Sequence[ParameterKey], ranges: Mapping[ParameterKey, Range], progress: Progress
) -> tuple[LinearizedFit, dict[ParameterKey, float]]:
    """Fit after a step of all parameters together, and their standard errors before it.

    If no step helps, the fit is the same.
    """
    probe = _parameter_probe(current, keys, ranges)
    (screened,) = screen_probes(current, [probe], progress, "optimizing nonlinear parameters")
    standard_errors = dict(zip(keys, _standard_errors(screened), strict=True))

    for length in _STEP_LENGTHS:
        better = _better_fit(current, _moved_entries(current, keys, length * screened.c, ranges), progress)
        if better is not None:
            return better, standard_errors
    return current, standard_errors


def _standard_errors(screened: ScreenedProbe) -> list[float]:
    """Standard errors of a probe's coefficients; infinite for those that the data do not determine.

    The screening gives these, and all of a probe that failed, the coefficient 0 without any variance.
    """
    errors = np.sqrt(np.diag(screened.covariance))
    is_determined = np.isfinite(errors) & (errors > 0)
    return [float(error) for error in np.where(is_determined, errors, np.inf)]


def _moved_entries(
    current: LinearizedFit, keys: Sequence[ParameterKey], steps: Array, ranges: Mapping[ParameterKey, Range]
) -> list[EffectEntry]:
    """The model's entries after a step of parameters within their ranges, or the nearest that physics allows."""
    entries = current.experiment.config.effects
    moved = list(entries)
    for key, step in zip(keys, steps, strict=True):
        i, name = key
        value = _moved_value(entries[i], name, step, ranges.get(key, _UNBOUNDED))
        moved[i] = _with_value(moved[i], name, value)
    for i in {i for i, _ in keys}:
        moved[i] = effect_types()[moved[i].effect].feasible_entry(moved[i], current.experiment.model)
    return moved


def _better_fit(current: LinearizedFit, entries: Sequence[EffectEntry], progress: Progress) -> LinearizedFit | None:
    """Fit with other entries on the same rows; None if it explains no more, or fails."""
    try:
        candidate = linearize_fit(with_effects(current.experiment, entries, current.theta), progress, current)
    except FAILURES:
        return None
    return candidate if candidate.total_cv_squared_error < current.total_cv_squared_error else None


def _moved_value(entry: EffectEntry, name: str, step: float, bounds: Range) -> float:
    """Value of a parameter after a step within its bounds.

    The step is limited to a share of the value, except for a small value that may change its sign.
    """
    value = _numeric_value(entry, name)
    must_stay_positive = value > 0 and _is_positive(entry.effect, name)
    may_change_sign = abs(value) <= _MAX_SIGN_CHANGE_SIZE and not must_stay_positive
    if not may_change_sign:
        longest = _MAX_RELATIVE_STEP * max(abs(value), _MIN_STEP_REFERENCE)
        step = float(np.clip(step, -longest, longest))
    return float(np.clip(value + step, *bounds))


def _grid_search(
    current: LinearizedFit, i: int, kind: type[JointEffect], progress: Progress
) -> tuple[LinearizedFit, dict[ParameterKey, float]]:
    """Fit with the values near the present ones that explain most, and the values' standard errors.

    Each set of values is a probe about the model without the effect. A standard error is half the range of values that
    explain nearly as much as the best, at least half the shortest step.

    Parameters
    ----------
    current
        Fit of the model with the effect.
    i, kind
        Index of the effect in the configuration, and its class.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    entries = list(current.experiment.config.effects)
    others = [*entries[:i], *entries[i + 1 :]]
    reduced = with_effects(current.experiment, others, current.theta)
    without = linearize_fit(reduced, progress, current, own_rows=True)
    summary = summarize_data(without)
    joint = current.experiment.equation.joints.index(str(entries[i].joint))
    start = _nonlinear_values(entries[i], kind)
    names = [name for name in kind.grid_parameters() if name in entries[i].parameters]  # what was left out stays so

    def values_at(point: GridPoint) -> dict[str, float]:
        moved = {name: _grid_value(kind, name, start[name], steps) for name, steps in zip(names, point, strict=True)}
        return {**start, **moved}

    def gains_at(points: Sequence[GridPoint]) -> list[float]:
        probes = [kind.probe(summary, joint, values_at(point)) for point in points]
        screened = screen_probes(without, probes, progress, "trying parameter values")
        return [_gain_with_unit_coefficient(one) for one in screened]

    best, gains = pattern_search(gains_at, len(names))
    values = values_at(best)
    one_step_on = values_at(tuple(steps + 1 for steps in best))
    one_step_back = values_at(tuple(steps - 1 for steps in best))
    min_gain = gains[best] - (1 - _NEAR_BEST_RATIO) * abs(gains[best])
    near_best = [values_at(point) for point, gain in gains.items() if gain >= min_gain]
    standard_errors: dict[ParameterKey, float] = {}
    for name in names:
        spread = float(np.ptp([near[name] for near in near_best]))
        shortest_step = max(one_step_on[name] - values[name], values[name] - one_step_back[name])
        standard_errors[i, name] = max(spread, shortest_step) / 2
        entries[i] = _with_value(entries[i], name, values[name])
    changed = with_effects(current.experiment, entries, current.theta)
    return linearize_fit(changed, progress, current, own_rows=kind.is_undefined_where_it_acts), standard_errors


def pattern_search(
    evaluate: Callable[[Sequence[GridPoint]], Sequence[float]], dimensions: int
) -> tuple[GridPoint, dict[GridPoint, float]]:
    """Point of a grid, near its origin, with the largest value, by a pattern search (Hooke & Jeeves 1961).

    All coordinates change together, as the best one may depend on the others.

    Parameters
    ----------
    evaluate
        Values at some points.
    dimensions
        Number of coordinates.

    Returns
    -------
    The point, and the values at all points that were evaluated.
    """
    values: dict[GridPoint, float] = {}
    best: GridPoint = (0,) * dimensions
    for stride in _PATTERN_STRIDES:
        for _ in range(_MAX_GRID_MOVES):
            neighbours = list(product(*((n - stride, n, n + stride) for n in best)))
            new = [point for point in neighbours if point not in values]
            values |= dict(zip(new, evaluate(new), strict=True))
            best_neighbour = max(neighbours, key=lambda point: values[point])
            if values[best_neighbour] <= values[best]:
                break
            best = best_neighbour
    return best, values


def _gain_with_unit_coefficient(screened: ScreenedProbe) -> float:
    """Gain of a probe whose coefficient is 1, as that of an effect without coefficients is, and not the best one.

    Minus infinity if it failed: with its gain of 0, it would be better than one that only increases the error.
    """
    if screened.failure is not None:
        return -np.inf
    deviation = screened.c - 1.0
    return screened.gain - float(deviation @ screened.information @ deviation)


def _grid_value(kind: type[JointEffect], name: str, value: float, steps: int) -> float:
    """Value of a parameter some shortest steps from another one."""
    (parameter,) = (parameter for parameter in kind.nonlinear_parameters if parameter.name == name)
    if parameter.optional_maximum is None:
        return float(value * _GRID_RATIO**steps)
    share = value / parameter.optional_maximum + steps * _GRID_SHARE_STEP
    return parameter.optional_maximum * float(np.clip(share, 0.0, 1.0))


def _nonlinear_values(entry: EffectEntry, kind: type[JointEffect]) -> dict[str, float]:
    """Values of all nonlinear parameters of an entry; optional ones that were left out are 0."""
    values = {}
    for parameter in kind.nonlinear_parameters:
        value = parameter_value(entry, parameter.name)
        values[parameter.name] = 0.0 if value is None else _numeric_value(entry, parameter.name)
    return values


def _is_positive(effect: str, name: str) -> bool:
    """True if a nonlinear parameter of an effect must be above 0."""
    parameters = effect_types()[effect].nonlinear_parameters
    return any(parameter.name == name and parameter.positive for parameter in parameters)


def _parameter_probe(
    current: LinearizedFit, keys: Sequence[ParameterKey], ranges: Mapping[ParameterKey, Range]
) -> Probe:
    """Probe whose columns are the derivatives of the predicted torque with respect to nonlinear parameters.

    They are finite differences, backward where a forward one would leave the parameter's range.
    """
    differences = []
    equations = []
    for key in keys:
        i, name = key
        entries = list(current.experiment.config.effects)
        value = _numeric_value(entries[i], name)
        difference = _RELATIVE_DIFFERENCE * max(abs(value), _MIN_DIFFERENCE_SCALE)
        _, highest = ranges.get(key, _UNBOUNDED)
        if value + difference >= highest:
            difference = -difference
        differences.append(difference)
        entries[i] = _with_value(entries[i], name, value + difference)
        # without theta, which would move the operating point: the difference must be the parameter's alone
        equations.append(with_effects(current.experiment, entries).equation)

    def columns(motion: Motion, model: Linearization) -> Mapping[int, Array]:
        derivatives = []
        for equation, difference in zip(equations, differences, strict=True):
            changed = LinearizedModel(equation, current.theta, model.measured_motion, model)
            derivatives.append((model.residual - changed.residual) / difference)
        return {j: np.stack([derivative[j] for derivative in derivatives]) for j in range(len(motion.q))}

    return Probe(
        effect="",  # of no effect, so that it has no configuration entry
        joint=None,
        link=None,
        columns=columns,
        coefficient_count=len(keys),
        to_entry=lambda c, information: None,
    )

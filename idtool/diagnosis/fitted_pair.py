"""`FittedPair`: the fitted models of a simulator and of a robot, each with the effects of both.

Term by term, the simulator's model can be changed to what the robot has, and compared with the robot's logs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.records import RIGID_BODY
from idtool.diagnosis.trial import FAILURES, fit_trial, has_fixed_inertia, with_effects
from idtool.dynamics.effects import NamedEffect, effect_from_entry, mechanism_of
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.rollouts import evaluate_rollouts
from idtool.estimation.evaluation.torque_errors import Errors, evaluate
from idtool.estimation.fit import Fit, fit
from idtool.robot.config import EffectEntry, UncertainValue
from idtool.robot.model import RobotModel

TermKey = tuple[str, str, int]  # effect, what it acts on, number among several of a kind there

ALL_BODIES: TermKey = (RIGID_BODY, "", 0)

_MODEL = "model"
_MAX_DISTANCE = 0.5  # between two effects of a kind on a joint, as a share: beyond, each is one of its own
_MAX_ITERATIONS = 3  # of the fit of nonlinear parameters


@dataclass(frozen=True)
class GapLevel:
    """Errors of a model on the robot's logs.

    Attributes
    ----------
    torque
        RMS torque error by joint, and ``overall`` [N·m or N].
    position
        RMS position error of the rollouts [rad or m]; None if they were not simulated.
    """

    torque: Mapping[str, float]
    position: Mapping[str, float] | None


@dataclass(frozen=True)
class FittedTerm:
    """An effect of a fitted model.

    Attributes
    ----------
    effect
        The effect.
    entry
        Its entry in the configuration; None for one under ``friction``.
    theta, covariance
        Its coefficients, shape (m,), and the covariance of their errors, shape (m, m).
    is_borrowed
        True if the effect is one of the other model, from which its nonlinear parameters are taken.
    """

    effect: NamedEffect
    entry: EffectEntry | None
    theta: Array
    covariance: Array
    is_borrowed: bool = False

    def parameters(self) -> dict[str, tuple[Any, Any]]:
        """Values and standard errors by name, of the parameters that were fitted or configured."""
        if self.is_borrowed:
            return dict(self.effect.parameters(self.theta, self.covariance))
        values: dict[str, tuple[Any, Any]] = {}
        for parameter in self.effect.nonlinear_parameters:
            if parameter.optional_maximum is not None:
                values[parameter.name] = (0.0, None)  # if it is left out
        if self.entry is not None:
            for name, value in self.entry.values.items():
                values[name] = (value, _configured_error(self.entry.parameters[name]))
        values.update(self.effect.parameters(self.theta, self.covariance))
        return values


class FittedPair:
    """Fitted models of a simulator and of a robot, each with the effects of both.

    Attributes
    ----------
    simulator_fit, robot_fit
        The fits to the logs of each.
    simulator_terms, robot_terms
        Effects of these fits besides the bodies.

    Parameters
    ----------
    simulator, robot
        Fits of the two, each with the effects that its own logs show.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """

    def __init__(self, simulator: Fit, robot: Fit, progress: Progress) -> None:
        self._progress = progress
        simulator = _with_refitted_delay(simulator, progress)
        robot = _with_refitted_delay(robot, progress)
        self.simulator_fit = _with_effects_of(simulator, robot, progress)
        self.robot_fit = _with_effects_of(robot, simulator, progress)
        self.simulator_terms = _terms(self.simulator_fit, simulator)
        self.robot_terms = _terms(self.robot_fit, robot, self.simulator_terms)

    @property
    def keys(self) -> list[TermKey]:
        """Effects of both, and the bodies if the robot's were identified."""
        keys = list(dict.fromkeys([*self.simulator_terms, *self.robot_terms]))
        return keys if has_fixed_inertia(self.robot_fit.experiment) else [*keys, ALL_BODIES]

    def changed_simulator(self, changed: Collection[TermKey]) -> tuple[Experiment, Array]:
        """The simulator's model with changes, on the robot's logs, and its coefficients, shape (p,).

        Parameters
        ----------
        changed
            Keys of the effects that are as the robot has them.
        """
        terms = []
        for key in self.keys:
            term = (self.robot_terms if key in changed else self.simulator_terms).get(key)
            if term is not None:
                terms.append(term)
        entries = [term.entry for term in terms if term.entry is not None]
        fitted = self.robot_fit
        experiment = with_effects(fitted.experiment, entries, fitted.estimate.theta)
        equation = experiment.equation
        theta = equation.prior.copy()
        values = {term.effect.key: term.theta for term in terms}
        for effect, part in equation.effect_slices():
            if isinstance(effect, NamedEffect):
                theta[part] = values[effect.key]
            elif ALL_BODIES in changed:
                theta[part] = fitted.estimate.theta[part]
        if equation.depends_on_parameters:
            experiment = replace(experiment, equation=equation.linearized_at(theta))
        return experiment, theta

    def mean_squared_errors(self, changed: Collection[TermKey]) -> Array:
        """Mean squared torque error of `changed_simulator` on the robot's logs, shape (nv,) [(N·m)² or N²]."""
        errors = self._torque_errors(*self.changed_simulator(changed))
        return errors.mean_squares_in_band

    def gap_level(self, changed: Collection[TermKey], simulate: bool) -> GapLevel:
        """Errors of `changed_simulator` on the robot's logs."""
        experiment, theta = self.changed_simulator(changed)
        joints = experiment.equation.joints
        torque = self._torque_errors(experiment, theta).rms(joints)
        position = None
        if simulate:
            rollouts = evaluate_rollouts(experiment, {_MODEL: theta}, self.robot_fit.has_held_out, self._progress)
            if rollouts is not None and _MODEL in rollouts.errors:
                position = rollouts.errors[_MODEL].rmse(joints, "position")
        return GapLevel(torque, position)

    def _torque_errors(self, experiment: Experiment, theta: Array) -> Errors:
        """Torque errors of a model on the robot's logs."""
        evaluation = evaluate(experiment, {_MODEL: theta}, self.robot_fit.has_held_out, self._progress)
        return evaluation.errors[_MODEL]


def _configured_error(given: Any) -> Any:
    """Standard error of a configuration's parameter; None if it has none."""
    if isinstance(given, list):
        return [_configured_error(x) for x in given]
    return given.get("standard_error") if isinstance(given, Mapping) else None


def _terms(fitted: Fit, own: Fit, other: Mapping[TermKey, FittedTerm] | None = None) -> dict[TermKey, FittedTerm]:
    """Effects of a fitted model besides the bodies.

    Parameters
    ----------
    fitted
        The fitted model.
    own
        The same without the effects of the other model.
    other
        Effects of the other model, by which several of a kind are numbered, see `numbered_terms`.
    """
    experiment = fitted.experiment
    own_keys = {effect.key for effect in own.experiment.equation.effects if isinstance(effect, NamedEffect)}
    entries = {effect_from_entry(entry, experiment.model).key: entry for entry in experiment.config.effects}
    terms = []
    for effect, part in experiment.equation.effect_slices():
        if not isinstance(effect, NamedEffect):
            continue
        theta = fitted.estimate.theta[part]
        covariance = fitted.uncertainty.covariance[part, part]
        is_borrowed = effect.key not in own_keys and effect.background_entry() is None
        terms.append(FittedTerm(effect, entries.get(effect.key), theta, covariance, is_borrowed))
    return numbered_terms(terms, other or {})


def numbered_terms(terms: Sequence[FittedTerm], other: Mapping[TermKey, FittedTerm]) -> dict[TermKey, FittedTerm]:
    """Effects by key. Several of a kind on a joint are numbered as the nearest ones of another model are.

    Parameters
    ----------
    terms
        The effects.
    other
        Those of the other model.
    """
    numbered: dict[TermKey, FittedTerm] = {}
    matches = _matches(terms, other)
    for i, term in enumerate(terms):
        owner = str(term.effect.key[1]) if len(term.effect.key) > 1 else ""
        number = 0
        while (term.effect.id, owner, number) in {*numbered, *other}:
            number += 1
        key = matches.get(i, (term.effect.id, owner, number))
        numbered[key] = term
    return numbered


def _matches(terms: Sequence[FittedTerm], other: Mapping[TermKey, FittedTerm]) -> dict[int, TermKey]:
    """Key of the other model's effect that is the same, by the index of an effect; the nearest pairs come first."""
    pairs = []
    for i, term in enumerate(terms):
        for key, other_term in other.items():
            distance = term.effect.distance_to(other_term.effect)
            if distance < _MAX_DISTANCE:
                pairs.append((distance, i, key))
    matches: dict[int, TermKey] = {}
    for _, i, key in sorted(pairs):
        if i not in matches and key not in matches.values():
            matches[i] = key
    return matches


def _with_effects_of(fitted: Fit, other: Fit, progress: Progress) -> Fit:
    """A fit with the effects of another besides its own: those with coefficients, and those that every log has."""
    present = _terms(fitted, fitted)
    entries = list(fitted.experiment.config.effects)
    optimized = []
    for key, term in _terms(other, other, present).items():
        if key in present or term.entry is None:
            continue
        background = term.effect.background_entry()
        if background is not None:
            optimized.append(len(entries))
            entries.append(term.entry.model_copy(update={"parameters": background.parameters}))
        elif len(term.theta):
            entries.append(term.entry)
    if len(entries) == len(fitted.experiment.config.effects):
        return fitted
    try:
        experiment = with_effects(fitted.experiment, entries, fitted.estimate.theta)
        return fit(_with_fitted_values(experiment, optimized, progress), progress)
    except FAILURES:  # these data do not determine them
        return fitted


def _with_fitted_values(experiment: Experiment, optimized: Sequence[int], progress: Progress) -> Experiment:
    """The experiment with the nonlinear parameters of some of its effects fitted, with their standard errors."""
    if not optimized:
        return experiment
    entries = experiment.config.effects
    trial = fit_trial(linearize_fit(experiment, progress), entries, optimized, progress, _MAX_ITERATIONS)
    fitted = list(trial.entries)
    for (i, name), error in trial.standard_errors.items():
        if not np.isfinite(error):
            continue
        value = {"value": fitted[i].values[name], "standard_error": error}
        fitted[i] = fitted[i].model_copy(update={"parameters": {**fitted[i].parameters, name: value}})
    return with_effects(experiment, fitted, trial.linearized.theta)


def fitted_delay(fitted: Fit) -> UncertainValue | None:
    """The delay from command to torque; None if none was fitted."""
    controller = fitted.experiment.config.controller
    delay = controller.known_delay if controller else None
    return None if delay is None or delay.standard_error is None else delay


def _with_refitted_delay(fitted: Fit, progress: Progress) -> Fit:
    """A fit with the delay from command to torque fitted again: a diagnosis fits it before it finds the effects.

    A delay of the torque, by which the diagnosis corrects the first one, is left out.
    """
    experiment = fitted.experiment
    controller = experiment.config.controller
    if controller is None or fitted_delay(fitted) is None:
        return fitted
    entries = [entry for entry in experiment.config.effects if not _delays_torque(entry, experiment.model)]
    experiment = with_effects(experiment, entries, fitted.estimate.theta)
    unknown = controller.model_copy(update={"delay": "auto"})
    config = experiment.config.model_copy(update={"controller": unknown})
    experiment, _, _ = with_delay(replace(experiment, config=config), progress)
    return fit(experiment, progress)


def _delays_torque(entry: EffectEntry, model: RobotModel) -> bool:
    """True for an effect that delays the torque."""
    mechanism = mechanism_of(effect_from_entry(entry, model), model)
    return bool(mechanism.torque_delay.any())

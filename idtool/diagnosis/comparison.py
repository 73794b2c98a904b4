"""A robot against its simulator: what to change in the simulator so that it moves as the robot does.

Both are diagnosed with the same model, the simulator with the bodies of the URDF, since it has exactly these. Then each
is fitted with the effects of both, so that every parameter has a value and a standard error on either side. A change is
an effect whose parameters differ significantly and without which the torque on the robot's logs is predicted noticeably
worse.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.data.pairing import LogPair, align
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.records import Diagnosis
from idtool.diagnosis.trial import FAILURES, fit_trial, has_fixed_inertia, with_effects
from idtool.dynamics.effects import NamedEffect, effect_from_entry
from idtool.dynamics.mechanism import Mechanism
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.rollouts import evaluate_rollouts
from idtool.estimation.evaluation.torque_errors import evaluate
from idtool.estimation.fit import Fit, fit
from idtool.robot.config import EffectEntry, UncertainValue
from idtool.robot.inertia import PI_SIZE, mass_com_inertia, symmetric_entries
from idtool.robot.model import RobotModel

_MIN_SIGNIFICANCE = 3.0  # standard errors by which a parameter must differ
_INSIGNIFICANT = f"differs by less than {_MIN_SIGNIFICANCE:g} standard errors"
_MIN_SHARE = 0.01  # of a joint's squared gap that a change must close
_NEGLIGIBLE = 3e-3  # of a joint's torque, as its standard deviation: a smaller error does not matter
_MAX_UNEXPLAINED = 0.05  # of a joint's rms torque that the simulator's model may leave
_MAX_ITERATIONS = 3  # of the fit of nonlinear parameters
_BODIES = "rigid_body"
COMMAND_DELAY = "command_delay"
_BODY_UNITS = {"mass": "kg", "com": "m", "inertia_com": "kg·m²"}

TermKey = tuple[str, str, int]  # effect, what it acts on, number among several of a kind there
_ALL_BODIES: TermKey = (_BODIES, "", 0)


@dataclass(frozen=True)
class Quantity:
    """A parameter in the simulator and on the robot; None: there is no such effect, or the error is not known.

    Attributes
    ----------
    simulator, simulator_error
        Value in the simulator and its standard error.
    robot, robot_error
        Value on the robot and its standard error.
    unit
        Unit; None: without.
    """

    simulator: Any
    simulator_error: Any
    robot: Any
    robot_error: Any
    unit: str | None

    @property
    def is_significant(self) -> bool:
        """True if the two differ by more than chance."""
        pairs = zip(*map(_elements, (self.simulator, self.simulator_error, self.robot, self.robot_error)), strict=False)
        for before, before_error, after, after_error in pairs:
            if not isinstance(before, float | int) or not isinstance(after, float | int):
                continue
            if before_error is None or after_error is None:
                continue
            if abs(after - before) > _MIN_SIGNIFICANCE * np.hypot(before_error, after_error):
                return True
        return False


def _elements(value: Any) -> list[Any]:
    """A value as a list of its elements."""
    return list(value) if isinstance(value, list | tuple) else [value]


@dataclass(frozen=True)
class Change:
    """An effect that differs between simulator and robot.

    Attributes
    ----------
    effect, joint, link
        Id of the effect, ``rigid_body`` for the inertia of a link, or ``command_delay`` for the controller's delay; and
        what it acts on.
    quantities
        Its parameters by name.
    share
        Share of the squared torque gap that is open without this change, every joint relative to its torque; of the
        inertia of links, without that of all links. None for the controller's delay, which changes the robot's torque.
    reason
        Reason why it need not be made, a few words; empty for one that is to be made.
    """

    effect: str
    joint: str | None
    link: str | None
    quantities: Mapping[str, Quantity]
    share: float | None
    reason: str = ""


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
class Comparison:
    """A robot against its simulator.

    Attributes
    ----------
    simulated, measured
        Diagnoses of the simulator's logs and of the robot's.
    pairs
        The logs in pairs.
    changes
        Changes to make in the simulator, the one that closes most of the gap first.
    unchanged
        Effects that need no change.
    before, after
        Errors of the simulator's model on the robot's logs, and of the same model with the changes.
    notices
        Notices for the user.
    """

    simulated: Diagnosis
    measured: Diagnosis
    pairs: tuple[LogPair, ...]
    changes: tuple[Change, ...]
    unchanged: tuple[Change, ...]
    before: GapLevel
    after: GapLevel
    notices: tuple[Notice, ...]


def compare(measured: Experiment, simulated: Experiment, options: Options, progress: Progress) -> Comparison:
    """Diagnose a robot relative to its simulator.

    Parameters
    ----------
    measured, simulated
        The model with the logs of the robot and with those of the simulator; log for log under the same commands.
    options
        Options for the robot's logs; on the simulator's, the inertia is fixed.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    IdtoolError
        If the logs cannot be used.
    """
    joints = measured.equation.joints
    runs = zip(measured.runs, simulated.runs, strict=False)  # logs for validation alone have no partner
    pairs = [align(run.signals.log, other.signals.log, joints) for run, other in runs]

    simulator_options = replace(options, inertia="fixed", assumed=(), simulate=False)
    simulator = diagnose(simulated, simulator_options, _prefixed(progress, "simulator"))
    started = _with_further_effects(measured, _linear_entries(simulator))
    robot = diagnose(started, options, _prefixed(progress, "robot"))

    sides = _Sides(simulator, robot, _prefixed(progress, "comparison"))
    changes, made = _changes(sides)
    return Comparison(
        simulated=simulator,
        measured=robot,
        pairs=tuple(pairs),
        changes=tuple(change for change in changes if not change.reason),
        unchanged=tuple(change for change in changes if change.reason),
        before=sides.gap_level((), options.simulate),
        after=sides.gap_level(made, options.simulate),
        notices=tuple(_notices(simulator)),
    )


def _prefixed(progress: Progress, subject: str) -> Progress:
    """Progress whose stages begin with a subject."""
    return lambda stage, share: progress(f"{subject}: {stage}", share)


def _linear_entries(diagnosis: Diagnosis) -> list[EffectEntry]:
    """Effects found in the simulator whose parameters follow from their coefficients alone."""
    last = diagnosis.last.experiment
    entries = []
    for entry in last.config.effects:
        effect = effect_from_entry(entry, last.model)
        count = len(effect.coefficients)
        linear = effect.parameters(np.zeros(count), np.zeros((count, count)))
        if count and set(linear) == set(entry.values):
            entries.append(entry)
    return entries


def _with_further_effects(experiment: Experiment, entries: Sequence[EffectEntry]) -> Experiment:
    """The experiment with further effects; as it is, if it cannot have them."""
    configured = experiment.config.effects
    present = {effect_from_entry(entry, experiment.model).key for entry in configured}
    more = [entry for entry in entries if effect_from_entry(entry, experiment.model).key not in present]
    return with_effects(experiment, [*configured, *more]) if more else experiment


@dataclass(frozen=True)
class _Term:
    """An effect of a fitted model.

    Attributes
    ----------
    effect
        The effect.
    entry
        Its entry in the configuration; None for one under ``friction``.
    theta, covariance
        Its coefficients, shape (m,), and the covariance of their errors, shape (m, m).
    """

    effect: NamedEffect
    entry: EffectEntry | None
    theta: Array
    covariance: Array

    def parameters(self) -> dict[str, tuple[Any, Any]]:
        """Values and standard errors by name."""
        values: dict[str, tuple[Any, Any]] = {}
        if self.entry is not None:
            for name, value in self.entry.values.items():
                values[name] = (value, _configured_error(self.entry.parameters[name]))
        values.update(self.effect.parameters(self.theta, self.covariance))
        return values


def _configured_error(given: Any) -> Any:
    """Standard error of a configuration's parameter; None if it has none."""
    if isinstance(given, list):
        return [_configured_error(x) for x in given]
    return given.get("standard_error") if isinstance(given, Mapping) else None


def _terms(fitted: Fit) -> dict[TermKey, _Term]:
    """Effects of a fitted model besides the bodies."""
    experiment = fitted.experiment
    equation = experiment.equation
    entries = {effect_from_entry(entry, experiment.model).key: entry for entry in experiment.config.effects}
    terms: dict[TermKey, _Term] = {}
    for effect, part in equation.effect_slices():
        if not isinstance(effect, NamedEffect):
            continue
        theta = fitted.estimate.theta[part]
        term = _Term(effect, entries.get(effect.key), theta, fitted.uncertainty.covariance[part, part])
        owner = str(effect.key[1]) if len(effect.key) > 1 else ""
        number = 0
        while (effect.id, owner, number) in terms:
            number += 1
        terms[effect.id, owner, number] = term
    return terms


def _with_fitted_values(experiment: Experiment, moving: Sequence[int], progress: Progress) -> Experiment:
    """The experiment with the nonlinear parameters of some of its effects fitted, with their standard errors."""
    if not moving:
        return experiment
    entries = experiment.config.effects
    trial = fit_trial(linearize_fit(experiment, progress), entries, moving, progress, _MAX_ITERATIONS)
    fitted = list(trial.entries)
    for (i, name), error in trial.errors.items():
        value = {"value": fitted[i].values[name], "standard_error": error}
        fitted[i] = fitted[i].model_copy(update={"parameters": {**fitted[i].parameters, name: value}})
    return with_effects(experiment, fitted, trial.linearized.theta)


@dataclass
class _Sides:
    """The fitted models of simulator and robot, effect by effect.

    Attributes
    ----------
    simulator, robot
        Diagnoses.
    simulator_fit, robot_fit
        Their fits, each with the effects of both.
    simulator_terms, robot_terms
        Effects of these fits.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """

    simulator: Diagnosis
    robot: Diagnosis
    progress: Progress
    simulator_terms: dict[TermKey, _Term] = field(init=False)
    robot_terms: dict[TermKey, _Term] = field(init=False)
    simulator_fit: Fit = field(init=False)
    robot_fit: Fit = field(init=False)

    def __post_init__(self) -> None:
        simulator = _with_refitted_delay(self.simulator.last, self.progress)
        robot = _with_refitted_delay(self.robot.last, self.progress)
        self.simulator_fit = self._with_effects_of(simulator, robot)
        self.robot_fit = self._with_effects_of(robot, simulator)
        self.simulator_terms = _terms(self.simulator_fit)
        self.robot_terms = _terms(self.robot_fit)

    def _with_effects_of(self, own: Fit, other: Fit) -> Fit:
        """A fit with the effects of another besides its own: those with coefficients, and those that every log has."""
        own_terms = _terms(own)
        entries = list(own.experiment.config.effects)
        moving = []
        for key, term in _terms(other).items():
            if key in own_terms or term.entry is None:
                continue
            background = term.effect.background_entry()
            if background is not None:
                moving.append(len(entries))
                entries.append(term.entry.model_copy(update={"parameters": background.parameters}))
            elif len(term.theta):
                entries.append(term.entry)
        if len(entries) == len(own.experiment.config.effects):
            return own
        try:
            experiment = with_effects(own.experiment, entries, own.estimate.theta)
            return fit(_with_fitted_values(experiment, moving, self.progress), self.progress)
        except FAILURES:  # these data cannot tell them
            return own

    @property
    def keys(self) -> list[TermKey]:
        """Effects of both, and the bodies if the robot's were identified."""
        keys = list(dict.fromkeys([*self.simulator_terms, *self.robot_terms]))
        return keys if has_fixed_inertia(self.robot_fit.experiment) else [*keys, _ALL_BODIES]

    def variant(self, from_robot: Collection[TermKey]) -> tuple[Experiment, Array]:
        """The simulator's model on the robot's logs, and its coefficients.

        Parameters
        ----------
        from_robot
            Effects that are as the robot has them.
        """
        terms = []
        for key in self.keys:
            term = (self.robot_terms if key in from_robot else self.simulator_terms).get(key)
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
            elif _ALL_BODIES in from_robot:
                theta[part] = fitted.estimate.theta[part]
        if equation.depends_on_parameters:
            experiment = replace(experiment, equation=equation.linearized_at(theta))
        return experiment, theta

    def squared_errors(self, from_robot: Collection[TermKey]) -> Array:
        """Mean squared torque error of `variant` on the robot's logs, shape (nv,) [(N·m)² or N²]."""
        experiment, theta = self.variant(from_robot)
        evaluation = evaluate(experiment, {"model": theta}, self.robot_fit.has_held_out, self.progress)
        errors = evaluation.errors["model"]
        return np.asarray(errors.sum_squares_in_band / max(errors.samples, 1))

    def gap_level(self, from_robot: Collection[TermKey], simulate: bool) -> GapLevel:
        """Errors of `variant` on the robot's logs."""
        squares = self.squared_errors(from_robot)
        joints = self.robot_fit.experiment.equation.joints
        torque = dict(zip(joints, np.sqrt(squares).tolist(), strict=True))
        torque["overall"] = float(np.sqrt(squares.mean()))
        position = None
        if simulate:
            experiment, theta = self.variant(from_robot)
            rollouts = evaluate_rollouts(experiment, {"model": theta}, self.robot_fit.has_held_out, self.progress)
            if "model" in rollouts.errors:
                position = rollouts.errors["model"].rmse(joints, "position")
        return GapLevel(torque, position)


def _changes(sides: _Sides) -> tuple[list[Change], list[TermKey]]:
    """All differences, those to be made first and the largest share first; and the effects that are to be changed."""
    differing: dict[TermKey, list[Change]] = {}
    significant = []
    for key in sides.keys:
        if key == _ALL_BODIES:
            differing[key] = _bodies_changes(sides)
            is_significant = _bodies_differ(sides)
        else:
            differing[key] = [_change(sides, key)]
            is_significant = _is_significant(differing[key][0])
        if is_significant:
            significant.append(key)
    shares, reasons = _gap_shares(sides, significant)

    changes = list(_delay_changes(sides))
    for key, own in differing.items():
        share = shares.get(key, 0.0)
        reason = reasons.get(key, _INSIGNIFICANT)
        changes += [replace(change, share=share, reason=reason) for change in own]
    changes.sort(key=lambda change: (bool(change.reason), -(change.share or 0.0)))
    return changes, [key for key in significant if not reasons[key]]


def _gap_shares(sides: _Sides, significant: Sequence[TermKey]) -> tuple[dict[TermKey, float], dict[TermKey, str]]:
    """Shares of the gap between simulator and robot that significant differences close.

    Returns
    -------
    The share of each difference, and the reason why it needs no change in the simulator; empty if it needs one.
    """
    joints = sides.robot_fit.experiment.equation.joints
    torque_std = np.array([sides.robot_fit.evaluation.torque_std[name] for name in joints])
    weights = 1 / np.maximum(torque_std, 1e-12) ** 2
    before = sides.squared_errors(())
    after = sides.squared_errors(significant)
    smallest = np.maximum(_MIN_SHARE * before, (_NEGLIGIBLE * torque_std) ** 2)
    gap = float(weights @ (before - after))
    shares: dict[TermKey, float] = {}
    reasons: dict[TermKey, str] = {}
    for key in significant:
        reopened = sides.squared_errors([other for other in significant if other != key]) - after
        shares[key] = float(weights @ reopened) / gap if gap > 0 else 0.0
        reasons[key] = "" if (reopened > smallest).any() else "hardly changes the torque"
    made = [key for key in significant if not reasons[key]]
    if made and weights @ sides.squared_errors(made) > (1 - _MIN_SHARE) * (weights @ before):
        for key in made:
            shares[key] = 0.0
            reasons[key] = "does not reduce the torque error together with the other changes"
    return shares, reasons


def _delay_changes(sides: _Sides) -> Iterator[Change]:
    """The delay from command to torque, if it was fitted on both sides."""
    simulator, robot = _fitted_delay(sides.simulator_fit), _fitted_delay(sides.robot_fit)
    if simulator is None or robot is None:
        return
    quantity = Quantity(simulator.value, simulator.standard_error, robot.value, robot.standard_error, "s")
    reason = "" if quantity.is_significant else _INSIGNIFICANT
    yield Change(COMMAND_DELAY, None, None, {"delay": quantity}, None, reason)


def _fitted_delay(fitted: Fit) -> UncertainValue | None:
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
    if controller is None or _fitted_delay(fitted) is None:
        return fitted
    entries = [entry for entry in experiment.config.effects if not _delays_torque(entry, experiment.model)]
    experiment = with_effects(experiment, entries, fitted.estimate.theta)
    unknown = controller.model_copy(update={"delay": "auto"})
    config = experiment.config.model_copy(update={"controller": unknown})
    experiment, _, _ = with_delay(replace(experiment, config=config), progress)
    return fit(experiment, progress)


def _delays_torque(entry: EffectEntry, model: RobotModel) -> bool:
    """True for an effect that delays the torque."""
    effect = effect_from_entry(entry, model)
    mechanism = Mechanism(model)
    effect.add_to_forward_model(np.array([c.prior for c in effect.coefficients]), mechanism)
    return bool(mechanism.torque_delay.any())


def _is_significant(change: Change) -> bool:
    """True if a parameter differs by more than chance, or one side has no such effect."""
    quantities = change.quantities.values()
    is_absent = any(quantity.simulator is None or quantity.robot is None for quantity in quantities)
    return is_absent or any(quantity.is_significant for quantity in quantities)


def _change(sides: _Sides, key: TermKey) -> Change:
    """An effect on both sides."""
    before, after = sides.simulator_terms.get(key), sides.robot_terms.get(key)
    term = after or before
    if term is None:
        raise AssertionError  # keys are those of the two
    simulator = before.parameters() if before else {}
    robot = after.parameters() if after else {}
    units = term.effect.parameter_units()
    quantities = {}
    for name in robot or simulator:
        unit = units.get(name)
        values = (*simulator.get(name, (None, None)), *robot.get(name, (None, None)))
        quantities[name] = Quantity(*values, None if unit == "1" else unit)
    if term.entry is None:
        return Change(term.effect.id, key[1], None, quantities, 0.0)
    return Change(term.effect.id, term.entry.joint, term.entry.link, quantities, 0.0)


def _bodies_changes(sides: _Sides) -> list[Change]:
    """The inertia of every link and rotor."""
    fitted = sides.robot_fit
    changes = []
    for i, body in enumerate(fitted.experiment.model.bodies):
        mass_error = float(fitted.uncertainty.standard_error[PI_SIZE * i])
        errors = {"mass": (0.0, mass_error if np.isfinite(mass_error) else None)}
        simulator = _mass_properties(body.pi)
        robot = _mass_properties(fitted.parameters(i))
        quantities = {}
        for name, unit in _BODY_UNITS.items():
            before_error, after_error = errors.get(name, (None, None))
            quantities[name] = Quantity(simulator[name], before_error, robot[name], after_error, unit)
        changes.append(Change(_BODIES, None, body.name, quantities, 0.0))
    return changes


def _bodies_differ(sides: _Sides) -> bool:
    """True if a parameter of a body differs significantly from the URDF's."""
    fitted = sides.robot_fit
    count = PI_SIZE * len(fitted.experiment.model.bodies)
    errors = fitted.uncertainty.standard_error[:count]
    difference = fitted.estimate.theta[:count] - fitted.experiment.equation.prior[:count]
    is_known = np.isfinite(errors)
    return bool((np.abs(difference[is_known]) > _MIN_SIGNIFICANCE * errors[is_known]).any())


def _mass_properties(pi: Array) -> dict[str, Any]:
    """Mass, centre of mass, and inertia about it [xx, xy, yy, xz, yz, zz], by the names of a report's bodies."""
    mass, com, inertia = mass_com_inertia(pi)
    return {"mass": float(mass), "com": com.tolist(), "inertia_com": symmetric_entries(inertia).tolist()}


def _notices(simulator: Diagnosis) -> Iterator[Notice]:
    """Notices about a simulator whose logs have faults, or whose logs the model's bodies do not explain."""
    for fault in simulator.faults:
        if fault.severity != "note":
            yield fault.about(f"simulator, {fault.subject}" if fault.subject else "simulator")
    last = simulator.last
    advice = "check that the simulator runs this URDF, with the same gravity, and logs the torque at the joints"
    for name, rms in simulator.after.torque.items():
        torque = last.evaluation.torque_std.get(name)
        if torque and rms > _MAX_UNEXPLAINED * torque:
            message = (
                f"the URDF's bodies do not explain the simulator's torque: {rms:.3g} of {torque:.3g} "
                f"{last.experiment.model.units[name]} RMS remain"
            )
            yield Notice("simulator_unexplained", "warning", name, message, advice)
    for entry in last.experiment.config.effects:
        effect = effect_from_entry(entry, last.experiment.model)
        if _changes_bodies(effect, last.experiment.model):
            target = entry.link or entry.joint
            name = effect.label or effect.id.replace("_", " ")
            parameter, value = next(iter(entry.values.items()))
            size = f"{value:.3g}" if isinstance(value, float) else f"{np.round(value, 3).tolist()}"
            unit = effect.parameter_units().get(parameter, "")
            size = f"{parameter} {size} {unit}".rstrip()
            message = f"the simulator's bodies are not those of the URDF: its logs show {name} ({size})"
            yield Notice("simulator_bodies_differ", "warning", target, message, advice)


def _changes_bodies(effect: NamedEffect, model: RobotModel) -> bool:
    """True for an effect of inertia or gravity."""
    mechanism = Mechanism(model)
    effect.add_to_forward_model(np.array([c.prior for c in effect.coefficients]), mechanism)
    is_moved = (mechanism.gravity != model.gravity).any()
    return bool(mechanism.pi.any() or is_moved or effect.modify_model(model) is not model)

"""A robot against its simulator: what to change in the simulator so that it moves as the robot does.

Both are diagnosed with the same model, the simulator with the bodies of the URDF, since it has exactly these. Then each
is fitted with the effects of both, so that every parameter has a value and a standard error on either side. A change is
an effect whose parameters differ significantly and without which the torque on the robot's logs is predicted noticeably
worse.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import capitalized, join_names
from idtool.common.notice import Notice
from idtool.common.number_text import parameter_text, short_number
from idtool.common.units import position_units, units_text
from idtool.data.inspection import inspect_log
from idtool.data.pairing import LogPair, align
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.error_summary import NEGLIGIBLE_SHARE
from idtool.diagnosis.fitted_pair import ALL_BODIES, FittedPair, GapLevel, TermKey, fitted_delay
from idtool.diagnosis.records import COMMAND_DELAY, RIGID_BODY, Diagnosis
from idtool.diagnosis.trial import with_effects
from idtool.dynamics.effects import NamedEffect, effect_from_entry, effect_name, mechanism_of
from idtool.dynamics.mechanism import Mechanism
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import PARAMETER_NAMES, PI_SIZE, mass_com_inertia, symmetric_entries
from idtool.robot.model import RobotModel

_MIN_SIGNIFICANCE = 3.0  # standard errors by which a parameter must differ
_INSIGNIFICANT = f"differs by less than {_MIN_SIGNIFICANCE:g} standard errors"
_UNKNOWN_ERROR = "its standard error in the simulator or on the robot is not known"
_MIN_SHARE = 0.01  # of a joint's squared gap that a change must close
_MAX_UNEXPLAINED = 0.05  # of a joint's rms torque that the simulator's model may leave
_MAX_OVER_FLOOR = 2.0  # times the noise floor: an error up to there may be noise
_IN_ROBOT_LOGS_ONLY = ("wrong_unit", "wrong_sign")  # faults that the configuration corrects in the robot's logs only
_CHECK_SIMULATOR = "check that the simulator runs this URDF, with the same gravity, and logs the torque at the joints"
_SMALL_TORQUE = np.array([1e-6])
_BODY_UNITS = {"mass": "kg", "com": "m", "inertia_com": "kg·m²"}


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
    def has_errors(self) -> bool:
        """True if both standard errors are known."""
        return self.simulator_error is not None and self.robot_error is not None

    @property
    def is_significant(self) -> bool:
        """True if the two differ by more than chance."""
        given = (self.simulator, self.simulator_error, self.robot, self.robot_error)
        elements = zip(*(_elements(value) for value in given), strict=False)  # the error of a list may be one None
        for simulator, simulator_error, robot, robot_error in elements:
            if not isinstance(simulator, float | int) or not isinstance(robot, float | int):
                continue
            if simulator_error is None or robot_error is None:
                continue
            if abs(robot - simulator) > _MIN_SIGNIFICANCE * np.hypot(simulator_error, robot_error):
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
        Share of the removed mean square torque error that returns without this change, every joint relative to its
        torque; of the inertia of links, without that of all links. None for the controller's delay, which changes the
        robot's torque.
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
class Obstacle:
    """Reason why a comparison is not conclusive.

    Attributes
    ----------
    reason
        The reason, a clause.
    advice
        What to do, one or two sentences.
    """

    reason: str
    advice: str


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
    obstacle
        Reason why the comparison is not conclusive, and what to do; None if it is conclusive.
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
    obstacle: Obstacle | None
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
    log_pairs = [align(run.signals.log, other.signals.log, joints) for run, other in runs]
    units = measured.model.units
    for log_pair in log_pairs:
        if log_pair.is_unrelated:
            what = f"does not show the motion of the robot's log {log_pair.measured}: {_difference(log_pair, units)}"
            raise LogError(log_pair.simulated, f"{what}; play the same commands in the simulator, under a controller")

    simulator_options = replace(options, inertia="fixed", assumed=(), simulate=False)
    simulator = diagnose(simulated, simulator_options, _prefixed(progress, "simulator"))
    with_simulator_effects = _with_further_effects(measured, _linear_entries(simulator))
    robot = diagnose(with_simulator_effects, options, _prefixed(progress, "robot"))

    pair = FittedPair(simulator.last, robot.last, _prefixed(progress, "comparison"))
    differences, changed_keys = _changes(pair, _unexplained_squares(simulator))
    changes = tuple(change for change in differences if not change.reason)
    before = pair.gap_level((), options.simulate)
    notices = [*_pair_notices(log_pairs, units), *_simulator_notices(simulator)]
    obstacle = _jumps(simulated)
    if obstacle is None:
        notices += _unexplained_notices(simulator)
        obstacle = _unexplained_simulator(simulator)
    if obstacle is None and not changes:
        obstacle = _unexplained_gap(before, robot)
    return Comparison(
        simulated=simulator,
        measured=robot,
        pairs=tuple(log_pairs),
        changes=changes,
        unchanged=tuple(change for change in differences if change.reason),
        before=before,
        after=pair.gap_level(changed_keys, options.simulate),
        obstacle=obstacle,
        notices=tuple(notices),
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
    """The experiment with those of further effects that it does not have already."""
    configured = experiment.config.effects
    present = {effect_from_entry(entry, experiment.model).key for entry in configured}
    more = [entry for entry in entries if effect_from_entry(entry, experiment.model).key not in present]
    return with_effects(experiment, [*configured, *more]) if more else experiment


def _unexplained_squares(diagnosis: Diagnosis) -> Array:
    """Mean squared torque error above the noise floor by joint, with all effects that were found, shape (n,)."""
    squares = []
    for name in diagnosis.last.experiment.equation.joints:
        square = diagnosis.after.torque[name] ** 2 - diagnosis.floor[name] ** 2
        squares.append(max(square, 0.0) if diagnosis.is_floor_known else 0.0)
    return np.array(squares)


def _changes(pair: FittedPair, unexplained: Array) -> tuple[list[Change], list[TermKey]]:
    """All differences, those to be made first and the largest share first; and the effects to be changed.

    Parameters
    ----------
    pair
        Models of simulator and robot.
    unexplained
        Mean squared error that the simulator's model has on the simulator's own logs, above the noise, shape (n,).
    """
    differences: dict[TermKey, list[Change]] = {}  # a change of all bodies is one of each of them
    significant = []
    for key in pair.keys:
        if key == ALL_BODIES:
            differences[key] = _bodies_changes(pair)
            is_significant = _bodies_differ(pair)
        else:
            change = _change(pair, key)
            differences[key] = [change]
            is_on_both_sides = key in pair.simulator_terms and key in pair.robot_terms
            is_significant = not is_on_both_sides or _is_significant(change)
        if is_significant:
            significant.append(key)
    gap_shares = _gap_shares(pair, significant, unexplained)

    changes = []
    delay_change = _delay_change(pair)
    if delay_change is not None:
        changes.append(delay_change)
    for key, changes_of_key in differences.items():
        for change in changes_of_key:
            gap_share = gap_shares.get(key, _GapShare(0.0, _insignificance(change)))
            changes.append(replace(change, share=gap_share.share, reason=gap_share.reason))
    changes.sort(key=lambda change: (bool(change.reason), -(change.share or 0.0)))
    return changes, _needed(gap_shares)


@dataclass(frozen=True)
class _GapShare:
    """Contribution of a difference to the gap between simulator and robot.

    Attributes
    ----------
    share
        Share of the squared gap that is open without the change.
    reason
        Reason why it needs no change in the simulator, a few words; empty if it needs one.
    """

    share: float
    reason: str


def _needed(gap_shares: Mapping[TermKey, _GapShare]) -> list[TermKey]:
    """Differences that need a change in the simulator."""
    return [key for key, gap_share in gap_shares.items() if not gap_share.reason]


def _gap_shares(pair: FittedPair, significant: Sequence[TermKey], unexplained: Array) -> dict[TermKey, _GapShare]:
    """Share of the gap between simulator and robot that each significant difference closes."""
    joints = pair.robot_fit.experiment.equation.joints
    torque_std = np.array([pair.robot_fit.evaluation.torque_std[name] for name in joints])
    weights = 1 / np.maximum(torque_std, 1e-12) ** 2
    before = pair.mean_squared_errors(())
    after = pair.mean_squared_errors(significant)
    least_change = np.maximum(_MIN_SHARE * before, (NEGLIGIBLE_SHARE * torque_std) ** 2)
    gap = float(weights @ (before - after))
    gap_shares: dict[TermKey, _GapShare] = {}
    for key in significant:
        others = [other for other in significant if other != key]
        reopened = pair.mean_squared_errors(others) - after
        share = float(weights @ reopened) / gap if gap > 0 else 0.0
        reason = ""
        if not (reopened > least_change).any():
            reason = "hardly changes the torque"
        elif not (reopened > np.maximum(least_change, unexplained)).any():
            reason = "changes the torque by less than the simulator's own logs leave unexplained"
        gap_shares[key] = _GapShare(share, reason)

    needed = _needed(gap_shares)
    if needed and weights @ pair.mean_squared_errors(needed) > (1 - _MIN_SHARE) * (weights @ before):
        without_effect = _GapShare(0.0, "does not reduce the torque error together with the other changes")
        gap_shares.update(dict.fromkeys(needed, without_effect))
    return gap_shares


def _delay_change(pair: FittedPair) -> Change | None:
    """The delay from command to torque; None unless it was fitted both in the simulator and on the robot."""
    simulator = fitted_delay(pair.simulator_fit)
    robot = fitted_delay(pair.robot_fit)
    if simulator is None or robot is None:
        return None
    quantity = Quantity(simulator.value, simulator.standard_error, robot.value, robot.standard_error, "s")
    reason = "" if quantity.is_significant else _INSIGNIFICANT
    return Change(COMMAND_DELAY, None, None, {"delay": quantity}, None, reason)


def _insignificance(change: Change) -> str:
    """Reason why a difference that is not significant needs no change, a few words."""
    has_errors = any(quantity.has_errors for quantity in change.quantities.values())
    return _INSIGNIFICANT if has_errors else _UNKNOWN_ERROR


def _is_significant(change: Change) -> bool:
    """True if a parameter of an effect that both sides have differs by more than chance."""
    return any(quantity.is_significant for quantity in change.quantities.values())


def _change(pair: FittedPair, key: TermKey) -> Change:
    """An effect in the simulator and on the robot."""
    simulator_term = pair.simulator_terms.get(key)
    robot_term = pair.robot_terms.get(key)
    term = robot_term or simulator_term
    if term is None:
        raise AssertionError  # keys are those of the two
    simulator = simulator_term.parameters() if simulator_term else {}
    robot = robot_term.parameters() if robot_term else {}
    units = term.effect.parameter_units()
    quantities = {}
    for name in dict.fromkeys([*robot, *simulator]):
        unit = units.get(name)
        values = (*simulator.get(name, (None, None)), *robot.get(name, (None, None)))
        quantities[name] = Quantity(*values, None if unit == "1" else unit)
    if term.entry is None:
        return Change(term.effect.id, key[1], None, quantities, 0.0)
    return Change(term.effect.id, term.entry.joint, term.entry.link, quantities, 0.0)


def _bodies_changes(pair: FittedPair) -> list[Change]:
    """The inertia of every link and rotor."""
    fitted = pair.robot_fit
    bodies = fitted.experiment.model.bodies
    standard_errors = fitted.uncertainty.standard_error[: PI_SIZE * len(bodies)].reshape(-1, PI_SIZE)
    mass_errors = standard_errors[:, PARAMETER_NAMES.index("m")]
    changes = []
    for i, body in enumerate(bodies):
        mass_error = float(mass_errors[i])
        errors = {"mass": (0.0, mass_error if np.isfinite(mass_error) else None)}
        simulator = _mass_properties(body.pi)
        robot = _mass_properties(fitted.parameters(i))
        quantities = {}
        for name, unit in _BODY_UNITS.items():
            before_error, after_error = errors.get(name, (None, None))
            quantities[name] = Quantity(simulator[name], before_error, robot[name], after_error, unit)
        changes.append(Change(RIGID_BODY, None, body.name, quantities, 0.0))
    return changes


def _bodies_differ(pair: FittedPair) -> bool:
    """True if a parameter of a body differs significantly from the URDF's."""
    fitted = pair.robot_fit
    count = PI_SIZE * len(fitted.experiment.model.bodies)
    errors = fitted.uncertainty.standard_error[:count]
    difference = fitted.estimate.theta[:count] - fitted.experiment.equation.prior[:count]
    is_known = np.isfinite(errors)
    return bool((np.abs(difference[is_known]) > _MIN_SIGNIFICANCE * errors[is_known]).any())


def _mass_properties(pi: Array) -> dict[str, Any]:
    """Mass, centre of mass, and inertia about it [xx, xy, yy, xz, yz, zz], by the names of a report's bodies."""
    mass, com, inertia = mass_com_inertia(pi)
    return {"mass": float(mass), "com": com.tolist(), "inertia_com": symmetric_entries(inertia).tolist()}


def _jumps(simulated: Experiment) -> Obstacle | None:
    """Jumps of the positions in the simulator's logs, as after a restart; None if there are none."""
    jumps = []
    for run in simulated.runs:
        for finding in inspect_log(run.signals.log).findings:
            if finding.code == "position_jumps" and finding.subject in simulated.model.names:
                jumps.append(f"{finding.message} on {finding.subject}")
    if not jumps:
        return None
    what = f"the simulator's logs have jumps, as after restarts ({join_names(jumps)})"
    advice = (
        "Log the simulator without restarts, under its controller; with `idtool simulate`, use `--closed-loop`, "
        "`--track` or `--window 0`. Then diagnose again."
    )
    return Obstacle(f"{what}: velocity and acceleration are wrong there", advice)


def _unexplained_simulator(simulator: Diagnosis) -> Obstacle | None:
    """Torque in the simulator's own logs that its model does not explain; None if it explains enough of it."""
    joints = _unexplained_joints(simulator)
    if not joints:
        return None
    reason = f"the simulator's own logs are not explained on {join_names(joints)}"
    return Obstacle(reason, f"{capitalized(_CHECK_SIMULATOR)}. Then diagnose again.")


def _unexplained_joints(simulator: Diagnosis) -> list[str]:
    """Joints on which much of the simulator's torque remains, and more than noise."""
    joints = []
    for name in simulator.last.experiment.equation.joints:
        rms = simulator.after.torque[name]
        torque = simulator.last.evaluation.torque_std[name]
        noise = _MAX_OVER_FLOOR * simulator.floor[name] if simulator.is_floor_known else 0.0
        limit = min(max(_MAX_UNEXPLAINED * torque, noise), torque)  # more than the torque is no noise
        if torque and rms > limit:
            joints.append(name)
    return joints


def _unexplained_notices(simulator: Diagnosis) -> Iterator[Notice]:
    """Notices about joints whose torque in the simulator's logs the model's bodies do not explain."""
    last = simulator.last
    for name in _unexplained_joints(simulator):
        unit = last.experiment.model.units[name]
        error = f"the error is {short_number(simulator.after.torque[name])} {unit} RMS"
        torque = f"the torque {short_number(last.evaluation.torque_std[name])} {unit}"
        message = f"the URDF's bodies do not explain the simulator's torque: {error}, {torque}"
        yield Notice("simulator_unexplained", "warning", name, message, _CHECK_SIMULATOR)


def _unexplained_gap(before: GapLevel, robot: Diagnosis) -> Obstacle | None:
    """An error of the simulator's model far above the noise floor although no change was found; None if it is near."""
    for name in robot.last.experiment.equation.joints:
        negligible = NEGLIGIBLE_SHARE * robot.last.evaluation.torque_std[name]
        if before.torque[name] > max(_MAX_OVER_FLOOR * robot.floor[name], negligible):
            advice = (
                "See the effects that need no change in diagnosis.html: those with large standard errors in the "
                "simulator are not determined by its logs. Log another motion in the simulator, and diagnose again."
            )
            return Obstacle("the simulator's error is far above the noise floor, and no difference explains it", advice)
    return None


def _difference(pair: LogPair, units: Mapping[str, str]) -> str:
    """Difference of the positions in two logs, as a clause; by the unit of each joint's torque."""
    unit = units_text(position_units(units))
    difference = f"the positions differ by {short_number(pair.position['overall'])} {unit} RMS"
    return f"{difference}, and the robot moves by {short_number(pair.motion['overall'])} {unit} RMS"


def _pair_notices(pairs: Sequence[LogPair], units: Mapping[str, str]) -> Iterator[Notice]:
    """Notices about pairs of logs that can hardly be of the same commands."""
    for pair in pairs:
        if not pair.moves_alike:
            names = f"{pair.measured} and {pair.simulated}"
            message = f"{names} do not show the same motion: {_difference(pair, units)}"
            yield Notice("pair_differs", "warning", None, message, "play the same commands in the simulator")


def _simulator_notices(simulator: Diagnosis) -> Iterator[Notice]:
    """Notices about a simulator whose logs have faults, or show what a simulator of the URDF cannot have."""
    for fault in simulator.faults:
        if fault.severity != "note":
            if fault.code in _IN_ROBOT_LOGS_ONLY:
                advice = "correct it where the simulator logs it: `log.scale` applies to the robot's logs only"
                fault = replace(fault, advice=advice)
            yield fault.about(f"simulator, {fault.subject}" if fault.subject else "simulator")
    last = simulator.last
    found = [step.entry for step in simulator.steps if step.entry is not None]
    for entry in found:
        effect = effect_from_entry(entry, last.experiment.model)
        if _is_foreign_to_simulators(effect, last.experiment.model):
            target = entry.link or entry.joint
            parameter, value = next(iter(entry.values.items()))
            size = parameter_text(parameter, value, unit=effect.parameter_units().get(parameter))
            shown = f"{effect_name(entry.effect)} ({size})"
            message = f"the simulator's logs show {shown}, which a simulator of this URDF does not have"
            yield Notice("simulator_bodies_differ", "warning", target, message, _CHECK_SIMULATOR)


def _is_foreign_to_simulators(effect: NamedEffect, model: RobotModel) -> bool:
    """True for other bodies, another gravity or a torque gain: a simulator of the URDF has none of them."""
    mechanism = mechanism_of(effect, model)
    has_other_bodies = bool(mechanism.pi.any())
    is_tilted = bool((mechanism.gravity != model.gravity).any())
    return has_other_bodies or is_tilted or _scales_torque(mechanism)


def _scales_torque(mechanism: Mechanism) -> bool:
    """True if sensors measure a multiple of small torques; an actuator that saturates does not."""
    return any(
        not np.isclose(sensor.to_measured(_SMALL_TORQUE), _SMALL_TORQUE, atol=0.0).all()
        for sensor in mechanism.torque_sensors.values()
    )

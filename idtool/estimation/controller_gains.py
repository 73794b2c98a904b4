"""The gains of joint controllers whose command and motion were logged and whose torque was not.

With kp and kd unknown, the torque equation is homogeneous in coefficients and gains together:

    Y theta = kp (qcmd(t − d) − q) + kd (vcmd(t − d) − v).

So the logs tell masses, friction and gains up to one common factor for each set of coupled joints, and the fit of all
of them to zero is perfect. The factor comes from outside: from a joint of the set whose torque was logged or whose kp
is given, or from known values that the motion determines, such as mass and centre of mass of one link. Known masses
alone do not: the torque tells first moments, and a mass only together with the first moment of the link before it.
Else the factor is that of the prior's bodies, which are the URDF's at the known masses: projected on their torque along
the logs, b0' G b0, that of the fitted bodies has the same size, b0' G b = b0' G b0, with G = Y_b' Y_b in units of the
joints' noise. This is a linear equation. If all masses of the prior are x % wrong, so are the gains.

A joint's residual is mostly noise of its position times kp. So E = qcmd − q is the noisy variable that is predicted,
and not a regressor: with its measured values as a column, kp would shrink to zero wherever the other joints hardly tell
its scale. That is the maximum-likelihood estimate of theta, gains and delay under the residual of E. Gauss-Newton steps
on the R-factors find it, with the delay on the polynomial of `command_delay`; the fit that follows determines the delay
again. Where joints hardly tell their scales from each other, the prior tells the size of each one's torque.

Standard errors are those of blocks of time for a given factor; they take account of coefficients and delay.

Without a moving vcmd, the column of kd is that of viscous friction: kd is then fitted only where the model has none.

Letters: E = qcmd(t − d) − q, which kp multiplies; p coefficients theta = K z, p' of them free (z); Y their columns, b
those of bodies; y the coefficients in a basis N of all z that satisfy the exact constraints, z = z0 + N y. In shapes, K
is the number of delays and G that of unknown gains.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import null_space
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import with_error
from idtool.data.batches import BatchSpan
from idtool.data.controller import MAX_DELAY, JointController
from idtool.data.logs.stored_arrays import column_ranges
from idtool.data.signals import Batch
from idtool.dynamics.effects import friction_types
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.command_delay import DelayPolynomial, minimizing_delay, projected_out, scaled_least_squares
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress, Rows, Run
from idtool.estimation.dataset.reduction import Reduction, empty
from idtool.estimation.dataset.weights import freedom_left
from idtool.estimation.problem.prior_bodies import prior_bodies
from idtool.estimation.uncertainty.base_parameters import structural_base_parameters
from idtool.estimation.uncertainty.cluster_robust import FEWEST_CLUSTERS
from idtool.robot.config import Controller, UncertainValue
from idtool.robot.inertia import PI_SIZE

GainName = Literal["kp", "kd"]
ScaleSource = Literal["logged_torque", "given_gain", "known_values", "prior"]

_SCALES: Mapping[ScaleSource, str] = {
    "logged_torque": "the logged torque of other joints",
    "given_gain": "the gains that are given",
    "known_values": "the known values of the configuration",
    "prior": "the masses of the prior",
}

_UNIT_GAINS: Mapping[GainName, tuple[float, float]] = {"kp": (1.0, 0.0), "kd": (0.0, 1.0)}  # kp and kd
_MOST_STEPS = 50
_CONVERGED = 1e-4  # relative change of all gains in a step
_MOST_KP_RATIO = 2.0  # of a kp to that before the step
_PRIOR_ERROR = 0.3  # relative standard error of the torque that the prior's bodies exert on a joint
# Divides _PRIOR_ERROR in the fit, but not in the standard errors: what a real robot's model leaves is no noise, and
# logs tell less than they seem.
_PRIOR_WEIGHT = 3.0
_LEAST_NOISE = 1e-4  # of a joint's torque
_TINY = 1e-12
_CLUSTERS = 2 * FEWEST_CLUSTERS
_LEAST_INFORMATION = 1e-6  # of a constraint: less of it that the motion determines is rounding
_LEAST_REST = 1e-3  # of a gain's column: less that no other column explains is rounding
_UNCERTAIN = 0.1  # relative standard error from which a gain is reported


@dataclass(frozen=True)
class ControllerGains:
    """Fitted gains.

    Attributes
    ----------
    kp, kd
        Fitted gains with their standard errors for a given scale, by joint [N·m/rad, N·m·s/rad].
    scales
        What fixed the scale, by joint.
    includes_friction
        Joints whose kd includes viscous friction.
    is_total_mass_known
        True if the prior has a total mass that was measured.
    has_converged
        False if the last step still changed a gain.
    """

    kp: Mapping[str, UncertainValue]
    kd: Mapping[str, UncertainValue]
    scales: Mapping[str, ScaleSource]
    includes_friction: tuple[str, ...]
    is_total_mass_known: bool
    has_converged: bool

    @property
    def text(self) -> str:
        """The gains in words, and what fixed their scale."""
        parts = []
        for name, gains in (("kp", self.kp), ("kd", self.kd)):
            if gains:
                values = ", ".join(f"{joint} {_gain_text(value)}" for joint, value in gains.items())
                parts.append(f"{name}: {values}")
        sources = join_names(list(dict.fromkeys(_SCALES[source] for source in self.scales.values())))
        return f"{'; '.join(parts)} (fitted, for the scale of {sources})"

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices about the source of the scale, and gains that are undetermined or not those of the controller."""
        notices = []
        if by_prior := [joint for joint, source in self.scales.items() if source == "prior"]:
            message = (
                "the logs determine the gains only relative to the masses, so their scale comes from the masses of the "
                f"prior: if all masses are 10 % wrong, so are the gains: {join_names(by_prior)}"
            )
            advice = "give one kp, or log the torque of one joint"
            if self.is_total_mass_known:
                notices.append(Notice("controller_gains_scale", "note", "controller", message, advice))
            else:
                advice = f"weigh the robot and set known.total_mass, {advice}"
                notices.append(Notice("controller_gains_scale", "warning", "controller", message, advice))
        uncertain = []
        for name, gains in (("kp", self.kp), ("kd", self.kd)):
            uncertain += [f"{name} of {joint}" for joint, gain in gains.items() if _is_uncertain(gain)]
        if uncertain:
            message = f"the logs hardly determine these gains: {join_names(uncertain)}"
            advice = "give them, or controller.delay if it is auto, or log faster motions with vcmd"
            notices.append(Notice("controller_gains_uncertain", "warning", "controller", message, advice))
        if not self.has_converged:
            message = f"the gains still change after {_MOST_STEPS} steps: the logs hardly tell them"
            advice = "give one kp, or controller.delay if it is auto"
            notices.append(Notice("controller_gains_not_converged", "warning", "controller", message, advice))
        if self.includes_friction:
            message = f"without a moving vcmd, kd includes viscous friction: {join_names(self.includes_friction)}"
            notices.append(Notice("controller_gain_with_friction", "note", "controller.kd", message))
        return tuple(notices)


def _gain_text(gain: UncertainValue) -> str:
    """A gain and its standard error."""
    return " ± ".join(with_error(gain.value, gain.standard_error))


def _is_uncertain(gain: UncertainValue) -> bool:
    """True for a gain whose standard error is a large share of it."""
    return (gain.standard_error or 0.0) > _UNCERTAIN * gain.value


def with_gains(experiment: Experiment, progress: Progress) -> tuple[Experiment, ControllerGains | None]:
    """Fit the gains where the configuration asks for it.

    Returns
    -------
    The experiment with numbers for all gains; and the fitted ones, None where all are given.

    Raises
    ------
    ConfigError
        If the logs cannot tell the gains.
    LogError
        If a joint has no sample that counts.
    """
    controller = experiment.config.controller
    gains = tuple(_unknown_gains(experiment))
    if controller is None or not gains:
        return experiment, None
    _check_model(experiment, gains)
    includes_friction = _joints_with_friction_in_kd(experiment, gains)
    fit = _GainFit(experiment, gains, progress)
    fitted: dict[GainName, dict[str, UncertainValue]] = {"kp": {}, "kd": {}}
    for gain, value, error in zip(gains, fit.values.tolist(), fit.standard_errors.tolist(), strict=True):
        fitted[gain.name][gain.joint] = UncertainValue(value=value, standard_error=error)
    known = _with_numbers(controller, experiment.equation.joints, fitted)
    config = experiment.config.model_copy(update={"controller": known})
    runs = []
    for run in experiment.runs:
        signals = run.signals
        joint_controller = JointController.from_log(signals.log, signals.joints, known)
        runs.append(replace(run, signals=signals.with_controller(joint_controller)))
    scales = {gain.joint: fit.scale.sources[gain.index] for gain in gains}
    is_weighed = config.known.total_mass is not None
    result = ControllerGains(fitted["kp"], fitted["kd"], scales, includes_friction, is_weighed, fit.has_converged)
    return replace(experiment, config=config, runs=tuple(runs)), result


def _with_numbers(
    controller: Controller, joints: Sequence[str], fitted: Mapping[GainName, Mapping[str, UncertainValue]]
) -> Controller:
    """The controller with fitted gains; joints whose gains are still unknown have none: their torque was logged."""
    kp, kd = {}, {}
    for joint in joints:
        own_kp, own_kd = controller.kp_of(joint), controller.kd_of(joint)
        if joint in fitted["kp"]:
            own_kp = fitted["kp"][joint].value
        if joint in fitted["kd"]:
            own_kd = fitted["kd"][joint].value
        if own_kp is not None and np.isfinite(own_kp + own_kd):
            kp[joint], kd[joint] = own_kp, own_kd
    return controller.model_copy(update={"kp": kp, "kd": kd})


@dataclass(frozen=True)
class _Gain:
    """One unknown gain of a joint, whose row of the torque equation has the index."""

    name: GainName
    joint: str
    index: int


def _unknown_gains(experiment: Experiment) -> Iterator[_Gain]:
    """The gains that are to be fitted, joint by joint."""
    controllers = [run.signals.controller for run in experiment.runs if run.train]
    for index in range(experiment.model.joint_count):
        commanded = [controller for controller in controllers if controller.joints[index]]
        if not commanded:
            continue
        joint = experiment.equation.joints[index]
        if np.isnan(commanded[0].kp[index, 0]):
            yield _Gain("kp", joint, index)
        if np.isnan(commanded[0].kd[index, 0]):
            yield _Gain("kd", joint, index)


def _check_model(experiment: Experiment, gains: Sequence[_Gain]) -> None:
    """Refuse a model with which gains are not fitted; ConfigError."""
    key = f"controller.{gains[0].name}"
    equation = experiment.equation
    if equation.contacts is not None:
        raise ConfigError(key, "fit is not for a floating base, contacts or wrench sensors; give a number")
    if equation.has_sensors or any(effect.uses_measured_torque for effect in equation.effects):
        what = "fit is not for models with effects on the measured torque, or with elastic joints"
        raise ConfigError(key, f"{what}; give a number, or remove these effects")


def _joints_with_friction_in_kd(experiment: Experiment, gains: Sequence[_Gain]) -> tuple[str, ...]:
    """Joints without a moving velocity command, whose kd includes viscous friction.

    Raises
    ------
    ConfigError
        If the model has viscous friction of such a joint, or its delay is not given: neither can be told from kd.
    """
    kd_joints = [gain.joint for gain in gains if gain.name == "kd"]
    without_command = [joint for joint in kd_joints if not _velocity_command_moves(experiment, joint)]
    viscous = friction_types()["viscous"].id
    with_viscous_friction = {c.owner for c in experiment.equation.coefficients if c.effect == viscous}
    controller = experiment.config.controller
    is_delay_given = controller is not None and controller.known_delay is not None
    confounded = [joint for joint in without_command if not is_delay_given or joint in with_viscous_friction]
    if confounded:
        what = f"without a moving vcmd, fit cannot tell kd of {join_names(confounded)} from viscous friction and delay"
        both = "or set friction.viscous: false and give controller.delay; kd then includes viscous friction"
        raise ConfigError("controller.kd", f"{what}; give kd, log vcmd, {both}")
    return tuple(without_command)


def _velocity_command_moves(experiment: Experiment, joint: str) -> bool:
    """True if a log that is fitted has a velocity command of a joint that changes."""
    index = experiment.equation.joints.index(joint)
    for run in experiment.runs:
        log = run.signals.log
        if run.train and run.signals.controller.joints[index] and log.has("vcmd", joint):
            column = log.joints.index(joint)
            least, greatest = column_ranges(log.signals["vcmd"][:, column : column + 1])
            if greatest[0] > least[0]:
                return True
    return False


def _torque_columns(equation: LinearModel, run: Run, gains: Sequence[_Gain], lags: DelayPolynomial) -> Rows:
    """Columns of the torque equation, those of the joint's gains and its known torque, both at each of the delays."""
    given = run.signals.controller
    signals = run.signals.with_controller(given.with_unknown_gains(0.0, 0.0))
    parts = signals.delayed_ranges(max(lags.delays), run.train)
    names = {gain.name for gain in gains}
    unit_controllers = {name: _unit_controller(given, *_UNIT_GAINS[name]) for name in names}

    def rows_of(batch: Batch, span: BatchSpan) -> tuple[list[Array], list[Mask]]:
        columns, kept = equation.filtered_rows(batch)
        known_torques = batch.filter(equation.delayed_torques(batch.motion))  # (K, nv, n)
        samples = slice(span.start - span.before, span.stop + span.after)
        unit_torques: dict[GainName, Array] = {}  # (K, nv, n) each
        for name, controller in unit_controllers.items():
            unit_torques[name] = batch.filter(signals.controller_torques(controller, samples, lags.delays))
        rows = []
        for j, own_columns in enumerate(columns):
            of_coefficients = own_columns[:-1]  # without the torque, which follows for each delay
            of_gains = [unit_torques[gain.name][:, j] for gain in gains if gain.index == j]
            rows.append(np.concatenate([of_coefficients, *of_gains, known_torques[:, j]]))
        return rows, kept

    return signals.batches(parts, delays=lags.delays).map_with_span(rows_of)


def _unit_controller(controller: JointController, kp: float, kd: float) -> JointController:
    """The controller with gains alike for all joints that it drives."""
    driven = np.where(controller.joints, 1.0, 0.0)[:, None]
    return replace(controller, kp=np.asarray(kp * driven), kd=np.asarray(kd * driven))


@dataclass(frozen=True)
class _JointRows:
    """One joint's rows, as of a triangular factor.

    Attributes
    ----------
    Y
        Columns of all free coefficients, shape (rows, p').
    unit_torques
        Of each of the joint's unknown gains, the torque that it would exert if it were 1, at each delay,
        shape (rows, K).
    known
        Torque of known gains, or as logged, at each delay, shape (rows, K).
    count
        Number of samples.
    """

    Y: Array
    unit_torques: Mapping[_Gain, Array]
    known: Array
    count: float

    def unit_torque(self, name: GainName, weights: Array) -> Array | None:
        """Torque of a gain of 1 between the delays, shape (rows,); None if the gain is not an unknown one."""
        for gain, torques in self.unit_torques.items():
            if gain.name == name:
                return np.asarray(torques @ weights)
        return None

    def residual_alone(self, weights: Array) -> float:
        """Norm of what coefficients of this joint alone leave of qcmd − q or, with known kp, of the torque."""
        position, velocity = self.unit_torque("kp", weights), self.unit_torque("kd", weights)
        columns = [self.Y] if velocity is None else [self.Y, velocity]
        target = self.known @ weights
        if position is not None:
            columns.append(target)
            target = position
        return float(np.linalg.norm(projected_out(target[:, None], np.column_stack(columns))))


@dataclass(frozen=True)
class _Estimate:
    """Coefficients, gains and delay, about which the torque equation is linearized.

    Attributes
    ----------
    z
        Free coefficients, shape (p',).
    gains
        The G gains in their order.
    delay
        [s].
    """

    z: Array
    gains: Mapping[_Gain, float]
    delay: float

    @property
    def values(self) -> Array:
        """The gains, shape (G,)."""
        return np.array(list(self.gains.values()))


class _Linearization(NamedTuple):
    """A joint's torque equation about an estimate, Y z = columns · (gains, delay) + right.

    Attributes
    ----------
    columns
        Derivatives of the controller's torque with respect to gains and delay, shape (rows, G + 1).
    right
        What does not depend on them, shape (rows,).
    residual
        Y z minus the controller's torque at the estimate, shape (rows,).
    """

    columns: Array
    right: Array
    residual: Array


class _GainFit:
    """Maximum-likelihood estimate of coefficients, gains and delay.

    Attributes
    ----------
    values, standard_errors
        The gains, and their standard errors for a given scale, shape (G,).
    scale
        What fixed the scale.
    has_converged
        False if the last step still changed a gain.
    """

    def __init__(self, experiment: Experiment, gains: Sequence[_Gain], progress: Progress) -> None:
        self._equation, self._equalities, self._gains = experiment.equation, experiment.equalities, gains
        controller = experiment.config.controller
        given = controller.known_delay if controller else None
        self._lags = DelayPolynomial(experiment.band_hz, given.value if given else None)
        data = experiment.blocks(
            lambda run: _torque_columns(experiment.equation, run, gains, self._lags),
            progress,
            "fitting the controller gains to",
        )
        total = merge_reductions([log.total for log in data])
        self._samples_per_independent = sum(f.rows for f in total) / sum(f.independent for f in total)
        rows = self._joint_rows(total)
        self.scale = _Scale(experiment, gains, [joint.Y for joint in rows])
        estimate = self._initial(rows)
        self.has_converged = False
        for _ in range(_MOST_STEPS):
            previous = estimate
            estimate = self._step(rows, previous)
            if np.allclose(estimate.values, previous.values, rtol=_CONVERGED, atol=0):
                self.has_converged = True
                break
        self.values = estimate.values
        self.standard_errors = self._errors(data, total, estimate)

    def _joint_rows(self, data: Reduction) -> list[_JointRows]:
        """The rows of each joint."""
        joints = []
        for j, (factor, columns) in enumerate(zip(data, self._equation.active(), strict=True)):
            Y = factor.R[:, : len(columns)] @ self._equalities.K[columns]
            own = [gain for gain in self._gains if gain.index == j]
            *unit_torques, known = np.split(factor.R[:, len(columns) :], len(own) + 1, axis=1)
            joints.append(_JointRows(Y, dict(zip(own, unit_torques, strict=True)), known, factor.rows))
        return joints

    def _initial(self, rows: Sequence[_JointRows]) -> _Estimate:
        """The delay with the least residuals of the joints alone, and gains and friction with the prior's bodies."""
        delay = self._lags.delays[0]
        if len(self._lags.delays) > 1:
            delay = minimizing_delay(lambda d: _cost_of_joints_alone(rows, self._lags.weights(d)))
        weights = self._lags.weights(delay)
        z = self.scale.prior.copy()
        gains: dict[_Gain, float] = {}
        for joint in rows:
            own = np.flatnonzero(self.scale.is_other & joint.Y.any(axis=0))
            values, own_z = self._initial_of_joint(joint, own, weights)
            z[own] = np.maximum(own_z, self.scale.lower[own])
            gains |= {gain: values[gain.name] for gain in joint.unit_torques}
        return _Estimate(z, gains, delay)

    def _initial_of_joint(self, joint: _JointRows, own: Indices, weights: Array) -> tuple[dict[GainName, float], Array]:
        """Gains and coefficients that are not of bodies, those of the indices, with the prior's bodies."""
        torque, known = joint.Y @ self.scale.prior, joint.known @ weights
        position, velocity = joint.unit_torque("kp", weights), joint.unit_torque("kd", weights)
        columns = [joint.Y[:, own]] if velocity is None else [joint.Y[:, own], -velocity]
        kp = 0.0
        if position is None:
            x, _ = scaled_least_squares(np.column_stack(columns), known - torque)
        else:
            if not position.any():
                what = "the position follows its command exactly, so that nothing tells the gain"
                raise ConfigError("controller.kp", f"{what}; log the command and the motion that it causes")
            relative, _ = scaled_least_squares(np.column_stack([torque - known, *columns]), position)
            is_positive = relative[0] > 0
            kp = 1 / relative[0] if is_positive else float(np.linalg.norm(torque) / np.linalg.norm(position))
            x = kp * relative[1:]
        kd = 0.0 if velocity is None else max(float(x[-1]), 0.0)
        return {"kp": float(kp), "kd": kd}, x[: len(own)]

    def _linearized(self, joint: _JointRows, estimate: _Estimate) -> _Linearization:
        """A joint's torque equation about an estimate; qcmd − q is predicted, see the module."""
        weights, slopes = self._lags.weights(estimate.delay), self._lags.slopes(estimate.delay)
        known = joint.known @ weights
        delay_slope = joint.known @ slopes  # d torque / d delay
        residual = joint.Y @ estimate.z - known
        columns = np.zeros((len(joint.Y), len(self._gains) + 1))
        own = [(i, *item) for i, item in enumerate(estimate.gains.items()) if item[0] in joint.unit_torques]
        for i, gain, value in own:
            columns[:, i] = joint.unit_torques[gain] @ weights
            residual = residual - value * columns[:, i]
            delay_slope = delay_slope + value * (joint.unit_torques[gain] @ slopes)
        right = known - delay_slope * estimate.delay
        for i, gain, value in own:
            if gain.name == "kp":
                columns[:, i] += residual / value  # qcmd − q as it is predicted
                right = right - residual
        columns[:, -1] = delay_slope
        return _Linearization(columns, right, residual)

    def _noise(self, rows: Sequence[_JointRows], estimate: _Estimate) -> Array:
        """Rms residual of each joint, shape (nv,) [N·m or N]."""
        noise = []
        for joint in rows:
            residual = float(np.linalg.norm(self._linearized(joint, estimate).residual))
            torque = float(np.linalg.norm(joint.Y @ estimate.z))
            noise.append(max(residual, _LEAST_NOISE * torque, _TINY) / np.sqrt(max(joint.count, 1.0)))
        return np.array(noise)

    def _system(
        self, rows: Sequence[_JointRows], estimate: _Estimate, noise: Array, with_soft: bool
    ) -> tuple[Array, Array, Array, Array]:
        """Rows of all joints in units of their noise: Y over z, columns, right side and residual of `_linearized`."""
        parts = []
        for joint, sigma in zip(rows, noise, strict=True):
            parts.append((joint.Y / sigma, *(part / sigma for part in self._linearized(joint, estimate))))
        if with_soft:
            soft = self.scale.soft()
            soft_rows = np.sqrt(self._samples_per_independent) * soft.rows
            values = np.sqrt(self._samples_per_independent) * soft.values
            no_gains = np.zeros((len(values), len(self._gains) + 1))
            parts.append((soft_rows, no_gains, values, soft_rows @ estimate.z - values))
        Y, columns, right, residual = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Y, columns, right, residual

    def _step(self, rows: Sequence[_JointRows], estimate: _Estimate) -> _Estimate:
        """The next estimate by a Gauss-Newton step within bounds."""
        noise = self._noise(rows, estimate)
        Y, columns, right, _ = self._system(rows, estimate, noise, with_soft=True)
        constrained = self.scale.constrained(noise)
        right = right - Y @ constrained.z0
        Y = Y @ constrained.N
        is_bounded = np.isfinite(constrained.lower)
        bounded, unbounded = Y[:, is_bounded], Y[:, ~is_bounded]
        bounded_count = bounded.shape[1]
        A = np.column_stack([bounded, -columns])  # of bounded coefficients, gains and delay
        lower_of_gains, upper_of_gains = self._bounds(estimate)
        lower = np.concatenate([constrained.lower[is_bounded], lower_of_gains])
        upper = np.concatenate([np.full(bounded_count, np.inf), upper_of_gains])
        without_unbounded = projected_out(np.column_stack([A, right]), unbounded)
        x = _bounded_least_squares(without_unbounded, lower, upper)
        y = np.zeros(Y.shape[1])
        y[is_bounded], gains_and_delay = np.split(x, [bounded_count])
        y[~is_bounded], _ = scaled_least_squares(unbounded, right - A @ x)
        *values, delay = gains_and_delay.tolist()
        z = constrained.z0 + constrained.N @ y
        return _Estimate(z, dict(zip(self._gains, values, strict=True)), delay)

    def _bounds(self, estimate: _Estimate) -> tuple[Array, Array]:
        """Lower and upper bounds of gains and delay for the step from an estimate, shape (G + 1,)."""
        lower, upper = [], []
        for gain, value in estimate.gains.items():
            is_kp = gain.name == "kp"
            lower.append(value / _MOST_KP_RATIO if is_kp else 0.0)
            upper.append(value * _MOST_KP_RATIO if is_kp else np.inf)
        is_given = len(self._lags.delays) == 1
        lower.append(estimate.delay - _TINY if is_given else 0.0)
        upper.append(estimate.delay + _TINY if is_given else MAX_DELAY)
        return np.array(lower), np.array(upper)

    def _errors(self, data: Sequence[Blocks], total: Reduction, estimate: _Estimate) -> Array:
        """Standard errors of the gains, shape (G,).

        They are those of scores in clusters of time, or by the number of independent samples if these are larger.
        """
        rows = self._joint_rows(total)
        noise = self._noise(rows, estimate)
        N = self.scale.constrained(noise).N
        Y, columns, _, _ = self._system(rows, estimate, noise, with_soft=True)
        of_columns, rank = scaled_least_squares(Y @ N, columns)  # what coefficients explain of them
        rest, size = columns - Y @ N @ of_columns, np.linalg.norm(columns, axis=0)
        self._check_determined(rest, size)
        has_column = np.linalg.norm(rest, axis=0) > _LEAST_REST * size  # a given delay has none
        rest = rest[:, has_column]
        inverse = np.linalg.inv(rest.T @ rest)

        soft = self.scale.soft()
        of_data, of_soft = np.split(rest, [len(rest) - len(soft.values)])
        soft_scores = of_soft * (soft.weights * np.sqrt(self._samples_per_independent))[:, None]
        soft_scatter = soft_scores.T @ soft_scores  # by the errors themselves, which the fit divides by the weights
        data_scatter = self._samples_per_independent * (of_data.T @ of_data)
        variance = np.diag(inverse @ (data_scatter + soft_scatter) @ inverse)

        scores = []
        length = max(sum(map(len, data)) // _CLUSTERS, 1)
        for log in data:
            for cluster in log.regrouped(length).parts:
                cluster_rows = self._joint_rows(cluster)
                own_Y, own_columns, _, residual = self._system(cluster_rows, estimate, noise, with_soft=False)
                own_rest = (own_columns - own_Y @ N @ of_columns)[:, has_column]
                scores.append(own_rest.T @ residual)
        if len(scores) >= FEWEST_CLUSTERS:
            cluster_scatter = np.atleast_2d(len(scores) * np.cov(np.transpose(scores))) / freedom_left(total, rank)
            robust = np.diag(inverse @ (cluster_scatter + soft_scatter) @ inverse)
            variance = np.maximum(variance, robust)
        return np.asarray(np.sqrt(variance[: len(self._gains)]))

    def _check_determined(self, rest: Array, size: Array) -> None:
        """Refuse gains whose columns the others explain; ConfigError."""
        for i, gain in enumerate(self._gains):
            own = projected_out(rest[:, [i]], np.delete(rest, i, axis=1))
            if np.linalg.norm(own) <= _LEAST_REST * size[i]:
                what = f"the logs do not tell {gain.name} of {gain.joint} from the coefficients of the model"
                raise ConfigError(f"controller.{gain.name}", f"{what}; give a number, or log other motions")


def _cost_of_joints_alone(rows: Sequence[_JointRows], weights: Array) -> float:
    """Negative log likelihood of the joints by themselves."""
    return sum(joint.count * float(np.log(joint.residual_alone(weights) + _TINY)) for joint in rows)


def _bounded_least_squares(rows: Array, lower: Array, upper: Array) -> Array:
    """Solution of least squares between bounds; the right side is the last column of the rows, shape (n, m + 1)."""
    from scipy.optimize import lsq_linear

    R = np.asarray(np.linalg.qr(rows, mode="r"))
    size = np.linalg.norm(R[:, :-1], axis=0)
    size[size == 0] = 1.0
    result = lsq_linear(R[:, :-1] / size, R[:, -1], bounds=(lower * size, upper * size), method="bvls")
    return np.asarray(result.x / size)


@dataclass(frozen=True)
class _Constrained:
    """Free coefficients that satisfy exact constraints, z0 + N y: shapes (p',) and (p', f); lower bounds of y (f,)."""

    z0: Array
    N: Array
    lower: Array


class _SoftConstraints(NamedTuple):
    """Measured constraints row · z = value, in units of their standard errors over their weights.

    Attributes
    ----------
    rows
        Shape (n, p').
    values
        Shape (n,).
    weights
        How many times more each counts in the fit than its standard error tells, shape (n,).
    """

    rows: Array
    values: Array
    weights: Array


class _Scale:
    """The prior's bodies, and what fixes the scale of each set of coupled joints.

    Attributes
    ----------
    sources
        By index of the joint; only joints of sets with unknown gains.
    prior
        Free coefficients of the prior's bodies, 0 for all others, shape (p',).
    is_other
        True for free coefficients that are not of bodies, shape (p',).
    lower
        Lower bounds of the free coefficients, shape (p',).
    """

    def __init__(self, experiment: Experiment, gains: Sequence[_Gain], rows: Sequence[Array]) -> None:
        self._equalities, joints = experiment.equalities, experiment.equation.joints
        every, free = experiment.equation.coefficients, experiment.equalities.free
        body_count = len(experiment.model.bodies)
        self.is_other = free >= PI_SIZE * body_count
        self.lower = np.array([every[i].lower for i in free])
        self.sources: dict[int, ScaleSource] = {}
        self._sets_by_prior: list[list[int]] = []
        for coupled in _coupled_joints(experiment):
            if any(gain.index in coupled for gain in gains):
                source = _scale_source(experiment, coupled)
                self.sources |= dict.fromkeys(coupled, source)
                if source == "prior":
                    self._sets_by_prior.append(coupled)
        self.prior = np.where(self.is_other, 0.0, _prior_theta(experiment, bool(self._sets_by_prior))[free])
        self._rows: list[Array] = []  # of each joint: torque by the prior times that of coefficients
        self._sizes: list[float] = []
        for Y in rows:
            row = np.where(self.is_other, 0.0, Y.T @ (Y @ self.prior))
            self._rows.append(row)
            self._sizes.append(float(row @ self.prior))
        self._with_unknown_kp = [gain.index for gain in gains if gain.name == "kp"]
        for j in self._with_unknown_kp:
            if not self._sizes[j] > 0:
                what = f"the URDF's bodies exert no torque on {joints[j]}, so that nothing tells the scale of its gains"
                raise ConfigError("controller.kp", f"{what}; give its kp, or correct the URDF's masses")

    def soft(self) -> _SoftConstraints:
        """Measured constraints, and that the torque of each joint with unknown kp has the size of the prior's."""
        measured = self._equalities.soft_rows()
        rows = [*(measured[:, :-1] @ self._equalities.K)]
        values = measured[:, -1].tolist()
        precision = _PRIOR_WEIGHT / _PRIOR_ERROR
        for j in self._with_unknown_kp:
            rows.append(precision * self._rows[j] / self._sizes[j])
            values.append(precision)
        weights = np.concatenate([np.ones(len(measured)), np.full(len(self._with_unknown_kp), _PRIOR_WEIGHT)])
        return _SoftConstraints(np.array(rows).reshape(-1, len(self.prior)), np.array(values), weights)

    def constrained(self, noise: Array) -> _Constrained:
        """The coefficients that satisfy the exact constraints, with the joints weighted by their noise, shape (nv,)."""
        rows = [constraint.row @ self._equalities.K for constraint in self._equalities.hard]
        values = [constraint.value for constraint in self._equalities.hard]
        for joints in self._sets_by_prior:
            rows.append(np.sum([self._rows[j] / noise[j] ** 2 for j in joints], axis=0))
            values.append(sum(self._sizes[j] / noise[j] ** 2 for j in joints))
        C = np.array(rows).reshape(-1, len(self.prior))
        size = np.linalg.norm(C, axis=1)
        C, right = C / size[:, None], np.array(values) / size
        N = null_space(C)
        lower = np.full(N.shape[1], -np.inf)
        is_free = ~C.any(axis=0)  # these come first in the basis, as they are
        lower[: np.count_nonzero(is_free)] = self.lower[is_free]
        return _Constrained(np.linalg.lstsq(C, right, rcond=None)[0], N, lower)


def _coupled_joints(experiment: Experiment) -> list[list[int]]:
    """Sets of joints whose equations have coefficients in common, by index."""
    sets: list[tuple[set[int], set[int]]] = []
    for j, columns in enumerate(experiment.equation.active()):
        free = set(np.flatnonzero(experiment.equalities.K[columns].any(axis=0)).tolist())
        joints = {j}
        apart = []
        for other_joints, other_free in sets:
            if free & other_free:
                joints |= other_joints
                free |= other_free
            else:
                apart.append((other_joints, other_free))
        sets = [*apart, (joints, free)]
    return [sorted(joints) for joints, _ in sets]


def _scale_source(experiment: Experiment, joints: Sequence[int]) -> ScaleSource:
    """Source of the scale of a set of coupled joints."""
    controllers = [run.signals.controller for run in experiment.runs if run.train]
    if any(not controller.joints[j] for controller in controllers for j in joints):
        return "logged_torque"
    if any(_has_given_gain(experiment, controller, j) for controller in controllers for j in joints):
        return "given_gain"
    if _known_values_determine_scale(experiment, joints):
        return "known_values"
    return "prior"


def _has_given_gain(experiment: Experiment, controller: JointController, j: int) -> bool:
    """True if a gain of a joint is given that friction cannot make up for, as it can for kd without a moving vcmd."""
    if controller.kp[j, 0] > 0:
        return True
    joint = experiment.equation.joints[j]
    return bool(controller.kd[j, 0] > 0) and _velocity_command_moves(experiment, joint)


def _known_values_determine_scale(experiment: Experiment, joints: Sequence[int]) -> bool:
    """True if the torque of a set of joints depends on known values of their coefficients.

    It does if not all known values can be had by changes of the coefficients that leave the torque unchanged.
    """
    active = np.unique(np.concatenate([experiment.equation.active()[j] for j in joints]))
    K = experiment.equalities.K
    rows, values = [], []
    for constraint in experiment.equalities.constraints:
        if constraint.row[active].any():
            size = float(np.linalg.norm(constraint.row @ K))
            rows.append(constraint.row @ K / size)
            values.append(constraint.value / size)
    if not any(values):
        return False
    base = structural_base_parameters(experiment.model, experiment.equation, experiment.equalities)
    B = base.B @ K
    unseen = null_space(B / np.linalg.norm(B, axis=1)[:, None])
    changed = np.array(rows) @ unseen
    needed = np.array(values)
    achieved = changed @ np.linalg.lstsq(changed, needed, rcond=_LEAST_INFORMATION)[0]
    return bool(np.linalg.norm(needed - achieved) > _LEAST_INFORMATION * np.linalg.norm(needed))


def _prior_theta(experiment: Experiment, fixes_scale: bool) -> Array:
    """Coefficients of the prior, shape (p,); ConfigError if it fixes the scale with placeholders and no total mass."""
    no_data = empty(experiment.equation.active())
    prior = prior_bodies(experiment.config, experiment.model, experiment.equation, no_data)
    if fixes_scale and prior.placeholders and experiment.config.known.total_mass is None:
        what = f"the logs tell gains only relative to masses, and the URDF's of {join_names(prior.placeholders)}"
        raise ConfigError("controller.kp", f"{what} are placeholders; set known.total_mass, or give one kp")
    return prior.equation.prior

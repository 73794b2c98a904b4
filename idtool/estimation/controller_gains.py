"""The gains of joint controllers whose command and motion were logged and whose torque was not.

With kp and kd unknown, the torque equation is homogeneous in coefficients and gains together:

    Y theta = kp (qcmd(t − d) − q) + kd (vcmd(t − d) − v).

The logs determine masses, friction and gains only up to one common scale for each set of coupled joints. Without a
fixed scale, least squares returns the zero solution. The scale is fixed by the first of these that is there:

1. A joint of the set whose torque was logged, or a gain that is given.
2. Known values that fix at least one base parameter, for example mass and centre of mass of one link. Known masses
   alone do not: a link's mass enters the torques only in a sum with the first moment of the link before it.
3. The prior, with inertial parameters b0, known masses inserted; b are the fitted ones. Y_b b0 and Y_b b are the
   torques that both give at all samples. Each joint's torque is divided by the standard deviation of its residual. The
   projection of Y_b b onto Y_b b0 must equal Y_b b0, which is one linear equation in b:

       (Y_b b0) · (Y_b b) = |Y_b b0|²

   If all masses of the prior are x % wrong, so are the gains.

The residual is mostly the noise of the position times kp. The position error E = qcmd − q is therefore the dependent
variable. If it were a regressor, its noise would bias kp towards zero (errors in variables). The bias would be large
where the coupling to other joints hardly determines the scale of kp.

The estimate is the maximum-likelihood one of theta, gains and delay for Gaussian residuals of E. Gauss-Newton
iterations compute it from each joint's R-factor. Torque at a delay between the stored ones is interpolated with
`DelayPolynomial`. The delay that is found is used only for the gains: `with_delay` estimates it again.

Whatever fixes the scale, each joint with unknown kp also has a soft constraint. It is the equation of the prior for
that joint alone, with the relative standard error _PRIOR_TORQUE_ERROR. It has an effect only where the motion hardly
determines the scales of joints relative to each other.

Standard errors are conditional on the scale. They are the larger of those for independent samples and the
cluster-robust ones. A cluster is a stretch of time.

If vcmd is absent or constant, the column of kd is proportional to that of viscous friction, and nearly collinear with
that of the delay. Then kd is fitted only if the model has no viscous friction of the joint and the delay is given,
and the fitted kd includes viscous friction. Otherwise there is an error.

Letters and shapes, ' is a transpose:

- E = qcmd(t − d) − q [rad or m], d the delay [s]
- theta (p,) all coefficients, z (n_z,) the free ones: theta = K z
- y (n_y,) coordinates of all z that satisfy the exact constraints: z = z0 + N y
- Y (r, n_z) columns of z in the rows of an R-factor; Y_b those of the bodies
- n_d number of delays, n_g of unknown gains, n of samples, r of rows of an R-factor, nv of joints
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
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

_SOURCE_TEXTS: Mapping[ScaleSource, str] = {
    "logged_torque": "the logged torque of other joints",
    "given_gain": "the gains that are given",
    "known_values": "the known values of the configuration",
    "prior": "the masses of the prior",
}

_UNIT_GAINS: Mapping[GainName, tuple[float, float]] = {"kp": (1.0, 0.0), "kd": (0.0, 1.0)}  # kp and kd
_MAX_ITERATIONS = 50
_GAIN_TOLERANCE = 1e-4  # relative change of gains in an iteration below which the fit has converged
_MAX_KP_STEP_RATIO = 2.0  # by which an iteration may multiply or divide a kp
_PRIOR_TORQUE_ERROR = 0.3  # relative standard error of the torque that the prior's bodies exert on a joint
# In the fit, that error is divided by this. The residual of a real robot is model error rather than noise. A fit that
# takes it for noise would trust the logs too much.
_PRIOR_ERROR_DIVISOR = 3.0
_MIN_RELATIVE_NOISE = 1e-4  # relative to the joint's torque
_MIN_RESIDUAL_NORM = 1e-12  # norm of a residual, against division by 0 and log(0)
_DELAY_SLACK = 1e-12  # s; `lsq_linear` needs bounds that differ, also for a given delay
_TARGET_CLUSTERS = 2 * FEWEST_CLUSTERS
_RELATIVE_TOLERANCE = 1e-6  # of known values and singular values: smaller ones are rounding
_MIN_UNEXPLAINED_SHARE = 1e-3  # share of a column that other columns must leave unexplained; less is rounding
_MAX_RELATIVE_ERROR = 0.1  # standard error of a gain, relative to it, that needs no warning


@dataclass(frozen=True)
class ControllerGains:
    """Fitted gains.

    Attributes
    ----------
    kp, kd
        Fitted gains by joint, with standard errors conditional on the scale [N·m/rad or N/m; N·m·s/rad or N·s/m].
    scale_sources
        What fixed the scale, by joint.
    joints_with_friction_in_kd
        Joints whose kd includes viscous friction.
    is_total_mass_known
        True if known.total_mass is set.
    has_converged
        False if the last iteration still changed a gain by more than the tolerance.
    """

    kp: Mapping[str, UncertainValue]
    kd: Mapping[str, UncertainValue]
    scale_sources: Mapping[str, ScaleSource]
    joints_with_friction_in_kd: tuple[str, ...]
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
        sources = join_names(list(dict.fromkeys(_SOURCE_TEXTS[source] for source in self.scale_sources.values())))
        return f"{'; '.join(parts)} (fitted, for the scale of {sources})"

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices about the source of the scale, and gains that are undetermined or not those of the controller."""
        notices = []
        if by_prior := [joint for joint, source in self.scale_sources.items() if source == "prior"]:
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
            message = f"the gains still change after {_MAX_ITERATIONS} iterations: the logs hardly determine them"
            advice = "give one kp, or controller.delay if it is auto"
            notices.append(Notice("controller_gains_not_converged", "warning", "controller", message, advice))
        if self.joints_with_friction_in_kd:
            joints = join_names(self.joints_with_friction_in_kd)
            message = f"without a moving vcmd, kd includes viscous friction: {joints}"
            notices.append(Notice("controller_gain_with_friction", "note", "controller.kd", message))
        return tuple(notices)


def _gain_text(gain: UncertainValue) -> str:
    """A gain and its standard error."""
    return " ± ".join(with_error(gain.value, gain.standard_error))


def _is_uncertain(gain: UncertainValue) -> bool:
    """True for a gain whose standard error is a large share of it."""
    return (gain.standard_error or 0.0) > _MAX_RELATIVE_ERROR * gain.value


def with_gains(experiment: Experiment, progress: Progress) -> tuple[Experiment, ControllerGains | None]:
    """Fit the gains where the configuration asks for it.

    Returns
    -------
    The experiment with the fitted gains in place of unknown ones; and the fitted gains, None if all are given.

    Raises
    ------
    ConfigError
        If the logs do not determine the gains.
    LogError
        If a joint has no sample that counts.
    """
    controller = experiment.config.controller
    gains = tuple(_unknown_gains(experiment))
    if controller is None or not gains:
        return experiment, None
    _check_model_is_supported(experiment, gains)
    joints_with_friction = _checked_joints_with_friction_in_kd(experiment, gains)
    fit = _GainFit(experiment, gains, progress)
    fitted: dict[GainName, dict[str, UncertainValue]] = {"kp": {}, "kd": {}}
    for gain, value, error in zip(gains, fit.gain_values.tolist(), fit.standard_errors.tolist(), strict=True):
        if gain.name == "kp" and not error < value:
            raise _undetermined_error(gain)
        fitted[gain.name][gain.joint] = UncertainValue(value=value, standard_error=error)
    completed = _with_fitted_gains(controller, experiment.equation.joints, fitted)
    config = experiment.config.model_copy(update={"controller": completed})
    runs = []
    for run in experiment.runs:
        signals = run.signals
        joint_controller = JointController.from_log(signals.log, signals.joints, completed)
        runs.append(replace(run, signals=signals.with_controller(joint_controller)))
    result = ControllerGains(
        kp=fitted["kp"],
        kd=fitted["kd"],
        scale_sources={gain.joint: fit.constraints.sources[gain.joint_index] for gain in gains},
        joints_with_friction_in_kd=joints_with_friction,
        is_total_mass_known=config.known.total_mass is not None,
        has_converged=fit.has_converged,
    )
    return replace(experiment, config=config, runs=tuple(runs)), result


def _with_fitted_gains(
    controller: Controller, joints: Sequence[str], fitted: Mapping[GainName, Mapping[str, UncertainValue]]
) -> Controller:
    """The controller with fitted gains.

    A joint whose torque was logged throughout has no gains in it if one of them is unknown.
    """
    kp, kd = {}, {}
    for joint in joints:
        joint_kp, joint_kd = controller.kp_of(joint), controller.kd_of(joint)
        if joint in fitted["kp"]:
            joint_kp = fitted["kp"][joint].value
        if joint in fitted["kd"]:
            joint_kd = fitted["kd"][joint].value
        # None: the joint has no controller; NaN: unknown still, since all logs have the joint's torque.
        if joint_kp is not None and np.isfinite(joint_kp + joint_kd):
            kp[joint], kd[joint] = joint_kp, joint_kd
    return controller.model_copy(update={"kp": kp, "kd": kd})


@dataclass(frozen=True)
class _UnknownGain:
    """A gain that is to be fitted: its name, and its joint by name and by index in the torque equation."""

    name: GainName
    joint: str
    joint_index: int


def _unknown_gains(experiment: Experiment) -> Iterator[_UnknownGain]:
    """The gains that are to be fitted, joint by joint.

    They are NaN in the controllers of the logs. The gains of a joint are the same in all logs.
    """
    controllers = [run.signals.controller for run in experiment.runs if run.train]
    for j in range(experiment.model.joint_count):
        # Of the logs in which the joint's torque is computed, not logged:
        controllers_of_joint = [controller for controller in controllers if controller.joints[j]]
        if not controllers_of_joint:
            continue
        joint = experiment.equation.joints[j]
        if np.isnan(controllers_of_joint[0].kp[j, 0]):
            yield _UnknownGain("kp", joint, j)
        if np.isnan(controllers_of_joint[0].kd[j, 0]):
            yield _UnknownGain("kd", joint, j)


def _check_model_is_supported(experiment: Experiment, gains: Sequence[_UnknownGain]) -> None:
    """Refuse a model with which gains are not fitted; ConfigError."""
    key = f"controller.{gains[0].name}"
    equation = experiment.equation
    if equation.contacts is not None:
        raise ConfigError(key, "fit does not support a floating base, contacts or wrench sensors; give a number")
    if equation.has_sensors or any(effect.uses_measured_torque for effect in equation.effects):
        what = "fit does not support effects on the measured torque or elastic joints"
        raise ConfigError(key, f"{what}; give a number, or remove these effects")


def _checked_joints_with_friction_in_kd(experiment: Experiment, gains: Sequence[_UnknownGain]) -> tuple[str, ...]:
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
        what = f"without a moving vcmd, kd of {join_names(confounded)} cannot be told from viscous friction and delay"
        both = "or set friction.viscous: false and give controller.delay; kd then includes viscous friction"
        raise ConfigError("controller.kd", f"{what}; give kd, log vcmd, {both}")
    return tuple(without_command)


def _velocity_command_moves(experiment: Experiment, joint: str) -> bool:
    """True if the joint's velocity command changes in a log that is fitted."""
    index = experiment.equation.joints.index(joint)
    for run in experiment.runs:
        log = run.signals.log
        if run.train and run.signals.controller.joints[index] and log.has("vcmd", joint):
            column = log.joints.index(joint)
            least, greatest = column_ranges(log.signals["vcmd"][:, column : column + 1])
            if greatest[0] > least[0]:
                return True
    return False


def _columns_of_joints(
    equation: LinearModel, run: Run, gains: Sequence[_UnknownGain], delay_polynomial: DelayPolynomial
) -> Rows:
    """Each joint's filtered columns, which `_GainFit._joint_factors` splits.

    In this order: its coefficients; for each of its unknown gains, the torque of a gain of 1 at each delay; the known
    torque, as logged or of given gains, at each delay.
    """
    controller = run.signals.controller
    signals = run.signals.with_controller(controller.with_unknown_gains(0.0, 0.0))  # its torque is the known one
    delays = delay_polynomial.delays
    ranges = signals.delayed_ranges(max(delays), run.train)
    gain_names = {gain.name for gain in gains}
    unit_controllers = {name: _with_uniform_gains(controller, *_UNIT_GAINS[name]) for name in gain_names}

    def rows_of(batch: Batch, span: BatchSpan) -> tuple[list[Array], list[Mask]]:
        columns, kept = equation.filtered_rows(batch)
        known_torques = batch.filter(equation.delayed_torques(batch.motion))  # (n_d, nv, n)
        samples = slice(span.start - span.before, span.stop + span.after)  # with those that the filter needs
        unit_torques: dict[GainName, Array] = {}  # (n_d, nv, n) each
        for name, unit_controller in unit_controllers.items():
            unit_torques[name] = batch.filter(signals.controller_torques(unit_controller, samples, delays))
        columns_of_joints = []
        for j, own_columns in enumerate(columns):
            of_coefficients = own_columns[:-1]  # without the torque, which follows for each delay
            of_gains = [unit_torques[gain.name][:, j] for gain in gains if gain.joint_index == j]
            columns_of_joints.append(np.concatenate([of_coefficients, *of_gains, known_torques[:, j]]))
        return columns_of_joints, kept

    return signals.batches(ranges, delays=delays).map_with_span(rows_of)


def _with_uniform_gains(controller: JointController, kp: float, kd: float) -> JointController:
    """The controller with gains alike for all joints that it drives."""
    driven = np.where(controller.joints, 1.0, 0.0)[:, None]
    return replace(controller, kp=np.asarray(kp * driven), kd=np.asarray(kd * driven))


@dataclass(frozen=True)
class _JointFactor:
    """One joint's triangular factor, split by its columns.

    Attributes
    ----------
    Y
        Columns of all free coefficients, shape (r, n_z).
    unit_torques
        Torque of each of the joint's unknown gains with a value of 1, at each delay, shape (r, n_d).
    known_torques
        Torque of known gains, or as logged, at each delay, shape (r, n_d).
    sample_count
        Number of samples behind the factor.
    """

    Y: Array
    unit_torques: Mapping[_UnknownGain, Array]
    known_torques: Array
    sample_count: float

    def unit_torque(self, name: GainName, delay_weights: Array) -> Array | None:
        """Torque of a gain of 1, interpolated to a delay, shape (r,): qcmd − q or vcmd − v; None for a known gain."""
        for gain, torques in self.unit_torques.items():
            if gain.name == name:
                return np.asarray(torques @ delay_weights)
        return None

    def independent_residual_norm(self, delay_weights: Array) -> float:
        """Residual norm of a fit of this joint only, to qcmd − q or, with known kp, to the known torque."""
        position_error = self.unit_torque("kp", delay_weights)
        velocity_error = self.unit_torque("kd", delay_weights)
        known_torque = self.known_torques @ delay_weights
        columns = [self.Y]
        if velocity_error is not None:
            columns.append(velocity_error)
        if position_error is None:
            target = known_torque
        else:
            target = position_error
            columns.append(known_torque)  # its coefficient is −1 / kp
        return float(np.linalg.norm(projected_out(target[:, None], np.column_stack(columns))))


@dataclass(frozen=True)
class _Estimate:
    """Coefficients, gains and delay, about which the torque equation is linearized.

    Attributes
    ----------
    z
        Free coefficients, shape (n_z,).
    gains
        The unknown gains in their order.
    delay
        [s].
    """

    z: Array
    gains: Mapping[_UnknownGain, float]
    delay: float

    @property
    def gain_values(self) -> Array:
        """The gains, shape (n_g,)."""
        return np.array(list(self.gains.values()))


class _Linearization(NamedTuple):
    """A joint's torque equation about an estimate, Y z = columns · (gains, delay) + right.

    Attributes
    ----------
    columns
        Columns of gains and delay, shape (r, n_g + 1). Those of kd and delay are derivatives of the controller's
        torque. That of kp is the predicted E, which is the measured one plus residual / kp.
    right
        Part that does not depend on gains and delay, shape (r,).
    residual
        Y z minus the controller's torque at the estimate, shape (r,).
    """

    columns: Array
    right: Array
    residual: Array


class _GainFit:
    """Maximum-likelihood estimate of coefficients, gains and delay.

    Attributes
    ----------
    gain_values, standard_errors
        The gains, and their standard errors conditional on the scale, shape (n_g,).
    constraints
        The constraints of the coefficients, and what fixed the scale.
    has_converged
        False if the last iteration still changed a gain by more than the tolerance.
    """

    def __init__(self, experiment: Experiment, gains: Sequence[_UnknownGain], progress: Progress) -> None:
        self._equation, self._equalities, self._gains = experiment.equation, experiment.equalities, gains
        controller = experiment.config.controller
        given_delay = controller.known_delay if controller else None
        self._delays = DelayPolynomial(experiment.band_hz, given_delay.value if given_delay else None)
        data = experiment.blocks(
            lambda run: _columns_of_joints(experiment.equation, run, gains, self._delays),
            progress,
            "fitting the controller gains to",
        )
        total = merge_reductions([log.total for log in data])
        self._redundancy = sum(factor.rows for factor in total) / sum(factor.independent for factor in total)
        joints = self._joint_factors(total)
        self.constraints = _Constraints(experiment, gains, [joint.Y for joint in joints])
        estimate = self._initial_estimate(joints)
        self.has_converged = False
        for _ in range(_MAX_ITERATIONS):
            previous = estimate
            estimate = self._next_estimate(joints, previous)
            if np.allclose(estimate.gain_values, previous.gain_values, rtol=_GAIN_TOLERANCE, atol=0):
                self.has_converged = True
                break
        self.gain_values = estimate.gain_values
        self.standard_errors = self._standard_errors(data, total, estimate)

    def _joint_factors(self, data: Reduction) -> list[_JointFactor]:
        """The factor of each joint, split by columns as `_columns_of_joints` has them."""
        joints = []
        for j, (factor, columns) in enumerate(zip(data, self._equation.active(), strict=True)):
            Y = self._equalities.free_columns(factor.R[:, : len(columns)], columns)
            own = [gain for gain in self._gains if gain.joint_index == j]
            *unit_torques, known_torques = np.split(factor.R[:, len(columns) :], len(own) + 1, axis=1)
            joints.append(_JointFactor(Y, dict(zip(own, unit_torques, strict=True)), known_torques, factor.rows))
        return joints

    def _initial_estimate(self, joints: Sequence[_JointFactor]) -> _Estimate:
        """The delay that fits best, each joint by itself; then gains and friction with the prior's bodies."""
        delay = self._delays.delays[0]
        if len(self._delays.delays) > 1:
            delay = minimizing_delay(lambda d: _cost_of_independent_joints(joints, self._delays.weights(d)))
        delay_weights = self._delays.weights(delay)
        z = self.constraints.prior_z.copy()
        gains: dict[_UnknownGain, float] = {}
        for joint in joints:
            own = np.flatnonzero(self.constraints.is_not_of_body & joint.Y.any(axis=0))
            values, own_z = self._initial_gains_and_friction(joint, own, delay_weights)
            z[own] = np.maximum(own_z, self.constraints.lower[own])
            gains |= {gain: values[gain.name] for gain in joint.unit_torques}
        return _Estimate(z, gains, delay)

    def _initial_gains_and_friction(
        self, joint: _JointFactor, own: Indices, delay_weights: Array
    ) -> tuple[dict[GainName, float], Array]:
        """Unknown gains of a joint, and its own coefficients by index, with the bodies fixed to the prior."""
        body_torque = joint.Y @ self.constraints.prior_z
        known_torque = joint.known_torques @ delay_weights
        position_error = joint.unit_torque("kp", delay_weights)
        velocity_error = joint.unit_torque("kd", delay_weights)
        columns = [joint.Y[:, own]]
        if velocity_error is not None:
            columns.append(-velocity_error)
        gains: dict[GainName, float] = {}
        if position_error is None:
            # Y z − kd (vcmd − v) = known torque − body torque
            x, _ = scaled_least_squares(np.column_stack(columns), known_torque - body_torque)
        else:
            if not position_error.any():
                what = "the position follows its command exactly, so the logs do not determine the gain"
                raise ConfigError("controller.kp", f"{what}; log the command and the motion that it causes")
            # (body torque − known torque) / kp + Y z / kp − (kd / kp) (vcmd − v) = qcmd − q
            A = np.column_stack([body_torque - known_torque, *columns])
            over_kp, _ = scaled_least_squares(A, position_error)
            if over_kp[0] > 0:
                kp = float(1 / over_kp[0])
            else:
                kp = float(np.linalg.norm(body_torque) / np.linalg.norm(position_error))
            gains["kp"] = kp
            x = kp * over_kp[1:]
        if velocity_error is not None:
            gains["kd"] = max(float(x[-1]), 0.0)
        return gains, x[: len(own)]

    def _linearized(self, joint: _JointFactor, estimate: _Estimate) -> _Linearization:
        """A joint's torque equation about an estimate; qcmd − q is predicted, see the module."""
        delay_weights, delay_slopes = self._delays.weights(estimate.delay), self._delays.slopes(estimate.delay)
        own = [(i, gain, value) for i, (gain, value) in enumerate(estimate.gains.items()) if gain in joint.unit_torques]
        known_torque = joint.known_torques @ delay_weights
        residual = joint.Y @ estimate.z - known_torque
        torque_slope = joint.known_torques @ delay_slopes  # d torque / d delay
        columns = np.zeros((len(joint.Y), len(self._gains) + 1))
        for i, gain, value in own:
            columns[:, i] = joint.unit_torques[gain] @ delay_weights
            residual = residual - value * columns[:, i]
            torque_slope = torque_slope + value * (joint.unit_torques[gain] @ delay_slopes)
        columns[:, -1] = torque_slope

        right = known_torque - torque_slope * estimate.delay
        for i, gain, value in own:
            if gain.name == "kp":
                # The predicted E in place of the measured one adds `residual` to the torque at the estimate. The same
                # is subtracted here, so that the residual at the estimate is unchanged.
                columns[:, i] += residual / value
                right = right - residual
        return _Linearization(columns, right, residual)

    def _noise(self, joints: Sequence[_JointFactor], estimate: _Estimate) -> Array:
        """Rms residual of each joint, shape (nv,) [N·m or N]."""
        noise = []
        for joint in joints:
            residual = float(np.linalg.norm(self._linearized(joint, estimate).residual))
            torque = float(np.linalg.norm(joint.Y @ estimate.z))
            norm = max(residual, _MIN_RELATIVE_NOISE * torque, _MIN_RESIDUAL_NORM)
            noise.append(norm / np.sqrt(max(joint.sample_count, 1.0)))
        return np.array(noise)

    def _system(
        self, joints: Sequence[_JointFactor], estimate: _Estimate, noise: Array, with_soft: bool
    ) -> tuple[Array, Array, Array, Array]:
        """Y, columns, right side and residual of `_linearized`: rows of all joints in units of their noise.

        The rows of soft constraints have zeros in the columns of gains and delay.
        """
        parts = []
        for joint, sigma in zip(joints, noise, strict=True):
            parts.append((joint.Y / sigma, *(part / sigma for part in self._linearized(joint, estimate))))
        if with_soft:
            # Samples are correlated, so the rows of data overstate their information by the redundancy. Soft rows are
            # multiplied likewise, so that their weight relative to the data is right.
            soft = self.constraints.soft()
            soft_row_scale = np.sqrt(self._redundancy)
            soft_rows, values = soft_row_scale * soft.rows, soft_row_scale * soft.values
            no_gains = np.zeros((len(values), len(self._gains) + 1))
            parts.append((soft_rows, no_gains, values, soft_rows @ estimate.z - values))
        Y, columns, right, residual = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Y, columns, right, residual

    def _next_estimate(self, joints: Sequence[_JointFactor], estimate: _Estimate) -> _Estimate:
        """The next estimate by a Gauss-Newton step within bounds."""
        noise = self._noise(joints, estimate)
        Y, columns, right, _ = self._system(joints, estimate, noise, with_soft=True)
        exact = self.constraints.exact(noise)
        # Y (z0 + N y) = columns · (gains, delay) + right
        target = right - Y @ exact.z0
        Y_N = Y @ exact.N
        is_bounded = np.isfinite(exact.lower)
        bounded, unbounded = Y_N[:, is_bounded], Y_N[:, ~is_bounded]
        bounded_count = bounded.shape[1]

        # Eliminate unbounded y by projecting out its columns; solve for the others within bounds; substitute back.
        A = np.column_stack([bounded, -columns])
        lower_of_gains, upper_of_gains = self._bounds_of_gains_and_delay(estimate)
        lower = np.concatenate([exact.lower[is_bounded], lower_of_gains])
        upper = np.concatenate([np.full(bounded_count, np.inf), upper_of_gains])
        projected_rows = projected_out(np.column_stack([A, target]), unbounded)
        x = _bounded_least_squares(projected_rows, lower, upper)
        y = np.zeros(Y_N.shape[1])
        y[is_bounded], gains_and_delay = np.split(x, [bounded_count])
        y[~is_bounded], _ = scaled_least_squares(unbounded, target - A @ x)
        *gain_values, delay = gains_and_delay.tolist()
        z = exact.z0 + exact.N @ y
        return _Estimate(z, dict(zip(self._gains, gain_values, strict=True)), delay)

    def _bounds_of_gains_and_delay(self, estimate: _Estimate) -> tuple[Array, Array]:
        """Lower and upper bounds of gains and delay for the step from an estimate, shape (n_g + 1,)."""
        lower, upper = [], []
        for gain, value in estimate.gains.items():
            is_kp = gain.name == "kp"
            lower.append(value / _MAX_KP_STEP_RATIO if is_kp else 0.0)
            upper.append(value * _MAX_KP_STEP_RATIO if is_kp else np.inf)
        is_given = len(self._delays.delays) == 1
        lower.append(estimate.delay - _DELAY_SLACK if is_given else 0.0)
        upper.append(estimate.delay + _DELAY_SLACK if is_given else MAX_DELAY)
        return np.array(lower), np.array(upper)

    def _standard_errors(self, data: Sequence[Blocks], total: Reduction, estimate: _Estimate) -> Array:
        """Standard errors of the gains, shape (n_g,).

        The variance is H⁻¹ S H⁻¹ with H = X' X. X are the columns of gains and delay after those of the coefficients
        are projected out, and S is the covariance of the scores X' residual. S is computed once for independent samples
        and once from the scatter of scores between clusters of time. The larger variance counts.
        """
        joints = self._joint_factors(total)
        noise = self._noise(joints, estimate)
        N = self.constraints.exact(noise).N
        Y, columns, _, _ = self._system(joints, estimate, noise, with_soft=True)
        coefficients_of_columns_y, rank = scaled_least_squares(Y @ N, columns)  # shape (n_y, n_g + 1)
        projected_columns = columns - Y @ N @ coefficients_of_columns_y
        column_norms = np.linalg.norm(columns, axis=0)
        self._check_determined(projected_columns, column_norms)
        # Not a given delay, whose column is 0, nor one that the coefficients explain:
        is_determined = np.linalg.norm(projected_columns, axis=0) > _MIN_UNEXPLAINED_SHARE * column_norms
        X = projected_columns[:, is_determined]
        H_inverse = np.linalg.inv(X.T @ X)

        soft = self.constraints.soft()
        X_of_data, X_of_soft = np.split(X, [len(X) - len(soft.values)])
        covariance_of_data = self._redundancy * (X_of_data.T @ X_of_data)
        # In `_system`, the error of a soft row has this standard deviation.
        scaled_row_error = soft.error_divisors * np.sqrt(self._redundancy)
        X_times_row_error = X_of_soft * scaled_row_error[:, None]
        covariance_of_soft = X_times_row_error.T @ X_times_row_error
        variance = np.diag(H_inverse @ (covariance_of_data + covariance_of_soft) @ H_inverse)

        scores = self._scores_of_clusters(data, estimate, noise, N @ coefficients_of_columns_y, is_determined)
        if len(scores) >= FEWEST_CLUSTERS:
            scatter = np.atleast_2d(len(scores) * np.cov(np.transpose(scores)))
            covariance_of_clusters = scatter / freedom_left(total, rank)
            robust = np.diag(H_inverse @ (covariance_of_clusters + covariance_of_soft) @ H_inverse)
            variance = np.maximum(variance, robust)
        return np.asarray(np.sqrt(variance[: len(self._gains)]))  # without that of the delay

    def _scores_of_clusters(
        self,
        data: Sequence[Blocks],
        estimate: _Estimate,
        noise: Array,
        coefficients_of_columns: Array,
        is_determined: Mask,
    ) -> list[Array]:
        """X' residual of each cluster of time, see `_standard_errors`, without soft constraints."""
        scores = []
        blocks_per_cluster = max(sum(map(len, data)) // _TARGET_CLUSTERS, 1)
        for blocks_of_log in data:
            for cluster in blocks_of_log.regrouped(blocks_per_cluster).parts:
                joints = self._joint_factors(cluster)
                Y, columns, _, residual = self._system(joints, estimate, noise, with_soft=False)
                X = (columns - Y @ coefficients_of_columns)[:, is_determined]
                scores.append(X.T @ residual)
        return scores

    def _check_determined(self, projected_columns: Array, column_norms: Array) -> None:
        """Refuse a gain whose column those of coefficients, other gains and delay explain; ConfigError."""
        for i, gain in enumerate(self._gains):
            others = np.delete(projected_columns, i, axis=1)
            unexplained = projected_out(projected_columns[:, [i]], others)
            if np.linalg.norm(unexplained) <= _MIN_UNEXPLAINED_SHARE * column_norms[i]:
                raise _undetermined_error(gain)


def _undetermined_error(gain: _UnknownGain) -> ConfigError:
    """Error about a gain that the logs do not determine."""
    what = f"the logs do not determine {gain.name} of {gain.joint} beside the other unknowns of the model"
    return ConfigError(f"controller.{gain.name}", f"{what}; give a number, or log other motions")


def _cost_of_independent_joints(joints: Sequence[_JointFactor], delay_weights: Array) -> float:
    """Negative log likelihood, up to a constant, with each joint fitted by itself."""
    cost = 0.0
    for joint in joints:
        cost += joint.sample_count * float(np.log(joint.independent_residual_norm(delay_weights) + _MIN_RESIDUAL_NORM))
    return cost


def _bounded_least_squares(rows: Array, lower: Array, upper: Array) -> Array:
    """Solution of least squares between bounds; the right side is the last column of the rows, shape (n, m + 1)."""
    from scipy.optimize import lsq_linear

    R = np.asarray(np.linalg.qr(rows, mode="r"))
    size = np.linalg.norm(R[:, :-1], axis=0)
    size[size == 0] = 1.0
    result = lsq_linear(R[:, :-1] / size, R[:, -1], bounds=(lower * size, upper * size), method="bvls")
    return np.asarray(result.x / size)


@dataclass(frozen=True)
class _ExactConstraints:
    """All coefficients that satisfy the exact constraints, z = z0 + N y.

    Attributes
    ----------
    z0, N
        Shapes (n_z,) and (n_z, n_y).
    lower
        Lower bounds of y, shape (n_y,).
    """

    z0: Array
    N: Array
    lower: Array


class _SoftConstraints(NamedTuple):
    """Constraints row · z = value that hold up to an error: measured values, and the size of the prior's torques.

    Attributes
    ----------
    rows, values
        Both sides times divisor / standard error, shapes (n, n_z) and (n,).
    error_divisors
        Divisor of the standard error in the fit, shape (n,): 1 for measured values.
    """

    rows: Array
    values: Array
    error_divisors: Array


class _Constraints:
    """Constraints of the free coefficients, and what fixes the scale of each set of coupled joints.

    Attributes
    ----------
    sources
        What fixes the scale, by index of the joint; only joints of sets with unknown gains.
    prior_z
        Free coefficients of the prior's bodies, 0 for all others, shape (n_z,).
    is_not_of_body
        True for free coefficients that are not of bodies, shape (n_z,).
    lower
        Lower bounds of the free coefficients, shape (n_z,).
    """

    def __init__(self, experiment: Experiment, gains: Sequence[_UnknownGain], Y_of_joints: Sequence[Array]) -> None:
        self._equalities = experiment.equalities
        free = experiment.equalities.free
        coefficients = experiment.equation.coefficients  # those of bodies first
        self.is_not_of_body = free >= PI_SIZE * len(experiment.model.bodies)
        self.lower = np.array([coefficients[i].lower for i in free])
        self.sources: dict[int, ScaleSource] = {}
        self._sets_scaled_by_prior: list[list[int]] = []
        for coupled in _coupled_joints(experiment):
            if any(gain.joint_index in coupled for gain in gains):
                source = _scale_source(experiment, coupled)
                self.sources |= dict.fromkeys(coupled, source)
                if source == "prior":
                    self._sets_scaled_by_prior.append(coupled)
        prior_theta = _prior_theta(experiment, fixes_scale=bool(self._sets_scaled_by_prior))
        self.prior_z = np.where(self.is_not_of_body, 0.0, prior_theta[free])
        # Left and right side of the prior's equation, joint by joint: (Y_b b0)' Y_b, and |Y_b b0|².
        self._scale_rows: list[Array] = []
        self._scale_values: list[float] = []
        for Y in Y_of_joints:
            prior_torque = Y @ self.prior_z
            product = np.where(self.is_not_of_body, 0.0, Y.T @ prior_torque)
            self._scale_rows.append(product)
            self._scale_values.append(float(product @ self.prior_z))
        self._joints_with_unknown_kp = [gain.joint_index for gain in gains if gain.name == "kp"]
        for j in self._joints_with_unknown_kp:
            if not self._scale_values[j] > 0:
                joint = experiment.equation.joints[j]
                what = f"the URDF's bodies exert no torque on {joint}, so they do not determine the scale of its gains"
                raise ConfigError("controller.kp", f"{what}; give its kp, or correct the URDF's masses")

    def soft(self) -> _SoftConstraints:
        """Measured values; and for each joint with unknown kp, the equation of the prior for this joint alone."""
        measured = self._equalities.soft_rows()
        rows = [*(measured[:, :-1] @ self._equalities.K)]
        values = measured[:, -1].tolist()
        inverse_error = _PRIOR_ERROR_DIVISOR / _PRIOR_TORQUE_ERROR
        for j in self._joints_with_unknown_kp:
            rows.append(inverse_error * self._scale_rows[j] / self._scale_values[j])
            values.append(inverse_error)
        of_prior = np.full(len(self._joints_with_unknown_kp), _PRIOR_ERROR_DIVISOR)
        divisors = np.concatenate([np.ones(len(measured)), of_prior])
        return _SoftConstraints(np.array(rows).reshape(-1, len(self.prior_z)), np.array(values), divisors)

    def exact(self, noise: Array) -> _ExactConstraints:
        """The coefficients that satisfy the exact constraints, with the joints weighted by their noise, shape (nv,)."""
        constraint_rows = [constraint.row @ self._equalities.K for constraint in self._equalities.hard]
        values = [constraint.value for constraint in self._equalities.hard]
        for joints in self._sets_scaled_by_prior:
            constraint_rows.append(np.sum([self._scale_rows[j] / noise[j] ** 2 for j in joints], axis=0))
            values.append(sum(self._scale_values[j] / noise[j] ** 2 for j in joints))
        C = np.array(constraint_rows).reshape(-1, len(self.prior_z))
        size = np.linalg.norm(C, axis=1)
        C, right = C / size[:, None], np.array(values) / size
        N = null_space(C)
        # The first columns of `null_space` are the coefficients that no constraint contains, in their order. Only these
        # keep their bounds.
        is_unconstrained = ~C.any(axis=0)
        lower = np.full(N.shape[1], -np.inf)
        lower[: np.count_nonzero(is_unconstrained)] = self.lower[is_unconstrained]
        z0 = np.linalg.lstsq(C, right, rcond=None)[0]
        return _ExactConstraints(z0, N, lower)


def _coupled_joints(experiment: Experiment) -> list[list[int]]:
    """Sets of joints whose equations have coefficients in common, by index."""
    sets: list[tuple[set[int], set[int]]] = []
    for j, columns in enumerate(experiment.equation.active()):
        free = set(np.flatnonzero(experiment.equalities.K[columns].any(axis=0)).tolist())
        joints = {j}
        uncoupled = []
        for other_joints, other_free in sets:
            if free & other_free:
                joints |= other_joints
                free |= other_free
            else:
                uncoupled.append((other_joints, other_free))
        sets = [*uncoupled, (joints, free)]
    return [sorted(joints) for joints, _ in sets]


def _scale_source(experiment: Experiment, joints: Sequence[int]) -> ScaleSource:
    """Source of the scale of a set of coupled joints."""
    controllers = [run.signals.controller for run in experiment.runs if run.train]
    if any(not controller.joints[j] for controller in controllers for j in joints):  # False: the log has the torque
        return "logged_torque"
    if any(_has_given_gain(experiment, controller, j) for controller in controllers for j in joints):
        return "given_gain"
    if _known_values_determine_scale(experiment, joints):
        return "known_values"
    return "prior"


def _has_given_gain(experiment: Experiment, controller: JointController, j: int) -> bool:
    """True if kp of a joint is given, or kd with a moving vcmd; without one, kd cannot be told from friction."""
    if controller.kp[j, 0] > 0:
        return True
    joint = experiment.equation.joints[j]
    return bool(controller.kd[j, 0] > 0) and _velocity_command_moves(experiment, joint)


def _known_values_determine_scale(experiment: Experiment, joints: Sequence[int]) -> bool:
    """True if known values fix the scale of a set of joints: if no z without torque satisfies all of them."""
    active = np.unique(np.concatenate([experiment.equation.active()[j] for j in joints]))
    K = experiment.equalities.K
    constraint_rows, values = [], []
    for constraint in experiment.equalities.constraints:
        if constraint.row[active].any():
            row = constraint.row @ K
            size = float(np.linalg.norm(row))
            constraint_rows.append(row / size)
            values.append(constraint.value / size)
    if not any(values):
        return False  # z = 0 satisfies all of them
    base = structural_base_parameters(experiment.model, experiment.equation, experiment.equalities)
    B = base.B @ K
    zero_torque_directions = null_space(B / np.linalg.norm(B, axis=1)[:, None])  # of z
    known = np.array(values)
    known_of_directions = np.array(constraint_rows) @ zero_torque_directions
    combination = np.linalg.lstsq(known_of_directions, known, rcond=_RELATIVE_TOLERANCE)[0]
    mismatch = known - known_of_directions @ combination
    return bool(np.linalg.norm(mismatch) > _RELATIVE_TOLERANCE * np.linalg.norm(known))


def _prior_theta(experiment: Experiment, fixes_scale: bool) -> Array:
    """Coefficients of the prior, shape (p,); ConfigError if it fixes the scale with placeholders and no total mass."""
    no_data = empty(experiment.equation.active())
    prior = prior_bodies(experiment.config, experiment.model, experiment.equation, no_data)
    if fixes_scale and prior.placeholders and experiment.config.known.total_mass is None:
        what = f"the logs determine gains only relative to masses, and the URDF's of {join_names(prior.placeholders)}"
        raise ConfigError("controller.kp", f"{what} are placeholders; set known.total_mass, or give one kp")
    return prior.equation.prior

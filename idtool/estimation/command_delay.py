"""The delay from command to torque, by least squares along with the coefficients.

The torque of a joint controller is linear in what was commanded. In the band it is a smooth function of the delay d,
tau(d) = Σ_k w_k(d) tau_k by the polynomial through a few delays, whose tau_k are further columns beside Y. One pass
over the logs gives their R-factors. From these follow the least residual at any delay, the best delay, and by the
scores of blocks of time its standard error, which is honest for residuals that are correlated (see `cluster_robust`).

To first order, kp d stands for viscous friction, as a joint that follows its command moves with the command's velocity.
Friction that may not be negative bounds the delay from above.

Letters: p coefficients theta, Y their columns; K delays; g = d tau / d delay.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import least_squares, svd
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.controller import MAX_DELAY
from idtool.data.signals import Batch, Signals
from idtool.dynamics.effects import friction_types
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.experiment import Experiment, Progress, Rows, Run
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.estimation.dataset.weights import free_noise, freedom_left
from idtool.estimation.uncertainty.cluster_robust import FEWEST_CLUSTERS
from idtool.robot.config import Config, UncertainValue

_CONFOUNDED = 0.9  # correlation of two effects from which it is reported
_RANK = 1e-9  # of the largest singular value of scaled columns: less is rounding
_WEIGHINGS = 5  # of the joints by the residual noise at the best delay
_CONVERGED = 1e-5  # s, between two of them
_CLUSTERS = 2 * FEWEST_CLUSTERS  # few, so that what is correlated lies within one
_GRID = 64  # delays between which the best one is searched for
_SIGNIFICANT = 3.0  # standard errors
_LEAST_GAIN = 0.01  # share of the torque error that another delay must take off


@dataclass(frozen=True)
class CommandDelay:
    """The delay from command to torque.

    Attributes
    ----------
    value
        Delay with the least residual of the torque equation [s].
    standard_error
        Of the value [s]; None: the commands do not tell it.
    known_friction_error
        Standard error if viscous friction were known [s].
    correlation
        Of the delay with viscous friction, all joints' together; 0: there is none in the model.
    slope
        Derivative of the coefficients of least squares with respect to the delay, shape (p,) [1/s].
    given
        The configuration's delay; None: it was to be fitted.
    gain
        Relative reduction of the torque error, rms, from ``given`` to ``value``.
    viscous
        Mean viscous friction of commanded joints with ``given`` and with ``value`` [N·m·s/rad or N·s/m].
    """

    value: float
    standard_error: float | None
    known_friction_error: float | None
    correlation: float
    slope: Array
    given: UncertainValue | None
    gain: float
    viscous: tuple[float, float]

    @property
    def error(self) -> float:
        """Standard error of the delay that the model has, 0 where it is given without one [s]."""
        return (self.given.standard_error if self.given else self.standard_error) or 0.0

    @property
    def contradicted(self) -> bool:
        """True if the given delay differs from the fitted one significantly and with a larger torque error."""
        if self.given is None or self.standard_error is None:
            return False
        difference = abs(self.value - self.given.value)
        error = np.hypot(self.standard_error, self.given.standard_error or 0.0)
        return bool(difference > _SIGNIFICANT * error and self.gain > _LEAST_GAIN)

    @property
    def text(self) -> str | None:
        """The delay in words, and its correlation with viscous friction if high; None: the commands do not tell it."""
        if self.standard_error is None or self.known_friction_error is None:
            return None
        fitted = _milliseconds(self.value, self.standard_error)
        text = f"{fitted} from command to torque (fitted)"
        if self.given is not None:
            given = f"{short_number(1e3 * self.given.value)} ms"
            text = f"{given} from command to torque (given); the value fitted to the data is {fitted}"
        if self.correlation < _CONFOUNDED:
            return text
        known = _milliseconds(self.value, self.known_friction_error).partition(" ")[2]
        return (
            f"{text}; viscous friction has nearly the same effect (correlation {self.correlation:.2f}); if "
            f"friction were known, the standard error would be {known}"
        )

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices about a delay that is undetermined, contradicted or too long."""
        setting = "controller.delay"
        if self.standard_error is None:
            if self.given is not None:
                return ()
            message = "the commands do not determine the delay; 0 is used"
            return (
                Notice("command_delay_undetermined", "warning", setting, message, "log a motion, or give the delay"),
            )
        if self.contradicted and self.given is not None:
            fitted = _milliseconds(self.value, self.standard_error)
            before, after = self.viscous
            difference = (
                f"{short_number(1e3 * self.given.value)} ms is given, but the value fitted to the data is {fitted}"
            )
            change = f"the fitted delay reduces the torque error by {100 * self.gain:.1f} %"
            friction = (
                f" and changes mean viscous friction from {short_number(before, 2)} to {short_number(after, 2)}"
                if before or after
                else ""
            )
            message = f"{difference}; {change}{friction}"
            return (
                Notice(
                    "command_delay_contradicted",
                    "warning",
                    setting,
                    message,
                    "set the delay to auto, so that it is fitted",
                ),
            )
        if self.given is None and self.value >= MAX_DELAY - _CONVERGED:
            most = f"{1e3 * MAX_DELAY:.0f} ms"
            message = f"a delay of {most} or more fits best"
            advice = "check controller.kp and kd, or give the delay"
            return (Notice("command_delay_too_long", "warning", setting, message, advice),)
        return ()


def _milliseconds(value: float, error: float) -> str:
    """A time and its standard error [s], both to the error's second digit."""
    digits = max(1 - int(np.floor(np.log10(1e3 * error))), 0) if error else 3
    return f"{1e3 * value:.{digits}f} ± {1e3 * error:.{digits}f} ms"


def with_delay(
    experiment: Experiment, progress: Progress
) -> tuple[Experiment, CommandDelay | None, tuple[Blocks, ...] | None]:
    """Fit the delay where the configuration asks for it.

    Returns
    -------
    The experiment with the delay; the fitted delay, None where it is given or no torque comes from a command; and the
    training data with it, None where they must be read anew.
    """
    controller = experiment.config.controller
    if controller is None or controller.known_delay is not None:
        return experiment, None, None
    result = _fit_delay(experiment, progress)
    if result is None:
        return experiment, None, None
    fitted, data, lags = result
    delay = UncertainValue(value=fitted.value, standard_error=fitted.standard_error)
    config = experiment.config.model_copy(update={"controller": controller.model_copy(update={"delay": delay})})
    runs = tuple(_with_known_delay(run, config, fitted.value) for run in experiment.runs)
    experiment = replace(experiment, config=config, runs=runs)
    if any(effect.uses_measured_torque for effect in experiment.equation.effects):
        return experiment, fitted, None
    return experiment, fitted, tuple(log.map(lambda part: lags.at(part, fitted.value)) for log in data)


def _with_known_delay(run: Run, config: Config, delay: float) -> Run:
    """A run under a configuration with a delay [s] where there was none."""
    train = tuple(run.signals.delayed_ranges(delay, run.train))
    held_out = tuple(run.signals.delayed_ranges(delay, run.held_out))
    before = run.signals
    sensors = (before.base_sensors, before.wrench_channels, before.contact_channels)
    signals = Signals(before.log, before.joints, config, *sensors, before.recording, before.batch_samples)
    return Run(signals, train, held_out)


def command_delay(experiment: Experiment, progress: Progress) -> CommandDelay | None:
    """Fit the delay to the training data, also if one is given.

    Parameters
    ----------
    experiment
        Model and data. Columns that take the torque for something are those at its own delay.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    None where no torque comes from a command.
    """
    result = _fit_delay(experiment, progress)
    return result[0] if result else None


def _fit_delay(
    experiment: Experiment, progress: Progress
) -> tuple[CommandDelay, tuple[Blocks, ...], DelayPolynomial] | None:
    """The fitted delay, and the data with the torque at many delays."""
    controller = experiment.config.controller
    by_command = np.any([run.signals.controller.joints for run in experiment.runs if run.train], axis=0)
    if controller is None or not by_command.any():
        return None
    if experiment.equation.contacts is not None:
        if controller.known_delay is None:
            raise ConfigError("controller.delay", "is not fitted for a floating base or with contacts; give it in s")
        return None
    equation, equalities, given = experiment.equation, experiment.equalities, controller.known_delay
    lags = DelayPolynomial(experiment.band_hz)
    data = experiment.blocks(lambda run: _rows(equation, run, lags), progress, "fitting the delay to")
    total = merge_reductions([log.total for log in data])
    value = 0.0
    for _ in range(_WEIGHINGS):
        noise = free_noise(equation, lags.at(total, value), equalities)
        profile = _Profile(equation, equalities, total, noise, lags)
        previous = value
        value = minimizing_delay(profile.cost)
        if abs(value - previous) < _CONVERGED:
            break
    errors = _DelayErrors(equation, equalities, data, noise, lags, value)
    value = 0.0 if errors.value is None else value
    start = min(given.value, MAX_DELAY) if given else value
    gain = 1 - np.sqrt(profile.cost(value) / max(profile.cost(start), np.finfo(float).tiny))
    joints = np.flatnonzero(by_command)
    viscous = (profile.viscous(start, joints), profile.viscous(value, joints))
    fitted = CommandDelay(
        value=value,
        standard_error=errors.value,
        known_friction_error=errors.known_friction,
        correlation=errors.correlation,
        slope=errors.slope,
        given=given,
        gain=float(gain),
        viscous=viscous,
    )
    return fitted, data, lags


def _rows(equation: LinearModel, run: Run, lags: DelayPolynomial) -> Rows:
    """Columns of the torque equation and then the torque at each of the delays, batch after batch."""
    parts = run.signals.delayed_ranges(MAX_DELAY, run.train)

    def rows_of(batch: Batch) -> tuple[list[Array], list[Mask]]:
        columns, kept = equation.filtered_rows(batch)
        torques = batch.filter(equation.delayed_torques(batch.motion))
        return [np.concatenate([own[:-1], torques[:, j]]) for j, own in enumerate(columns)], kept

    return run.signals.batches(parts, delays=lags.delays).map(rows_of)


class DelayPolynomial:
    """Delays, and the polynomial that interpolates the torque between them: Chebyshev points, so that it does not ring.

    Parameters
    ----------
    band_hz
        The low-pass's cut-off [Hz].
    given
        A known delay [s], which is then the only one.

    Attributes
    ----------
    delays
        From 0 to the longest [s], K.
    """

    def __init__(self, band_hz: float, given: float | None = None) -> None:
        if given is not None:
            self.delays: list[float] = [given]
            self._coefficients: Array = np.ones((1, 1))
            self._slopes: Array = np.zeros((1, 1))
            return
        # The error at the band's edge is (x / 2)^K / K! or so, x the phase that the longest delay makes there.
        count = int(np.ceil(1.25 * np.pi * band_hz * MAX_DELAY)) + 7
        places = -np.cos(np.pi * np.arange(count) / (count - 1))
        self.delays = (MAX_DELAY * (1 + places) / 2).tolist()
        self._coefficients = np.asarray(np.linalg.inv(chebvander(places, count - 1)))
        self._slopes = np.asarray(chebder(self._coefficients) * 2 / MAX_DELAY)

    def weights(self, delay: float) -> Array:
        """Weights w, shape (K,)."""
        return np.asarray(chebval(2 * delay / MAX_DELAY - 1, self._coefficients))

    def slopes(self, delay: float) -> Array:
        """Slopes dw / d delay [1/s], shape (K,)."""
        return np.asarray(chebval(2 * delay / MAX_DELAY - 1, self._slopes))

    def at(self, data: Reduction, delay: float) -> Reduction:
        """The reduction of [Y, tau(delay)] from that with all delays."""
        m, w = len(self.delays), self.weights(delay)
        return tuple(Factor.merged((replace(f, R=np.column_stack([f.R[:, :-m], f.R[:, -m:] @ w])),)) for f in data)


class _Profile:
    """Least sum of squared residuals at a delay, in units of the joints' noise.

    The coefficients are free but for lower bounds, as on friction: what is not bounded is taken out beforehand.
    """

    def __init__(
        self,
        equation: LinearModel,
        equalities: EqualityConstraints,
        data: Reduction,
        noise: Array,
        lags: DelayPolynomial,
    ) -> None:
        self._lags = lags
        every = equation.coefficients
        coefficients = [every[i] for i in equalities.free]
        lower = np.array([c.lower for c in coefficients])
        bounded = np.isfinite(lower)
        rows = _weighted(equation, equalities, data, noise, len(lags.delays))
        Y, taus = (np.concatenate(part) for part in zip(*rows, strict=True))
        rest = np.column_stack([Y[:, bounded], taus - (Y[:, bounded] @ lower[bounded])[:, None]])
        rest = projected_out(rest, Y[:, ~bounded])
        R = np.asarray(np.linalg.qr(rest, mode="r"))
        count = int(np.count_nonzero(bounded))
        self._Y, self._taus = R[:, :count], R[:, count:]
        viscous_friction = friction_types()["viscous"].id
        owners = [c.owner if c.effect == viscous_friction else "" for c in coefficients]
        self._owners = np.array(owners)[bounded]
        self._joints = np.array(equation.joints)

    def _nonnegative_fit(self, delay: float) -> tuple[Array, float]:
        """Bounded coefficients above their bounds, and the norm of the residual."""
        from scipy.optimize import nnls

        tau = self._taus @ self._lags.weights(delay)
        if not self._Y.shape[1]:
            return np.zeros(0), float(np.linalg.norm(tau))
        x, residual = nnls(self._Y, tau)
        return x, float(residual)

    def cost(self, delay: float) -> float:
        """Sum of squared residuals."""
        return self._nonnegative_fit(delay)[1] ** 2

    def viscous(self, delay: float, joints: Indices) -> float:
        """Mean viscous friction of some joints; 0 where the model has none."""
        own = self._nonnegative_fit(delay)[0][np.isin(self._owners, self._joints[joints])]
        return float(own.mean()) if len(own) else 0.0


def minimizing_delay(cost: Callable[[float], float]) -> float:
    """The delay of least cost, from 0 to the longest one that is searched [s]."""
    from scipy.optimize import minimize_scalar

    grid = np.linspace(0, MAX_DELAY, _GRID + 1)
    best = int(np.argmin([cost(delay) for delay in grid]))
    bracket = (grid[max(best - 1, 0)], grid[min(best + 1, _GRID)])
    minimum = float(minimize_scalar(cost, bounds=bracket, method="bounded", options={"xatol": 1e-8}).x)
    return min((0.0, minimum, MAX_DELAY), key=cost)


class _DelayErrors:
    """Errors of the delay by least squares without bounds, in which viscous friction is refitted or known.

    What is left out of a model is the same at all times, but not on all joints. So scores are summed in clusters of
    time, and by joint: the larger of both standard errors counts, or that by the number of independent samples.

    Attributes
    ----------
    value, known_friction
        Standard errors of the delay, viscous friction refitted and known [s]; None: the commands do not tell it.
    correlation
        Of the delay with viscous friction.
    slope
        Derivative of the coefficients with respect to the delay, shape (p,) [1/s].
    """

    def __init__(
        self,
        equation: LinearModel,
        equalities: EqualityConstraints,
        data: Sequence[Blocks],
        noise: Array,
        lags: DelayPolynomial,
        delay: float,
    ) -> None:
        rows = partial(_weighted, equation, equalities, noise=noise, count=len(lags.delays))
        w, slopes = lags.weights(delay), lags.slopes(delay)
        total = merge_reductions([log.total for log in data])
        Y, taus = (np.concatenate(part) for part in zip(*rows(total), strict=True))
        every = equation.coefficients
        viscous_friction = friction_types()["viscous"].id
        viscous = np.array([every[i].effect == viscous_friction for i in equalities.free])
        theta, rank = scaled_least_squares(Y, taus @ w)
        with_friction, _ = scaled_least_squares(Y, taus @ slopes)
        without_friction, _ = scaled_least_squares(np.where(viscous, 0.0, Y), taus @ slopes)
        changes = (with_friction, without_friction)

        def products(part: Reduction) -> Array:
            """By joint and change: slope with itself, and with the residual; shape (2, nv, 2)."""
            sums = np.zeros((2, len(noise), len(changes)))
            for j, (columns, tau) in enumerate(rows(part)):
                residual = tau @ w - columns @ theta
                for k, change in enumerate(changes):
                    slope = tau @ slopes - columns @ change
                    sums[:, j, k] = slope @ slope, slope @ residual
            return sums

        self.slope = equalities.K @ with_friction
        self.value = self.known_friction = None
        self.correlation = 0.0
        by_joint = products(total)[0]  # (nv, 2)
        information = by_joint.sum(axis=0)
        independent_per_row = sum(factor.independent for factor in total) / sum(factor.rows for factor in total)
        if information[0] * independent_per_row * MAX_DELAY**2 < 1:  # an error as large as the whole range
            return
        length = max(sum(map(len, data)) // _CLUSTERS, 1)
        clusters = [part for log in data for part in log.regrouped(length).parts]
        scores = np.array([products(cluster)[1] for cluster in clusters])  # (clusters, nv, 2)
        share = freedom_left(total, rank)
        variance = information / independent_per_row
        if len(scores) >= FEWEST_CLUSTERS:
            variance = np.maximum(variance, _variance_of_sum(scores.sum(axis=1)) / share)
        has_information = by_joint[:, 0] > _RANK * information[0]
        variance = np.maximum(variance, _variance_of_sum(scores.sum(axis=0)[has_information]) / share)
        self.value, self.known_friction = (np.sqrt(variance) / information).tolist()
        self.correlation = float(np.sqrt(max(1 - information[0] / information[1], 0.0)))


def _variance_of_sum(scores: Array) -> Array:
    """Variance of the sum of independent scores, shape (n, 2) to (2,); of a single one it is not known."""
    return len(scores) * np.var(scores, axis=0, ddof=1) if len(scores) > 1 else np.zeros(scores.shape[1])


def _weighted(
    equation: LinearModel, equalities: EqualityConstraints, data: Reduction, noise: Array, count: int
) -> list[tuple[Array, Array]]:
    """Each joint's rows in units of its noise: Y over the free coefficients, (rows, p'), and tau_k, (rows, K)."""
    rows = []
    for factor, columns, sigma in zip(data, equation.active(), noise, strict=True):
        Y = equalities.free_columns(factor.R[:, :-count], columns) / sigma
        taus = factor.R[:, -count:] / sigma
        rows.append((Y, taus))
    return rows


def scaled_least_squares(Y: Array, right: Array) -> tuple[Array, int]:
    """The shortest least-squares solution in units of the columns, shape (m,) or (m, k), and the rank of Y (n, m)."""
    size = np.linalg.norm(Y, axis=0)
    size[size == 0] = 1.0
    z, rank = least_squares(Y / size, right, _RANK)
    return (z.T / size).T, rank


def projected_out(rows: Array, Y: Array) -> Array:
    """Columns minus their projection onto the span of the columns of Y, shape (rows, k)."""
    size = np.linalg.norm(Y, axis=0)
    U, s, _ = svd(Y[:, size > 0] / size[size > 0])
    U = U[:, s > _RANK * s[0]] if len(s) else U
    return np.asarray(rows - U @ (U.T @ rows))

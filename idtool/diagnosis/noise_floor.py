"""Noise floor: the residual that no model could go below, from the residual's own spectrum.

Noise of torque sensors is white; that of encoders grows with the fourth power of the frequency once it has become an
acceleration. What a model lacks follows the motion, whose power is at low frequencies, or occurs in bursts. So the
power density above the motion's frequencies, in the quieter moments, is fitted with N0 + N4 f^4, which is taken as the
noise down to 0 Hz.

While a joint rests, friction can be anything up to its level, so that no model can explain the residual up to there.
The filter spreads this over the samples around each rest and each reversal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.data.power_density import periodograms
from idtool.data.signals import Batch
from idtool.diagnosis.residual_series import MIN_SHARE
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked

_NOISE_BAND = (0.3, 0.95)  # of the band, in which the residual's spectrum is taken as noise
_ITERATIONS = 4
_LINE = 4.0  # times the noise: a line of the spectrum, not noise
_WINDOW = 64  # samples of a periodogram, at the decimated rate
_QUIET = 0.25  # quantile of the periodograms
_QUIET_OF_MEAN = -np.log(1 - _QUIET)  # that quantile over the mean: periodograms of noise are exponential
_MIN_WINDOWS = 12
_MAX_UNDEFINED_SHARE = 0.03  # of a filtered sample's weight, where an effect other than friction is undefined
_MAX_COLOUR = 15.0  # ratio of the residual's slow power to that of white noise, up to which it may be noise
_MIN_MOVING = 0.7  # share of a window in which the joint moves


@dataclass(frozen=True)
class NoiseFloor:
    """Noise in the residual, by joint.

    Attributes
    ----------
    rms
        Residual that noise and rest leave in the band, shape (nv,) [N·m or N].
    noise, residual
        Noise, and residual of the model, while the joint moves, shape (nv,) [N·m or N].
    slow_power_ratio
        Power of the residual at the motion's frequencies over that of the noise there, shape (nv,).
    is_estimated
        False if the data do not suffice to estimate the noise of any joint: all of the residual counts as noise.
    is_joint_estimated
        Mask of the joints of which the data suffice, shape (nv,).
    """

    rms: Array
    noise: Array
    residual: Array
    slow_power_ratio: Array
    is_estimated: bool = True
    is_joint_estimated: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def without_structure(self, shares: Array) -> NoiseFloor:
        """Floor if shares of the residual's power, shape (nv,), are structure, and so not noise."""
        noise_share = np.clip(1 - shares, 0.0, 1.0)
        noise = np.minimum(self.noise, self.residual * np.sqrt(noise_share))
        power = np.square(self.rms) - np.square(self.noise) + np.square(noise)
        return replace(self, noise=noise, rms=np.sqrt(np.maximum(power, 0.0)))

    def with_coloured_noise(self, without_structure: Mask) -> NoiseFloor:
        """Floor if all of the residual is noise, whose power falls with the frequency, on joints without structure.

        That is assumed where its slow power is only a few times that of white noise: what a model lacks has hundreds of
        times as much.

        Parameters
        ----------
        without_structure
            Mask of the joints whose residual nothing explains, shape (nv,).
        """
        is_noise = without_structure & (self.slow_power_ratio < _MAX_COLOUR)
        noise = np.where(is_noise, self.residual, self.noise)
        power = np.square(self.rms) - np.square(self.noise) + np.square(noise)
        return replace(self, noise=noise, rms=np.sqrt(power))


def estimate_noise_floor(
    experiment: Experiment,
    theta: Array,
    progress: Progress,
    reversal_margin: float = 0.0,
    of_true_torque: bool = False,
    on_training_data: bool = False,
) -> NoiseFloor:
    """Noise floor from the residual of a model, on the held-out data if there are any, else on the training data.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Its coefficients, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.
    reversal_margin
        Least distance in time from reversals at which a joint counts as moving [s].
    of_true_torque
        True for the residual of the true torque, False for that of the torque as errors are compared.
    on_training_data
        True to use the training data in any case.
    """
    held_out = experiment.has_held_out and not on_training_data
    judged = _residual_samples(experiment, theta, held_out, reversal_margin, of_true_torque, progress)
    periodograms = judged.periodograms
    if held_out and not any(map(_suffice, periodograms)):
        # noise is the same in the training data
        training = _residual_samples(experiment, theta, False, reversal_margin, of_true_torque, progress)
        periodograms = [a + b for a, b in zip(judged.periodograms, training.periodograms, strict=True)]

    low_pass = experiment.runs[0].signals.low_pass
    dt = experiment.runs[0].signals.log.dt
    f = np.fft.rfftfreq(_WINDOW, dt * low_pass.stride).astype(np.float64)
    passed_power = _passed_power(low_pass.kernel, f, dt)
    residual = np.sqrt(judged.moving_squares / np.maximum(judged.moving_count, 1))
    noise = residual.copy()
    slow_power_ratio = np.ones(len(residual))
    for j, powers in enumerate(periodograms):
        if _suffice(powers):
            rms, slow_power_ratio[j] = _noise_in_band(f, np.array(powers), passed_power, experiment.band_hz)
            noise[j] = min(rms * np.sqrt(judged.share[j]), residual[j])

    mean_squares = []
    for joint_noise, moving_count, at_rest in zip(noise, judged.moving_count, judged.resting, strict=True):
        mean_squares.append(_mean_square(float(joint_noise), float(moving_count), at_rest))
    is_joint_estimated = np.array([_suffice(powers) for powers in periodograms])
    is_estimated = bool(is_joint_estimated.any())
    return NoiseFloor(np.sqrt(mean_squares), noise, residual, slow_power_ratio, is_estimated, is_joint_estimated)


@dataclass(frozen=True)
class _ResidualSamples:
    """Residual of a model on the held-out or the training data, by joint.

    Attributes
    ----------
    moving_squares, moving_count
        Sum of squares and number of the samples in which the joint moves, shape (nv,).
    share
        Mean share of a moving sample that unknown contact forces leave, shape (nv,); 1 with a fixed base.
    resting
        Residual, and largest unknowable torque, of the other samples, batch after batch.
    periodograms
        Periodograms of the windows in which it moves.
    """

    moving_squares: Array
    moving_count: Array
    share: Array
    resting: list[list[tuple[Array, Array]]]
    periodograms: list[list[Array]]


def _residual_samples(
    experiment: Experiment,
    theta: Array,
    held_out: bool,
    reversal_margin: float,
    of_true_torque: bool,
    progress: Progress,
) -> _ResidualSamples:
    """Residual of a model on the held-out or the training data; the arguments are those of `estimate_noise_floor`."""
    joint_count = len(experiment.equation.joints)
    moving_squares = np.zeros(joint_count)
    moving_count = np.zeros(joint_count)
    share_sum = np.zeros(joint_count)
    resting: list[list[tuple[Array, Array]]] = [[] for _ in range(joint_count)]
    periodograms: list[list[Array]] = [[] for _ in range(joint_count)]
    for run in experiment.runs:
        dt = run.signals.log.dt * run.signals.low_pass.stride
        parts = run.parts(held_out)
        for batch in tracked(experiment.batches(run, held_out), parts, progress, "estimating the noise floor"):
            model = LinearizedModel(experiment.equation, theta, batch.motion)
            if of_true_torque:
                residual = experiment.equation.row_filter(batch).filter_rows(model.residual)
            else:
                measured, predicted, _ = experiment.equation.compared_torques(batch, theta)
                residual = measured - predicted
            moving = np.array(experiment.equation.clean_samples(batch, reversal_margin))
            shares = _shares(experiment.equation, batch)
            share_sum += (shares * moving).sum(axis=1)
            moving_squares += (np.square(residual) * moving).sum(axis=1)
            moving_count += moving.sum(axis=1)
            unknowable = _unknowable_torque(model, batch)
            for j in range(joint_count):
                resting[j].append((residual[j, ~moving[j]], unknowable[j, ~moving[j]]))
                is_known = moving[j] & (shares[j] > MIN_SHARE)
                of_whole_row = residual[j] / np.sqrt(np.maximum(shares[j], MIN_SHARE))
                periodograms[j] += _periodograms(of_whole_row, is_known, dt)
    share = share_sum / np.maximum(moving_count, 1)
    return _ResidualSamples(moving_squares, moving_count, share, resting, periodograms)


def _shares(equation: LinearModel, batch: Batch) -> Array:
    """Share of each row's noise, as power, that unknown contact forces leave; 1 without contacts; shape (nv, n)."""
    if equation.contacts is None:
        return np.ones((len(equation.joints), len(batch.t)))
    return np.stack(equation.row_filter(batch).shares)


def _suffice(periodograms: Sequence[Array]) -> bool:
    """True if there are enough periodograms of a joint to estimate its noise."""
    return len(periodograms) >= _MIN_WINDOWS


def _mean_square(noise: float, moving_count: float, resting: Sequence[tuple[Array, Array]]) -> float:
    """Mean square of a joint's noise while it moves, and of the residual that no model can explain while it rests.

    Parameters
    ----------
    noise
        Its rms noise [N·m or N].
    moving_count
        Number of samples in which it moves.
    resting
        Residual, and largest unknowable torque, of the samples in which it rests or reverses, batch after batch.
    """
    residual = np.concatenate([residual for residual, _ in resting])
    unknowable = np.concatenate([torque for _, torque in resting])
    resting_squares = np.minimum(np.square(residual), np.square(noise) + np.square(unknowable))
    total = np.square(noise) * moving_count + resting_squares.sum()
    return float(total / max(moving_count + len(residual), 1))


def _unknowable_torque(model: LinearizedModel, batch: Batch) -> Array:
    """Largest error of each filtered sample that comes from samples where columns are undefined [N·m], shape (nv, n).

    Where friction may have either direction, that is twice its level; where another effect is undefined, infinity.
    """
    friction = np.stack([model.friction_level(j) for j in range(len(model.true_motion.q))])
    of_friction, of_others = model.equation.undefined_shares(batch)
    error = 2 * of_friction * np.maximum(batch.filter(friction), 0.0)
    return np.asarray(np.where(of_others > _MAX_UNDEFINED_SHARE, np.inf, error))


def _periodograms(residual: Array, moving: Mask, dt: float) -> list[Array]:
    """Periodograms of windows in which the joint moves most of the time, interpolated where it does not.

    Parameters
    ----------
    residual, moving
        Residual of one joint, and mask of the samples in which it moves, shape (n,).
    dt
        Time between samples [s].
    """
    if not moving.any():
        return []
    samples = np.arange(len(residual))
    interpolated = np.interp(samples, samples[moving], residual[moving])
    windows = []
    for start in range(0, len(residual) - _WINDOW + 1, _WINDOW // 2):
        share = moving[start : start + _WINDOW].mean()
        if share > _MIN_MOVING:  # interpolated samples have hardly any power
            windows.append(interpolated[start : start + _WINDOW] / np.sqrt(share))
    if not windows:
        return []
    return list(periodograms(np.array(windows), dt))


def _noise_in_band(f: Array, powers: Array, passed_power: Array, band: float) -> tuple[float, float]:
    """Rms of the noise in the band, and the ratio of the residual's slow power to that of the noise.

    Parameters
    ----------
    f
        Frequencies, shape (k,) [Hz].
    powers
        Periodograms, one a row, shape (m, k).
    passed_power
        Share of the power that the filter lets pass, shape (k,).
    band
        End of the band [Hz].
    """
    quiet = np.quantile(powers, _QUIET, axis=0) / _QUIET_OF_MEAN
    unfiltered = quiet / np.maximum(passed_power, 1e-300)
    noise = _noise_density(f, unfiltered, band) * passed_power
    rms = float(np.sqrt(noise.sum() * (f[1] - f[0])))
    slow = f < _NOISE_BAND[0] * band
    slow_power_ratio = float(powers.mean(axis=0)[slow].sum() / noise[slow].sum())
    return rms, slow_power_ratio


def _passed_power(kernel: Array, f: Array, dt: float) -> Array:
    """Share of the power at each frequency that the filter, whose kernel is symmetric, lets pass."""
    lag = np.arange(len(kernel)) - len(kernel) // 2
    return np.square(np.cos(2 * np.pi * np.outer(f, lag) * dt) @ kernel)


def _noise_density(f: Array, density: Array, band: float) -> Array:
    """N0 + N4 f^4 at all frequencies, fitted to the density above the motion's, without its lines."""
    use = (f > _NOISE_BAND[0] * band) & (f < _NOISE_BAND[1] * band)
    columns = np.column_stack([np.ones_like(f), (f / band) ** 4])
    noise = np.full_like(f, np.median(density[use]))
    for _ in range(_ITERATIONS):
        own = use & (density < _LINE * noise)
        c = _nonnegative_pair(columns[own] / noise[own, None], density[own] / noise[own])
        noise = np.maximum(columns @ c, 1e-3 * noise)
    return np.asarray(noise)


def _nonnegative_pair(A: Array, b: Array) -> Array:
    """Least-squares solution of A c = b with two coefficients that are not negative, shape (2,)."""
    c = np.linalg.lstsq(A, b, rcond=None)[0]
    if (c >= 0).all():
        return np.asarray(c)
    gain = A.T @ b
    gain_of_one = np.maximum(gain, 0) / np.linalg.norm(A, axis=0)  # by which each alone reduces the error
    best = gain_of_one.argmax()
    c = np.zeros(2)
    c[best] = max(gain[best], 0.0) / (A[:, best] @ A[:, best])
    return c

"""Torque errors of a model: RMS per joint, in the filter's band and against the torque as logged.

An error depends on the frequency band, so prediction and measurement pass through the same zero-phase low-pass. The
error against the torque as logged compares the filtered prediction with the unfiltered measurement.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.data.signals import Batch, Motion
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.envelope import Envelope, Trace
from idtool.estimation.dataset.experiment import Experiment, Progress, Run, tracked
from idtool.estimation.evaluation.held_out_offsets import models_in_log
from idtool.estimation.evaluation.spectrum import Correlations


@dataclass
class Errors:
    """Torque errors of one model: sums over the samples, for each joint.

    Attributes
    ----------
    samples
        Number of samples.
    known_samples
        Number of samples in the logs in which each joint's torque is known, shape (nv,).
    sum_squares_in_band, sum_squares_as_logged
        Sums of squared errors, shape (nv,) [(N·m)² or N²].
    sum_squares_by_second
        Sum over all joints of the squared errors in the band within each second of samples, log by log, shape (s,);
        none from reduced logs.
    """

    samples: int
    known_samples: Array
    sum_squares_in_band: Array
    sum_squares_as_logged: Array
    sum_squares_by_second: Array

    @staticmethod
    def none(joint_count: int, seconds: int) -> Errors:
        """Errors of no samples, of logs with samples of a number of seconds."""
        zero = np.zeros(joint_count)
        return Errors(0, zero.copy(), zero.copy(), zero.copy(), np.zeros(seconds))

    @property
    def mean_squares_in_band(self) -> Array:
        """Mean squared error of each joint in the band, shape (nv,) [(N·m)² or N²]; 0 if its torque is not known."""
        return self.sum_squares_in_band / np.maximum(self.known_samples, 1)

    def rms(self, joints: Sequence[str], raw: bool = False) -> dict[str, float]:
        """RMS error of each joint, NaN if its torque is not known, and of all others as ``overall`` [N·m or N].

        ``raw``: against the torque as logged, else in the band.
        """
        sums = self.sum_squares_as_logged if raw else self.sum_squares_in_band
        squares = np.where(self.known_samples > 0, sums / np.maximum(self.known_samples, 1), np.nan)
        by_joint = dict(zip(joints, np.sqrt(squares).tolist(), strict=True))
        return by_joint | {"overall": overall_rms(by_joint.values())}


def overall_rms(by_joint: Iterable[float]) -> float:
    """RMS over joints of an RMS by joint, those that are NaN left out; 0 if all are."""
    squares = [rms**2 for rms in by_joint if not np.isnan(rms)]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


@dataclass(frozen=True)
class Evaluation:
    """Torque errors of one or more models on some logs.

    Attributes
    ----------
    errors
        Errors by model.
    torque_std
        Standard deviation of the measured torque in the band, by joint [N·m or N], which normalizes the error.
    traces
        Torque curves for drawing, one `Trace` per log.
    independent_samples
        Number of independent samples in the first model's residual, by joint.
    sensor_offsets
        Readings of the wrench sensors without load that were estimated from the logs themselves, for the first model:
        by log and fixed joint, shape (6,) [N, N·m].
    """

    errors: Mapping[str, Errors]
    torque_std: Mapping[str, float]
    traces: tuple[Trace, ...]
    independent_samples: Mapping[str, float]
    sensor_offsets: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)


def evaluate(
    experiment: Experiment, models: Mapping[str, Array], held_out: bool, progress: Progress, angles: bool = False
) -> Evaluation:
    """Predict the torque of the training or the held-out parts with one or more models.

    Parameters
    ----------
    experiment
        Model and data.
    models
        Name to coefficients, shape (p,).
    held_out
        If true the held-out parts, else the training parts.
    progress
        Callback for the stage and its progress, from 0 to 1.
    angles
        If true the traces hold the joints' positions too, as ``q``, and the rotation of a floating base to the world,
        row after row, as ``base``.
    """
    joints = experiment.equation.joints
    seconds = sum(_seconds(run, held_out) for run in experiment.runs)
    errors = {name: Errors.none(len(joints), seconds) for name in models}
    second = 0  # the first of a log
    torque_sums = np.zeros((2, len(joints)))  # of the measured torque and of its square
    known_samples = np.zeros(len(joints))
    stride = 1
    traces, correlations = [], Correlations()
    sensor_offsets = {}
    for run in experiment.runs:
        parts = run.parts(held_out)
        if not parts:
            continue
        log, stride = run.signals.log, run.signals.low_pass.stride
        envelope = Envelope(parts, log.t)
        own = models_in_log(experiment, run, held_out, models)
        if own.offsets:
            sensor_offsets[run.signals.recording] = own.offsets
        samples_of_log = 0
        is_known = np.zeros(len(joints), dtype=bool)
        torque_sums_of_log = np.zeros_like(torque_sums)
        squares_of_log = {name: np.zeros((2, len(joints))) for name in models}  # in the band, as logged
        batches = run.signals.batches(parts, every_sample=True)
        for batch in tracked(batches, parts, progress, f"predicting {log.path.name}"):
            measured, predicted, is_known_in_batch = _predict(own.equation, batch, own.thetas)
            inner = slice(batch.before, len(batch.motion.t) - batch.after)
            numbers = samples_of_log + np.arange(measured.shape[1])
            seconds_of_samples = second + (numbers * log.dt).astype(int)
            samples_of_log += measured.shape[1]
            is_known |= is_known_in_batch
            for name, torque in predicted.items():
                squares = np.square(torque - measured)
                squares_as_logged = np.square(torque - batch.motion.logged_tau[:, inner])
                errors[name].samples += torque.shape[1]
                np.add.at(errors[name].sum_squares_by_second, seconds_of_samples, squares.sum(axis=0))
                squares_of_log[name] += squares.sum(axis=1), squares_as_logged.sum(axis=1)
            torque_sums_of_log += measured.sum(axis=1), np.square(measured).sum(axis=1)
            residual = measured - next(iter(predicted.values()))
            correlations.add(residual, measured, stride, log.dt)
            curves = {"measured": measured, "residual": residual, **predicted}
            t = batch.motion.t[inner] + log.start
            envelope.add(t, {**curves, **_posture_curves(batch.motion, inner)} if angles else curves)
        for name, (in_band, as_logged) in squares_of_log.items():
            errors[name].sum_squares_in_band += is_known * in_band
            errors[name].sum_squares_as_logged += is_known * as_logged
            errors[name].known_samples += is_known * samples_of_log
        torque_sums += is_known * torque_sums_of_log
        known_samples += is_known * samples_of_log
        traces.append(envelope.trace(log.path.name))
        second += _seconds(run, held_out)
    independent = correlations.independent(stride)
    return Evaluation(
        errors,
        dict(zip(joints, torque_deviation(torque_sums, known_samples).tolist(), strict=True)),
        tuple(traces),
        dict(zip(joints, independent.tolist(), strict=False)),
        sensor_offsets,
    )


def torque_deviation(sums: Array, samples: Array) -> Array:
    """Standard deviation of the measured torque, shape (nv,) [N·m or N].

    Parameters
    ----------
    sums
        Sums of it and of its square, shape (2, nv).
    samples
        Number of samples of each joint, shape (nv,).
    """
    mean, square = sums / np.maximum(samples, 1)
    return np.asarray(np.sqrt(np.maximum(square - mean**2, 0)))


def _posture_curves(motion: Motion, inner: slice) -> dict[str, Array]:
    """Positions of the joints, and rotation of a floating base to the world, shape (9, N)."""
    curves = {"q": motion.q[:, inner]}
    if motion.contacts is not None:
        base_to_world = motion.contacts.world_to_base.transpose(1, 0, 2)
        curves["base"] = base_to_world[..., inner].reshape(9, -1)
    return curves


def _seconds(run: Run, held_out: bool) -> int:
    """Number of seconds of samples in a log's part for validation, or for fitting; a rest counts as one."""
    samples = sum(part.stop - part.start for part in run.parts(held_out))
    return int(samples * run.signals.log.dt) + 1


def _predict(equation: LinearModel, batch: Batch, models: Mapping[str, Array]) -> tuple[Array, dict[str, Array], Mask]:
    """Measured torque and each model's, in the band, at every sample; and which rows are known, shape (nv,)."""
    thetas = np.stack(list(models.values()))
    measured, predicted, is_known = equation.compared_torques(batch, thetas)
    return measured, dict(zip(models, predicted, strict=True)), is_known

"""Noise of the measured torque that a model cancels, which explains nothing.

A model that derives the link's motion from the measured torque, such as one of an elastic joint, can cancel some of
that torque's noise. Its *noise gain* is the ratio of the noise in its residual to that of the torque. Both come from
white noise that is added to the measured torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Batch, Motion
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment

_SAMPLES = 40_000  # by which a ratio of noises is known to about two hundredths
_SEED = 0

# change of the residual, unfiltered, by noise added to the torque; both of shape (nv, N)
_ResidualChange = Callable[[Array], Array]


def noise_gain_of(experiment: Experiment, noise: Array) -> Array:
    """Noise gain of a model at each joint, at most 1, shape (nv,).

    Parameters
    ----------
    experiment
        Model and data.
    noise
        Noise of each joint's rows, shape (nv,) [N·m or N].
    """
    equation = experiment.equation
    if not any(effect.uses_measured_torque for effect in equation.effects):
        return np.ones(len(noise))
    theta = equation.operating_theta

    def residual_change_along(motion: Motion) -> _ResidualChange:
        return LinearizedModel(equation, theta, motion).residual_change_by_noise

    return _noise_gain(experiment, equation, noise, residual_change_along)


def noise_gain_with_probe(experiment: Experiment, theta: Array, noise: Array, probe: Probe, c: Array) -> Array:
    """Noise gain to first order of a model with a probe, at most 1, shape (nv,).

    Parameters
    ----------
    experiment, theta
        Model without the probe and its coefficients, shape (p,), and data.
    noise
        Noise of each joint's rows, shape (nv,) [N·m or N].
    probe, c
        The probe and its coefficients, shape (k,).
    """
    equation = experiment.equation

    def residual_change_along(motion: Motion) -> _ResidualChange:
        model = LinearizedModel(equation, theta, motion)
        clean = model.true_motion
        clean_columns = probe.columns(clean, model)

        def residual_change(white: Array) -> Array:
            noisy_columns = probe.columns(replace(clean, tau=clean.tau + white), model)
            change = white.copy()
            for joint, columns in noisy_columns.items():
                change[joint] -= c @ (columns - clean_columns[joint])
            return change

        return residual_change

    return _noise_gain(experiment, equation, noise, residual_change_along)


def _noise_gain(
    experiment: Experiment,
    equation: LinearModel,
    noise: Array,
    residual_change_along: Callable[[Motion], _ResidualChange],
) -> Array:
    """Rms of the residual's change over that of the noise added, at most 1, shape (nv,)."""
    rng = np.random.default_rng(_SEED)
    noise_squares = np.zeros(len(noise))
    remaining_squares = np.zeros(len(noise))
    training_samples = sum(part.stop - part.start for run in experiment.runs for part in run.train)
    repetitions = math.ceil(_SAMPLES / max(training_samples, 1))
    for batch in _first_training_batches(experiment):
        residual_change = residual_change_along(batch.motion)
        passed_share = np.linalg.norm(batch.low_pass.kernel)  # of the rms of white noise
        masks = equation.clean_samples(batch)
        for _ in range(repetitions):
            white = rng.standard_normal(batch.motion.tau.shape) * (noise / passed_share)[:, None]
            filtered_noise = batch.filter(white)
            filtered_change = batch.filter(residual_change(white))
            for j, mask in enumerate(masks):
                noise_squares[j] += np.square(filtered_noise[j, mask]).sum()
                remaining_squares[j] += np.square(filtered_change[j, mask]).sum()
    gain = np.ones(len(noise))
    known = noise_squares > 0
    gain[known] = np.minimum(np.sqrt(remaining_squares[known] / noise_squares[known]), 1.0)
    return gain


def _first_training_batches(experiment: Experiment) -> Iterator[Batch]:
    """The first batches, until they have `_SAMPLES` samples."""
    count = 0
    for run in experiment.runs:
        if not run.train:
            continue
        for batch in experiment.batches(run, held_out=False):
            yield batch
            count += len(batch.motion.t)
            if count >= _SAMPLES:
                return

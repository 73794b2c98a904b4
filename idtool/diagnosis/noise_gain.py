"""Noise of the measured torque that a model cancels, which explains nothing.

A model that derives the link's motion from the measured torque, such as one of an elastic joint, can cancel some of
that torque's noise. Its *noise gain* is the ratio of the noise in its residual to that of the torque. Both come from
white noise that is added to the measured torque.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import cycle

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Batch, Motion
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment

_SAMPLES = 40_000  # by which a ratio of noises is known to about two hundredths
_SEED = 0

# change of the residual, unfiltered, by noise added to the torque, both of shape (nv, N)
_ResidualChange = Callable[[Motion, Array], Array]


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

    def residual_change(motion: Motion, white: Array) -> Array:
        noisy = replace(motion, tau=motion.tau + white, kept_columns=None)  # needed only once
        clean_residual = LinearizedModel(equation, theta, motion).residual
        return LinearizedModel(equation, theta, noisy).residual - clean_residual

    return _noise_gain(experiment, equation, noise, residual_change)


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

    def residual_change(motion: Motion, white: Array) -> Array:
        model = LinearizedModel(equation, theta, motion)
        clean = model.true_motion
        clean_columns = probe.columns(clean, model)
        noisy_columns = probe.columns(replace(clean, tau=clean.tau + white), model)
        change = white.copy()
        for joint, columns in noisy_columns.items():
            change[joint] -= c @ (columns - clean_columns[joint])
        return change

    return _noise_gain(experiment, equation, noise, residual_change)


def _noise_gain(experiment: Experiment, equation: LinearModel, noise: Array, residual_change: _ResidualChange) -> Array:
    """Rms of the residual's change over that of the noise added, at most 1, shape (nv,)."""
    rng = np.random.default_rng(_SEED)
    noise_squares = np.zeros(len(noise))
    remaining_squares = np.zeros(len(noise))
    for batch in _repeated_training_batches(experiment):
        passed_share = np.linalg.norm(batch.low_pass.kernel)  # of the rms of white noise
        white = rng.standard_normal(batch.motion.tau.shape) * (noise / passed_share)[:, None]
        filtered_noise = batch.filter(white)
        filtered_change = batch.filter(residual_change(batch.motion, white))
        for j, mask in enumerate(equation.clean_samples(batch)):
            noise_squares[j] += np.square(filtered_noise[j, mask]).sum()
            remaining_squares[j] += np.square(filtered_change[j, mask]).sum()
    gain = np.ones(len(noise))
    known = noise_squares > 0
    gain[known] = np.minimum(np.sqrt(remaining_squares[known] / noise_squares[known]), 1.0)
    return gain


def _repeated_training_batches(experiment: Experiment) -> Iterator[Batch]:
    """Training data, from the start again when it ends, until there is enough to know the noise."""
    runs = [run for run in experiment.runs if run.train]
    count = 0
    for run in cycle(runs):
        for batch in experiment.batches(run, held_out=False):
            yield batch
            count += len(batch.motion.t)
            if count >= _SAMPLES:
                return

"""`residual_maps`: residual torque of each joint by state, time and frequency, for drawing."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.records import ResidualProfile
from idtool.diagnosis.residual_series import ResidualSeries, residual_series
from idtool.diagnosis.spectra import angle_spectrum, masked_power_density
from idtool.estimation.dataset.experiment import Experiment, Progress

STATE_BINS = 60
TIME_BINS = 120
_MAX_NUMBERS = 2e6  # that are drawn
_MIN_SAMPLES = 3  # in a bin that is drawn
_LOW_SPEED = 0.1  # quantile of the speed, below which bins of velocity have one width


def residual_maps(experiment: Experiment, theta: Array, progress: Progress) -> dict[str, ResidualProfile]:
    """Residual torque by joint, in the band, on training and held-out parts together.

    Several logs follow each other in time. Samples at which the direction of a joint's friction is not known, or its
    play is open, are left out.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    models = [(experiment.equation, theta)]
    series = residual_series(experiment, models, progress, "mapping the residual", _MAX_NUMBERS)
    joints = experiment.equation.joints
    return {name: _profile(series, j, experiment.band_hz) for j, name in enumerate(joints)}


def _profile(series: ResidualSeries, j: int, band: float) -> ResidualProfile:
    valid = series.valid[j]
    residual = series.residuals[0, j]
    q = series.q[j, valid]
    v = series.v[j, valid]
    a = series.a[j, valid]
    tau = series.tau[j, valid]
    variables = {
        "position": (q, uniform_edges(q, STATE_BINS)),
        "velocity": (v, velocity_edges(v)),
        "acceleration": (a, uniform_edges(a, STATE_BINS)),
        "torque": (tau, uniform_edges(tau, STATE_BINS)),
        "time": (series.t[valid], uniform_edges(series.t, TIME_BINS)),
    }
    centers, mean, rms = {}, {}, {}
    for name, (values, edges) in variables.items():
        centers[name], mean[name], rms[name] = bin_means(values, edges, residual[valid])
    frequency, density = masked_power_density(residual, valid, series.dt, series.segments, band)
    angle, amplitude = angle_spectrum(residual[valid], q, v, band)
    return ResidualProfile(centers, mean, rms, frequency, np.sqrt(density), angle, amplitude)


def uniform_edges(x: Array, count: int) -> Array:
    """Edges of bins of one width."""
    return np.linspace(float(x.min()), float(x.max()), count + 1) if len(x) else np.zeros(2)


def velocity_edges(v: Array) -> Array:
    """Edges of bins of velocity, whose width grows with the speed; zero is an edge."""
    speed = np.abs(v)
    top = float(speed.max(initial=0.0))
    low_speed = float(np.quantile(speed, _LOW_SPEED)) if len(v) else 0.0
    scale = max(low_speed, 1e-3 * top, np.finfo(float).tiny)
    return np.asarray(scale * np.sinh(np.linspace(-1, 1, STATE_BINS + 1) * np.arcsinh(top / scale)))


def bin_means(values: Array, edges: Array, x: Array) -> tuple[Array, Array, Array]:
    """Centres of bins, and mean and rms of x in each that has enough samples, shape (k,) each.

    Parameters
    ----------
    values
        The variable that is binned, shape (n,).
    edges
        Edges of the bins, ascending.
    x
        Values of the samples, shape (n,).
    """
    bins = len(edges) - 1
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    filled = count >= _MIN_SAMPLES
    mean = np.bincount(index, x, bins)[filled] / count[filled]
    mean_square = np.bincount(index, np.square(x), bins)[filled] / count[filled]
    centers = (edges[1:] + edges[:-1]) / 2
    return centers[filled], mean, np.sqrt(mean_square)

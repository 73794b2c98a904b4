"""`residual_maps`: what a model leaves of each joint's torque, by state, time and frequency, for drawing."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.lines import density, ripple
from idtool.diagnosis.records import Residual
from idtool.diagnosis.residual_series import ResidualSeries, series
from idtool.estimation.dataset.experiment import Experiment, Progress

_BINS = 60
_TIMES = 120  # bins of time
_FEWEST = 3  # samples in a bin that is drawn
_NEAR_ZERO = 0.1  # quantile of the speed, below which bins of velocity are of even width


def residual_maps(experiment: Experiment, theta: Array, progress: Progress) -> dict[str, Residual]:
    """Measured torque less a model's by joint, in the band, on training and held-out parts together.

    Several logs follow each other in time. Samples at which the sign of a joint's friction is not known are left out.

    Parameters
    ----------
    experiment
        Model and data.
    theta
        Coefficients, shape (p,).
    progress
        Told how far it has come.
    """
    found = series(experiment, [(experiment.equation, theta)], progress, "mapping what is left")
    joints = experiment.equation.joints
    return {name: _residual(found, j, experiment.band_hz) for j, name in enumerate(joints)}


def _residual(found: ResidualSeries, j: int, band: float) -> Residual:
    kept, left = found.kept[j], found.left[0, j]
    x, q, v = left[kept], found.q[j, kept], found.v[j, kept]
    views = {
        "position": (q, _even(q, _BINS)),
        "velocity": (v, _finer_near_zero(v)),
        "acceleration": (found.a[j, kept], _even(found.a[j, kept], _BINS)),
        "torque": (found.tau[j, kept], _even(found.tau[j, kept], _BINS)),
        "time": (found.t[kept], _even(found.t, _TIMES)),
    }
    binned = {name: _binned(at, edges, x) for name, (at, edges) in views.items()}
    against, mean, rms = ({name: three[i] for name, three in binned.items()} for i in range(3))
    spectrum = density(left, kept, found.step, found.stretches, band)
    return Residual(against, mean, rms, spectrum[0], np.sqrt(spectrum[1]), *ripple(x, q, v, band))


def _even(x: Array, count: int) -> Array:
    """Edges of bins of one width."""
    return np.linspace(float(x.min()), float(x.max()), count + 1) if len(x) else np.zeros(2)


def _finer_near_zero(v: Array) -> Array:
    """Edges of bins of velocity: as wide as the speed is great, but of one width near zero, which is an edge."""
    speed = np.abs(v)
    top = float(speed.max(initial=0.0))
    scale = max(float(np.quantile(speed, _NEAR_ZERO)) if len(v) else 0.0, 1e-3 * top, np.finfo(float).tiny)
    return np.asarray(scale * np.sinh(np.linspace(-1, 1, _BINS + 1) * np.arcsinh(top / scale)))


def _binned(at: Array, edges: Array, x: Array) -> tuple[Array, Array, Array]:
    """Centres of bins, and mean and rms of x in each that has samples."""
    bins = len(edges) - 1
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    full = count >= _FEWEST
    sums = (np.bincount(index, y, bins)[full] / count[full] for y in (x, np.square(x)))
    mean, square = sums
    return ((edges[1:] + edges[:-1]) / 2)[full], mean, np.sqrt(square)

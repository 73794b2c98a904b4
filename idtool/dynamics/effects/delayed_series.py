"""Delays: as a configuration gives them, and series of a motion that are recorded late or early."""

from __future__ import annotations

import math

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.entry_parameters import entry_location, read_number
from idtool.robot.config import EffectEntry

_MAX_DELAY = 1.0  # s: what is later belongs to another motion
_SPLINE_MARGIN = 16  # samples, more than a spline of order 5 is influenced by


def read_delay(entry: EffectEntry) -> float:
    """Parameter ``delay`` of a configuration's entry [s].

    Raises
    ------
    ConfigError
        If it is no number, or too long.
    """
    delay = read_number(entry, "delay")
    if not abs(delay) <= _MAX_DELAY:
        message = f"a delay of {delay:g} s is too long; give at most {_MAX_DELAY:g} s"
        raise ConfigError(entry_location(entry), message)
    return delay


def delayed(x: Array, samples: float) -> Array:
    """Series delayed by a number of samples, shape (..., N), on a spline of order 5, each continued by its ends.

    Linear interpolation would damp frequencies near the end of the band. This is `scipy.ndimage.shift`, which weights
    each sample anew; here the weights of all samples are the same.
    """
    from scipy import ndimage
    from scipy.interpolate import BSpline

    whole_samples = math.floor(samples)
    fraction = samples - whole_samples
    pad = abs(whole_samples) + _SPLINE_MARGIN
    padded = np.pad(x, [(0, 0)] * (x.ndim - 1) + [(pad, pad)], mode="edge")
    coefficients = ndimage.spline_filter1d(padded, order=5, mode="mirror")
    neighbours = np.arange(-3, 3)  # samples within the reach of a basis function
    basis = BSpline.basis_element(np.arange(-3.0, 4.0))  # of order 5, about 0
    weights = basis(-fraction - neighbours)
    delayed = np.zeros(x.shape)
    for neighbour, weight in zip(neighbours, weights, strict=True):
        first = pad - whole_samples + neighbour
        delayed += weight * coefficients[..., first : first + x.shape[-1]]
    return delayed


def beyond_samples(motion: Motion, delay: float) -> Mask:
    """Mask of the samples of a motion at which a series, a delay [s] later, lies beyond its ends, shape (N,)."""
    mask = np.zeros(len(motion.t), dtype=bool)
    beyond = int(np.ceil(abs(delay) / motion.dt))
    if delay < 0:
        mask[:beyond] = True
    elif delay > 0:
        mask[max(len(mask) - beyond, 0) :] = True
    return mask

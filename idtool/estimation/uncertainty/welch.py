"""Welch's test: whether independent estimates of one quantity differ by more than their standard errors explain.

Their errors may have different sizes, and are themselves estimated. Of many such tests some fail by chance: of the
quantities named, 5 % are expected to be named for nothing.

Letters: r quantities, L estimates of each.

Source: Welch, On the comparison of several mean values, 1951; Benjamini & Hochberg, Controlling the false discovery
rate, 1995
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from idtool.common.arrays import Array, Mask
from idtool.estimation.uncertainty.false_discovery import discoveries

FALSE_DISCOVERIES = 0.05  # of the quantities that are said to differ
_INFINITE = 1e6  # degrees of freedom, as good as infinitely many


def welch_p_values(value: Array, error: Array, freedom: Array) -> Array:
    """Probability of a scatter so large by chance, shape (r,); NaN where fewer than two estimates have an error.

    Parameters
    ----------
    value, error
        Estimates and their standard errors, shape (r, L); an error that is infinite or 0 leaves an estimate out.
    freedom
        Degrees of freedom of the standard errors, shape (r, L).
    """
    weight = _weights(error)
    count = np.count_nonzero(weight, axis=1)
    total = weight.sum(axis=1, keepdims=True)
    is_tested = count > 1
    terms = np.square(1 - weight / np.where(total > 0, total, 1.0)) / freedom
    correction = np.where(weight > 0, terms, 0.0).sum(axis=1)
    squares = np.maximum(np.square(count) - 1.0, 1.0)
    F = np.square(birge_ratio(value, error)) / (1 + 2 * (count - 2) / squares * correction)
    numerator = np.maximum(count - 1, 1)  # degrees of freedom
    denominator = np.where(correction > 0, squares / np.where(correction > 0, 3 * correction, 1.0), np.inf)
    p_values = fdtrc(numerator, np.minimum(denominator, _INFINITE), np.where(is_tested, F, 0.0))
    return np.where(is_tested, p_values, np.nan)


def significant_differences(p_values: Array) -> Mask:
    """True for quantities that differ by more than chance explains, shape (r,); NaN: not tested.

    Parameters
    ----------
    p_values
        From `welch_p_values`, shape (r,).
    """
    tested = np.flatnonzero(~np.isnan(p_values))
    differs = np.zeros(len(p_values), dtype=bool)
    if len(tested):
        differs[tested] = discoveries(p_values[tested], FALSE_DISCOVERIES)
    return differs


def birge_ratio(value: Array, error: Array) -> Array:
    """Scatter of several estimates in units of what their errors predict, shape (r,); NaN for fewer than two.

    Parameters
    ----------
    value, error
        As in `welch_p_values`.
    """
    weight = _weights(error)
    count = np.count_nonzero(weight, axis=1)
    determined = np.where(weight > 0, value, 0.0)
    mean = (weight * determined).sum(axis=1) / np.where(count > 0, weight.sum(axis=1), 1.0)
    chi_square = (weight * np.square(determined - mean[:, None])).sum(axis=1)
    return np.where(count > 1, np.sqrt(chi_square / np.maximum(count - 1, 1)), np.nan)


def _weights(error: Array) -> Array:
    """One over the squares of finite errors, 0 for others."""
    is_known = np.isfinite(error) & (error > 0)
    return np.where(is_known, 1 / np.square(np.where(is_known, error, 1.0)), 0.0)

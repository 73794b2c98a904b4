"""A measured velocity against its position: lag, gain and agreement.

Letters: q position [rad or m], v velocity [rad/s or m/s], D = dq/dt, A = d²q/dt², dt sample time [s], N samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.fft import irfft, rfft, rfftfreq

from idtool.common.arrays import Array, ComplexArray
from idtool.common.fourier import fast_length
from idtool.data.smoothing import moving_mean

_MIN_SAMPLES = 64  # samples
_MAX_LAG = 0.1  # s: more than any drive's filter, less than half a period of most excitations
_LONG_LAG_PENALTY = 0.1  # of the correlation, at the longest lag: of equal correlations, that of the shorter lag wins
_COHERENCE_BINS = 15  # of a spectrum without padding, over which it is averaged for the coherence
_MIN_SQUARED_COHERENCE = 0.5  # bins below it do not belong to the band; of noise, about 1 bin in 100 is above it
_BAND_POWER = 0.99
_MIN_BAND_PERIODS = 8  # of the upper edge of the band, in the series
_MAX_ITERATIONS = 4
_CONVERGED = 1e-6  # samples of change of the lag
_CUTOFF = 5  # standard deviations at which the Gaussian is cut off


class Agreement(NamedTuple):
    """Agreement of a velocity with the derivative of its position.

    Attributes
    ----------
    lag
        Of v behind dq/dt [s]; negative if v leads.
    gain
        Of v over dq/dt; negative if v has the opposite sign.
    agreement
        Share of v's power in the band of the motion that gain · dq/dt, ``lag`` earlier, explains: 0..1.
    lag_error
        Standard error of the lag [s].
    """

    lag: float
    gain: float
    agreement: float
    lag_error: float


_UNKNOWN = Agreement(float("nan"), float("nan"), float("nan"), float("inf"))
_UNRELATED = _UNKNOWN._replace(agreement=0.0)


def velocity_agreement(q: Array, v: Array, dt: float) -> Agreement:
    """Lag, gain and agreement of a measured velocity with the derivative of the position.

    The spectra give the band of the motion, and the lag to the nearest sample. Then v = gain · D(t − lag) + constant is
    solved by the Gauss–Newton method. For this, all signals are smoothed by the same Gaussian, which is as wide as the
    band. D is the convolution of q with the derivative of the Gaussian, shifted by the lag. So lags between samples
    need no interpolation. Samples that the kernel does not cover are left out, so that there are no transients.

    The noise of q in D and its noise in A are uncorrelated, so that it does not bias the lag. If v is low-pass
    filtered, the lag is the filter's delay, averaged over the frequencies of the motion by their power.

    Parameters
    ----------
    q, v
        One joint's position [rad or m] and velocity [rad/s or m/s] without a gap, shape (N,).
    dt
        Sample time [s]; the samples count as equally spaced.

    Returns
    -------
    The agreement. If q and v have nothing in common, it is 0, and lag and gain are NaN. If one of them is constant, or
    the series is too short, it is NaN too. In both cases the error of the lag is infinite.
    """
    if len(q) < _MIN_SAMPLES or not (np.ptp(q) > 0 and np.ptp(v) > 0):
        return _UNKNOWN
    lag, band_edge = _coarse_lag_and_band(q, v, dt)
    if band_edge == 0:
        return _UNRELATED
    sigma = max(1 / (2 * np.pi * band_edge), dt)
    half_width = int((_CUTOFF * sigma + _MAX_LAG) / dt) + 1
    kernel_t = np.linspace(-half_width * dt, half_width * dt, 2 * half_width + 1)
    if len(q) < 2 * len(kernel_t):
        return _UNKNOWN
    size = fast_length(len(q))
    q_spectrum = rfft(q, size)

    def smoothed(spectrum: ComplexArray, kernel: Array) -> Array:
        """Convolution with a kernel of K samples, where it lies within the series, shape (N − K + 1,)."""
        convolution = irfft(spectrum * rfft(kernel, size), size)
        return np.asarray(convolution[len(kernel) - 1 : len(q)])

    V = smoothed(rfft(v, size), _gaussian(kernel_t, sigma))
    for _ in range(_MAX_ITERATIONS):
        lagged_t = kernel_t - lag
        g = _gaussian(lagged_t, sigma)
        first_derivative = -lagged_t / sigma**2 * g
        second_derivative = (lagged_t**2 / sigma**2 - 1) / sigma**2 * g
        D = smoothed(q_spectrum, first_derivative)
        A = smoothed(q_spectrum, second_derivative)
        M = np.stack([D, A, np.ones_like(D)], axis=1)
        coefficients = np.linalg.lstsq(M, V, rcond=None)[0]
        gain, acceleration_coefficient, _ = coefficients
        if gain == 0:
            return _UNRELATED
        correction = -acceleration_coefficient / gain  # D at a later lag is D - correction * A to first order
        lag += correction
        if abs(lag) > _MAX_LAG:
            return _UNRELATED
        if abs(correction) < _CONVERGED * dt:
            break
    residual = V - M @ coefficients
    agreement = 1 - residual.var() / V.var()
    independent_samples = max(2 * band_edge * dt * len(V), 1.0)
    error = residual.std() / (abs(gain) * A.std() * np.sqrt(independent_samples))
    return Agreement(float(lag), float(gain), float(max(agreement, 0.0)), float(error))


def _gaussian(t: Array, sigma: float) -> Array:
    kernel = np.exp(-0.5 * (t / sigma) ** 2)
    return np.asarray(kernel / kernel.sum())


def _coarse_lag_and_band(q: Array, v: Array, dt: float) -> tuple[float, float]:
    """Lag [s] to the nearest sample, and upper edge [Hz] of the band in which q and v move together; 0: nowhere."""
    # both taken half-way between samples, so that they are in phase
    n = len(q) - 1
    size = fast_length(n)
    window = np.hanning(n)
    derivative_spectrum = rfft(window * np.diff(q) / dt, size)
    velocity_spectrum = rfft(window * 0.5 * (v[1:] + v[:-1]), size)
    cross_spectrum = np.conj(derivative_spectrum) * velocity_spectrum

    max_lag = int(min(_MAX_LAG / dt, n // 8))
    lags = np.arange(-max_lag, max_lag + 1)  # samples
    preference = 1 - _LONG_LAG_PENALTY * np.abs(lags) / (max_lag + 1)
    correlation = irfft(cross_spectrum, size)[lags] * preference
    lag = float(lags[np.argmax(np.abs(correlation))] * dt)

    f = rfftfreq(size, dt)
    width = min(round(_COHERENCE_BINS * size / n), len(f) // 2)  # padding puts more bins between
    in_phase = cross_spectrum * np.exp(2j * np.pi * f * lag)
    cross_power = np.abs(moving_mean(in_phase, width)) ** 2
    derivative_power = moving_mean(np.abs(derivative_spectrum) ** 2, width)
    velocity_power = moving_mean(np.abs(velocity_spectrum) ** 2, width)
    is_coherent = cross_power > _MIN_SQUARED_COHERENCE * (derivative_power * velocity_power)
    cumulative_power = np.cumsum(np.where(is_coherent, np.abs(cross_spectrum), 0.0))
    total_power = cumulative_power[-1]
    if total_power == 0:
        return lag, 0.0
    edge = f[np.searchsorted(cumulative_power, _BAND_POWER * total_power)]
    return lag, float(max(edge, _MIN_BAND_PERIODS / (n * dt)))

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
_SMOOTHING = 15  # bins of a spectrum without padding, over which it is averaged for the coherence
_MIN_SQUARED_COHERENCE = 0.5  # bins below it have no say in the band; noise alone passes in 1 of 85 to 185
_BAND_POWER = 0.99
_MAX_ITERATIONS = 4
_CONVERGED = 1e-6  # samples of change of the lag
_REACH = 5  # standard deviations at which the Gaussian is cut off


class Agreement(NamedTuple):
    """Agreement of a velocity with the derivative of its position.

    Attributes
    ----------
    lag
        Of v behind dq/dt [s]; negative where v leads.
    gain
        Of v over dq/dt; negative where the sign is turned.
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
    """Lag of a measured velocity behind the derivative of the position, with its error, and the agreement of the two.

    The spectra give the band of the motion and the lag to the nearest sample. Then v = gain · D(t − lag) + constant is
    solved by Gauss–Newton with every signal smoothed by one Gaussian as wide as that band. D is q under the Gaussian's
    derivative, shifted by the lag: exact for any fraction of a sample, and with nothing to settle at the ends. The
    noise of q in D and that in A are uncorrelated, and so leave the lag unbiased. As power weights it, a low-pass
    filter comes out as its delay at the frequencies of the motion.

    Parameters
    ----------
    q, v
        One joint's position [rad or m] and velocity [rad/s or m/s] without a gap, shape (N,).
    dt
        Sample time [s]; the samples count as equally spaced.

    Returns
    -------
    The agreement. Lag and gain are NaN where nothing agrees; all but the error, which is infinite, are NaN where
    nothing moves or the stretch is too short.
    """
    if len(q) < _MIN_SAMPLES or not (np.ptp(q) > 0 and np.ptp(v) > 0):
        return _UNKNOWN
    lag, band = _coarse_lag_and_band(q, v, dt)
    if band == 0:
        return _UNRELATED
    sigma = max(1 / (2 * np.pi * band), dt)
    reach = int((_REACH * sigma + _MAX_LAG) / dt) + 1
    x = np.linspace(-reach * dt, reach * dt, 2 * reach + 1)
    if len(q) < 2 * len(x):
        return _UNKNOWN
    size = fast_length(len(q))
    q_spectrum = rfft(q, size)

    def smoothed(spectrum: ComplexArray, kernel: Array) -> Array:
        """Convolution where the kernel lies within the series, shape (N − K + 1,)."""
        return np.asarray(irfft(spectrum * rfft(kernel, size), size)[len(kernel) - 1 : len(q)])

    V = smoothed(rfft(v, size), _gaussian(x, sigma))
    for _ in range(_MAX_ITERATIONS):
        g = _gaussian(x - lag, sigma)
        D = smoothed(q_spectrum, -(x - lag) / sigma**2 * g)
        A = smoothed(q_spectrum, ((x - lag) ** 2 / sigma**2 - 1) / sigma**2 * g)
        M = np.stack([D, A, np.ones_like(D)], axis=1)
        coefficients = np.linalg.lstsq(M, V, rcond=None)[0]
        gain, of_acceleration, _ = coefficients
        if gain == 0:
            return _UNRELATED
        correction = -of_acceleration / gain  # D at a later lag is D - correction * A to first order
        lag += correction
        if abs(lag) > _MAX_LAG:
            return _UNRELATED
        if abs(correction) < _CONVERGED * dt:
            break
    residual = V - M @ coefficients
    agreement = 1 - residual.var() / V.var()
    independent_samples = max(2 * band * dt * len(V), 1.0)
    error = residual.std() / (abs(gain) * A.std() * np.sqrt(independent_samples))
    return Agreement(float(lag), float(gain), float(max(agreement, 0.0)), float(error))


def _gaussian(x: Array, sigma: float) -> Array:
    kernel = np.exp(-0.5 * (x / sigma) ** 2)
    return np.asarray(kernel / kernel.sum())


def _coarse_lag_and_band(q: Array, v: Array, dt: float) -> tuple[float, float]:
    """Lag [s] to the nearest sample, and upper edge [Hz] of the band in which q and v move together; 0: nowhere."""
    # both taken half-way between samples, so that they are in phase
    n = len(q) - 1
    size = fast_length(n)
    window = np.hanning(n)
    D = rfft(window * np.diff(q) / dt, size)
    V = rfft(window * 0.5 * (v[1:] + v[:-1]), size)
    S = np.conj(D) * V
    max_lag = int(min(_MAX_LAG / dt, n // 8))
    k = np.arange(-max_lag, max_lag + 1)
    correlation = irfft(S, size)[k] * (1 - 0.1 * np.abs(k) / (max_lag + 1))  # the shorter lag wins a tie
    lag = float(k[np.argmax(np.abs(correlation))] * dt)
    f = rfftfreq(size, dt)
    width = min(round(_SMOOTHING * size / n), len(f) // 2)  # padding puts more bins between
    in_phase = S * np.exp(2j * np.pi * f * lag)
    power = moving_mean(np.abs(D) ** 2, width) * moving_mean(np.abs(V) ** 2, width)
    is_coherent = np.abs(moving_mean(in_phase, width)) ** 2 > _MIN_SQUARED_COHERENCE * power
    weight = np.cumsum(np.where(is_coherent, np.abs(S), 0.0))
    if weight[-1] == 0:
        return lag, 0.0
    edge = f[np.searchsorted(weight, _BAND_POWER * weight[-1])]
    return lag, float(max(edge, 8 / (n * dt)))

"""Number of independent samples in a residual, by its spectrum where the motion has its own.

Of two autocorrelated series, the scatter of their product's mean is that of n / (1 + 2 Σ_k rho_1(k) rho_2(k))
independent samples (Bayley & Hammersley 1946): the residual's spectrum weighted by that of the torque, which is the
columns'. White noise through a low-pass counts as its band; a residual as slow as the motion counts for very little.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.fourier import fast_length

_LONGEST_LAG = 2.0  # s


@dataclass
class Correlations:
    """Autocovariances of a residual and a torque, over batches of any number.

    Attributes
    ----------
    samples
        Number of samples at the logged rate.
    residual, torque
        Sums of products, by lag in rows, shape (nv, lags).
    """

    samples: int = 0
    residual: Array = field(default_factory=lambda: np.zeros((0, 0)))
    torque: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def add(self, residual: Array, torque: Array, stride: int, dt: float) -> None:
        """Add a batch, shape (nv, N) each, of samples ``dt`` [s] apart, of which every ``stride``-th is used."""
        lags = min(int(_LONGEST_LAG / (stride * dt)), -(-residual.shape[1] // stride))
        if lags < 1:
            return
        self.samples += residual.shape[1]
        self.residual = _added(self.residual, _products(residual[:, ::stride], lags))
        self.torque = _added(self.torque, _products(torque[:, ::stride], lags))

    def independent(self, stride: int) -> Array:
        """Number of independent samples of each joint, shape (nv,)."""
        lags = self.residual.shape[1]
        if not lags:
            return np.zeros(len(self.residual))
        size = self.residual[:, :1] * self.torque[:, :1]
        rho = self.residual * self.torque / np.where(size > 0, size, 1.0)
        taper = 1 - np.arange(lags) / lags
        inflation = 1 + 2 * rho[:, 1:] @ taper[1:]
        return np.asarray(self.samples / stride / np.maximum(inflation, 1.0))


def _products(x: Array, lags: int) -> Array:
    """Σ_t x(t) x(t + k) for k < lags, shape (nv, lags)."""
    size = fast_length(x.shape[1] + lags)
    return np.asarray(np.fft.irfft(np.square(np.abs(np.fft.rfft(x, size))), size)[:, :lags])


def _added(total: Array, new: Array) -> Array:
    """Sum of two arrays, the shorter one padded with zeros."""
    if total.shape[1] < new.shape[1]:
        total, new = new.copy(), total
    if new.size:
        total[:, : new.shape[1]] += new
    return total

"""Band in which the derivative of a gyroscope is the angular acceleration of the base, not noise.

The derivative of white noise grows with the frequency. In the regressor it does not average out: its power beside that
of the motion attenuates what is identified, and shifts the centre of mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import signal

from idtool.common.arrays import Array
from idtool.data.base_sensors import GYROSCOPE
from idtool.data.logs.log import Channel, JointLog

_MAX_NOISE_SHARE = 1e-3  # of the power of the angular acceleration
_LOWEST = 8.0  # Hz: contacts open and close within a tenth of a second
_MAX_NOISE_SHARE_AT_LOWEST = 0.1  # where it is larger, the base hardly moves
_WINDOW = 2.0  # s, of a spectrum
_NOISE_BAND = (0.6, 0.95)  # of the Nyquist frequency, in which there is noise alone


class _Accelerations(NamedTuple):
    """Power of the angular acceleration below each frequency, and that of noise, up to a common factor, shape (k,)."""

    frequencies: Array
    power: Array
    noise: Array

    @property
    def power_of_motion(self) -> Array:
        """Power without the noise."""
        return np.maximum(self.power - self.noise, 0.0)

    @property
    def shows_motion(self) -> bool:
        """True if the motion is more than noise at low frequencies."""
        lowest = int(np.searchsorted(self.frequencies, _LOWEST))
        return bool(self.noise[lowest] < _MAX_NOISE_SHARE_AT_LOWEST * self.power_of_motion[lowest])

    def highest_clear_frequency(self) -> float:
        """Frequency below which the noise is a small share of the power [Hz]; infinite if it is everywhere."""
        is_clear = self.noise <= _MAX_NOISE_SHARE * self.power_of_motion
        noisy = np.flatnonzero(~is_clear & (self.frequencies > _LOWEST))
        return max(float(self.frequencies[noisy[0] - 1]), _LOWEST) if len(noisy) else np.inf


def gyroscope_band(logs: Sequence[JointLog]) -> float:
    """Highest cut-off at which the noise of the gyroscope hardly counts in any log in which the base moves [Hz].

    Parameters
    ----------
    logs
        Logs with an IMU.

    Returns
    -------
    At least 8 Hz; infinite if the noise does not count at any frequency.
    """
    bands = []
    for log in logs:
        spectrum = _accelerations([log.channels[name] for name in GYROSCOPE])
        if spectrum is not None and spectrum.shows_motion:
            bands.append(spectrum.highest_clear_frequency())
    return min(bands, default=np.inf)


def _accelerations(rates: Sequence[Channel]) -> _Accelerations | None:
    """Spectra of a log's angular velocities, added up; None if it is too short."""
    values = np.stack([channel.x for channel in rates])
    is_known = np.isfinite(values).all(axis=0)
    step = Channel(rates[0].t[is_known], values[0, is_known]).step
    samples = round(_WINDOW / step) if step else 0
    if not 0 < samples <= is_known.sum():
        return None
    frequencies, density = signal.welch(values[:, is_known], 1 / step, nperseg=samples)
    low, high = np.multiply(_NOISE_BAND, frequencies[-1])
    is_noise = (frequencies > low) & (frequencies < high)
    noise_density = np.median(density[:, is_noise], axis=1).sum()
    squares = np.square(frequencies)
    power = np.cumsum(density.sum(axis=0) * squares)
    return _Accelerations(frequencies, power, np.cumsum(noise_density * squares))

"""Highest frequency at which the derivative of the gyroscope shows the motion of the base rather than noise.

The derivative of white noise grows with the frequency. Noise in the regressor biases least squares however long the log
is (errors in variables): it attenuates what the angular acceleration identifies, such as the centre of mass.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.data.base_sensors import GYROSCOPE
from idtool.data.logs.log import Channel, JointLog
from idtool.data.power_density import power_density

_MAX_NOISE_TO_MOTION = 1e-3  # ratio of powers; the relative bias of what is identified is about as large
_MAX_NOISE_TO_HELD_BASE = 0.1  # likewise; no gyroscope is so noisy that a base which moves is below
_LOWEST_CUTOFF = 8.0  # Hz: a lower one would smear how contacts open and close, in a tenth of a second
_SEGMENT_DURATION = 2.0  # s, of Welch's spectrum, which so has a resolution of 0.5 Hz
_NOISE_FROM, _NOISE_TO = 0.6, 0.95  # of the Nyquist frequency: taken for noise, above what moves a base


@dataclass(frozen=True)
class _CumulativeSpectrum:
    """Power of the angular acceleration below each frequency, the sum over three axes.

    Attributes
    ----------
    frequencies
        Ascending [Hz], shape (k,).
    measured
        Power of the derivative of the gyroscope [rad²/s⁴], shape (k,).
    noise
        Its part that is noise, likewise.
    """

    frequencies: Array
    measured: Array
    noise: Array

    def is_clear(self, max_noise_to_motion: float) -> Mask:
        """True for the frequencies below which the noise has at most a given ratio to the motion, shape (k,)."""
        motion = np.maximum(self.measured - self.noise, 0.0)
        return np.asarray(self.noise <= max_noise_to_motion * motion)

    @property
    def is_of_held_base(self) -> bool:
        """True if hardly more than noise is below the lowest cut-off."""
        is_below = self.frequencies <= _LOWEST_CUTOFF
        return not self.is_clear(_MAX_NOISE_TO_HELD_BASE)[is_below][-1]

    @property
    def highest_cutoff(self) -> float:
        """Cut-off up to which the noise hardly counts, at least the lowest one [Hz]; infinite if it never counts."""
        is_noisy = ~self.is_clear(_MAX_NOISE_TO_MOTION) & (self.frequencies > _LOWEST_CUTOFF)
        if not is_noisy.any():
            return np.inf
        first_noisy = int(np.argmax(is_noisy))
        last_clear = float(self.frequencies[first_noisy - 1])
        return max(last_clear, _LOWEST_CUTOFF)


def gyroscope_cutoff(logs: Sequence[JointLog]) -> float:
    """Highest cut-off that keeps the noise of the gyroscope negligible in every log in which the base moves [Hz].

    Noise that a low-pass in the gyroscope itself removes is not seen.

    Parameters
    ----------
    logs
        Logs with the channels of an IMU.

    Returns
    -------
    At least 8 Hz; infinite if the noise counts at no frequency, or no log tells.
    """
    cutoffs = []
    for log in logs:
        spectrum = _cumulative_spectrum(log)
        if spectrum is not None and not spectrum.is_of_held_base:
            cutoffs.append(spectrum.highest_cutoff)
    return min(cutoffs, default=np.inf)


def _cumulative_spectrum(log: JointLog) -> _CumulativeSpectrum | None:
    """Spectrum of a log's longest part without a gap; None if that is shorter than a segment of the spectrum."""
    longest = max(log.segments, key=lambda segment: segment.stop - segment.start)
    start, end = log.t[longest.start], log.t[longest.stop - 1]
    stamps = log.channels[GYROSCOPE[0]].t
    rates = np.stack([log.channels[name].x for name in GYROSCOPE])
    is_used = np.isfinite(rates).all(axis=0) & (stamps >= start) & (stamps <= end)
    period = Channel(stamps[is_used], rates[0, is_used]).step
    if period == 0 or is_used.sum() * period < _SEGMENT_DURATION:
        return None
    segment_samples = round(_SEGMENT_DURATION / period)
    frequencies, density_by_axis = power_density(rates[:, is_used], period, segment_samples)
    nyquist = frequencies[-1]
    is_noise = (frequencies > _NOISE_FROM * nyquist) & (frequencies < _NOISE_TO * nyquist)
    noise_by_axis = np.median(density_by_axis[:, is_noise], axis=1)
    derivative_gain = np.square(2 * np.pi * frequencies)
    measured_density = density_by_axis.sum(axis=0) * derivative_gain
    noise_density = noise_by_axis.sum() * derivative_gain
    resolution = frequencies[1]
    return _CumulativeSpectrum(
        frequencies=frequencies,
        measured=np.cumsum(measured_density) * resolution,
        noise=np.cumsum(noise_density) * resolution,
    )

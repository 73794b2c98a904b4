"""Fourier series within a smooth window (Swevers et al. 1997, whose series start in motion)."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, smooth_step
from idtool.excitation.patterns.linear import LinearPattern

_MAX_HARMONICS = 60  # spread over the band where it has room for more
_RAMP_SHARE = 0.1  # of the duration
_MAX_RAMP = 1.5  # s


class Fourier(LinearPattern):
    """Window times a constant, sines and cosines; the window takes the motion from rest and back to it."""

    name = "fourier"

    @override
    def frequencies(self) -> Array:
        w = 2 * np.pi * self._harmonics() / self.duration
        return np.concatenate([np.zeros(1), w, w])

    @override
    def functions(self, t: Array) -> MotionSamples:
        w = (2 * np.pi * self._harmonics() / self.duration)[:, None]
        sin = np.sin(w * t)
        cos = np.cos(w * t)
        one = np.ones((1, len(t)))
        f = np.concatenate([one, sin, cos])
        df = np.concatenate([0 * one, w * cos, -w * sin])
        ddf = np.concatenate([0 * one, -(w**2) * sin, -(w**2) * cos])
        window, dwindow, ddwindow = self._window(t)
        value = window * f
        first = dwindow * f + window * df
        second = ddwindow * f + 2 * dwindow * df + window * ddf
        return MotionSamples(value, first, second)

    def _harmonics(self) -> Array:
        """Numbers of periods in the duration, shape (H,)."""
        highest = max(int(self.max_frequency * self.duration), 1)
        if highest <= _MAX_HARMONICS:
            return np.arange(1.0, highest + 1)
        return np.asarray(np.unique(np.round(np.geomspace(1, highest, _MAX_HARMONICS))))

    def _window(self, t: Array) -> MotionSamples:
        """A factor that rises from 0 to 1 at the start and falls to 0 at the end, and its derivatives."""
        ramp = min(_RAMP_SHARE * self.duration, _MAX_RAMP)
        up = smooth_step(t / ramp)
        down = smooth_step((self.duration - t) / ramp)
        value = up.q * down.q
        first = (up.v * down.q - up.q * down.v) / ramp
        second = (up.a * down.q - 2 * up.v * down.v + up.q * down.a) / ramp**2
        return MotionSamples(value, first, second)

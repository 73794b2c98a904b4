"""Fourier series within a smooth window (Swevers et al. 1997, whose series start in motion)."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, smooth_step
from idtool.excitation.patterns.linear import LinearPattern

_HARMONICS = 60  # at most; where there is room for more, they are spread
_RAMP = 0.1  # of the whole, but no more than
_LONGEST_RAMP = 1.5  # s


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
        sin, cos, one = np.sin(w * t), np.cos(w * t), np.ones((1, len(t)))
        f = np.concatenate([one, sin, cos])
        df = np.concatenate([0 * one, w * cos, -w * sin])
        ddf = np.concatenate([0 * one, -(w**2) * sin, -(w**2) * cos])
        window, dwindow, ddwindow = self._window(t)
        return MotionSamples(window * f, dwindow * f + window * df, ddwindow * f + 2 * dwindow * df + window * ddf)

    def _harmonics(self) -> Array:
        """Multiples of one turn in all."""
        most = max(int(self.max_frequency * self.duration), 1)
        if most <= _HARMONICS:
            return np.arange(1.0, most + 1)
        return np.asarray(np.unique(np.round(np.geomspace(1, most, _HARMONICS))))

    def _window(self, t: Array) -> MotionSamples:
        ramp = min(_RAMP * self.duration, _LONGEST_RAMP)
        up, down = smooth_step(t / ramp), smooth_step((self.duration - t) / ramp)
        value = up.q * down.q
        first = (up.v * down.q - up.q * down.v) / ramp
        second = (up.a * down.q - 2 * up.v * down.v + up.q * down.a) / ramp**2
        return MotionSamples(value, first, second)

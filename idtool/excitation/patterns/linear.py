"""`LinearPattern`: motions that are linear in their numbers: home plus a sum of functions of time."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec

_RANDOM_SHARE = 0.9  # of the limits that a random motion uses
_SAMPLES = 500  # of a random motion, to scale it
_CACHED = 2  # sets of times: those of the samples, and those of the clearance


class LinearPattern(Pattern):
    """q = home + Σ over k of x_k unit_k f_k(t), with functions that vanish with two derivatives at both ends."""

    def __init__(self, spec: PatternSpec) -> None:
        super().__init__(spec)
        self.max_frequency = spec.max_frequency
        self._cache: list[tuple[Array, MotionSamples]] = []

    @abstractmethod
    def functions(self, t: Array) -> MotionSamples:
        """The K functions and their two derivatives, shape (K, N) each."""

    @abstractmethod
    def frequencies(self) -> Array:
        """Approximate angular frequency of each function, shape (K,) [rad/s]."""

    def units(self) -> Array:
        """Amplitude within the limits of each joint moved by each function alone, shape (nv, K) [rad or m]."""
        w = self.frequencies()
        with np.errstate(divide="ignore"):
            by_velocity = self.limits.velocity[:, None] / w
            by_acceleration = self.limits.acceleration[:, None] / w**2
        return np.asarray(np.minimum(self.limits.half_range[:, None], np.minimum(by_velocity, by_acceleration)))

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        x = rng.normal(size=self.units().size)
        q, v, a = self.motion(x, np.linspace(0, self.duration, _SAMPLES))
        excursion = np.abs(q - self.home[:, None]).max(axis=1)
        shares = [
            _RANDOM_SHARE * self.max_excursion / excursion,
            _RANDOM_SHARE * self.limits.velocity / np.abs(v).max(axis=1),
            _RANDOM_SHARE * self.limits.acceleration / np.abs(a).max(axis=1),
        ]
        return self.scaled(x, np.min(shares, axis=0))

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        amplitudes = x.reshape(len(self.home), -1) * self.units()
        f, df, ddf = self._functions_at(t)
        return MotionSamples(self.home[:, None] + amplitudes @ f, amplitudes @ df, amplitudes @ ddf)

    @override
    def gradient(self, x: Array, t: Array, by: MotionSamples) -> Array:
        f, df, ddf = self._functions_at(t)
        by_amplitude = by.q @ f.T + by.v @ df.T + by.a @ ddf.T
        return np.asarray(by_amplitude * self.units()).ravel()

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        return (x.reshape(len(self.home), -1) * share[:, None]).ravel()

    def _functions_at(self, t: Array) -> MotionSamples:
        """The functions at given times, cached for the last few sets of times."""
        for times, functions in self._cache:
            if times is t:
                return functions
        functions = self.functions(t)
        self._cache = [(t, functions), *self._cache[: _CACHED - 1]]
        return functions

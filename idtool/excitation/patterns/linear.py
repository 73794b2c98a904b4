"""`LinearPattern`: motions that are linear in their numbers: home plus a sum of functions of time."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec

_DRAWN = 0.9  # of the limits that a random motion takes
_LOOKED_AT = 500  # samples
_KEPT = 2  # sets of times: those of the samples, and those at which the clearance is looked at


class LinearPattern(Pattern):
    """q = home + Σ over k of x_k unit_k f_k(t), with functions that vanish with two derivatives at both ends."""

    def __init__(self, setting: PatternSpec) -> None:
        super().__init__(setting)
        self.max_frequency = setting.max_frequency
        self._last: list[tuple[Array, MotionSamples]] = []

    @abstractmethod
    def functions(self, t: Array) -> MotionSamples:
        """The K functions and their two derivatives, shape (K, N) each."""

    @abstractmethod
    def frequencies(self) -> Array:
        """About how fast each function changes, shape (K,) [rad/s]."""

    def units(self) -> Array:
        """By how much each function may move each joint by itself, shape (nv, K) [rad or m]."""
        w = self.frequencies()
        velocity, acceleration = self.limits.velocity[:, None], self.limits.acceleration[:, None]
        with np.errstate(divide="ignore"):
            return np.asarray(
                np.minimum(self.limits.half_range[:, None], np.minimum(velocity / w, acceleration / w**2))
            )

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        x = rng.normal(size=self.units().size)
        q, v, a = self.motion(x, np.linspace(0, self.duration, _LOOKED_AT))
        ways = ((q - self.home[:, None], self.max_excursion), (v, self.limits.velocity), (a, self.limits.acceleration))
        return self.scaled(x, np.min([_DRAWN * limit / np.abs(way).max(axis=1) for way, limit in ways], axis=0))

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        C = x.reshape(len(self.home), -1) * self.units()
        q, v, a = (C @ f for f in self._at(t))
        return MotionSamples(self.home[:, None] + q, v, a)

    @override
    def gradient(self, x: Array, t: Array, by: MotionSamples) -> Array:
        total = np.sum([d @ f.T for d, f in zip(by, self._at(t), strict=True)], axis=0)
        return np.asarray(total * self.units()).ravel()

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        return (x.reshape(len(self.home), -1) * share[:, None]).ravel()

    def _at(self, t: Array) -> MotionSamples:
        """The functions; those of the last few times are kept."""
        for times, functions in self._last:
            if times is t:
                return functions
        self._last = [(t, self.functions(t)), *self._last[: _KEPT - 1]]
        return self._last[0][1]

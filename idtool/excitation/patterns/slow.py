"""Slow sweeps at several constant speeds in both directions, for friction as a function of speed."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import STEP_VELOCITY, MotionSamples, Pattern, PatternSpec

_MAX_SWEEPS = 3  # one speed each
_SPEED_RATIO = 4.0  # of one speed to the next
_VELOCITY_SHARE = 0.3  # of the limit, for the fastest sweep
_RANGE_SHARE = 0.9  # of the range from home to the limits
_MIN_SWEEP = 1.0  # s of one speed, there and back; a shorter segment has fewer speeds
_CHANGE_SHARE = 0.15  # of half a sweep, for each change of velocity


class SlowSweeps(Pattern):
    """All joints sweep out from home and back at one speed each, then at the next.

    The joints have their speeds in different orders and directions. x is the velocity of each joint in each sweep, in
    units of the fastest, shape (nv · sweeps,).
    """

    name = "slow"

    def __init__(self, spec: PatternSpec) -> None:
        super().__init__(spec)
        self.sweeps = int(np.clip(self.duration / _MIN_SWEEP, 1, _MAX_SWEEPS))
        self._sweep_duration = self.duration / self.sweeps
        # Of a sweep at unit velocity; at its turning point the velocity changes from 1 to −1.
        distance = self._sweep_duration / 2 * (1 - 1.5 * _CHANGE_SHARE)
        change = _CHANGE_SHARE * self._sweep_duration / 2  # s
        by_velocity = _VELOCITY_SHARE * self.limits.velocity
        by_range = _RANGE_SHARE * self.max_excursion / distance
        by_acceleration = self.limits.acceleration * change / (2 * STEP_VELOCITY)
        self.fastest: Array = np.minimum(np.minimum(by_velocity, by_range), by_acceleration)

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        """Random orders and signs of speeds a factor of four apart, shape (nv · sweeps,)."""
        speeds = _SPEED_RATIO ** -np.arange(self.sweeps, dtype=float)
        orders: Array = np.array([rng.permutation(speeds) for _ in self.home], dtype=np.float64)
        return np.asarray(orders * rng.choice([-1.0, 1.0], orders.shape), dtype=np.float64).ravel()

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        return np.asarray(x.reshape(len(self.home), -1) * share[:, None]).ravel()

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        sweep = np.clip((t / self._sweep_duration).astype(int), 0, self.sweeps - 1)
        q, v, a = self._sweep(t - sweep * self._sweep_duration)
        velocity = self.fastest[:, None] * x.reshape(len(self.home), -1)[:, sweep]
        return MotionSamples(self.home[:, None] + velocity * q, velocity * v, velocity * a)

    def _sweep(self, t: Array) -> MotionSamples:
        """A sweep at velocities of 1 and −1; the velocity is a sum of smooth steps. Shape (N,) each."""
        change = _CHANGE_SHARE * self._sweep_duration / 2
        q, v, a = np.zeros((3, len(t)))
        for start, size in (
            (0.0, 1.0),
            ((self._sweep_duration - change) / 2, -2.0),
            (self._sweep_duration - change, 1.0),
        ):
            x = np.clip((t - start) / change, 0.0, 1.0)
            after = np.maximum(t - start - change, 0.0)
            q += size * (change * x**4 * (2.5 - 3 * x + x**2) + after)
            v += size * x**3 * (10 - 15 * x + 6 * x**2)
            a += size * 30 * x**2 * (1 - x) ** 2 / change
        return MotionSamples(q, v, a)

"""Slow sweeps at constant speeds, several and in both directions: friction against speed."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import STEP_SPEED, MotionSamples, Pattern, PatternSpec

_SPEEDS = 3  # that each joint sweeps at
_RATIO = 4.0  # from one speed to the next
_FASTEST = 0.3  # of the velocity limit
_ROOM = 0.9  # of the way from home to the limits
_SHORTEST = 1.0  # s of one speed, there and back; a part too short for all speeds has fewer
_TURN = 0.15  # of a sweep is taken by each change of velocity


class SlowSweeps(Pattern):
    """All joints sweep out from home and back at one speed each, then at the next.

    The joints take their speeds in different orders and directions, told by x: the velocity of each joint in each
    sweep, in units of the fastest, shape (nv · sweeps,).
    """

    name = "slow"

    def __init__(self, setting: PatternSpec) -> None:
        super().__init__(setting)
        self.sweeps = int(np.clip(self.duration / _SHORTEST, 1, _SPEEDS))
        self._each = self.duration / self.sweeps
        way = self._each / 2 * (1 - 1.5 * _TURN)  # of a sweep at a velocity of 1
        change = _TURN * self._each / 2  # s from one velocity to the next; at the turning point, from +1 to −1
        fastest = np.minimum(_FASTEST * self.limits.velocity, _ROOM * self.max_excursion / way)
        self.fastest: Array = np.minimum(fastest, self.limits.acceleration * change / (2 * STEP_SPEED))

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        """Speeds a factor of four apart, in an order and with signs at random."""
        speeds = _RATIO ** -np.arange(self.sweeps, dtype=float)
        orders: Array = np.array([rng.permutation(speeds) for _ in self.home], dtype=np.float64)
        return np.asarray(orders * rng.choice([-1.0, 1.0], orders.shape), dtype=np.float64).ravel()

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        return np.asarray(x.reshape(len(self.home), -1) * share[:, None]).ravel()

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        sweep = np.clip((t / self._each).astype(int), 0, self.sweeps - 1)
        q, v, a = self._sweep(t - sweep * self._each)
        velocity = self.fastest[:, None] * x.reshape(len(self.home), -1)[:, sweep]
        return MotionSamples(self.home[:, None] + velocity * q, velocity * v, velocity * a)

    def _sweep(self, t: Array) -> MotionSamples:
        """Out and back at velocities of 1 and −1: the velocity is a sum of smooth steps, the way its integral."""
        change = _TURN * self._each / 2
        q, v, a = np.zeros((3, len(t)))
        for start, size in ((0.0, 1.0), ((self._each - change) / 2, -2.0), (self._each - change, 1.0)):
            x = np.clip((t - start) / change, 0.0, 1.0)
            after = np.maximum(t - start - change, 0.0)
            q += size * (change * x**4 * (2.5 - 3 * x + x**2) + after)
            v += size * x**3 * (10 - 15 * x + 6 * x**2)
            a += size * 30 * x**2 * (1 - x) ** 2 / change
        return MotionSamples(q, v, a)

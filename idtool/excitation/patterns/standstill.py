"""Standstill at several poses, for friction at rest and torque of gravity alone."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec, max_step_distance, smooth_step

_CELL = 1.0  # s, about, of a move and the standstill after it
_HOLD_SHARE = 0.4  # of it is standstill
_RANGE_SHARE = 0.9  # of the range from home to the limits


class Standstill(Pattern):
    """Moves from pose to pose with a standstill at each, from home and back; x: poses in units of the reach."""

    name = "standstill"

    def __init__(self, spec: PatternSpec) -> None:
        super().__init__(spec)
        self.holds = max(int(self.duration / _CELL) - 1, 1)
        self._cell_duration = self.duration / (self.holds + 1)
        self._move_duration = (1 - _HOLD_SHARE) * self._cell_duration
        distance = max_step_distance(self.limits.velocity, self.limits.acceleration, self._move_duration)
        # From pose to pose it is up to twice the reach.
        self.reach: Array = np.minimum(_RANGE_SHARE * self.max_excursion, distance / 2)

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, len(self.home) * self.holds)

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        return np.asarray(x.reshape(len(self.home), -1) * share[:, None]).ravel()

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        excursions = self.reach[:, None] * x.reshape(len(self.home), -1)
        poses = self.home[:, None] + np.pad(excursions, [(0, 0), (1, 1)])
        cell = np.clip((t / self._cell_duration).astype(int), 0, self.holds)
        duration = self._move_duration
        q, v, a = smooth_step((t - cell * self._cell_duration) / duration)
        distance = poses[:, cell + 1] - poses[:, cell]
        return MotionSamples(poses[:, cell] + distance * q, distance * v / duration, distance * a / duration**2)

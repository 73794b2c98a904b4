"""Holds at several poses: what a joint's friction does at rest, and what gravity alone asks for."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec, max_step_distance, smooth_step

_CELL = 1.0  # s that a move and the hold after it take, about
_HOLD = 0.4  # of it is held
_ROOM = 0.9  # of the way from home to the limits


class Standstill(Pattern):
    """From home to pose after pose and home again, a hold at each; x is where they are, in units of the reach."""

    name = "standstill"

    def __init__(self, setting: PatternSpec) -> None:
        super().__init__(setting)
        self.holds = max(int(self.duration / _CELL) - 1, 1)
        self._each = self.duration / (self.holds + 1)
        far = max_step_distance(self.limits.velocity, self.limits.acceleration, (1 - _HOLD) * self._each)
        self.reach: Array = np.minimum(
            _ROOM * self.max_excursion, far / 2
        )  # from pose to pose it is twice that at most

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, len(self.home) * self.holds)

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        return np.asarray(x.reshape(len(self.home), -1) * share[:, None]).ravel()

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        away = self.reach[:, None] * x.reshape(len(self.home), -1)
        poses = self.home[:, None] + np.pad(away, [(0, 0), (1, 1)])
        cell = np.clip((t / self._each).astype(int), 0, self.holds)
        move = (1 - _HOLD) * self._each
        q, v, a = smooth_step((t - cell * self._each) / move)
        way = poses[:, cell + 1] - poses[:, cell]
        return MotionSamples(poses[:, cell] + way * q, way * v / move, way * a / move**2)

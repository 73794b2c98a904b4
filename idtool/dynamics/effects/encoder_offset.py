"""Encoders whose zero is not the joint's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.held_effect import HeldJointEffect
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism

_MOST = 0.7  # rad or m: beyond, it is another zero by intention


class EncoderOffset(HeldJointEffect):
    """True q = measured q + offset. A controller acts on the measured one."""

    id = "encoder_offset"
    means = "the encoder's zero is not the joint's"
    shows = "standstill over the whole travel, the base turned over or tilted by a known angle"
    held = (Held("offset"),)

    @classmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """See `HeldJointEffect.slopes`."""
        zero = np.zeros_like(motion.t)
        return present.moved(motion, joint, zero + 1, zero, zero)

    @classmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """See `HeldJointEffect.solved`."""
        return {"offset": c} if abs(c) < _MOST else None

    def true(self, motion: Motion) -> Motion:
        """See `Effect.true`."""
        q = motion.q.copy()
        q[self.joint] += self.shape["offset"]
        return replace(motion, q=q)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.position_offset[self.joint] += self.shape["offset"]

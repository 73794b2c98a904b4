"""Encoders whose zero is not the joint's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idtool.effects.held_effect import HeldJointEffect
from idtool.effects.joint_effect import Held
from idtool.mechanism import Mechanism
from idtool.signals import Motion

Array = NDArray[np.float64]


class EncoderOffset(HeldJointEffect):
    """True q = measured q + offset. A controller acts on the measured one."""

    id = "encoder_offset"
    held = (Held("offset"),)

    def true(self, motion: Motion) -> Motion:
        """See `Effect.true`."""
        q = motion.q.copy()
        q[self.joint] += self.shape["offset"]
        return replace(motion, q=q)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.position_offset[self.joint] += self.shape["offset"]

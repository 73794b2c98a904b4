"""Drag that grows with the square of speed: windage, oil, water."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm


class QuadraticDrag(JointTerm):
    """d v abs(v)."""

    id = "quadratic_drag"
    means = "drag grows with the square of speed"
    shows = "steady motion at several high speeds"
    name = "drag"
    friction = True
    unit = ("N·m·s²/rad²", "N·s²/m²")

    def column(self, motion: Motion) -> Array:
        """The square of the velocity, with its sign."""
        v = motion.v[self.joint]
        return np.asarray(v * np.abs(v))

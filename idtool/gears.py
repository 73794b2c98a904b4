"""Gears that give way: springs with dampers and play between the motors' and the links' sides of joints.

Letters: q, v positions and velocities of the n coordinates (n, W), as in `dynamics`; tau torque at the joints (nv, W).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from idtool.dynamics import motor_sides
from idtool.mechanism import Mechanism

Array = NDArray[np.float64]


class Gears:
    """Springs with dampers and play between the motors' and the links' sides."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.joint = np.array(sorted(mechanism.gears))
        self._motor = motor_sides(mechanism)[self.joint]
        gears = [mechanism.gears[j] for j in self.joint]
        self._stiffness = np.array([[gear.stiffness] for gear in gears])
        self._ratio = np.array([[gear.damping] for gear in gears])
        self._half_play = np.array([[gear.play / 2] for gear in gears])
        self._damping = np.zeros_like(self._stiffness)

    def damp(self, M: Array) -> None:
        """Set the dampers by the motors' own inertia, in the mass matrix, shape (W, n, n)."""
        inertia = np.diagonal(M, axis1=1, axis2=2).mean(axis=0)[self._motor][:, None]
        self._damping = 2 * self._ratio * np.sqrt(self._stiffness * np.maximum(inertia, 0))

    def apart(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """All coordinates, shape (n, W), when the motors' sides are at q, v, and the gears carry tau, shape (nv, W)."""
        sides = np.concatenate([q, q[self.joint]])
        carried = tau[self.joint]
        sides[self.joint] -= carried / self._stiffness + self._half_play * np.sign(carried)
        return sides, np.concatenate([v, v[self.joint]])

    def torque(self, q: Array, v: Array) -> Array:
        """Torque of the gears on all coordinates, shape (n, w)."""
        out = np.zeros_like(q)
        deflection = q[self._motor] - q[self.joint]
        beyond = deflection - np.clip(deflection, -self._half_play, self._half_play)
        rate = np.where((beyond != 0) | (self._half_play == 0), v[self._motor] - v[self.joint], 0.0)
        carried = self._stiffness * beyond + self._damping * rate
        # Teeth push and do not pull, whatever the damper says.
        carried = np.where((self._half_play > 0) & (carried * beyond < 0), 0.0, carried)
        out[self._motor], out[self.joint] = -carried, carried
        return out

    def stops(self, coordinates: int) -> list[tuple[Array, float]]:
        """Where teeth meet: the deflection's slope in the coordinates, shape (n,), and its value there."""
        found = []
        for link, motor, half in zip(self.joint, self._motor, self._half_play[:, 0], strict=True):
            slope = np.zeros(coordinates)
            slope[motor], slope[link] = 1.0, -1.0
            found += [(slope, side * float(half)) for side in (-1, 1) if half]
        return found

    def stiffen(self, damping: Array, stiffness: Array) -> None:
        """Let no rate of damping and stiffness, shape (n, w), be less than the gears make it."""
        for side in (self._motor, self.joint):
            stiffness[side] = np.maximum(stiffness[side], self._stiffness)
            damping[side] = np.maximum(damping[side], self._damping)

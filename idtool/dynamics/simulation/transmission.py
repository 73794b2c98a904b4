"""Gears that give way: springs with dampers and play between the motors' and the links' sides of joints.

Letters: q, v positions and velocities of the n coordinates (n, W), as in `dynamics`; tau torque at the joints (nv, W).
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.rigid_body_dynamics import motor_coordinates

_RIGID = 2 * np.pi * 200.0  # rad/s: far above what a log's band holds, and no need of very short steps


class Transmissions:
    """Springs with dampers and play between the motors' and the links' sides."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.joint = np.array(sorted(mechanism.transmissions))
        self._motor = motor_coordinates(mechanism)[self.joint]
        gears = [mechanism.transmissions[j] for j in self.joint]
        self._stiffness = np.array([[gear.stiffness] for gear in gears])
        self._ratio = np.array([[gear.damping_ratio] for gear in gears])
        self._half_play = np.array([[gear.backlash / 2] for gear in gears])
        self._damping = np.zeros_like(self._stiffness)

    def set_damping(self, M: Array) -> None:
        """Set the dampers and what is as good as rigid by the inertias in the mass matrix at zero, shape (n, n)."""
        gear, apart = np.arange(len(self.joint)), np.zeros((len(self.joint), len(M)))
        apart[gear, self._motor], apart[gear, self.joint] = 1.0, -1.0
        reduced = 1 / np.einsum("ki,ij,kj->k", apart, np.linalg.inv(M), apart)
        rigid = np.isinf(self._stiffness)
        inertia = np.where(rigid, reduced[:, None], np.diag(M)[self._motor, None])
        self._stiffness = np.where(rigid, inertia * _RIGID**2, self._stiffness)
        self._damping = 2 * self._ratio * np.sqrt(self._stiffness * np.maximum(inertia, 0))

    def deflect(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
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

    def breakpoints(self, coordinates: int) -> list[tuple[Array, float]]:
        """Where teeth meet: the deflection's slope in the coordinates, shape (n,), and its value there."""
        found = []
        for link, motor, half in zip(self.joint, self._motor, self._half_play[:, 0], strict=True):
            slope = np.zeros(coordinates)
            slope[motor], slope[link] = 1.0, -1.0
            found += [(slope, side * float(half)) for side in (-1, 1) if half]
        return found

    def include_stiffness(self, damping: Array, stiffness: Array) -> None:
        """Let damping and stiffness, shape (w, n, n), be no less than the gears make them."""
        for x, own in ((stiffness, self._stiffness[:, 0]), (damping, self._damping[:, 0])):
            for side, other in ((self._motor, self.joint), (self.joint, self._motor)):
                x[:, side, side] = np.maximum(x[:, side, side], own)
                x[:, side, other] = -own

"""`Transmissions`: springs with dampers and backlash between the motor and the link sides of joints.

Letters: q, v positions and velocities of the n coordinates (n, W), as in `rigid_body_dynamics`; tau torque at the
joints (nv, W).
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.rigid_body_dynamics import motor_coordinates

_RIGID_FREQUENCY = 2 * np.pi * 200.0  # rad/s: far above a log's band, yet steps need not be very short


class Transmissions:
    """Springs with dampers and backlash between motor and link sides.

    Attributes
    ----------
    joints
        Indices of the joints that have one, shape (k,).

    Parameters
    ----------
    mechanism
        The forward model.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.joints = np.array(sorted(mechanism.transmissions))
        self._motor = motor_coordinates(mechanism)[self.joints]
        transmissions = [mechanism.transmissions[j] for j in self.joints]
        self._stiffness = np.array([[transmission.stiffness] for transmission in transmissions])
        self._damping_ratio = np.array([[transmission.damping_ratio] for transmission in transmissions])
        self._half_backlash = np.array([[transmission.backlash / 2] for transmission in transmissions])
        self._damping = np.zeros_like(self._stiffness)

    def set_damping(self, M: Array) -> None:
        """Set the dampers and the nearly rigid springs from the mass matrix at zero, shape (n, n)."""
        rows = np.arange(len(self.joints))
        difference = np.zeros((len(self.joints), len(M)))  # motor less link
        difference[rows, self._motor] = 1.0
        difference[rows, self.joints] = -1.0
        reduced = 1 / np.einsum("ki,ij,kj->k", difference, np.linalg.inv(M), difference)
        rigid = np.isinf(self._stiffness)
        inertia = np.where(rigid, reduced[:, None], np.diag(M)[self._motor, None])
        self._stiffness = np.where(rigid, inertia * _RIGID_FREQUENCY**2, self._stiffness)
        self._damping = 2 * self._damping_ratio * np.sqrt(self._stiffness * np.maximum(inertia, 0))

    def deflect(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """All coordinates, shape (n, W), where the motor sides are at q, v and the transmissions carry tau."""
        carried = tau[self.joints]
        coordinates = np.concatenate([q, q[self.joints]])
        coordinates[self.joints] -= carried / self._stiffness + self._half_backlash * np.sign(carried)
        return coordinates, np.concatenate([v, v[self.joints]])

    def torque(self, q: Array, v: Array) -> Array:
        """Torque of the transmissions on all coordinates, shape (n, w)."""
        deflection = q[self._motor] - q[self.joints]
        beyond = deflection - np.clip(deflection, -self._half_backlash, self._half_backlash)
        in_contact = (beyond != 0) | (self._half_backlash == 0)
        rate = np.where(in_contact, v[self._motor] - v[self.joints], 0.0)
        carried = self._stiffness * beyond + self._damping * rate
        # Teeth push and do not pull, whatever the damper says.
        carried = np.where((self._half_backlash > 0) & (carried * beyond < 0), 0.0, carried)
        out = np.zeros_like(q)
        out[self._motor] = -carried
        out[self.joints] = carried
        return out

    def breakpoints(self, coordinates: int) -> list[tuple[Array, float]]:
        """Deflections at which teeth meet: their gradient by the coordinates, shape (n,), and their value."""
        breakpoints = []
        for link, motor, half in zip(self.joints, self._motor, self._half_backlash[:, 0], strict=True):
            if not half:
                continue
            gradient = np.zeros(coordinates)
            gradient[motor] = 1.0
            gradient[link] = -1.0
            breakpoints.append((gradient, -float(half)))
            breakpoints.append((gradient, float(half)))
        return breakpoints

    def include_stiffness(self, damping: Array, stiffness: Array) -> None:
        """Raise damping and stiffness, shape (w, n, n), to at least those of the transmissions, in place."""
        for matrix, own in ((stiffness, self._stiffness[:, 0]), (damping, self._damping[:, 0])):
            for side, other in ((self._motor, self.joints), (self.joints, self._motor)):
                matrix[:, side, side] = np.maximum(matrix[:, side, side], own)
                matrix[:, side, other] = -own

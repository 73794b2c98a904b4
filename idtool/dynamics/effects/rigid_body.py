"""Rigid bodies, links and rotors alike: tau = Y(q, v, a) pi (6), (7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.signals import Motion
from idtool.dynamics.effects.base import Coefficient, Effect
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Body
from idtool.robot.inertia import NAMES, POWERS, SIZE, UNITS, mass_com_inertia, skew
from idtool.robot.kinematics import BodyMotion, body_motions, cross
from idtool.robot.model import Model

_LIGHT = 0.1  # of the bodies' median mass


class RigidBodies(Effect):
    """All bodies of a model, ten coefficients each, in the model's order.

    Parameters
    ----------
    model
        The tree of bodies.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        typical = typical_mass(model.bodies)
        self.coefficients = tuple(
            Coefficient("rigid_body", body.name, name, unit, float(prior), float(scale))
            for body in model.bodies
            for name, unit, prior, scale in zip(NAMES, UNITS, body.pi, scales(body, typical), strict=True)
        )
        self._support = support = model.support()
        self.active = tuple(
            (np.flatnonzero(support[:, j])[:, None] * SIZE + np.arange(SIZE)).ravel() for j in range(support.shape[1])
        )
        self._first_row: Indices = (
            np.cumsum(support, axis=0) - support
        )  # of each body within a joint's columns, in bodies

    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """See `Effect.write`."""
        for i, body_motion in enumerate(body_motions(self.model, motion.q, motion.v, motion.a)):
            D = _inertia_torque(body_motion)
            body = self.model.bodies[i]
            above = self._support[body.mount.body] if body.mount.body >= 0 else np.zeros(len(self.active), dtype=bool)
            for k, joint in enumerate(body_motion.coordinates):
                first = SIZE * self._first_row[i, joint]
                rows = out[joint][first : first + SIZE]
                if above[joint]:
                    _write_row(body_motion, D, k, rows)
                else:
                    _write_own_row(body, body_motion, D, body.ratios[joint], rows)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.pi += theta.reshape(-1, SIZE)
        mechanism.gravity = self.model.gravity


def _write_own_row(body: Body, motion: BodyMotion, D: Array, ratio: float, out: Array) -> None:
    """The same as `_write_row` for a coordinate that moves the body along or about its own axis and in no other way."""
    axis = ratio * body.axis
    if body.prismatic:
        out[0] = axis @ motion.acc
        out[1:4] = np.tensordot(axis, motion.M, axes=1)
        out[4:] = 0
    else:
        out[0] = 0
        out[1:4] = skew(-axis) @ motion.acc
        out[4:] = np.tensordot(axis, D, axes=1)


def _write_row(motion: BodyMotion, D: Array, k: int, out: Array) -> None:
    """A body's ten columns in one joint's equation: the power that joint's motion takes from the body's wrench.

    With the body's wrench f = m acc + M h, n = h × acc + I alpha + w × I w (4), the power is S_v · f + S_w · n;
    collected by parameter.
    """
    S_w, S_v = motion.S_w[:, k], motion.S_v[:, k]
    np.einsum("in,in->n", S_v, motion.acc, out=out[0])
    np.einsum("in,ijn->jn", S_v, motion.M, out=out[1:4])
    out[1:4] += cross(motion.acc, S_w)
    np.einsum("in,ijn->jn", S_w, D, out=out[4:])


def _inertia_torque(motion: BodyMotion) -> Array:
    """I alpha + w × I w = D [I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], shape (3, 6, N)."""
    (x, y, z), (a, b, c), M = motion.w, motion.alpha, motion.M
    xy, yz, zx = x * y, y * z, z * x
    D = np.empty((3, 6, len(x)))
    D[0] = a, b - zx, -yz, c + xy, M[1, 1] - M[2, 2], yz
    D[1] = zx, a + yz, b, M[2, 2] - M[0, 0], c - xy, -zx
    D[2] = -xy, M[0, 0] - M[1, 1], xy, a - yz, b + zx, c
    return D


def typical_mass(bodies: Sequence[Body]) -> float:
    """A mass to measure by where a body has none [kg]: the bodies' median, or 1."""
    masses = [body.pi[0] for body in bodies if body.pi[0] > 0]
    return float(np.median(masses)) if masses else 1.0


def length(body: Body) -> float:
    """A body's typical length [m]: its bounds', or the prior's radius of gyration, or 0.1."""
    if body.bounds:
        return max(bound.size for bound in body.bounds)
    mass, _, inertia = mass_com_inertia(body.pi)
    gyration = np.sqrt(np.trace(inertia) / (2 * mass)) if mass > 0 and np.trace(inertia) > 0 else 0.0
    return float(gyration) or 0.1


def scales(body: Body, typical: float) -> Array:
    """Typical sizes of a body's parameters, shape (10,): mass, mass × length, mass × length².

    A mass far below the others' may be there to hold a place, and is not measured by itself.
    """
    mass = max(body.pi[0], _LIGHT * typical)
    return np.asarray(mass * length(body) ** POWERS)

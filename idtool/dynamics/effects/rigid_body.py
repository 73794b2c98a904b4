"""Rigid bodies, links and rotors alike: tau = Y(q, v, a) pi (6), (7)."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices
from idtool.data.column_cache import IdentityKey
from idtool.data.signals import Motion
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Body
from idtool.robot.inertia import LENGTH_POWERS, PARAMETER_NAMES, PARAMETER_UNITS, PI_SIZE, mass_com_inertia, skew
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.kinematics import BodyJacobian, BodyMotion, body_jacobians, body_motions, cross
from idtool.robot.model import RobotModel

_MIN_MASS_SHARE = 0.1  # of the bodies' median mass


class RigidBodies(Effect):
    """All bodies of a model, ten coefficients each, in the model's order.

    Parameters
    ----------
    model
        The tree of bodies.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        typical = typical_mass(model.bodies)
        coefficients = []
        for body in model.bodies:
            for name, unit, prior, scale in zip(
                PARAMETER_NAMES, PARAMETER_UNITS, body.pi, parameter_scales(body, typical), strict=True
            ):
                coefficients.append(Coefficient("rigid_body", body.name, name, unit, float(prior), float(scale)))
        self.coefficients = tuple(coefficients)

        support = model.support()
        active = []
        for joint in range(support.shape[1]):
            bodies = np.flatnonzero(support[:, joint])
            active.append((bodies[:, None] * PI_SIZE + np.arange(PI_SIZE)).ravel())
        self.active = tuple(active)
        self._support = support
        # Number of bodies before each body among the columns of a joint:
        self._position: Indices = np.cumsum(support, axis=0) - support

    @property
    @override
    def column_key(self) -> Hashable:
        return "rigid_bodies", IdentityKey(self.model)

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        motions = body_motions(self.model, motion.q, motion.v, motion.a)
        jacobians = body_jacobians(self.model, motions)
        for i, (body_motion, jacobian) in enumerate(zip(motions, jacobians, strict=True)):
            D = _inertia_torque(body_motion)
            body = self.model.bodies[i]
            for k, joint in enumerate(jacobian.coordinates):
                first = PI_SIZE * self._position[i, joint]
                rows = out[joint][first : first + PI_SIZE]
                parent = body.mount.body
                moves_parent = parent >= 0 and self._support[parent, joint]
                if moves_parent or body.first_free_coordinate is not None:
                    _write_columns(body_motion, jacobian, D, k, rows)
                else:
                    _write_own_axis_columns(body, body_motion, D, body.ratios[joint], rows)

    def torque(self, theta: Array, motion: Motion) -> Array:
        """Columns times coefficients, shape (nv, N) [N·m or N]; faster than by evaluating the columns.

        Parameters
        ----------
        theta
            The coefficients, shape (m,).
        motion
            N samples.
        """
        return inverse_dynamics(self.model, theta.reshape(-1, PI_SIZE), motion.q, motion.v, motion.a)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.pi += theta.reshape(-1, PI_SIZE)
        mechanism.gravity = self.model.gravity


def _write_own_axis_columns(body: Body, motion: BodyMotion, D: Array, ratio: float, out: Array) -> None:
    """Write what `_write_columns` does, for a joint that moves the body along or about its own axis alone."""
    axis = ratio * body.axis
    if body.prismatic:
        out[0] = axis @ motion.acc
        out[1:4] = np.tensordot(axis, motion.M, axes=1)
        out[4:] = 0
    else:
        out[0] = 0
        out[1:4] = skew(-axis) @ motion.acc
        out[4:] = np.tensordot(axis, D, axes=1)


def _write_columns(motion: BodyMotion, jacobian: BodyJacobian, D: Array, k: int, out: Array) -> None:
    """Write a body's ten columns in one joint's equation: the power of the body's wrench in that joint's motion.

    With the body's wrench f = m acc + M h, n = h × acc + I alpha + w × I w (4), the power is S_v · f + S_w · n;
    collected by parameter.
    """
    S_w, S_v = jacobian.S_w[:, k], jacobian.S_v[:, k]
    np.einsum("in,in->n", S_v, motion.acc, out=out[0])
    np.einsum("in,ijn->jn", S_v, motion.M, out=out[1:4])
    out[1:4] += cross(motion.acc, S_w)
    np.einsum("in,ijn->jn", S_w, D, out=out[4:])


def _inertia_torque(motion: BodyMotion) -> Array:
    """Matrix D of I alpha + w × I w = D [I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], shape (3, 6, N)."""
    x, y, z = motion.w
    a, b, c = motion.alpha
    xy, yz, zx = x * y, y * z, z * x
    M = motion.M
    D = np.empty((3, 6, len(x)))
    D[0] = a, b - zx, -yz, c + xy, M[1, 1] - M[2, 2], yz
    D[1] = zx, a + yz, b, M[2, 2] - M[0, 0], c - xy, -zx
    D[2] = -xy, M[0, 0] - M[1, 1], xy, a - yz, b + zx, c
    return D


def typical_mass(bodies: Sequence[Body]) -> float:
    """Median mass of the bodies that have one, or 1 [kg]."""
    masses = [body.pi[0] for body in bodies if body.pi[0] > 0]
    return float(np.median(masses)) if masses else 1.0


def typical_length(body: Body) -> float:
    """Size of a body's bounds, or the prior's radius of gyration, or 0.1 [m]."""
    if body.bounds:
        return max(bound.size for bound in body.bounds)
    mass, _, inertia = mass_com_inertia(body.pi)
    trace = np.trace(inertia)
    if mass > 0 and trace > 0:
        return float(np.sqrt(trace / (2 * mass)))
    return 0.1


def parameter_scales(body: Body, typical: float) -> Array:
    """Typical sizes of a body's parameters, shape (10,): mass, mass × length, mass × length².

    A mass far below the ``typical`` one [kg] may be a placeholder, and is raised to a tenth of it.
    """
    mass = max(body.pi[0], _MIN_MASS_SHARE * typical)
    return np.asarray(mass * typical_length(body) ** LENGTH_POWERS)

"""Rigid bodies, links and rotors alike: tau = Y(q, v, a) pi (6), (7)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices, Mask, mask_runs
from idtool.data.column_cache import IdentityKey
from idtool.data.signals import Motion
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Body
from idtool.robot.inertia import LENGTH_POWERS, PARAMETER_NAMES, PARAMETER_UNITS, PI_SIZE, mass_com_inertia, skew
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.kinematics import BodyMotion, body_motions, cross, iterate_jacobians
from idtool.robot.model import RobotModel

_BUFFER = 1 << 18  # numbers, 2 MiB: what fits in a processor's cache
_MIN_MASS_SHARE = 0.1  # of the bodies' median mass

RIGID_BODY = "rigid_body"  # effect of their coefficients


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
                coefficients.append(Coefficient(RIGID_BODY, body.name, name, unit, float(prior), float(scale)))
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
        for i, coordinates, columns in self._columns_by_body(motion):
            self._write(i, coordinates, columns, out)

    @override
    def filtered_columns(self, motion: Motion, low_pass: Callable[[Array], Array], out: Sequence[Array]) -> None:
        for i, coordinates, columns in self._columns_by_body(motion):
            self._write(i, coordinates, low_pass(columns), out)

    def _write(self, i: int, coordinates: Indices, columns: Array, out: Sequence[Array]) -> None:
        """Write the columns of body i, shape (k, 10, N), to those of the k joints that move it."""
        for joint, own in zip(coordinates, columns, strict=True):
            first = PI_SIZE * self._position[i, joint]
            out[joint][first : first + PI_SIZE] = own

    def _columns_by_body(self, motion: Motion) -> Iterator[tuple[int, Indices, Array]]:
        """Every body with the k joints that move it and its columns in their equations, shape (k, 10, N).

        The array is overwritten by the next body's columns: memory of all of them together would be many times a
        processor's cache.
        """
        motions = body_motions(self.model, motion.q, motion.v, motion.a)
        at_once = max(_BUFFER // (PI_SIZE * len(motion.t)), 1)
        buffer = np.empty((at_once, PI_SIZE, len(motion.t)))
        for i, jacobian in enumerate(iterate_jacobians(self.model, motions)):
            body, body_motion = self.model.bodies[i], motions[i]
            D = _inertia_torque(body_motion)
            for first in range(0, len(jacobian.coordinates), at_once):
                coordinates = jacobian.coordinates[first : first + at_once]
                columns = buffer[: len(coordinates)]
                is_along_axis = self._moves_along_axis_alone(i)[coordinates]
                for start, stop in mask_runs(~is_along_axis).tolist():
                    chosen = slice(first + start, first + stop)
                    S_w, S_v = jacobian.S_w[:, chosen], jacobian.S_v[:, chosen]
                    _write_columns(body_motion, S_w, S_v, D, columns[start:stop])
                for k in np.flatnonzero(is_along_axis):
                    _write_own_axis_columns(body, body_motion, D, body.ratios[coordinates[k]], columns[k])
                yield i, coordinates, columns

    def _moves_along_axis_alone(self, i: int) -> Mask:
        """True for joints that move body i along or about its own axis but not its parent, shape (nv,)."""
        body = self.model.bodies[i]
        if body.first_free_coordinate is not None:
            return np.zeros(self._support.shape[1], dtype=bool)
        parent = body.mount.body
        moves_parent = self._support[parent] if parent >= 0 else False
        return np.asarray(self._support[i] & ~np.asarray(moves_parent))

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
    """Write what `_write_columns` does, for a joint that moves the body along or about its own axis alone.

    What is zero is exactly zero.
    """
    axis = ratio * body.axis
    if body.prismatic:
        out[0] = axis @ motion.acc
        out[1:4] = np.tensordot(axis, motion.M, axes=1)
        out[4:] = 0
    else:
        out[0] = 0
        out[1:4] = skew(-axis) @ motion.acc
        out[4:] = np.tensordot(axis, D, axes=1)


def _write_columns(motion: BodyMotion, S_w: Array, S_v: Array, D: Array, out: Array) -> None:
    """Write a body's ten columns in k joints' equations: the power of the body's wrench in each joint's motion.

    With the body's wrench f = m acc + M h, n = h × acc + I alpha + w × I w (4), the power is S_v · f + S_w · n;
    collected by parameter.
    """
    np.einsum("ikn,in->kn", S_v, motion.acc, out=out[:, 0])
    np.einsum("ikn,ijn->kjn", S_v, motion.M, out=out[:, 1:4])
    out[:, 1:4] += cross(motion.acc[:, None], S_w).swapaxes(0, 1)
    np.einsum("ikn,ijn->kjn", S_w, D, out=out[:, 4:])


def _inertia_torque(motion: BodyMotion) -> Array:
    """Matrix D of I alpha + w × I w = D [I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], shape (3, 6, N)."""
    x, y, z = motion.w
    a, b, c = motion.alpha
    xy, yz, zx = x * y, y * z, z * x
    M = motion.M
    D = np.empty((3, 6, len(x)))
    np.stack((a, b - zx, -yz, c + xy, M[1, 1] - M[2, 2], yz), out=D[0])
    np.stack((zx, a + yz, b, M[2, 2] - M[0, 0], c - xy, -zx), out=D[1])
    np.stack((-xy, M[0, 0] - M[1, 1], xy, a - yz, b + zx, c), out=D[2])
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

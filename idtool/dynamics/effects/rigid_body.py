"""Rigid bodies, links and rotors alike: tau = Y(q, v, a) pi (6), (7)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices, Mask, mask_runs
from idtool.common.dataclass import dataclass
from idtool.data.column_cache import IdentityKey
from idtool.data.signals import Motion
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Body
from idtool.robot.inertia import LENGTH_POWERS, PARAMETER_NAMES, PARAMETER_UNITS, PI_SIZE, mass_com_inertia
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.kinematics import BodyMotion, body_motions, iterate_jacobians
from idtool.robot.model import RobotModel

_BUFFER = 1 << 18  # numbers, 2 MiB: what fits in a processor's cache
_MIN_MASS_SHARE = 0.1  # of the bodies' median mass

RIGID_BODY = "rigid_body"  # effect of their coefficients


@dataclass(frozen=True)
class ParameterSubset:
    """Some of the parameters of a body.

    Attributes
    ----------
    has_mass
        True if the mass is one of them.
    moments
        Indices of those of the three first moments h.
    inertias
        Indices of those of the six moments and products of inertia.
    """

    has_mass: bool = True
    moments: range = range(3)
    inertias: range = range(6)

    @property
    def indices(self) -> Indices:
        """Their indices among the ten parameters, ascending."""
        mass = np.arange(1 if self.has_mass else 0)
        moments = 1 + np.array(self.moments, dtype=np.intp)
        inertias = 4 + np.array(self.inertias, dtype=np.intp)
        return np.concatenate([mass, moments, inertias])


ALL_PARAMETERS = ParameterSubset()


class RigidBodies(Effect):
    """All bodies of a model, in the model's order, with ten coefficients each or some of these.

    Attributes
    ----------
    is_complete
        True if all parameters have coefficients.

    Parameters
    ----------
    model
        The tree of bodies.
    subsets
        Parameters of each body that have coefficients, while the others are 0; None: all have.
    """

    def __init__(self, model: RobotModel, subsets: Sequence[ParameterSubset] | None = None) -> None:
        self.model = model
        self._subsets = [ALL_PARAMETERS] * len(model.bodies) if subsets is None else list(subsets)
        self.is_complete = subsets is None
        typical = typical_mass(model.bodies)
        coefficients: list[Coefficient] = []
        coefficient_indices = []  # by body
        for body, subset in zip(model.bodies, self._subsets, strict=True):
            scales = parameter_scales(body, typical)
            indices = subset.indices
            coefficient_indices.append(len(coefficients) + np.arange(len(indices)))
            for k in indices.tolist():
                name, unit = PARAMETER_NAMES[k], PARAMETER_UNITS[k]
                prior, scale = float(body.pi[k]), float(scales[k])
                coefficients.append(Coefficient(RIGID_BODY, body.name, name, unit, prior, scale))
        self.coefficients = tuple(coefficients)

        support = model.support()
        active = []
        for joint in range(support.shape[1]):
            bodies = np.flatnonzero(support[:, joint])
            active.append(np.concatenate([np.zeros(0, dtype=np.intp), *(coefficient_indices[i] for i in bodies)]))
        self.active = tuple(active)
        self._support = support
        # Number of columns of a joint before those of each body:
        counts = support * np.array([len(indices) for indices in coefficient_indices], dtype=np.intp)[:, None]
        self._first_column: Indices = np.cumsum(counts, axis=0) - counts

    @property
    @override
    def column_key(self) -> Hashable:
        return "rigid_bodies", IdentityKey(self.model), tuple(self._subsets)

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        for i, coordinates, columns in self._columns_by_body(motion):
            self._write(i, coordinates, columns, out)

    @override
    def filtered_columns(self, motion: Motion, low_pass: Callable[[Array], Array], out: Sequence[Array]) -> None:
        for i, coordinates, columns in self._columns_by_body(motion):
            self._write(i, coordinates, low_pass(columns), out)

    def _write(self, i: int, coordinates: Indices, columns: Array, out: Sequence[Array]) -> None:
        """Write the m columns of body i, shape (k, m, N), to those of the k joints that move it."""
        for joint, own in zip(coordinates, columns, strict=True):
            first = self._first_column[i, joint]
            out[joint][first : first + len(own)] = own

    def _columns_by_body(self, motion: Motion) -> Iterator[tuple[int, Indices, Array]]:
        """Every body with the k joints that move it and its m columns in their equations, shape (k, m, N).

        The array is overwritten by the next body's columns: memory of all of them together would be many times a
        processor's cache.
        """
        motions = body_motions(self.model, motion.q, motion.v, motion.a)
        at_once = max(_BUFFER // (PI_SIZE * len(motion.t)), 1)
        buffer = np.empty((at_once, PI_SIZE, len(motion.t)))
        for i, jacobian in enumerate(iterate_jacobians(self.model, motions)):
            body, body_motion, subset = self.model.bodies[i], motions[i], self._subsets[i]
            count = len(subset.indices)
            D = _inertia_torque(body_motion, subset.inertias)
            for first in range(0, len(jacobian.coordinates), at_once):
                coordinates = jacobian.coordinates[first : first + at_once]
                columns = buffer[: len(coordinates), :count]
                is_along_axis = self._moves_along_axis_alone(i)[coordinates]
                for start, stop in mask_runs(~is_along_axis).tolist():
                    chosen = slice(first + start, first + stop)
                    S_w, S_v = jacobian.S_w[:, chosen], jacobian.S_v[:, chosen]
                    _write_columns(body_motion, S_w, S_v, D, subset, columns[start:stop])
                for k in np.flatnonzero(is_along_axis):
                    _write_own_axis_columns(body, body_motion, D, body.ratios[coordinates[k]], subset, columns[k])
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
        return inverse_dynamics(self.model, self._parameters(theta), motion.q, motion.v, motion.a)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.pi += self._parameters(theta)
        mechanism.gravity = self.model.gravity

    def _parameters(self, theta: Array) -> Array:
        """Parameters of all bodies, shape (bodies, 10); 0 where there is no coefficient."""
        if self.is_complete:
            return theta.reshape(-1, PI_SIZE)
        parameters = np.zeros((len(self._subsets), PI_SIZE))
        rest = theta
        for own, subset in zip(parameters, self._subsets, strict=True):
            indices = subset.indices
            own[indices] = rest[: len(indices)]
            rest = rest[len(indices) :]
        return parameters


def _write_own_axis_columns(
    body: Body, motion: BodyMotion, D: Array, ratio: float, subset: ParameterSubset, out: Array
) -> None:
    """Write what `_write_columns` does, for a joint that moves the body along or about its own axis alone.

    What is zero is exactly zero.
    """
    axis = ratio * body.axis
    mass, moments, inertias = _parts(subset, out)
    if body.prismatic:
        mass[:] = axis @ motion.acc
        moments[:] = _combined(axis, motion.M[:, _as_slice(subset.moments)])
        inertias[:] = 0
    else:
        mass[:] = 0
        for row, i in zip(moments, subset.moments, strict=True):
            j, k = (i + 1) % 3, (i + 2) % 3
            row[:] = _combined(np.array([axis[k], -axis[j]]), motion.acc[[j, k]])
        inertias[:] = _combined(axis, D)


def _combined(factors: Array, x: Array) -> Array:
    """Linear combination of arrays, shape (m, ..., N) to (..., N).

    Factors are often 0; their arrays are skipped.
    """
    total = np.zeros(x.shape[1:])
    for i in np.flatnonzero(factors):
        total += factors[i] * x[i]
    return total


def _write_columns(motion: BodyMotion, S_w: Array, S_v: Array, D: Array, subset: ParameterSubset, out: Array) -> None:
    """Write a body's m columns in k joints' equations, (k, m, N): the power of its wrench in each joint's motion.

    With the body's wrench f = m acc + M h, n = h × acc + I alpha + w × I w (4), the power is S_v · f + S_w · n;
    collected by parameter.
    """
    mass, moments, inertias = _parts(subset, out.swapaxes(0, 1))
    if subset.has_mass:
        np.einsum("ikn,in->kn", S_v, motion.acc, out=mass[0])
    np.einsum("ikn,ijn->jkn", S_v, motion.M[:, _as_slice(subset.moments)], out=moments)
    for column, i in zip(moments, subset.moments, strict=True):
        j, k = (i + 1) % 3, (i + 2) % 3
        column += motion.acc[j] * S_w[k]
        column -= motion.acc[k] * S_w[j]
    np.einsum("ikn,ijn->jkn", S_w, D, out=inertias)


def _as_slice(indices: range) -> slice:
    """The slice of the same indices, which takes a view of an array."""
    return slice(indices.start, indices.stop, indices.step)


def _parts(subset: ParameterSubset, columns: Array) -> tuple[Array, Array, Array]:
    """The m columns of a body, shape (m, ...): of its mass, of its first moments, and of its inertia."""
    first_moment = int(subset.has_mass)
    first_inertia = first_moment + len(subset.moments)
    return columns[:first_moment], columns[first_moment:first_inertia], columns[first_inertia:]


def _inertia_torque(motion: BodyMotion, inertias: range) -> Array:
    """Matrix D of I alpha + w × I w = D [I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], shape (3, 6, N), or some of its columns.

    Parameters
    ----------
    motion
        The body's motion.
    inertias
        Indices of the columns.
    """
    x, y, z = motion.w
    a, b, c = motion.alpha
    xy, yz, zx = x * y, y * z, z * x
    M = motion.M
    columns: tuple[Callable[[], tuple[Array, Array, Array]], ...] = (
        lambda: (a, zx, -xy),
        lambda: (b - zx, a + yz, M[0, 0] - M[1, 1]),
        lambda: (-yz, b, xy),
        lambda: (c + xy, M[2, 2] - M[0, 0], a - yz),
        lambda: (M[1, 1] - M[2, 2], c - xy, b + zx),
        lambda: (yz, -zx, c),
    )
    D = np.empty((3, len(inertias), len(x)))
    for i, column in enumerate(inertias):
        for row, entries in zip(D, columns[column](), strict=True):
            row[i] = entries
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

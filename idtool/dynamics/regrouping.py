"""`regrouped`: the torque equation without the columns of bodies that depend linearly on others, whatever the motion.

A massless rod along a joint's axis moves alike whether it belongs to the joint's body or to the one that carries it;
so does, on a prismatic joint, any inertia without mass. Its columns in both bodies are therefore equal:

    Y_body n = Y_carrier X n,

n the rod's parameters and X their transform to the carrier's frame. This makes some columns of the body combinations of
its others and of the carrier's: three of a revolute joint's ten, six of a prismatic one's. On a carrier that stands
still, columns of zero and multiples of one another come on top (Gautier & Khalil, Direct calculation of minimum set of
inertial parameters of serial robots, 1990). The other columns are kept, and with the parameters of rods regrouped with
those of their carriers

    Y theta = Y_kept beta

exactly. An R-factor of [Y_kept, tau] therefore holds all that one of [Y, tau] does, for less work: columns that are not
kept need not be evaluated, filtered and decomposed.

Letters: p coefficients theta; r of them kept, with the regrouped values beta; of joint j, m_j and r_j.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.dynamics.effects.effect import Effect
from idtool.dynamics.effects.rigid_body import ALL_PARAMETERS, ParameterSubset, RigidBodies
from idtool.dynamics.regressor import LinearModel
from idtool.robot.body import Body
from idtool.robot.inertia import PI_SIZE, parameter_transform, symmetric_entries, symmetric_matrix

_INERTIAS = slice(4, PI_SIZE)  # of a body's parameters
_DIAGONAL = (0, 2, 5)  # of I_xx, I_yy, I_zz among the six of an inertia


@dataclass(frozen=True)
class RegroupedBody:
    """Columns of one body that depend on its others and on those of its carrier.

    Attributes
    ----------
    kept, dependent
        Indices of its parameters whose columns are kept, shape (k,), and of the others, shape (d,).
    carrier
        Index of the body that carries it; −1: it stands still, and has no columns.
    of_kept, of_carrier
        The dependent columns as combinations of those kept, shape (k, d), and of the carrier's, shape (10, d).
    """

    kept: Indices
    dependent: Indices
    carrier: int
    of_kept: Array
    of_carrier: Array


@dataclass(frozen=True)
class RegroupedModel:
    """A torque equation without dependent columns of bodies.

    Attributes
    ----------
    equation
        The equation of the columns that are kept, with the coefficients beta.
    complete
        The equation with all columns.
    bodies
        Its bodies, in their order; none: all columns are kept.
    """

    equation: LinearModel
    complete: LinearModel
    bodies: tuple[RegroupedBody, ...]

    def all_columns(self, joint: int, kept: Array) -> Array:
        """All columns of a joint from those that are kept.

        Parameters
        ----------
        joint
            Index of the joint.
        kept
            Rows of the columns that are kept and of further ones, such as the torque, shape (..., r_j + n).

        Returns
        -------
        Shape (..., m_j + n).
        """
        if not self.bodies:
            return kept
        active = self.complete.active()[joint]
        is_body = active < PI_SIZE * len(self.bodies)
        own_bodies = np.unique(active[is_body] // PI_SIZE).tolist()
        columns = np.empty((*kept.shape[:-1], PI_SIZE * len(own_bodies)))
        by_body: dict[int, Array] = {}
        first = 0
        for position, i in enumerate(own_bodies):
            body = self.bodies[i]
            own = columns[..., PI_SIZE * position : PI_SIZE * (position + 1)]
            own_kept = kept[..., first : first + len(body.kept)]
            own[..., body.kept] = own_kept
            dependent = own_kept @ body.of_kept
            if body.carrier in by_body:
                dependent += by_body[body.carrier] @ body.of_carrier
            own[..., body.dependent] = dependent
            by_body[i] = own
            first += len(body.kept)
        return np.concatenate([columns, kept[..., first:]], axis=-1)

    def regrouped_values(self, theta: Array) -> Array:
        """Coefficients beta of the columns that are kept, shape (r,), from those of all columns, shape (p,)."""
        if not self.bodies:
            return theta
        count = PI_SIZE * len(self.bodies)
        by_body = theta[:count].reshape(-1, PI_SIZE).copy()
        values = [theta[count:]]
        for own, body in zip(by_body[::-1], self.bodies[::-1], strict=True):  # before what carries it
            dependent = own[body.dependent]
            values.append(own[body.kept] + body.of_kept @ dependent)
            if body.carrier >= 0:
                by_body[body.carrier] += body.of_carrier @ dependent
        return np.concatenate(values[::-1])


def regrouped(equation: LinearModel) -> RegroupedModel:
    """The equation without the dependent columns of its bodies; with all of them if columns depend on coefficients."""
    bodies, *others = equation.effects
    is_identified = equation.known_bodies is None
    if equation.depends_on_parameters or not is_identified or not isinstance(bodies, RigidBodies):
        return RegroupedModel(equation, equation, ())
    model = bodies.model
    subsets = [_independent_parameters(body) for body in model.bodies]
    effects: list[Effect] = [RigidBodies(model, subsets), *others]
    steps = tuple(_regrouped_body(body, subset) for body, subset in zip(model.bodies, subsets, strict=True))
    return RegroupedModel(replace(equation, effects=tuple(effects)), equation, steps)


def _regrouped_body(body: Body, subset: ParameterSubset) -> RegroupedBody:
    """A body's dependent columns, if those of a subset of its parameters are kept."""
    kept = subset.indices
    dependent = np.setdiff1d(np.arange(PI_SIZE), kept)
    basis = _parameters_of_carrier(body)
    rods = basis @ np.linalg.inv(basis[dependent])  # each has one of the dependent parameters, which is 1
    in_carrier = parameter_transform(body.mount.R, body.mount.p) @ rods
    return RegroupedBody(kept, dependent, body.mount.body, -rods[kept], in_carrier)


def _independent_parameters(body: Body) -> ParameterSubset:
    """Parameters of a body whose columns are kept; the others are those that the rod has most of."""
    if body.first_free_coordinate is not None:
        return ALL_PARAMETERS
    is_grounded = body.mount.body < 0
    if body.prismatic:
        return ParameterSubset(moments=range(0 if is_grounded else 3), inertias=range(0))
    x, y, z = np.abs(body.axis).tolist()
    moments = (range(1, 3), range(0, 3, 2), range(2))[int(np.argmax([x, y, z]))]
    if is_grounded:  # only the inertia about the axis matters
        largest = _DIAGONAL[int(np.argmax([x, y, z]))]
        inertias = range(largest, largest + 1)
    else:
        inertias = range(1, 6) if x <= z else range(5)
    return ParameterSubset(False, moments, inertias)


def _parameters_of_carrier(body: Body) -> Array:
    """Basis of the parameters that act alike on the body and on its carrier, shape (10, d)."""
    if body.first_free_coordinate is not None:
        return np.zeros((PI_SIZE, 0))
    if body.prismatic:
        pure_inertias = np.eye(PI_SIZE)[:, _INERTIAS]
        if body.mount.body >= 0:
            return pure_inertias
        return np.eye(PI_SIZE)[:, 1:]
    mass = np.eye(PI_SIZE)[:, :1]
    moment = np.zeros((PI_SIZE, 1))
    moment[1:4, 0] = body.axis
    if body.mount.body < 0:
        return np.concatenate([mass, moment, _without_inertia_about(body.axis)], axis=1)
    inertia = np.zeros((PI_SIZE, 1))
    inertia[_INERTIAS, 0] = symmetric_entries(np.eye(3) - np.outer(body.axis, body.axis))
    return np.concatenate([mass, moment, inertia], axis=1)


def _without_inertia_about(axis: Array) -> Array:
    """Basis of the inertias whose moment about an axis is zero, shape (10, 5)."""
    about_axis = np.array([axis @ symmetric_matrix(unit) @ axis for unit in np.eye(6)])  # (6,)
    largest = _DIAGONAL[int(np.argmax(np.abs(axis)))]
    others = np.delete(np.arange(6), largest)
    basis = np.zeros((PI_SIZE, 5))
    basis[4 + others, np.arange(5)] = 1.0
    basis[4 + largest] = -about_axis[others] / about_axis[largest]
    return basis

"""`regrouped`: the torque equation without columns of bodies that depend on others, whatever the motion.

Take an infinitely thin rod along the axis of a revolute joint. Its motion is the same whether it belongs to the joint's
body or to the carrier, the body before the joint. On a prismatic joint, this is true of any inertia whose mass and
first moments are zero. The columns are therefore equal:

    Y_body n = Y_carrier X n,

n the rod's parameters and X their transform to the carrier's frame. This makes some columns of the body combinations of
its others and of the carrier's: three of a revolute joint's ten, six of a prismatic one's. If the carrier stands still,
further columns are zero or multiples of others (Gautier & Khalil, Direct calculation of minimum set of inertial
parameters of serial robots, 1990). These columns are left out. Special geometries, such as parallel axes, make more
columns dependent; those are kept. With the parameters of rods regrouped with those of their carriers,

    Y theta = Y_kept beta

exactly. An R-factor of [Y_kept, tau] therefore holds all that one of [Y, tau] does, for less work: columns that are not
kept need not be evaluated, filtered and decomposed.

Letters: p coefficients theta; r of them kept, with the regrouped values beta; of joint j, m_j and r_j.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.dynamics.effects.effect import Effect
from idtool.dynamics.effects.rigid_body import ALL_PARAMETERS, ParameterSubset, RigidBodies
from idtool.dynamics.regressor import LinearModel
from idtool.robot.body import Body
from idtool.robot.inertia import PI_SIZE, parameter_transform, symmetric_entries, symmetric_matrix

_INERTIAS = slice(4, PI_SIZE)  # of a body's parameters
_DIAGONAL = (0, 2, 5)  # indices of I_xx, I_yy, I_zz among the six of an inertia
_WITHOUT_XX, _WITHOUT_ZZ = range(1, 6), range(5)  # indices among these six
_MOMENTS_WITHOUT = (range(1, 3), range(0, 3, 2), range(2))  # indices of the first moments but that along x, y or z


@dataclass(frozen=True)
class RegroupedBody:
    """Columns of one body that depend on its others and on those of its carrier.

    Attributes
    ----------
    kept, dependent
        Indices of its parameters whose columns are kept, shape (k,), and of the others, shape (d,).
    carrier
        Index of the body that carries it, which comes before it; −1: that stands still, and has no columns.
    kept_combinations, carrier_combinations
        Factors of the kept columns, shape (k, d), and of the carrier's ten, shape (10, d). The dependent columns are
        the sum of both products.
    """

    kept: Indices
    dependent: Indices
    carrier: int
    kept_combinations: Array
    carrier_combinations: Array


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
        """All columns of a joint from those that are kept; of an R-factor, one with the same Gram matrix.

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
        is_of_body = active < PI_SIZE * len(self.bodies)
        body_indices = np.unique(active[is_of_body] // PI_SIZE).tolist()
        kept_of_bodies = sum(len(self.bodies[i].kept) for i in body_indices)
        further = kept[..., kept_of_bodies:]
        count = PI_SIZE * len(body_indices)
        columns = np.empty((*kept.shape[:-1], count + further.shape[-1]))
        columns[..., count:] = further
        columns_by_body: dict[int, Array] = {}
        first_kept = 0
        for position, i in enumerate(body_indices):
            body = self.bodies[i]
            own_kept = kept[..., first_kept : first_kept + len(body.kept)]
            dependent = own_kept @ body.kept_combinations
            if body.carrier in columns_by_body:
                dependent += columns_by_body[body.carrier] @ body.carrier_combinations
            own_columns = columns[..., PI_SIZE * position : PI_SIZE * (position + 1)]
            own_columns[..., body.kept] = own_kept
            own_columns[..., body.dependent] = dependent
            columns_by_body[i] = own_columns
            first_kept += len(body.kept)
        return columns

    def regrouped_values(self, theta: Array) -> Array:
        """Coefficients beta of the columns that are kept, shape (r,), from those of all columns, shape (p,)."""
        if not self.bodies:
            return theta
        count = PI_SIZE * len(self.bodies)
        parameters = theta[:count].reshape(-1, PI_SIZE).copy()
        values = [theta[count:]]
        for i in reversed(range(len(self.bodies))):  # a body before what carries it
            body, own = self.bodies[i], parameters[i]
            moved = own[body.dependent]
            values.append(own[body.kept] + body.kept_combinations @ moved)
            if body.carrier >= 0:
                parameters[body.carrier] += body.carrier_combinations @ moved
        return np.concatenate(values[::-1])


def regrouped(equation: LinearModel) -> RegroupedModel:
    """The equation without dependent columns of its bodies.

    All columns are kept if the inertias are not identified, are known, or have only some of their parameters as
    unknowns, and if columns depend on the coefficients.
    """
    rigid_bodies, *others = equation.effects
    if not isinstance(rigid_bodies, RigidBodies) or not rigid_bodies.is_complete:
        return not_regrouped(equation)
    if equation.depends_on_parameters or equation.known_bodies is not None:
        return not_regrouped(equation)
    model = rigid_bodies.model
    subsets = [_kept_parameters(body) for body in model.bodies]
    effects: list[Effect] = [RigidBodies(model, subsets), *others]
    bodies = tuple(_regrouped_body(body, subset) for body, subset in zip(model.bodies, subsets, strict=True))
    return RegroupedModel(replace(equation, effects=tuple(effects)), equation, bodies)


def not_regrouped(equation: LinearModel) -> RegroupedModel:
    """The equation with all columns kept."""
    return RegroupedModel(equation, equation, ())


def _regrouped_body(body: Body, subset: ParameterSubset) -> RegroupedBody:
    """A body's dependent columns, if those of a subset of its parameters are kept."""
    kept = subset.indices
    dependent = np.setdiff1d(np.arange(PI_SIZE), kept)
    basis = _transferable_parameters(body)
    unit_basis = basis @ np.linalg.inv(basis[dependent])  # each vector has one dependent parameter, which is 1
    to_carrier = parameter_transform(body.mount.R, body.mount.p)
    return RegroupedBody(
        kept=kept,
        dependent=dependent,
        carrier=body.mount.body,
        kept_combinations=-unit_basis[kept],
        carrier_combinations=to_carrier @ unit_basis,
    )


def _kept_parameters(body: Body) -> ParameterSubset:
    """Parameters of a body whose columns are kept.

    As many are left out as are transferable to the carrier: those in which the rod, along the axis, is large.
    """
    if body.first_free_coordinate is not None:
        return ALL_PARAMETERS
    is_grounded = body.mount.body < 0
    if body.prismatic:
        return ParameterSubset(moments=range(0 if is_grounded else 3), inertias=range(0))
    x, _, z = np.abs(body.axis)
    largest = int(np.argmax(np.abs(body.axis)))
    moments = _MOMENTS_WITHOUT[largest]
    if is_grounded:  # only the inertia about the axis matters
        inertias = range(_DIAGONAL[largest], _DIAGONAL[largest] + 1)
    else:
        inertias = _WITHOUT_XX if x <= z else _WITHOUT_ZZ
    return ParameterSubset(False, moments, inertias)


def _transferable_parameters(body: Body) -> Array:
    """Basis of the parameters that act alike on the body and on its carrier, in the body's frame, shape (10, d)."""
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
    free_entries = np.delete(np.arange(6), largest)
    basis = np.zeros((PI_SIZE, 5))
    basis[4 + free_entries, np.arange(5)] = 1.0
    basis[4 + largest] = -about_axis[free_entries] / about_axis[largest]
    return basis

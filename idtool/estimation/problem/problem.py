"""The optimization problem (27) on R-factors, in units in which all unknowns are of order one.

    min over theta of f(theta) = (1/n) Σ_j ‖Y_j theta − tau_j‖² / sigma_j² + w Σ_bodies d(pi, pî)

subject to every body's inequalities, the coefficients' bounds and exact constraints. d is the prior's distance, of
least squares or the log-det divergence. With theta = K (scale · z), z the coefficients that are no copies of others,
f = ‖A z − b‖² + Σ log-dets + constant, and A is triangular with p' rows whatever the log's length. A body is the sum of
its pieces (Cor. 2): z = S x.

Letters: p coefficients theta, p' of them free, z; m solver variables x; A (p', p'), b (p',); sigma_j noise of joint j's
torque [N·m or N].
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import svd
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows
from idtool.estimation.problem.prior import LogDet, log_dets, prior_rows
from idtool.estimation.problem.variables import INTERIOR, ConicInequality, PieceVariables, piece_variables
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets import ConstraintSet

_LEAST_WEIGHT = 1e-8  # of the prior: where neither data nor regularization hold them, coefficients stay there
_AGREEMENT = 1e-6  # of exact constraints that follow from each other
_RANK = 1e-9  # of the largest singular value: constraints below it follow from the others


@dataclass(frozen=True)
class Problem:
    """The optimization problem, apart from how it is solved.

    Attributes
    ----------
    A, b, constant
        The quadratic part of f is ‖A z − b‖² + constant; shapes (p', p'), of full rank, and (p',).
    scale
        Units of z, shape (p',).
    K
        theta = K (scale · z), shape (p, p').
    pieces
        The bodies' pieces in the order of x; then come the other coefficients.
    body_names
        Name of every body.
    other_coefficients
        Indices in z of the coefficients that are no inertia parameters.
    lower
        Their lower bounds, in units of ``scale``.
    E, e
        Exact constraints: E z = e, rows of norm one; shapes (k, p') and (k,).
    log_dets
        The part of f that is not quadratic.
    equality_labels
        Places of the exact constraints in the configuration.
    interior
        How far inside its set a body is kept, in units of its own mass and size.
    """

    A: Array
    b: Array
    constant: float
    scale: Array
    K: Array
    pieces: tuple[PieceVariables, ...]
    body_names: tuple[str, ...]
    other_coefficients: Indices
    lower: Array
    E: Array
    e: Array
    log_dets: tuple[LogDet, ...] = ()
    equality_labels: tuple[str, ...] = ()
    interior: float = INTERIOR

    @cached_property
    def inequalities(self) -> tuple[ConicInequality, ...]:
        """All inequalities of the bodies on x."""
        inequalities = []
        for variables in self.pieces:
            for inequality in variables.piece.inequalities:
                inequalities.append(
                    ConicInequality(
                        first=variables.start,
                        G=inequality.scaled(variables.length, variables.piece.powers),
                        label=f"{self.body_names[variables.body]}: {inequality.label}",
                        interior=self.interior if inequality.strict else 0.0,
                    )
                )
        return tuple(inequalities)

    @property
    def variables(self) -> int:
        """Number of variables x, m."""
        return self._first_other + len(self.other_coefficients)

    @property
    def _first_other(self) -> int:
        """Index in x of the first coefficient that is no inertia parameter."""
        return self.pieces[-1].stop if self.pieces else 0

    @property
    def bounded(self) -> Indices:
        """Indices in x of the coefficients that have a lower bound."""
        return self._first_other + np.flatnonzero(np.isfinite(self.lower))

    @property
    def bounds(self) -> Array:
        """Lower bounds of the `bounded` coefficients."""
        return self.lower[np.isfinite(self.lower)]

    @cached_property
    def S(self) -> Array:  # noqa: N802
        """Sum of pieces: z = S x, shape (p', m)."""
        S = np.zeros((len(self.scale), self.variables))
        for piece in self.pieces:
            S[piece.z_slice, piece.x_slice] = piece.basis
        S[self.other_coefficients, self._first_other + np.arange(len(self.other_coefficients))] = 1
        return S

    def theta(self, z: Array) -> Array:
        """All coefficients, copies included, shape (p,), SI."""
        return np.asarray(self.K @ (self.scale * z))

    def piece_parameters(self, x: Array) -> list[tuple[int, Array]]:
        """Body index and parameters, shape (10,), SI, of every piece; of copies too."""
        parameters = []
        for body in range(len(self.body_names)):
            K = self.K[PI_SIZE * body : PI_SIZE * (body + 1)]
            first = int(np.flatnonzero(K.any(axis=0))[0])
            for piece in self.pieces:
                if piece.first == first:
                    z = self.scale[piece.z_slice] * (piece.basis @ x[piece.x_slice])
                    parameters.append((body, K[:, piece.z_slice] @ z))
        return parameters

    def cost(self, z: Array) -> float:
        """The objective f."""
        quadratic = float(np.square(self.A @ z - self.b).sum()) + self.constant
        return quadratic + sum(term.value(z) for term in self.log_dets)


def build_problem(
    model: LinearModel,
    bodies: Sequence[Body],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    noise: Array,
    equalities: EqualityConstraints | None = None,
    data: Array | None = None,
) -> Problem:
    """State (27) on R-factors.

    Parameters
    ----------
    model
        The torque equation; its first coefficients are the bodies' parameters.
    bodies
        The bodies.
    reduction
        The data.
    sets
        One set per body.
    regularization
        The prior's kind and weight.
    noise
        sigma, shape (nv,).
    equalities
        The equality constraints; default: none.
    data
        The `weighted_rows`, if they are known.

    Raises
    ------
    ConfigError
        If exact constraints contradict each other.
    """
    p = len(model.coefficients)
    equalities = equalities or EqualityConstraints.none(p)
    data = weighted_rows(model, reduction, noise) if data is None else data
    units = _units(model, data)
    soft = _soft_rows(equalities, reduction, p)
    prior = prior_rows(model, bodies, regularization, units)
    least = np.sqrt(_LEAST_WEIGHT) / units
    anchor = np.column_stack([np.diag(least), least * model.prior])
    rows = np.concatenate([data, soft, prior, anchor])

    scale = units[equalities.free]
    q = len(scale)
    R = np.asarray(np.linalg.qr(np.column_stack([rows[:, :p] @ equalities.K * scale, rows[:, p]]), mode="r"))
    others = np.flatnonzero(equalities.free >= PI_SIZE * len(bodies))
    lower = np.array([model.coefficients[equalities.free[i]].lower for i in others]) / scale[others]
    E, e = _exact_equations(equalities, scale)
    return Problem(
        A=R[:q, :q],
        b=R[:q, q],
        constant=float(np.square(R[q:, q]).sum()),
        scale=scale,
        K=equalities.K,
        pieces=piece_variables(bodies, sets, equalities.free),
        body_names=tuple(body.name for body in bodies),
        other_coefficients=others,
        lower=lower,
        E=E,
        e=e,
        log_dets=log_dets(model, bodies, regularization, equalities, scale),
        equality_labels=tuple(dict.fromkeys(constraint.label for constraint in equalities.hard)),
    )


def _units(model: LinearModel, data: Array) -> Array:
    """Typical size of every coefficient, shape (p,): an inertia parameter's own, any other's by its effect."""
    has_scale = np.array([c.scale is not None for c in model.coefficients])
    factor = _placeholder_factor(data, np.where(has_scale, model.prior, 0.0))
    effect = np.linalg.norm(data[:, :-1], axis=0)
    units = []
    for c, size in zip(model.coefficients, effect, strict=True):
        if c.scale is not None:
            units.append(factor * c.scale)
        else:
            units.append(1 / (size or 1.0))
    return np.array(units)


def _placeholder_factor(rows: Array, prior: Array) -> float:
    """Ratio of the measured torque to that of the prior's bodies, at least 1.

    URDFs are often given with masses that only hold a place. Deviations from such a prior are no multiples of it.
    """
    measured, explained = np.linalg.norm(rows[:, -1]), np.linalg.norm(rows[:, :-1] @ prior)
    return max(float(measured / explained), 1.0) if explained > 0 else 1.0


def _soft_rows(equalities: EqualityConstraints, reduction: Reduction, p: int) -> Array:
    """Measured constraints, weighted against samples that repeat each other; shape (measured, p + 1)."""
    independent = sum(factor.independent for factor in reduction) / len(reduction)
    return np.asarray(equalities.soft_rows().reshape(-1, p + 1) / np.sqrt(max(independent, 1.0)))


def _exact_equations(equalities: EqualityConstraints, scale: Array) -> tuple[Array, Array]:
    """E and e of the exact constraints E z = e, without those that follow from others; rows of norm one."""
    if not equalities.hard:
        return np.zeros((0, len(scale))), np.zeros(0)
    E = np.array([constraint.row for constraint in equalities.hard]) @ equalities.K * scale
    e = np.array([constraint.value for constraint in equalities.hard])
    size = np.linalg.norm(E, axis=1)
    E, e = E / size[:, None], e / size
    U, s, Vt = svd(E)
    is_independent = s > _RANK * s[0]
    rows = Vt[is_independent]
    values = (U.T @ e)[is_independent] / s[is_independent]
    deviation = np.abs(E @ rows.T @ values - e)
    if deviation.max() > _AGREEMENT * max(np.abs(e).max(), 1.0):
        worst = equalities.hard[int(np.argmax(deviation))].label
        raise ConfigError(worst, "contradicts another exactly known value; give one of them a standard_error")
    return rows, values

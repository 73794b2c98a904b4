"""The optimization problem (27) on R-factors, in units in which all unknowns are of order one.

    min over theta of f(theta) = (1/n) Σ_j ‖Y_j theta − tau_j‖² / sigma_j² + w Σ_bodies d(pi, pî)

subject to every body's inequalities, the coefficients' bounds and what is known exactly. d is the prior's distance, of
least squares or the log-det divergence. With theta = K (scale · z), z the coefficients that are no copies of others,
f = ‖A z − b‖² + Σ log-dets + constant, and A is triangular with p' rows whatever the log's length. A body is the sum of
its pieces (Cor. 2): z = S x.

Letters: p coefficients theta, p' of them free, z; m solver variables x; A (p', p'), b (p',); sigma_j noise of joint j's
torque [N·m or N].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import svd
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows
from idtool.estimation.problem.parts import INTERIOR, Matrix, Part, parts_of
from idtool.estimation.problem.prior import LogDet, log_dets, prior_rows
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.inertia import SIZE
from idtool.robot.sets import ConstraintSet

_LEAST_WEIGHT = 1e-8  # of the prior: where neither data nor regularization say anything, coefficients stay there
_AGREE = 1e-6  # of exact facts that say the same
_RANK = 1e-9  # of the largest singular value: facts that say less than that beyond the others say nothing


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
    parts
        The bodies' pieces in the order of x; then come the other coefficients.
    labels
        Name of every body.
    others
        Indices in z of the coefficients that are no inertia parameters.
    lower
        Their lower bounds, in units of ``scale``.
    E, e
        What is known exactly: E z = e, rows of norm one; shapes (k, p') and (k,).
    facts
        Where that stands in the configuration.
    log_dets
        The part of f that is not quadratic.
    interior
        How far inside its set a body is kept, in units of its own mass and size.
    """

    A: Array
    b: Array
    constant: float
    scale: Array
    K: Array
    parts: tuple[Part, ...]
    labels: tuple[str, ...]
    others: Indices
    lower: Array
    E: Array
    e: Array
    log_dets: tuple[LogDet, ...] = ()
    facts: tuple[str, ...] = ()
    interior: float = INTERIOR

    @cached_property
    def inequalities(self) -> tuple[Matrix, ...]:
        """All matrix inequalities on x."""
        return tuple(
            Matrix(
                part.start,
                inequality.scaled(part.length, part.piece.powers),
                f"{self.labels[part.body]}: {inequality.label}",
                self.interior if inequality.strict else 0.0,
            )
            for part in self.parts
            for inequality in part.piece.inequalities
        )

    @property
    def variables(self) -> int:
        """How many x there are, m."""
        return self._split + len(self.others)

    @property
    def _split(self) -> int:
        return self.parts[-1].stop if self.parts else 0

    @property
    def bounded(self) -> Indices:
        """Indices in x of the coefficients that have a lower bound."""
        return self._split + np.flatnonzero(np.isfinite(self.lower))

    @property
    def bounds(self) -> Array:
        """Their lower bounds."""
        return self.lower[np.isfinite(self.lower)]

    @cached_property
    def S(self) -> Array:  # noqa: N802
        """Sum of pieces: z = S x, shape (p', m)."""
        S = np.zeros((len(self.scale), self.variables))
        for part in self.parts:
            S[part.first : part.first + SIZE, part.start : part.stop] = part.basis
        S[self.others, self._split + np.arange(len(self.others))] = 1
        return S

    def theta(self, z: Array) -> Array:
        """All coefficients, copies included, shape (p,), SI."""
        return np.asarray(self.K @ (self.scale * z))

    def pieces(self, x: Array) -> list[tuple[int, Array]]:
        """Body index and parameters, shape (10,), SI, of every piece; of copies too."""
        found = []
        for body in range(len(self.labels)):
            own = self.K[SIZE * body : SIZE * (body + 1)]
            first = int(np.flatnonzero(own.any(axis=0))[0])
            z = slice(first, first + SIZE)
            for part in (part for part in self.parts if part.first == first):
                found.append((body, own[:, z] @ (self.scale[z] * (part.basis @ x[part.start : part.stop]))))
        return found

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
    known: Knowledge | None = None,
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
        One set a body.
    regularization
        The prior's kind and weight.
    noise
        sigma, shape (nv,).
    known
        What is known otherwise; default: nothing.

    Raises
    ------
    ConfigError
        If what is known exactly contradicts itself.
    """
    p = len(model.coefficients)
    known = known or Knowledge.none(p)
    data = weighted_rows(model, reduction, noise)
    units = _units(model, data)
    rows = np.concatenate([data, _soft(known, reduction, p), prior_rows(model, bodies, regularization, units)])
    least = np.sqrt(_LEAST_WEIGHT) / units
    rows = np.concatenate([rows, np.column_stack([np.diag(least), least * model.prior])])
    scale = units[known.free]
    R = np.asarray(np.linalg.qr(np.column_stack([rows[:, :p] @ known.K * scale, rows[:, p]]), mode="r"))
    q = len(scale)
    parts = parts_of(bodies, sets, known.free)
    others = np.flatnonzero(known.free >= SIZE * len(bodies))
    lower = np.array([model.coefficients[known.free[i]].lower for i in others]) / scale[others]
    E, e = _equalities(known, scale)
    terms = log_dets(model, bodies, regularization, known, scale)
    constant = float(np.square(R[q:, q]).sum())
    names = tuple(body.name for body in bodies)
    facts = tuple(dict.fromkeys(fact.label for fact in known.hard))
    return Problem(R[:q, :q], R[:q, q], constant, scale, known.K, parts, names, others, lower, E, e, terms, facts)


def _units(model: LinearModel, data: Array) -> Array:
    """Typical size of every coefficient, shape (p,): an inertia parameter's own, any other's by what it does."""
    held = np.array([c.scale is not None for c in model.coefficients])
    size = np.linalg.norm(data[:, :-1], axis=0)
    grown = _placeholder_factor(data, np.where(held, model.prior, 0.0))
    return np.array(
        [
            grown * c.scale if c.scale is not None else 1 / (s or 1.0)
            for c, s in zip(model.coefficients, size, strict=True)
        ]
    )


def _placeholder_factor(rows: Array, prior: Array) -> float:
    """How much heavier than the prior the bodies are by the torque they take, at least 1.

    URDFs are often given with masses that only hold a place. Deviations from such a prior are no multiples of it.
    """
    measured, explained = np.linalg.norm(rows[:, -1]), np.linalg.norm(rows[:, :-1] @ prior)
    return max(float(measured / explained), 1.0) if explained > 0 else 1.0


def _soft(known: Knowledge, reduction: Reduction, p: int) -> Array:
    """What is known with a standard error, weighted against samples that repeat each other; shape (facts, p + 1)."""
    independent = sum(factor.independent for factor in reduction) / len(reduction)
    return np.asarray(known.soft_rows().reshape(-1, p + 1) / np.sqrt(max(independent, 1.0)))


def _equalities(known: Knowledge, scale: Array) -> tuple[Array, Array]:
    """The exact facts on z without those that follow from others; rows of norm one."""
    if not known.hard:
        return np.zeros((0, len(scale))), np.zeros(0)
    E = np.array([fact.row for fact in known.hard]) @ known.K * scale
    e = np.array([fact.value for fact in known.hard])
    size = np.linalg.norm(E, axis=1)
    E, e = E / size[:, None], e / size
    U, s, Vt = svd(E)
    seen = s > _RANK * s[0]
    rows, values = Vt[seen], (U.T @ e)[seen] / s[seen]
    wrong = np.abs(E @ rows.T @ values - e)
    if wrong.max() > _AGREE * max(np.abs(e).max(), 1.0):
        worst = known.hard[int(np.argmax(wrong))].label
        raise ConfigError(worst, "contradicts what else is known exactly; give one of them a standard_error")
    return rows, values

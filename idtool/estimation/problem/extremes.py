"""Least values of many linear functions over all that the constraints allow at a cost up to a level.

The least c · x for every objective c, among all x with X_i(x) ⪰ 0, E S x = e and f(x) ≤ level, is approached from
inside, along a central path (Nesterov & Nemirovskii 1994; Boyd & Vandenberghe, Convex Optimization, chapter 11):

    x(kappa) = argmin of kappa c · x + phi(x),  phi(x) = −w log(level − f(x)) − Σ log det X_i(x).

The weight w grows with the number of rows of the inequalities. With w = 1, their barrier would outweigh that of the
level: paths would run close to the level, and steps would be short. All paths begin at the centre, where phi is least.
They are followed together: each step of Newton's method is taken for all objectives at once.

Near the end of a path, c · x(kappa) is about the least value + a / kappa with a constant a, so its derivative with
respect to kappa is −a / kappa². On the path, this derivative is −c · H⁻¹ c. Hence the gap a / kappa is about
kappa c · H⁻¹ c, which is subtracted.

Letters: D objectives c; m variables x; H (D, m, m) Hessian of phi; kappa the inverse of mu in `barrier`; A, S, E, e, f
as in `problem`, X_i as in `barrier`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import SolverError
from idtool.common.linear_algebra import null_space
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.inequality_groups import InequalityGroup, inequality_groups, log_det_groups
from idtool.estimation.problem.problem import Problem

_ACCURACY = 1e-3  # greatest gap at the end, relative to the decrease from the centre; most of it is then subtracted
# Greatest squared Newton decrement (Boyd & Vandenberghe, section 9.5) at which …
_CENTER_DECREMENT = 1e-3  # … a point counts as the centre
_GROWTH_DECREMENT = 0.3  # … kappa is increased
_FINAL_DECREMENT = 0.1  # … a path may end
_FIRST_KAPPA = 10.0  # times 1 / √(c · H⁻¹ c) at the centre
_KAPPA_FACTOR = 10.0
_ROWS_PER_WEIGHT = 8  # w is the number of rows of all X_i divided by this, and at least 1
_MAX_NEWTON_STEPS = 100
_BOUNDARY_FRACTION = 0.7  # greatest step relative to one to the boundary: near it, many would be needed to get away
_MAX_HALVINGS = 40
_MAX_SEARCH_STEPS = 25
_SEARCH_ACCURACY = 1e-2  # of a step's length
_CONSTANT_OBJECTIVE = (
    1e-9  # relative norm in the space that exact constraints leave, below which an objective is constant
)
_BATCH_ENTRIES = 2**20  # of the Hessians of objectives that are followed together


class LevelSet:
    """All that the constraints allow at a cost up to a level.

    Parameters
    ----------
    problem
        From `build_problem`.
    start
        Its optimum, shape (m,), whose cost is below the level.
    level
        Greatest cost f.

    Raises
    ------
    SolverError
        If the level is not above the optimum's cost, or no interior or no centre is found.
    """

    def __init__(self, problem: Problem, start: Array, level: float) -> None:
        self._groups = inequality_groups(problem)
        self._log_dets = log_det_groups(problem)
        self._S = problem.S
        self._AS, self._b = problem.A @ problem.S, problem.b
        self._linear_cost = np.zeros(problem.variables)
        self._reduced_level = level - problem.constant
        for term in problem.log_dets:
            self._linear_cost += problem.S[term.z_slice].T @ term.slope
            self._reduced_level -= term.offset
        self._quadratic_hessian = 2 * self._AS.T @ self._AS
        ES = problem.E @ problem.S
        self._null_basis = null_space(ES) if len(ES) else None
        self._weight = max(sum(group.rows for group in self._groups) / _ROWS_PER_WEIGHT, 1.0)
        try:
            self._center = self._find_center(self._strictly_inside(problem, start, level))
        except np.linalg.LinAlgError:  # a Hessian is singular to rounding
            raise SolverError("solver", "could not find the middle of what the data allow") from None

    @property
    def batch_size(self) -> int:
        """Number of objectives that are best followed together, for the memory that they take."""
        return max(_BATCH_ENTRIES // len(self._center) ** 2, 1)

    def least(self, objectives: Array, sufficient: Array) -> Array:
        """Least values of objective · z over the level set, z = S x.

        Estimates with an error of about 1e-4 of the decrease from the centre, of either sign. Where a path falls below
        ``sufficient``, it is left early: its estimate is then only known to be below this.

        Parameters
        ----------
        objectives
            Shape (D, p').
        sufficient
            Shape (D,).

        Returns
        -------
        Shape (D,); NaN where a path could not be followed.
        """
        try:
            return self._least(objectives, sufficient)
        except np.linalg.LinAlgError:  # one path is too near the boundary for Cholesky; halves find out which
            if len(objectives) == 1:
                return np.array([np.nan])
            halves = [slice(len(objectives) // 2), slice(len(objectives) // 2, None)]
            return np.concatenate([self.least(objectives[half], sufficient[half]) for half in halves])

    def _least(self, objectives: Array, sufficient: Array) -> Array:
        """Minima as in `least`, all paths followed together; LinAlgError if one comes too near the boundary."""
        c = objectives @ self._S
        values = np.asarray(c @ self._center)
        projected_c = c if self._null_basis is None else c @ self._null_basis
        varies = np.linalg.norm(projected_c, axis=1) > _CONSTANT_OBJECTIVE * np.linalg.norm(c, axis=1)
        if not varies.any():
            return values
        values[varies] = np.nan

        paths = self._first_points(np.flatnonzero(varies), c[varies])
        for _ in range(_MAX_NEWTON_STEPS):
            gradient, H = self._derivatives(paths.x)
            directions = -self._solve(H, np.stack([gradient, paths.c], axis=-1))
            centering, descent = directions[..., 0], directions[..., 1]
            step = centering + paths.kappa[:, None] * descent
            squared_decrement = -_dot(step, gradient + paths.kappa[:, None] * paths.c)

            value = _dot(paths.c, paths.x)
            gap = -paths.kappa * _dot(paths.c, descent)
            decrease = paths.c @ self._center - value
            is_near_end = gap <= _ACCURACY * decrease
            is_converged = is_near_end & (squared_decrement < _FINAL_DECREMENT)
            has_arrived = is_converged | (value < sufficient[paths.indices])
            values[paths.indices[has_arrived]] = value[has_arrived] - gap[has_arrived]
            if has_arrived.all():
                break

            grows = ~is_near_end & (squared_decrement < _GROWTH_DECREMENT)
            kappa = np.where(grows, _KAPPA_FACTOR * paths.kappa, paths.kappa)
            step = centering + kappa[:, None] * descent
            goes_on = ~has_arrived
            paths = paths._replace(kappa=kappa).select(goes_on)
            paths = self._moved(paths, step[goes_on])
        return values

    def _first_points(self, indices: Indices, c: Array) -> _Paths:
        """Points at the centre, with a kappa for which the first full step is `_FIRST_KAPPA` in the Hessian's norm."""
        x = np.tile(self._center, (len(c), 1))
        _, H = self._derivatives(x[:1])
        H_inverse_c = self._solve(H, c.T[None])[0].T  # all paths begin with the same H
        return _Paths(indices, c, x, _FIRST_KAPPA / np.sqrt(_dot(c, H_inverse_c)))

    def _moved(self, paths: _Paths, step: Array) -> _Paths:
        """The paths' points after a step each, or the part of it that minimises what it is to decrease."""
        length = self._step_length(paths.x, step, paths.kappa * _dot(paths.c, step))
        return paths._replace(x=paths.x + length[:, None] * step)

    def _strictly_inside(self, problem: Problem, start: Array, level: float) -> Array:
        """A point strictly inside, with a cost below the level.

        The barrier method, to a gap of all the room, gives a point inside the inequalities. It is moved towards the
        optimum until its cost is low enough; the set is convex, so it stays inside.
        """
        room = level - problem.cost(problem.S @ start)
        if not room > 0:
            raise SolverError("solver", "the level is not above the least cost")
        interior = Barrier(problem, self._quadratic_hessian, 2 * self._AS.T @ self._b, gap=room).x
        for _ in range(_MAX_HALVINGS):
            if problem.cost(problem.S @ interior) < level - room / 2:
                return interior
            interior = (interior + start) / 2
        raise SolverError("solver", "found nothing inside of what the data allow")

    def _find_center(self, x: Array) -> Array:
        """The point at which phi is least, from one strictly inside."""
        x = x[None]
        for _ in range(_MAX_NEWTON_STEPS):
            gradient, H = self._derivatives(x)
            step = -self._solve(H, gradient[..., None])[..., 0]
            if -_dot(step, gradient)[0] < _CENTER_DECREMENT:
                return np.asarray(x[0])
            x = x + self._step_length(x, step, np.zeros(1))[:, None] * step
        raise SolverError("solver", "could not find the middle of what the data allow")

    def _derivatives(self, x: Array) -> tuple[Array, Array]:
        """Gradient, shape (D, m), and Hessian, shape (D, m, m), of phi at points x, shape (D, m).

        With g = ∇f and s = level − f, −w log s has the gradient w g / s and the Hessian w ∇²f / s + w g gᵀ / s².
        """
        residual = x @ self._AS.T - self._b
        g = 2 * residual @ self._AS + self._linear_cost
        H = np.tile(self._quadratic_hessian, (len(x), 1, 1))
        _add_derivatives(self._log_dets, x, g, H)
        s = self._slack(x, residual)[:, None]
        gradient = self._weight * g / s
        H *= (self._weight / s)[..., None]
        H += gradient[:, :, None] * (g / s)[:, None, :]
        _add_derivatives(self._groups, x, gradient, H)
        return gradient, H

    def _slack(self, x: Array, residual: Array) -> Array:
        """Level − f, shape (D,)."""
        cost = np.sum(residual**2, axis=1) + x @ self._linear_cost
        for group in self._log_dets:
            cost = cost - group.log_det(x)
        return np.asarray(self._reduced_level - cost)

    def _solve(self, H: Array, rhs: Array) -> Array:
        """Solutions of H y = rhs in the space that exact constraints leave, shape (D, m, k). H may be overwritten."""
        if self._null_basis is not None:
            H = self._null_basis.T @ H @ self._null_basis
            rhs = self._null_basis.T @ rhs
        y = np.empty(rhs.shape)
        for i, (matrix, columns) in enumerate(zip(H, rhs, strict=True)):
            # By Cholesky's factors; a symmetric matrix in C order is its transpose in Fortran's, and is not copied.
            _, y[i], info = lapack.dposv(matrix.T, columns, overwrite_a=True)
            if info:
                raise np.linalg.LinAlgError
        return y if self._null_basis is None else np.asarray(self._null_basis @ y)

    def _step_length(self, x: Array, step: Array, objective_slope: Array) -> Array:
        """Step lengths t that minimise objective_slope · t + phi(x + t · step), kept off the inequalities; shape (D,).

        By Newton's method in one variable, with bisection where that leaves the bracket.
        """
        line = self._line(x, step, objective_slope)
        boundary = line.boundary()
        low, high = np.zeros(len(x)), boundary
        t = np.minimum(1.0, high / 2)
        is_found = np.zeros(len(x), dtype=bool)
        for _ in range(_MAX_SEARCH_STEPS):
            is_inside, first, second = line.derivatives(t)
            is_before = is_inside & (first < 0)
            low, high = np.where(is_before, t, low), np.where(is_before, high, t)
            newton = t - first / second
            is_found = is_inside & (np.abs(newton - t) <= _SEARCH_ACCURACY * t)
            if is_found.all():
                break
            middle = np.where(np.isfinite(high), (low + high) / 2, 2 * t)
            is_between = is_inside & (low < newton) & (newton < high)
            t = np.where(is_found, t, np.where(is_between, newton, middle))
        return np.minimum(np.where(is_found, t, low), _BOUNDARY_FRACTION * boundary)

    def _line(self, x: Array, step: Array, objective_slope: Array) -> _Line:
        """The function of t that `_step_length` minimises."""
        residual = x @ self._AS.T - self._b
        change = step @ self._AS.T
        # concatenate needs at least one array
        no_rates = np.zeros((len(x), 0))
        rates = [group.rates(x, step) for group in self._groups]
        log_det_rates = [group.rates(x, step) for group in self._log_dets]
        weights = [np.full(group.rows, group.weight) for group in self._log_dets]
        return _Line(
            objective_slope=objective_slope,
            rates=np.concatenate([no_rates, *rates], axis=1),
            log_det_rates=np.concatenate([no_rates, *log_det_rates], axis=1),
            log_det_weights=np.concatenate([np.zeros(0), *weights]),
            weight=self._weight,
            slack=self._slack(x, residual),
            cost_slope=2 * _dot(residual, change) + step @ self._linear_cost,
            cost_curvature=2 * _dot(change, change),
        )


class _Paths(NamedTuple):
    """Points on paths that are followed together.

    Attributes
    ----------
    indices
        Of their objectives, shape (D,).
    c
        Objectives, shape (D, m).
    x
        Points, shape (D, m).
    kappa
        Weights of the objectives, shape (D,).
    """

    indices: Indices
    c: Array
    x: Array
    kappa: Array

    def select(self, chosen: Mask) -> _Paths:
        """Some of the paths."""
        return _Paths(self.indices[chosen], self.c[chosen], self.x[chosen], self.kappa[chosen])


class _Line(NamedTuple):
    """Restriction of objective and phi to D lines x + t · step, in closed form.

    Rates r are the eigenvalues of X⁻¹ dX, dX the change of X along the step: det X(t) = det X(0) · Π (1 + t r).

    Attributes
    ----------
    objective_slope
        Derivative of kappa c · x, shape (D,).
    rates
        Of all inequalities, shape (D, R).
    log_det_rates, log_det_weights
        Of all log-dets, shape (D, L) and (L,).
    weight
        Of the level.
    slack
        level − f at t = 0, shape (D,).
    cost_slope, cost_curvature
        Derivatives of f without the log-dets at t = 0, shape (D,).
    """

    objective_slope: Array
    rates: Array
    log_det_rates: Array
    log_det_weights: Array
    weight: float
    slack: Array
    cost_slope: Array
    cost_curvature: Array

    def boundary(self) -> Array:
        """Largest t up to which inequalities and log-dets hold, infinite if they always do, shape (D,)."""
        least_rate = np.concatenate([self.rates, self.log_det_rates], axis=1).min(axis=1, initial=0.0)
        end = np.full(len(least_rate), np.inf)
        np.divide(-1.0, least_rate, out=end, where=least_rate < 0)
        return end

    def derivatives(self, t: Array) -> tuple[Mask, Array, Array]:
        """Mask of the t with a cost below the level, and the first and second derivatives there, shape (D,) each."""
        parts = self.rates / (1 + t[:, None] * self.rates)
        log_det_parts = self.log_det_rates / (1 + t[:, None] * self.log_det_rates)
        logarithms = np.log1p(t[:, None] * self.log_det_rates) @ self.log_det_weights
        slack = self.slack - self.cost_slope * t - self.cost_curvature * t**2 / 2 + logarithms
        is_inside = slack > 0
        slack = np.where(is_inside, slack, 1.0)
        slack_slope = -self.cost_slope - self.cost_curvature * t + log_det_parts @ self.log_det_weights
        slack_curvature = -self.cost_curvature - log_det_parts**2 @ self.log_det_weights
        first = self.objective_slope - parts.sum(axis=1) - self.weight * slack_slope / slack
        second = np.sum(parts**2, axis=1) + self.weight * ((slack_slope / slack) ** 2 - slack_curvature / slack)
        return is_inside, first, second


def _add_derivatives(groups: Sequence[InequalityGroup], x: Array, gradient: Array, H: Array) -> None:
    """Add those of the groups' barriers at points x, shape (D, m), to a gradient, shape (D, m), and a Hessian."""
    for group in groups:
        slopes, curvatures = group.derivatives(x)
        for i, variables in enumerate(group.variables):
            gradient[:, variables] += slopes[:, i]
            H[:, variables[:, None], variables] += curvatures[:, i]


def _dot(a: Array, b: Array) -> Array:
    """Products of each row with its partner, shape (D,)."""
    return np.asarray(np.einsum("di,di->d", a, b))

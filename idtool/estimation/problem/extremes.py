"""Least values of many linear functions over all that the constraints allow at a cost up to a level.

The least c · x for every objective c, among all x with X_i(x) ⪰ 0, E S x = e and f(x) ≤ level, is approached from
inside, along a central path (Nesterov & Nemirovskii 1994; Boyd & Vandenberghe, Convex Optimization, chapter 11):

    x(tau) = argmin of tau c · x + phi(x),  phi(x) = −w log(level − f(x)) − Σ log det X_i(x).

The level is one inequality among many: with a weight w of 1, the path would come too near to it, and steps be short.
All paths begin at the centre, where phi is least. They are followed together: each step of Newton's method is taken for
all objectives at once. Near the end of a path the gap to the least value is about a / tau; as d(c · x)/dtau =
−c · H⁻¹ c, it is tau c · H⁻¹ c to first order in 1 / tau, and this is subtracted.

Letters: D objectives c; m variables x; H (D, m, m) Hessian of phi; tau the inverse of mu in `barrier`; A, S, E, e, f as
in `problem`, X_i as in `barrier`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import SolverError
from idtool.common.linear_algebra import null_space
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.inequality_groups import InequalityGroup, inequality_groups, log_det_groups
from idtool.estimation.problem.problem import Problem

_ACCURACY = 1e-3  # greatest gap at the end, relative to the way from the centre; its estimate is then subtracted
# Squared Newton decrements (Boyd & Vandenberghe, section 9.5) at which …
_CENTERED = 1e-3  # … the centre is found
_NEXT_TAU = 0.3  # … tau grows
_ARRIVED = 0.1  # … c · x is near that of the path
_FIRST_TAU = 10.0  # in units of the barrier's own length along c at the centre
_TAU_FACTOR = 10.0
_ROWS_PER_LEVEL = 8  # rows of inequalities for each 1 of w
_MOST_STEPS = 100
_MOST_OF_WAY = 0.7  # to the first inequality that a step goes at the most: nearer, it would take many to get away
_MOST_HALVINGS = 40
_MOST_SEARCH_STEPS = 25
_SEARCH_ACCURACY = 1e-2  # of a step's length
_FIXED = 1e-9  # length of an objective in the space that exact constraints leave, relative to its own, that is rounding
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
        If it has no interior.
    """

    def __init__(self, problem: Problem, start: Array, level: float) -> None:
        self._groups = inequality_groups(problem)
        self._log_dets = log_det_groups(problem)
        self._S = problem.S
        self._AS, self._b = problem.A @ problem.S, problem.b
        self._slope = np.zeros(problem.variables)
        self._room = level - problem.constant
        for term in problem.log_dets:
            self._slope += problem.S[term.z_slice].T @ term.slope
            self._room -= term.offset
        self._P = 2 * self._AS.T @ self._AS
        ES = problem.E @ problem.S
        self._N = null_space(ES) if len(ES) else None
        self._weight = max(sum(group.rows for group in self._groups) / _ROWS_PER_LEVEL, 1.0)
        try:
            self._center = self._find_center(self._strictly_inside(problem, start, level))
        except np.linalg.LinAlgError:  # rounding has left nothing
            raise SolverError("solver", "could not find the middle of what the data allow") from None

    @property
    def batch_size(self) -> int:
        """Number of objectives that are best followed together, for the memory that they take."""
        return max(_BATCH_ENTRIES // len(self._center) ** 2, 1)

    def least(self, objectives: Array, enough: Array) -> Array:
        """Least values of objective · z.

        They are accurate to about 1e-4 of the way from the centre, on either side.

        Parameters
        ----------
        objectives
            Shape (D, p').
        enough
            Values below which it need not be the least one, shape (D,).

        Returns
        -------
        Shape (D,); NaN where a path could not be followed.
        """
        try:
            return self._least(objectives, enough)
        except np.linalg.LinAlgError:  # so near the boundary that rounding has left nothing: of one of the paths
            if len(objectives) == 1:
                return np.array([np.nan])
            halves = [slice(len(objectives) // 2), slice(len(objectives) // 2, None)]
            return np.concatenate([self.least(objectives[half], enough[half]) for half in halves])

    def _least(self, objectives: Array, enough: Array) -> Array:
        """As in `least`."""
        c = objectives @ self._S
        values = np.asarray(c @ self._center)
        free = c if self._N is None else c @ self._N
        is_free = np.linalg.norm(free, axis=1) > _FIXED * np.linalg.norm(c, axis=1)
        if not is_free.any():
            return values
        paths = np.flatnonzero(is_free)
        values[paths] = np.nan

        c = c[paths]
        x = np.tile(self._center, (len(paths), 1))
        _, H = self._derivatives(x[:1])
        tau = _FIRST_TAU / np.sqrt(np.sum(c * self._solve(H, c.T[None])[0].T, axis=1))
        for _ in range(_MOST_STEPS):
            gradient, H = self._derivatives(x)
            to_center, downhill = -np.moveaxis(self._solve(H, np.stack([gradient, c], axis=-1)), -1, 0)
            step = to_center + tau[:, None] * downhill
            squared_decrement = -_dot(step, gradient + tau[:, None] * c)
            value, gap = _dot(c, x), -tau * _dot(c, downhill)
            is_near_end = gap <= _ACCURACY * (c @ self._center - value)
            has_arrived = is_near_end & (squared_decrement < _ARRIVED) | (value < enough[paths])
            values[paths[has_arrived]] = value[has_arrived] - gap[has_arrived]
            if has_arrived.all():
                break

            tau = np.where(~is_near_end & (squared_decrement < _NEXT_TAU), _TAU_FACTOR * tau, tau)
            step = to_center + tau[:, None] * downhill
            goes_on = ~has_arrived
            paths, c, x, tau, step = paths[goes_on], c[goes_on], x[goes_on], tau[goes_on], step[goes_on]
            x = x + self._step_length(x, step, tau * _dot(c, step))[:, None] * step
        return values

    def _strictly_inside(self, problem: Problem, start: Array, level: float) -> Array:
        """A point strictly inside: between the optimum and one far inside the inequalities."""
        room = level - problem.cost(problem.S @ start)
        if not room > 0:
            raise SolverError("solver", "the level is not above the least cost")
        inside = Barrier(problem, self._P, 2 * self._AS.T @ self._b, gap=room).x
        for _ in range(_MOST_HALVINGS):
            if problem.cost(problem.S @ inside) < level - room / 2:
                return inside
            inside = (inside + start) / 2
        raise SolverError("solver", "found nothing inside of what the data allow")

    def _find_center(self, x: Array) -> Array:
        """The point at which phi is least, from one strictly inside."""
        x = x[None]
        for _ in range(_MOST_STEPS):
            gradient, H = self._derivatives(x)
            step = -self._solve(H, gradient[..., None])[..., 0]
            if -_dot(step, gradient)[0] < _CENTERED:
                return np.asarray(x[0])
            x = x + self._step_length(x, step, np.zeros(1))[:, None] * step
        raise SolverError("solver", "could not find the middle of what the data allow")

    def _derivatives(self, x: Array) -> tuple[Array, Array]:
        """Gradient, shape (D, m), and Hessian, shape (D, m, m), of phi at points of shape (D, m)."""
        residual = x @ self._AS.T - self._b
        cost_gradient = 2 * residual @ self._AS + self._slope
        H = np.tile(self._P, (len(x), 1, 1))
        _add_derivatives(self._log_dets, x, cost_gradient, H)
        room = self._room_left(x, residual)[:, None]
        gradient = self._weight * cost_gradient / room
        H *= (self._weight / room)[..., None]
        H += gradient[:, :, None] * (cost_gradient / room)[:, None, :]
        _add_derivatives(self._groups, x, gradient, H)
        return gradient, H

    def _room_left(self, x: Array, residual: Array) -> Array:
        """Level − f, shape (D,)."""
        cost = np.sum(residual**2, axis=1) + x @ self._slope
        for group in self._log_dets:
            cost = cost - group.log_det(x)
        return np.asarray(self._room - cost)

    def _solve(self, H: Array, right: Array) -> Array:
        """Solutions of H y = right in the space that exact constraints leave, shape (D, m, k). H is overwritten."""
        if self._N is not None:
            H, right = self._N.T @ H @ self._N, self._N.T @ right
        y = np.empty(right.shape)
        for i, (matrix, columns) in enumerate(zip(H, right, strict=True)):
            _, y[i], info = lapack.dposv(matrix.T, columns, overwrite_a=True)
            if info:
                raise np.linalg.LinAlgError
        return y if self._N is None else np.asarray(self._N @ y)

    def _step_length(self, x: Array, step: Array, slope: Array) -> Array:
        """Line search: the t that minimises slope · t + phi(x + t · step), short of an inequality's end; shape (D,)."""
        line = self._line(x, step, slope)
        boundary = line.boundary()
        low, high = np.zeros(len(x)), boundary
        t = np.minimum(1.0, high / 2)
        is_found = np.zeros(len(x), dtype=bool)
        for _ in range(_MOST_SEARCH_STEPS):
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
        return np.minimum(np.where(is_found, t, low), _MOST_OF_WAY * boundary)

    def _line(self, x: Array, step: Array, slope: Array) -> _Line:
        """Slope · t + phi(x + t · step) as a function of t."""
        residual = x @ self._AS.T - self._b
        change = step @ self._AS.T
        none = np.zeros((len(x), 0))
        log_det_rates = [group.rates(x, step) for group in self._log_dets]
        weights = [np.full(group.rows, group.weight) for group in self._log_dets]
        return _Line(
            slope=slope,
            rates=np.concatenate([none, *(group.rates(x, step) for group in self._groups)], axis=1),
            log_det_rates=np.concatenate([none, *log_det_rates], axis=1),
            log_det_weights=np.concatenate([none[0], *weights]),
            weight=self._weight,
            room=self._room_left(x, residual),
            cost_slope=2 * _dot(residual, change) + step @ self._slope,
            cost_curvature=2 * _dot(change, change),
        )


class _Line(NamedTuple):
    """slope · t + phi along D lines, in closed form.

    A group's −log det is −Σ log(1 + t r) and a constant, r its rates; so is a log-det of the cost, with its weight.

    Attributes
    ----------
    slope
        Shape (D,).
    rates
        Of all inequalities, shape (D, R).
    log_det_rates, log_det_weights
        Of all log-dets, shape (D, L) and (L,).
    weight
        Of the level.
    room
        level − f at t = 0, shape (D,).
    cost_slope, cost_curvature
        Derivatives of f without the log-dets at t = 0, shape (D,).
    """

    slope: Array
    rates: Array
    log_det_rates: Array
    log_det_weights: Array
    weight: float
    room: Array
    cost_slope: Array
    cost_curvature: Array

    def boundary(self) -> Array:
        """The t up to which the inequalities hold, shape (D,)."""
        least_rate = np.concatenate([self.rates, self.log_det_rates], axis=1).min(axis=1, initial=0.0)
        end = np.full(len(least_rate), np.inf)
        np.divide(-1.0, least_rate, out=end, where=least_rate < 0)
        return end

    def derivatives(self, t: Array) -> tuple[Mask, Array, Array]:
        """Mask of the t with a cost below the level, and the first and second derivatives there, shape (D,) each."""
        parts = self.rates / (1 + t[:, None] * self.rates)
        log_det_parts = self.log_det_rates / (1 + t[:, None] * self.log_det_rates)
        logarithms = np.log1p(t[:, None] * self.log_det_rates) @ self.log_det_weights
        room = self.room - self.cost_slope * t - self.cost_curvature * t**2 / 2 + logarithms
        is_inside = room > 0
        room = np.where(is_inside, room, 1.0)
        room_slope = -self.cost_slope - self.cost_curvature * t + log_det_parts @ self.log_det_weights
        room_curvature = -self.cost_curvature - log_det_parts**2 @ self.log_det_weights
        first = self.slope - parts.sum(axis=1) - self.weight * room_slope / room
        second = np.sum(parts**2, axis=1) + self.weight * ((room_slope / room) ** 2 - room_curvature / room)
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

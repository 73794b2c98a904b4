"""Minimum of a quadratic function over a problem's inequalities, tracked from inside as the function changes.

    min over x of ½ xᵀ P x − qᵀ x + Σ log-dets − mu Σ log det X_i(x)  subject to  E S x = e,

X_i(x) = Σ_k x_k G_k − interior · 1 for every inequality, entry by entry where it is on a vector, and the problem's
log-dets, if it has any. Its minimiser costs at most mu nu more than the least within the inequalities, nu the rows of
all X_i together (Nesterov & Nemirovskii 1994), and is strictly inside. Newton's method on it does not depend on units,
nor on how far the eigenvalues of P lie apart: where P has changed little one step is enough. Steps are in the null
space N of E S, so that rounding does not leave the equations.

Letters: m variables x; P (m, m), q (m,).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag, lapack

from idtool.common.arrays import Array
from idtool.common.exceptions import SolverError
from idtool.common.linear_algebra import null_space
from idtool.estimation.problem.inequality_groups import InequalityGroup, inequality_groups, log_det_groups
from idtool.estimation.problem.problem import Problem

_LAST_STEP = 0.3  # in the barrier's own length: a shorter step ends the search, what is left is a tenth of it squared
_MOST_OF_WAY = 0.9  # to the boundary that a step goes at the most: nearer, and the next is lost to rounding
_MOST_STEPS = 30  # with one weight of the barrier, or in a search along a step
_WEIGHT_UP, _WEIGHT_DOWN = 100.0, 10.0  # factors by which the barrier's weight changes when the function has
_MOST_WEIGHTS = 60  # tried for one function
_PULLS = 10.0 ** np.arange(7)  # into the inequalities, when a start is searched for
_START_CURVATURE = 1e-6  # relative: keeps a start where nothing else does
_EQUATION_TOLERANCE = 1e-6  # of exact constraints


class Barrier:
    """Tracker of the minimiser.

    Attributes
    ----------
    x
        The minimiser, shape (m,): strictly inside of all inequalities.
    nu
        Number of rows of all inequalities.

    Parameters
    ----------
    problem
        Its inequalities, bounds and exact constraints hold.
    P, q
        The first function; P positive definite but for the variables that no z depends on.
    gap
        Difference from the least cost that a minimiser may have.
    start
        First point if that is strictly inside, shape (m,); default: the minimiser without inequalities.

    Raises
    ------
    SolverError
        If nothing fulfils the inequalities and exact constraints.
    """

    def __init__(self, problem: Problem, P: Array, q: Array, gap: float, start: Array | None = None) -> None:
        self._groups = inequality_groups(problem)
        self._log_dets = log_det_groups(problem)
        self._slope = np.zeros(len(q))  # of the log-dets' linear parts
        for term in problem.log_dets:
            self._slope = self._slope + problem.S[term.z_slice].T @ term.slope
        self.nu = sum(group.rows for group in self._groups)
        self._mu = gap / max(self.nu, 1)
        self._E, self._e = problem.E @ problem.S, problem.e
        self._N = null_space(self._E) if len(self._E) else None
        self._center = self._strictly_inside(P, q, start)
        self.x = self._center
        self.move(P, q)

    def move(self, P: Array, q: Array, share: float = 1.0, start: Array | None = None) -> Array:
        """Follow the minimiser to another function, with the log-dets times ``share``; returns x.

        Starts at x, or at ``start``, strictly inside and on the exact constraints, shape (m,).
        """
        q = q - share * self._slope
        self.x = self.x if start is None else start
        mu, lowest = self._mu, self._mu
        minimum = self._center
        for _ in range(_MOST_WEIGHTS):
            log_dets = [replace(group, weight=share * group.weight / mu) for group in self._log_dets]
            self.x, is_minimum = _minimise(self._groups + log_dets, P / mu, q / mu, self.x, self._N)
            if is_minimum and mu == lowest:
                return self.x
            if is_minimum:
                minimum = self.x
                mu = max(mu / _WEIGHT_DOWN, lowest)
            else:  # it has hugged the boundary in the wrong place: the way leads through the middle
                self.x = 0.5 * (self.x + self._center)
                mu = _WEIGHT_UP * mu
        self.x = minimum  # with a larger weight
        return self.x

    def curvature(self, x: Array) -> Array:
        """Hessian of the barrier, its weight counted, and the log-dets at a point strictly inside; shape (m, m)."""
        H = np.zeros((len(x), len(x)))
        for group in self._groups:
            H[group.variables[:, :, None], group.variables[:, None, :]] += self._mu * group.derivatives(x)[1]
        for group in self._log_dets:
            H[group.variables[:, :, None], group.variables[:, None, :]] += group.derivatives(x)[1]
        return H

    def _strictly_inside(self, P: Array, q: Array, start: Array | None) -> Array:
        """A point strictly inside: the least s with X_i + s · 1 ⪰ 0, by the same method, until s is negative.

        The given start or the minimiser without inequalities where that is strictly inside already.
        """
        m = len(q)
        size = float(P.diagonal().max())
        P, q = P / size + _START_CURVATURE * np.eye(m), q / size
        if start is not None:
            start = self._with_equations(start)
            if self._is_inside(start):
                return start
        x = self._with_equations(np.asarray(np.linalg.solve(P, q)))
        if self._is_inside(x):
            return x
        inequalities = self._groups + self._log_dets
        relaxed = [group.relaxed(slack=m) for group in inequalities]
        P_relaxed = np.zeros((m + 1, m + 1))
        P_relaxed[:m, :m] = P
        N_relaxed = None if self._N is None else block_diag(self._N, np.ones((1, 1)))
        x = np.append(x, 1 - min(group.smallest(x) for group in inequalities))
        for pull in _PULLS:
            x, _ = _minimise(relaxed, P_relaxed, np.append(q, -pull), x, N_relaxed)
            if x[-1] < 0:
                return x[:m]
        what = "no parameters satisfy both the constraints and the exactly known values; relax one of them"
        raise SolverError("constraints", what)

    def _is_inside(self, x: Array) -> bool:
        """True if all inequalities hold strictly at x, and the log-dets are finite."""
        return all(group.smallest(x) > 0 for group in self._groups + self._log_dets)

    def _with_equations(self, x: Array) -> Array:
        """Nearest point to x at which exact constraints hold."""
        if not len(self._e):
            return x
        x = x + np.linalg.lstsq(self._E, self._e - self._E @ x, rcond=None)[0]
        if np.abs(self._E @ x - self._e).max() > _EQUATION_TOLERANCE:
            raise SolverError("known", "known values contradict each other; give one of them a standard_error")
        return x


def _minimise(groups: list[InequalityGroup], P: Array, q: Array, x: Array, N: Array | None) -> tuple[Array, bool]:
    """Newton's method with a line search from x, strictly inside, along the columns of N, shape (m, f); None: anywhere.

    Returns
    -------
    The minimiser, and true if it converged.
    """
    for _ in range(_MOST_STEPS):
        try:
            gradient, H = _derivatives(groups, P, q, x)
        except np.linalg.LinAlgError:  # so near the boundary that rounding has left nothing
            break
        step = _newton(H, gradient, N)
        if step is None:
            break
        if not groups:
            return x + step, True
        is_short = step @ H @ step < _LAST_STEP**2
        if is_short and min(group.smallest(x + step) for group in groups) > 0:
            return x + step, True
        rates = [group.rates(x, step) for group in groups]
        weights = np.concatenate([np.full(len(r), group.weight) for r, group in zip(rates, groups, strict=True)])
        first, second = float((P @ x - q) @ step), float(step @ P @ step)
        x = x + _search(first, second, np.concatenate(rates), weights) * step
    return x, False


def _derivatives(groups: list[InequalityGroup], P: Array, q: Array, x: Array) -> tuple[Array, Array]:
    """Gradient, shape (m,), and Hessian, shape (m, m), of the function with its barrier, strictly inside."""
    gradient = P @ x - q
    H = P.copy()
    for group in groups:
        slope, curvature = group.derivatives(x)
        np.add.at(gradient, group.variables, slope)
        places = group.variables[:, :, None] * len(x) + group.variables[:, None, :]
        np.add.at(H.reshape(-1), places.ravel(), curvature.ravel())
    return gradient, H


def _newton(H: Array, gradient: Array, N: Array | None) -> Array | None:
    """Step to the minimum of the second-order model along the columns of N, shape (m, f); None: anywhere.

    None is returned if rounding has left nothing of the model.
    """
    H_free = H if N is None else N.T @ H @ N
    gradient_free = gradient if N is None else N.T @ gradient
    if not len(H_free):  # equations determine everything
        return np.zeros_like(gradient)
    diagonal = H_free.diagonal()
    if not (diagonal > 0).all():
        return None
    size = 1 / np.sqrt(diagonal)
    scaled = H_free * size[:, None] * size
    _, solution, failure = lapack.dposv(scaled.T, size * gradient_free, overwrite_a=True)  # scaled is symmetric
    if failure:
        return None
    step = -size * solution
    return np.asarray(step if N is None else N @ step)


def _search(slope: float, curvature: float, rates: Array, weights: Array) -> float:
    """Line search: t that minimises slope t + ½ curvature t² − Σ w log(1 + t r), by Newton's method in a bracket."""
    low = 0.0
    high = float(-1 / rates.min()) if rates.min() < 0 else np.inf
    longest = _MOST_OF_WAY * high
    t = min(1.0, 0.5 * high)
    for _ in range(_MOST_STEPS):
        part = rates / (1 + t * rates)
        first = slope + curvature * t - float(weights @ part)
        if first < 0:
            low = t
        else:
            high = t
        step = first / (curvature + float(weights @ part**2))
        if abs(step) <= 1e-3 * t:
            break
        if low < t - step < high:
            t -= step
        elif np.isfinite(high):
            t = 0.5 * (low + high)
        else:
            t *= 2
    return min(t, longest)

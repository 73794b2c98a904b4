"""The least of a quadratic function over a problem's inequalities, tracked from inside as the function changes.

    min over x of ½ xᵀ P x − qᵀ x + Σ log-dets − mu Σ log det X_i(x)  subject to  E S x = e,

X_i(x) = Σ_k x_k G_k − interior · 1 for every inequality, entry by entry where it is on a vector, and the problem's
log-dets, if it has any. Its minimiser costs at most mu nu more than the least within the inequalities, nu the rows of
all X_i together (Nesterov & Nemirovskii 1994), and is strictly inside. Newton's method on it does not depend on units,
nor on how far the eigenvalues of P lie apart: where P has changed little one step is enough.

Letters: m variables x; P (m, m), q (m,); B inequalities of one form, of K variables and n rows each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import SolverError
from idtool.estimation.problem.problem import Problem

_NEAR = 0.3  # a step that is shorter in the barrier's own length ends the search: what is left is a tenth of it squared
_FAR = 0.9  # of the way to the boundary that a step goes at the most: nearer, and the next is lost to rounding
_STEPS = 30  # with one weight of the barrier, or in a search along a step
_UP, _DOWN, _WEIGHTS = 100.0, 10.0, 60  # factors by which the weight changes when the function has, and how often
_PULL = 10.0 ** np.arange(7)  # into the inequalities, when a start is sought
_SOFT = 1e-6  # of one: keeps a start where nothing else does
_EXACT = 1e-6  # to which what is known exactly must be met


@dataclass(frozen=True)
class _Group:
    """Inequalities of one form.

    Attributes
    ----------
    own
        Indices of their variables, shape (B, K); no two rows share one.
    G
        Shape (B, K, n, n), or (B, K, n) where they are on vectors.
    least
        What is taken off, shape (B, n, n) or (B, n).
    weight
        Of its −log det in the function, in units of mu.
    """

    own: Indices
    G: Array
    least: Array
    weight: float = 1.0

    def value(self, x: Array) -> Array:
        """All X_i, shape (B, n, n) or (B, n)."""
        K = self.own.shape[1]
        sums = x[self.own][:, None, :] @ self.G.reshape(len(self.G), K, -1)
        return np.asarray(sums.reshape(self.least.shape) - self.least)

    def derivatives(self, x: Array) -> tuple[Array, Array]:
        """Of weight · Σ −log det X_i: gradients, shape (B, K), and Hessians, shape (B, K, K)."""
        X = self.value(x)
        if X.ndim == 2:
            Y = self.G / X[:, None, :]
            return -self.weight * Y.sum(axis=-1), self.weight * (Y @ Y.swapaxes(-1, -2))
        Y = np.linalg.inv(X)[:, None] @ self.G
        shape = (*self.own.shape, -1)
        rows, columns = Y.reshape(shape), Y.swapaxes(-1, -2).reshape(shape)
        gradient = -self.weight * np.einsum("bkii->bk", Y)
        return gradient, self.weight * (rows @ columns.swapaxes(-1, -2))

    def rates(self, x: Array, step: Array) -> Array:
        """Eigenvalues r with X_i(x + t · step) singular where 1 + t r = 0, in a row."""
        X, D = self.value(x), self.value(step) + self.least
        if X.ndim == 2:
            return np.asarray((D / X).ravel())
        inverse = np.linalg.inv(np.linalg.cholesky(X))
        return np.asarray(np.linalg.eigvalsh(inverse @ D @ inverse.swapaxes(-1, -2)).ravel())

    def smallest(self, x: Array) -> float:
        """The least eigenvalue or entry of all X_i."""
        X = self.value(x)
        return float((X if X.ndim == 2 else np.linalg.eigvalsh(X)).min())

    def relaxed(self, last: int) -> Iterator[_Group]:
        """The same one by one, with a further variable, of index ``last``, that is added on the diagonal."""
        one = np.eye(self.G.shape[-1]) if self.G.ndim == 4 else np.ones(self.G.shape[-1])
        for own, G, least in zip(self.own, self.G, self.least, strict=True):
            yield _Group(np.append(own, last)[None], np.concatenate([G, one[None]])[None], least[None])


class Barrier:
    """The tracker.

    Attributes
    ----------
    x
        Where it is, shape (m,): strictly inside, or anywhere where there is nothing to be inside of.
    nu
        Rows of all inequalities.

    Parameters
    ----------
    problem
        Whose inequalities, bounds and exact facts hold.
    P, q
        The function to start at; P positive definite but for the variables that no z depends on.
    gap
        What a minimiser may cost more than the least.
    start
        Where to begin if that is strictly inside, shape (m,); default: at the least without inequalities.

    Raises
    ------
    SolverError
        If nothing fulfils the inequalities and what is known exactly.
    """

    def __init__(self, problem: Problem, P: Array, q: Array, gap: float, start: Array | None = None) -> None:
        self._groups = _groups(problem)
        self._log_dets = _log_det_groups(problem)
        self._slope = sum((problem.S[term.own].T @ term.slope for term in problem.log_dets), np.zeros(len(q)))
        self.nu = sum(int(np.prod(group.least.shape[:2])) for group in self._groups)
        self._mu = gap / max(self.nu, 1)
        self._exact, self._e = problem.E @ problem.S, problem.e
        self.x = self._middle = self._start(P, q, start)
        self.move(P, q)

    def move(self, P: Array, q: Array, share: float = 1.0, start: Array | None = None) -> Array:
        """Follow the minimiser to another function, with the log-dets times ``share``; returns x.

        From where it is, or from a start strictly inside, shape (m,).
        """
        q = q - share * self._slope
        self.x = self.x if start is None else start
        mu, lowest = self._mu, self._mu
        for _ in range(_WEIGHTS):
            groups = self._groups + [replace(group, weight=share * group.weight / mu) for group in self._log_dets]
            self.x, there = _minimise(groups, P / mu, q / mu, self.x, self._exact, self._e)
            if there and mu == lowest:
                break
            if not there:  # it has hugged the boundary in the wrong place: the way leads through the middle
                self.x = 0.5 * (self.x + self._middle)
            mu = max(mu / _DOWN, lowest) if there else _UP * mu
        return self.x

    def curvature(self, x: Array) -> Array:
        """Hessian of the barrier, its weight counted, and the log-dets at a point strictly inside; shape (m, m)."""
        H = np.zeros((len(x), len(x)))
        for group in self._groups:
            H[group.own[:, :, None], group.own[:, None, :]] += self._mu * group.derivatives(x)[1]
        for group in self._log_dets:
            H[group.own[:, :, None], group.own[:, None, :]] += group.derivatives(x)[1]
        return H

    def _start(self, P: Array, q: Array, start: Array | None) -> Array:
        """A point strictly inside: the least s with X_i + s · 1 ⪰ 0, by the same method, until s is negative."""
        m = len(q)
        size = float(P.diagonal().max())
        P, q = P / size + _SOFT * np.eye(m), q / size
        inside = self._groups + self._log_dets
        if start is not None and self._is_inside(self._with_facts(start)):
            return self._with_facts(start)
        x = self._with_facts(np.asarray(np.linalg.solve(P, q)))
        if self._is_inside(x):
            return x
        groups = [replace(relaxed, weight=1.0) for group in inside for relaxed in group.relaxed(m)]
        wide = np.zeros((m + 1, m + 1))
        wide[:m, :m] = P
        exact = np.column_stack([self._exact, np.zeros(len(self._e))])
        x = np.append(x, 1 - min(group.smallest(x) for group in inside))
        for pull in _PULL:
            x, _ = _minimise(groups, wide, np.append(q, -pull), x, exact, self._e)
            if x[-1] < 0:
                return x[:m]
        raise SolverError("constraints", "no parameters fulfil them and what is known exactly; loosen one of them")

    def _is_inside(self, x: Array) -> bool:
        """Whether x is strictly inside of everything."""
        return all(group.smallest(x) > 0 for group in self._groups + self._log_dets)

    def _with_facts(self, x: Array) -> Array:
        """The x nearest to another at which what is known exactly holds."""
        if not len(self._e):
            return x
        x = x + np.linalg.lstsq(self._exact, self._e - self._exact @ x, rcond=None)[0]
        if np.abs(self._exact @ x - self._e).max() > _EXACT:
            raise SolverError("known", "facts contradict each other; give one of them a standard_error")
        return x


def _groups(problem: Problem) -> list[_Group]:
    """The inequalities by form, those that share variables apart."""
    found: dict[tuple[int, ...], list[_Group]] = defaultdict(list)
    seen: dict[int, int] = defaultdict(int)
    for matrix in problem.inequalities:
        one = np.eye(matrix.G.shape[-1]) if matrix.G.ndim == 3 else np.ones(matrix.G.shape[-1])
        own = np.arange(matrix.own.start, matrix.own.stop)
        group = _Group(own[None], matrix.G[None], matrix.interior * one[None])
        found[seen[matrix.first], *matrix.G.shape].append(group)
        seen[matrix.first] += 1
    groups = [_joined(alike) for alike in found.values()]
    if len(problem.bounded):
        groups.append(_Group(problem.bounded[None], np.eye(len(problem.bounded))[None], problem.bounds[None]))
    return groups


def _log_det_groups(problem: Problem) -> list[_Group]:
    """The problem's log-dets by how many variables their body has, a body's apart from its copies'."""
    found: dict[tuple[int, int], list[_Group]] = defaultdict(list)
    seen: dict[int, int] = defaultdict(int)
    for term in problem.log_dets:
        own = np.flatnonzero(problem.S[term.own].any(axis=0))
        G = np.tensordot(problem.S[term.own, own].T, term.G, axes=1)
        copy = seen[term.first]
        seen[term.first] += 1
        found[copy, len(own)].append(_Group(own[None], G[None], np.zeros((1, *G.shape[1:])), term.weight))
    return [replace(_joined(alike), weight=alike[0].weight) for alike in found.values()]


def _joined(groups: list[_Group]) -> _Group:
    own, G, least = (np.concatenate([getattr(group, name) for group in groups]) for name in ("own", "G", "least"))
    return _Group(own, G, least)


def _minimise(groups: list[_Group], P: Array, q: Array, x: Array, exact: Array, e: Array) -> tuple[Array, bool]:
    """Newton steps from x, strictly inside, each as far as is best, until one is short; and whether one was."""
    for _ in range(_STEPS):
        gradient, H = P @ x - q, P.copy()
        for group in groups:
            slope, curvature = group.derivatives(x)
            gradient[group.own] += slope
            H[group.own[:, :, None], group.own[:, None, :]] += curvature
        step = _newton(H, gradient, exact, exact @ x - e)
        if step is None:
            break
        if not groups or (step @ H @ step < _NEAR**2 and min(group.smallest(x + step) for group in groups) > 0):
            return x + step, True
        rates = [group.rates(x, step) for group in groups]
        weights = np.concatenate([np.full(len(r), group.weight) for r, group in zip(rates, groups, strict=True)])
        first, second = float((P @ x - q) @ step), float(step @ P @ step)
        x = x + _search(first, second, np.concatenate(rates), weights) * step
    return x, False


def _newton(H: Array, gradient: Array, exact: Array, off: Array) -> Array | None:
    """The step to the least of the second-order model that takes ``off``, what is wrong with exact · x, away.

    None: rounding has left nothing of the model.
    """
    size = 1 / np.sqrt(H.diagonal())
    try:
        factor = cho_factor(H * size[:, None] * size, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    step = -size * cho_solve(factor, size * gradient, check_finite=False)
    if len(exact):
        across = size[:, None] * cho_solve(factor, size[:, None] * exact.T, check_finite=False)
        step -= across @ np.linalg.solve(exact @ across, exact @ step + off)
    return np.asarray(step)


def _search(slope: float, curvature: float, rates: Array, weights: Array) -> float:
    """The t that minimises slope t + ½ curvature t² − Σ w log(1 + t r): Newton's method within a bracket."""
    low, high = 0.0, float(-1 / rates.min()) if rates.min() < 0 else np.inf
    most, t = _FAR * high, min(1.0, 0.5 * high)
    for _ in range(_STEPS):
        part = rates / (1 + t * rates)
        first = slope + curvature * t - float(weights @ part)
        low, high = (t, high) if first < 0 else (low, t)
        step = first / (curvature + float(weights @ part**2))
        if abs(step) <= 1e-3 * t:
            break
        t = t - step if low < t - step < high else (0.5 * (low + high) if np.isfinite(high) else 2 * t)
    return min(t, most)

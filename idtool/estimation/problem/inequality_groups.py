"""A problem's inequalities and log-dets in groups of one form, with their barrier, for one point or many at once.

Letters: m variables x; D points, shape (D, m), or one, shape (m,), whose results lack the axis D; B inequalities of one
form, of K variables and n rows each.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.estimation.problem.problem import Problem


@dataclass(frozen=True)
class InequalityGroup:
    """Inequalities of one form.

    Attributes
    ----------
    variables
        Indices of their variables, shape (B, K); only a slack variable is in several rows.
    G
        Shape (B, K, n, n), or (B, K, n) where they are on vectors.
    least
        Constant that is subtracted, shape (B, n, n) or (B, n).
    weight
        Weight of −log det X_i in the function that is minimised: 1 for an inequality, the prior's for a log-det.
    """

    variables: Indices
    G: Array
    least: Array
    weight: float = 1.0

    @property
    def is_on_matrices(self) -> bool:
        """True where the inequalities are on matrices, false where they are on vectors."""
        return self.G.ndim == 4

    @property
    def rows(self) -> int:
        """Rows of all X_i together."""
        return int(np.prod(self.least.shape[:2]))

    def value(self, x: Array) -> Array:
        """All X_i, shape (D, B, n, n) or (D, B, n)."""
        K = self.variables.shape[1]
        sums = x[..., self.variables][..., None, :] @ self.G.reshape(len(self.G), K, -1)
        return np.asarray(sums.reshape(*x.shape[:-1], *self.least.shape) - self.least)

    def derivatives(self, x: Array) -> tuple[Array, Array]:
        """Gradients, shape (D, B, K), and Hessians, shape (D, B, K, K), of each barrier −weight · log det X_i."""
        X = self.value(x)
        if not self.is_on_matrices:
            Y = self.G / X[..., None, :]
            return -self.weight * Y.sum(axis=-1), self.weight * (Y @ Y.swapaxes(-1, -2))
        Y = np.linalg.inv(X)[..., None, :, :] @ self.G
        shape = (*Y.shape[:-2], -1)
        rows, columns = Y.reshape(shape), Y.swapaxes(-1, -2).reshape(shape)
        gradient = -self.weight * np.einsum("...ii->...", Y)
        return gradient, self.weight * (rows @ columns.swapaxes(-1, -2))

    def log_det(self, x: Array) -> Array:
        """Sum of weight · log det X_i, strictly inside, shape (D,)."""
        X = self.value(x)
        if not self.is_on_matrices:
            return np.asarray(self.weight * np.log(X).sum(axis=(-1, -2)))
        return np.asarray(self.weight * np.linalg.slogdet(X)[1].sum(axis=-1))

    def rates(self, x: Array, step: Array) -> Array:
        """Eigenvalues r with X_i(x + t · step) singular where 1 + t r = 0, in a row of `rows`; shape (D, rows)."""
        X, change = self.value(x), self.value(step) + self.least
        if self.is_on_matrices:
            inverse = np.linalg.inv(np.linalg.cholesky(X))
            rates = np.linalg.eigvalsh(inverse @ change @ inverse.swapaxes(-1, -2))
        else:
            rates = change / X
        return np.asarray(rates.reshape(*x.shape[:-1], -1))

    def smallest(self, x: Array) -> float:
        """Smallest eigenvalue or entry of all X_i."""
        X = self.value(x)
        return float((np.linalg.eigvalsh(X) if self.is_on_matrices else X).min())

    def relaxed(self, slack: int) -> InequalityGroup:
        """The inequalities X_i + s · 1 ⪰ 0 with a slack variable s of index ``slack``; of weight 1."""
        one = np.eye(self.G.shape[-1]) if self.is_on_matrices else np.ones(self.G.shape[-1])
        count = len(self.G)
        variables = np.column_stack([self.variables, np.full(count, slack)])
        ones = np.broadcast_to(one, (count, 1, *one.shape))
        return InequalityGroup(variables, np.concatenate([self.G, ones], axis=1), self.least)


def inequality_groups(problem: Problem) -> list[InequalityGroup]:
    """The inequalities by form, those that share variables in different groups."""
    by_form: dict[tuple[int, ...], list[InequalityGroup]] = defaultdict(list)
    count: dict[int, int] = defaultdict(int)  # of inequalities on the same variables
    for inequality in problem.inequalities:
        G = inequality.G
        one = np.eye(G.shape[-1]) if G.ndim == 3 else np.ones(G.shape[-1])
        variables = np.arange(inequality.x_slice.start, inequality.x_slice.stop)
        group = InequalityGroup(variables[None], G[None], inequality.interior * one[None])
        by_form[count[inequality.first], *G.shape].append(group)
        count[inequality.first] += 1
    groups = [_concatenated(alike) for alike in by_form.values()]
    if len(problem.bounded):
        groups.append(InequalityGroup(problem.bounded[None], np.eye(len(problem.bounded))[None], problem.bounds[None]))
    return groups


def log_det_groups(problem: Problem) -> list[InequalityGroup]:
    """The log-dets by weight and number of variables of their body, a body's and its copies' in different groups."""
    by_form: dict[tuple[int, int, float], list[InequalityGroup]] = defaultdict(list)
    count: dict[int, int] = defaultdict(int)  # of log-dets on the same variables
    for term in problem.log_dets:
        variables = np.flatnonzero(problem.S[term.z_slice].any(axis=0))
        G = np.tensordot(problem.S[term.z_slice, variables].T, term.G, axes=1)
        group = InequalityGroup(variables[None], G[None], np.zeros((1, *G.shape[1:])), term.weight)
        by_form[count[term.first], len(variables), term.weight].append(group)
        count[term.first] += 1
    return [_concatenated(alike) for alike in by_form.values()]


def _concatenated(groups: list[InequalityGroup]) -> InequalityGroup:
    """One group of several of the same form and weight."""
    return InequalityGroup(
        variables=np.concatenate([group.variables for group in groups]),
        G=np.concatenate([group.G for group in groups]),
        least=np.concatenate([group.least for group in groups]),
        weight=groups[0].weight,
    )

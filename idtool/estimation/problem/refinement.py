"""An optimum refined until the parameters are at it, not only the cost.

Near its least f is flat: where nothing but a prior of weight w holds a parameter, a cost that is g above the least may
leave it √(g / w) off. So the conditions of the optimum themselves are solved,

    ∇f(x) = Σ ⟨G, Z_i⟩ + (E S)ᵀ nu,  E S x = e,  X_i(x) − margin · 1 = S_i,  S_i Z_i = mu · 1,  S_i, Z_i ⪰ 0,

by Newton's method while mu goes to zero: the primal-dual method with Nesterov and Todd's scaling and Mehrotra's
corrector (Vandenberghe, The CVXOPT linear and quadratic cone program solvers, 2010). R_i is the scaling,
R_i⁻¹ S_i R_i⁻ᵀ = R_iᵀ Z_i R_i = diag(d_i). Each step is a least-squares problem, solved by QR where its columns are all
but dependent, and S_i = P_i P_iᵀ and Z_i = Q_i Q_iᵀ are kept as their factors: the last steps are taken in digits that
normal equations and Z_i itself have lost.

Letters as in `problem`; B inequalities of one form, of K variables and n rows each. One on a vector is n of one row.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.estimation.problem.conic import Solution, svec
from idtool.estimation.problem.problem import Problem

_ACCURACY = 3e-8  # in units of z: a step that is shorter is the last
_MOST_STEPS = 40
_PATIENCE = 4  # steps in a row that are no shorter than one before, after which it ends
_DUAL_UNIT = 0.03  # typical Z at an inequality's limit
_LEAST_MU = 1e-15  # to start with
_CAREFUL, _BOLD = 0.9, 1 - 1e-6  # of the way to the boundary that a step goes
_CORRECTIONS = 3  # of a solution of the linear system, each from the residual of the last
_LEAST_PIVOT = 1e-7  # its square is the share of a computed step's digits that is right
_ONE = np.ones((1, 1))


@dataclass(frozen=True)
class Refined:
    """A refined optimum.

    Attributes
    ----------
    solution
        The optimum and its dual variables.
    error
        Distance of any z from the optimum, by the length of the next step.
    """

    solution: Solution
    error: float


def refine(problem: Problem, solution: Solution) -> Refined | None:
    """Refine a solver's optimum.

    Parameters
    ----------
    problem
        From `problem.build_problem`.
    solution
        Near the optimum, with exact constraints met, and its dual variables.

    Returns
    -------
    The optimum among the bodies that are as far inside their sets as the problem demands; None where the method breaks
    down at once.
    """
    iterates: list[_Iterate] = []
    with suppress(np.linalg.LinAlgError):
        newton = _Newton(problem, solution)
        for steps in range(_MOST_STEPS):
            before, imbalance = newton.solution(steps), newton.imbalance()
            error = newton.step()
            iterates.append(_Iterate(before, error, imbalance))
            if error <= _ACCURACY:
                iterates.append(_Iterate(newton.solution(steps + 1), error, newton.imbalance()))
                break
            errors = [iterate.error for iterate in iterates]
            if min(errors[-_PATIENCE:]) > min(errors):
                break
    if not iterates:
        return None
    nearest = min(reversed(iterates), key=lambda iterate: iterate.error)
    balanced = min(iterates, key=lambda iterate: iterate.imbalance).solution
    solution = replace(nearest.solution, duals=balanced.duals, multipliers=balanced.multipliers)
    return Refined(solution, nearest.error) if np.isfinite(nearest.error) else None


@dataclass(frozen=True)
class _Iterate:
    """A solution, the length of the step from there to the optimum, and the imbalance of its dual variables."""

    solution: Solution
    error: float
    imbalance: float


@dataclass(frozen=True)
class _Row:
    """A matrix inequality, or one entry of an inequality on a vector, and its dual variable.

    Attributes
    ----------
    variables, G, least
        As in `_Form`, of one.
    Z
        Shape (n, n).
    place
        Index of the inequality, or one beyond them for the lower bounds, and of its entry.
    """

    variables: Indices
    G: Array
    least: float
    Z: Array
    place: tuple[int, int]


def _rows(problem: Problem, solution: Solution) -> Iterator[_Row]:
    """All inequalities and, last, the lower bounds."""
    for i, (inequality, Z) in enumerate(zip(problem.inequalities, solution.duals, strict=True)):
        variables = np.arange(inequality.x_slice.start, inequality.x_slice.stop)
        if Z.ndim == 2:
            yield _Row(variables, inequality.G, inequality.interior, _symmetric(Z), (i, 0))
            continue
        for j, multiplier in enumerate(Z):
            yield _Row(variables, inequality.G[:, j, None, None], inequality.interior, multiplier * _ONE, (i, j))
    bounds = zip(problem.bounded, problem.bounds, solution.multipliers, strict=True)
    for j, (k, bound, multiplier) in enumerate(bounds):
        yield _Row(np.array([k]), _ONE[None], bound, multiplier * _ONE, (len(solution.duals), j))


class _Form:
    """The inequalities of one form, with their slack S = P Pᵀ and their dual variables Z = Q Qᵀ.

    Attributes
    ----------
    variables
        Indices of their variables, shape (B, K).
    G
        Shape (B, K, n, n).
    least
        Constant that is subtracted from X, shape (B, n, n).
    P, Q, Z
        Shape (B, n, n).
    places
        As in `_Row`.
    """

    def __init__(self, rows: Sequence[_Row]) -> None:
        self.variables = np.array([row.variables for row in rows])
        self.G = np.array([row.G for row in rows])
        self._one = np.eye(self.G.shape[-1])
        self.least = np.array([row.least for row in rows])[:, None, None] * self._one
        self.Z = np.array([row.Z for row in rows])
        self.places = [row.place for row in rows]
        self.count = self.least.shape[0] * self.least.shape[1]

    def slack(self, x: Array) -> Array:
        """X(x) − margin · 1."""
        return _combined(x[self.variables], self.G) - self.least

    def centre(self, x: Array, mu: float) -> None:
        """Set S and Z to the nearest that have S Z = mu · 1, in units in which both are of one size."""
        values, vectors = np.linalg.eigh(_symmetric(self.slack(x) - self.Z / _DUAL_UNIT))
        product = mu / _DUAL_UNIT
        far = 0.5 * (np.abs(values) + np.sqrt(np.square(values) + 4 * product))
        S = np.where(values > 0, far, product / far)
        self._set(vectors * np.sqrt(S)[:, None], vectors * np.sqrt(mu / S)[:, None])

    def product(self) -> float:
        """Σ ⟨S, Z⟩."""
        return float(np.square(_transposed(self.P) @ self.Q).sum())

    def slope(self, m: int) -> Array:
        """Σ ⟨G, Z⟩ on x, shape (m,)."""
        slope = np.zeros(m)
        np.add.at(slope, self.variables, np.einsum("bkij,bij->bk", self.G, self.Z))
        return slope

    def scale(self, x: Array) -> None:
        """Find the scaling R with d, and the scaled G and residual of S."""
        U, self._d, Vt = np.linalg.svd(_transposed(self.Q) @ self.P)
        root = np.sqrt(self._d)[:, None]
        self._R = self.P @ _transposed(Vt) / root
        self._inverse = _transposed(self.Q @ U / root)
        self._D = self._d[:, None] * self._one
        self._G = self._inverse[:, None] @ self.G @ _transposed(self._inverse)[:, None]
        residual = self.slack(x) - self.P @ _transposed(self.P)
        self._residual = self._inverse @ residual @ _transposed(self._inverse)

    def root(self, m: int) -> Array:
        """Rows whose squares are the barrier's second derivative, shape (B n (n + 1) / 2, m)."""
        entries = _transposed(svec(self._G))
        root = np.zeros((*entries.shape[:2], m))
        for block, variables, values in zip(root, self.variables, entries, strict=True):
            block[:, variables] = values
        return root.reshape(-1, m)

    def target(self, mu: float, second_order: Array | float) -> Array:
        """Sum of the scaled changes of S and Z that leads to S Z = mu · 1, with a second-order term of S Z."""
        residual = mu * self._one - np.square(self._D) - second_order
        return np.asarray(2 * residual / (self._d[:, :, None] + self._d[:, None]))

    def right_side(self, target: Array) -> Array:
        """The target less the residual of S, as entries along `root`."""
        return svec(target - self._residual).ravel()

    def changes(self, dx: Array, target: Array) -> tuple[Array, Array]:
        """The scaled changes of S and Z that go with a step of x."""
        dS = _combined(dx[self.variables], self._G) + self._residual
        return _symmetric(dS), _symmetric(target - dS)

    def rate(self, change: Array) -> float:
        """The least r such that S or Z is singular after the share −1 / r of a scaled change."""
        size = 1 / np.sqrt(self._d)
        return float(np.linalg.eigvalsh(size[:, :, None] * change * size[:, None]).min())

    def product_after(self, share: float, dS: Array, dZ: Array) -> float:
        """Σ ⟨S, Z⟩ after a share of scaled changes."""
        return float(((self._D + share * dS) * (self._D + share * dZ)).sum())

    def move(self, share: float, dS: Array, dZ: Array) -> None:
        """Take a share of scaled changes."""
        P = self._R @ np.linalg.cholesky(self._D + share * dS)
        Q = _transposed(self._inverse) @ np.linalg.cholesky(self._D + share * dZ)
        self._set(P, Q)

    def _set(self, P: Array, Q: Array) -> None:
        self.P, self.Q, self.Z = P, Q, Q @ _transposed(Q)


class _Newton:
    """Newton's method from a solution to the optimum."""

    def __init__(self, problem: Problem, solution: Solution) -> None:
        self._problem, self._solution, self._S = problem, solution, problem.S
        self._root = np.sqrt(2) * problem.A @ problem.S  # of the second derivative of f but for the log-dets
        exact = problem.E @ problem.S
        self._free = np.linalg.qr(exact.T, mode="complete")[0][:, len(exact) :] if len(exact) else None
        self.x = solution.x
        alike: dict[tuple[int, ...], list[_Row]] = defaultdict(list)
        for row in _rows(problem, solution):
            alike[row.G.shape].append(row)
        self._forms = [_Form(rows) for rows in alike.values()]
        self._count = max(sum(form.count for form in self._forms), 1)
        product = sum(float(np.abs((form.slack(self.x) * form.Z).sum())) for form in self._forms)
        for form in self._forms:
            form.centre(self.x, max(product / self._count, _LEAST_MU))

    def step(self) -> float:
        """Take one step of Newton's method; returns the distance of the optimum by it."""
        m = len(self.x)
        for form in self._forms:
            form.scale(self.x)
        barrier = np.concatenate([np.zeros((0, m)), *(form.root(m) for form in self._forms)])
        log_dets = [term.root(self._S @ self.x) @ self._S[term.z_slice] for term in self._problem.log_dets]
        solve = self._factored(np.concatenate([self._root, *log_dets, barrier]))
        mu = sum(form.product() for form in self._forms) / self._count
        downhill = -self._uphill()

        def direction(mu: float, second_order: Sequence[Array | float]) -> tuple[Array, list[tuple[Array, Array]]]:
            targets = [form.target(mu, term) for form, term in zip(self._forms, second_order, strict=True)]
            right_sides = [form.right_side(target) for form, target in zip(self._forms, targets, strict=True)]
            dx = solve(downhill + barrier.T @ np.concatenate([np.zeros(0), *right_sides]))
            return dx, [form.changes(dx, target) for form, target in zip(self._forms, targets, strict=True)]

        dx, changes = direction(0.0, [0.0] * len(self._forms))
        share = min(1.0, self._steps_to_boundary(dx, changes))
        error = float(np.abs(self._S @ dx).max()) / share
        pairs = list(zip(self._forms, changes, strict=True))
        mu_after = sum(form.product_after(share, *change) for form, change in pairs) / self._count
        centring = max(mu_after / mu, 0.0) ** 3 if mu else 0.0
        dx, changes = direction(centring * mu, [_symmetric(dS @ dZ) for dS, dZ in changes])
        share_of_way = min(max(_CAREFUL, 1 - centring), _BOLD)
        share = min(1.0, share_of_way * self._steps_to_boundary(dx, changes))
        self.x = self.x + share * dx
        for form, change in zip(self._forms, changes, strict=True):
            form.move(share, *change)
        return error if np.isfinite(error) else np.inf

    def imbalance(self) -> float:
        """Deviation of slope and dual variables from their balance at the optimum."""
        uphill = self._uphill()
        if self._free is not None:
            uphill = self._free.T @ uphill
        imbalance = float(np.abs(uphill).sum()) + sum(form.product() for form in self._forms)
        return imbalance if np.isfinite(imbalance) else np.inf

    def solution(self, steps: int) -> Solution:
        """The current solution, after so many steps."""
        duals = [Z.copy() for Z in (*self._solution.duals, self._solution.multipliers)]
        for form in self._forms:
            for (i, j), Z in zip(form.places, form.Z, strict=True):
                if duals[i].ndim == 2:
                    duals[i] = Z
                else:
                    duals[i][j] = Z[0, 0]
        iterations = self._solution.iterations + steps
        return replace(self._solution, x=self.x, duals=duals[:-1], multipliers=duals[-1], iterations=iterations)

    def _uphill(self) -> Array:
        """Slope of f less that of the inequalities, shape (m,); at the optimum exact constraints balance it."""
        z = self._S @ self.x
        slope = np.sqrt(2) * self._root.T @ (self._problem.A @ z - self._problem.b)
        for term in self._problem.log_dets:
            slope += self._S[term.z_slice].T @ term.gradient(z)
        return np.asarray(slope - sum(form.slope(len(slope)) for form in self._forms))

    def _factored(self, H: Array) -> Callable[[Array], Array]:
        """The solution dx of Hᵀ H dx = y with E S dx = 0, as a function of y."""
        if self._free is not None:
            H = H @ self._free
        size = 1 / np.linalg.norm(H, axis=0)
        H = H * size
        R = _triangle(H)

        def solve(y: Array) -> Array:
            y = size * (y if self._free is None else self._free.T @ y)
            dx = np.zeros_like(y)
            for _ in range(_CORRECTIONS):
                rest = y - H.T @ (H @ dx)
                dx = dx + solve_triangular(R, solve_triangular(R, rest, trans=1))
            dx = size * dx
            return np.asarray(dx if self._free is None else self._free @ dx)

        return solve

    def _steps_to_boundary(self, dx: Array, changes: Sequence[tuple[Array, Array]]) -> float:
        """Multiple of a step that leads to the boundary."""
        pairs = zip(self._forms, changes, strict=True)
        rates = [form.rate(change) for form, both in pairs for change in both]
        for term in self._problem.log_dets:
            inverse = np.linalg.inv(np.linalg.cholesky(term.matrix(self._S @ self.x)))
            rates.append(float(np.linalg.eigvalsh(inverse @ term.matrix(self._S @ dx) @ inverse.T)[0]))
        least = min(rates, default=0.0)
        return -1 / least if least < 0 else np.inf


def _combined(x: Array, G: Array) -> Array:
    """Σ_k x_k G_k, shapes (B, K) and (B, K, n, n) to (B, n, n)."""
    B, K, n, _ = G.shape
    return np.asarray((x[:, None] @ G.reshape(B, K, n * n)).reshape(B, n, n))


def _triangle(H: Array) -> Array:
    """R with Rᵀ R = Hᵀ H, columns of norm one: by Cholesky's method where that keeps enough digits, else by QR."""
    with suppress(np.linalg.LinAlgError):
        R = _transposed(np.linalg.cholesky(H.T @ H))
        if R.diagonal().min(initial=np.inf) > _LEAST_PIVOT:
            return R
    return np.asarray(np.linalg.qr(H, mode="r"))


def _transposed(matrices: NDArray[Any]) -> Array:
    return np.asarray(matrices.swapaxes(-1, -2))


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + _transposed(matrices)))

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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from idtool.common.arrays import Array, Indices
from idtool.estimation.problem.conic import Solution, svec
from idtool.estimation.problem.problem import Problem

_ACCURACY = 3e-8  # in units of z: a step that is shorter is the last
_STEPS, _PATIENCE = 40, 4  # in all, and in a row that are no shorter than one before
_DUAL_UNIT = 0.03  # typical Z at an inequality's limit
_LEAST = 1e-15  # mu to start with
_CAREFUL, _BOLD = 0.9, 1 - 1e-6  # of the way to the boundary that a step goes
_CORRECTED = 3  # times that a step is computed, from what the last time left
_CONDITIONED = 1e-7  # least pivot: its square is what is left of a computed step's digits
_ONE = np.ones((1, 1))


@dataclass(frozen=True)
class Refined:
    """A refined optimum.

    Attributes
    ----------
    solution
        The optimum and its dual variables.
    error
        How far any z is from the optimum, by the length of the next step.
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
        Near the optimum, what is known exactly met, and its dual variables.

    Returns
    -------
    The optimum among the bodies that are as far inside their sets as the problem demands; None where the method breaks
    down at once.
    """
    passed: list[_Point] = []
    with suppress(np.linalg.LinAlgError):
        path = _Path(problem, solution)
        for steps in range(_STEPS):
            here, imbalance = path.solution(steps), path.imbalance()
            error = path.step()
            passed.append(_Point(here, error, imbalance))
            if error <= _ACCURACY:
                passed.append(_Point(path.solution(steps + 1), error, path.imbalance()))
                break
            errors = [point.error for point in passed]
            if min(errors[-_PATIENCE:]) > min(errors):
                break
    if not passed:
        return None
    nearest = min(reversed(passed), key=lambda point: point.error)
    balanced = min(passed, key=lambda point: point.imbalance).solution
    solution = replace(nearest.solution, duals=balanced.duals, multipliers=balanced.multipliers)
    return Refined(solution, nearest.error) if np.isfinite(nearest.error) else None


@dataclass(frozen=True)
class _Point:
    """A point on the way, the length of the step from there to the optimum, and how far its duals are from balance."""

    solution: Solution
    error: float
    imbalance: float


@dataclass(frozen=True)
class _Row:
    """A matrix inequality, or one entry of an inequality on a vector, and its dual variable.

    Attributes
    ----------
    own, G, least
        As in `_Form`, of one.
    Z
        Shape (n, n).
    place
        Which inequality it is, or one beyond them for the lower bounds, and which of its entries.
    """

    own: Indices
    G: Array
    least: float
    Z: Array
    place: tuple[int, int]


def _rows(problem: Problem, solution: Solution) -> Iterator[_Row]:
    """All inequalities and, last, the lower bounds."""
    for i, (inequality, Z) in enumerate(zip(problem.inequalities, solution.duals, strict=True)):
        own = np.arange(inequality.x_slice.start, inequality.x_slice.stop)
        if Z.ndim == 2:
            yield _Row(own, inequality.G, inequality.interior, _symmetric(Z), (i, 0))
            continue
        for j, multiplier in enumerate(Z):
            yield _Row(own, inequality.G[:, j, None, None], inequality.interior, multiplier * _ONE, (i, j))
    bounds = zip(problem.bounded, problem.bounds, solution.multipliers, strict=True)
    for j, (k, bound, multiplier) in enumerate(bounds):
        yield _Row(np.array([k]), _ONE[None], bound, multiplier * _ONE, (len(solution.duals), j))


class _Form:
    """The inequalities of one form, with their slack S = P Pᵀ and their dual variables Z = Q Qᵀ.

    Attributes
    ----------
    own
        Indices of their variables, shape (B, K).
    G
        Shape (B, K, n, n).
    least
        What is taken off X, shape (B, n, n).
    P, Q, Z
        Shape (B, n, n).
    places
        As in `_Row`.
    """

    def __init__(self, rows: Sequence[_Row]) -> None:
        self.own = np.array([row.own for row in rows])
        self.G = np.array([row.G for row in rows])
        self._one = np.eye(self.G.shape[-1])
        self.least = np.array([row.least for row in rows])[:, None, None] * self._one
        self.Z = np.array([row.Z for row in rows])
        self.places = [row.place for row in rows]
        self.count = self.least.shape[0] * self.least.shape[1]

    def slack(self, x: Array) -> Array:
        """X(x) − margin · 1."""
        return _combined(x[self.own], self.G) - self.least

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
        np.add.at(slope, self.own, np.einsum("bkij,bij->bk", self.G, self.Z))
        return slope

    def scale(self, x: Array) -> None:
        """Find the scaling R with d, and what it makes of G and of what S lacks."""
        U, self._d, Vt = np.linalg.svd(_transposed(self.Q) @ self.P)
        root = np.sqrt(self._d)[:, None]
        self._R = self.P @ _transposed(Vt) / root
        self._inverse = _transposed(self.Q @ U / root)
        self._D = self._d[:, None] * self._one
        self._G = self._inverse[:, None] @ self.G @ _transposed(self._inverse)[:, None]
        lack = self.slack(x) - self.P @ _transposed(self.P)
        self._lack = self._inverse @ lack @ _transposed(self._inverse)

    def root(self, m: int) -> Array:
        """Rows whose squares are the barrier's second derivative, shape (B n (n + 1) / 2, m)."""
        entries = _transposed(svec(self._G))
        root = np.zeros((*entries.shape[:2], m))
        for block, own, values in zip(root, self.own, entries, strict=True):
            block[:, own] = values
        return root.reshape(-1, m)

    def wanted(self, mu: float, bend: Array | float) -> Array:
        """Sum of the scaled changes of S and Z that leads to S Z = mu · 1; ``bend`` is what is of second order."""
        off = mu * self._one - np.square(self._D) - bend
        return np.asarray(2 * off / (self._d[:, :, None] + self._d[:, None]))

    def pull(self, wanted: Array) -> Array:
        """That, without what S lacks, as entries along `root`."""
        return svec(wanted - self._lack).ravel()

    def changes(self, dx: Array, wanted: Array) -> tuple[Array, Array]:
        """The scaled changes of S and Z that go with a step of x."""
        dS = _combined(dx[self.own], self._G) + self._lack
        return _symmetric(dS), _symmetric(wanted - dS)

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


class _Path:
    """The way from a solution to the optimum."""

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
            form.centre(self.x, max(product / self._count, _LEAST))

    def step(self) -> float:
        """Take one step of Newton's method; returns how far the optimum is by it."""
        m = len(self.x)
        for form in self._forms:
            form.scale(self.x)
        barrier = np.concatenate([np.zeros((0, m)), *(form.root(m) for form in self._forms)])
        log_dets = [term.root(self._S @ self.x) @ self._S[term.z_slice] for term in self._problem.log_dets]
        solve = self._factored(np.concatenate([self._root, *log_dets, barrier]))
        mu = sum(form.product() for form in self._forms) / self._count
        downhill = -self._uphill()

        def direction(mu: float, bends: Sequence[Array | float]) -> tuple[Array, list[tuple[Array, Array]]]:
            wanted = [form.wanted(mu, bend) for form, bend in zip(self._forms, bends, strict=True)]
            pulls = [form.pull(one) for form, one in zip(self._forms, wanted, strict=True)]
            dx = solve(downhill + barrier.T @ np.concatenate([np.zeros(0), *pulls]))
            return dx, [form.changes(dx, one) for form, one in zip(self._forms, wanted, strict=True)]

        dx, changes = direction(0.0, [0.0] * len(self._forms))
        share = min(1.0, self._reach(dx, changes))
        error = float(np.abs(self._S @ dx).max()) / share
        pairs = list(zip(self._forms, changes, strict=True))
        left = sum(form.product_after(share, *change) for form, change in pairs) / self._count
        centring = max(left / mu, 0.0) ** 3 if mu else 0.0
        dx, changes = direction(centring * mu, [_symmetric(dS @ dZ) for dS, dZ in changes])
        bold = min(max(_CAREFUL, 1 - centring), _BOLD)
        share = min(1.0, bold * self._reach(dx, changes))
        self.x = self.x + share * dx
        for form, change in zip(self._forms, changes, strict=True):
            form.move(share, *change)
        return error if np.isfinite(error) else np.inf

    def imbalance(self) -> float:
        """How far slope and dual variables are from their balance at the optimum."""
        uphill = self._uphill()
        if self._free is not None:
            uphill = self._free.T @ uphill
        left = float(np.abs(uphill).sum()) + sum(form.product() for form in self._forms)
        return left if np.isfinite(left) else np.inf

    def solution(self, steps: int) -> Solution:
        """Where it has come to after some steps."""
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
        """What the slope of f is not balanced by, shape (m,), but for what is known exactly."""
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
            for _ in range(_CORRECTED):
                rest = y - H.T @ (H @ dx)
                dx = dx + solve_triangular(R, solve_triangular(R, rest, trans=1))
            dx = size * dx
            return np.asarray(dx if self._free is None else self._free @ dx)

        return solve

    def _reach(self, dx: Array, changes: Sequence[tuple[Array, Array]]) -> float:
        """How many times a step leads to the boundary."""
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
        if R.diagonal().min() > _CONDITIONED:
            return R
    return np.asarray(np.linalg.qr(H, mode="r"))


def _transposed(matrices: NDArray[Any]) -> Array:
    return np.asarray(matrices.swapaxes(-1, -2))


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + _transposed(matrices)))

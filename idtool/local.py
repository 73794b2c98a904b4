"""Estimators that keep every body realizable by how they describe it, with no inequality for the solver to see.

- log-Cholesky (Rucker & Wensing, "Smooth parameterization of rigid-body inertia", IEEE RA-L 2022): J = e^{2 alpha} U Uᵀ
  with [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]] = U. Any ten numbers are a body.
- the manifold (Thm 2; Traversaro et al. 2016): pi(R, mu, c, m) with Sigma_C = R diag(mu) Rᵀ, R in SO(3), m ≥ 0. The
  triangle inequalities (13) are mu ≥ 0, by (21).

Both make (27) a nonlinear least-squares problem on the R-factors, solved by scipy from a start. With log-Cholesky a
finite point where the cost is stationary is the global optimum, since dJ may be any symmetric matrix; but where an
inequality is active the optimum lies at infinity, and the cost is flat on the way to every part of the boundary, also
the wrong one. On the manifold this fails where mu coincide or m is zero.

Letters: B bodies; y (B, 10) their coordinates; J (B, 4, 4) pseudo-inertias in units of the bodies, less ``INTERIOR``,
so that what is described is exactly what the convex problem allows; x = z as in `problem`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from idtool.conic import svec
from idtool.exceptions import SolverError
from idtool.inequality import DENSITY
from idtool.inertia import SIZE, from_pseudo_inertia, pseudo_inertia, skew
from idtool.prior import LogDet
from idtool.problem import INTERIOR, Problem

Array = NDArray[np.float64]

_INNER = 1e-3  # least eigenvalue of a start, in units of the body
_SETTINGS: dict[str, Any] = {"method": "trf", "ftol": 1e-10, "xtol": 1e-10, "gtol": 1e-10, "max_nfev": 500}  # of scipy
_SETTLED = 1e-9  # relative gain below which there is no further run
_NUDGE = 1e-9  # of a body's size: what lies nearer than that among the mu coincides
_SERIES = 1e-2  # |λ − 1| below which (λ − 1 − log λ) / (λ − 1)² is summed up
_EQUAL = 1e-5  # relative difference of eigenvalues below which a difference quotient is a derivative


@dataclass(frozen=True)
class Local:
    """What a local estimator found.

    Attributes
    ----------
    x
        Shape (m,), inside all inequalities and bounds of the problem.
    status
        Why scipy stopped, in its words.
    iterations
        Evaluations of the residual.
    seconds
        Wall time.
    """

    x: Array
    status: str
    iterations: int
    seconds: float


class Chart(Protocol):
    """Coordinates y of bodies, ten each, in which every value is realizable.

    Attributes
    ----------
    lower
        Lower bounds of a body's ten, shape (10,).
    runs
        How often scipy is run at the most, each time from coordinates laid anew around where it came to.
    y
        Coordinates of the bodies that the chart was laid around, shape (B, 10).
    """

    lower: ClassVar[Array]
    runs: ClassVar[int]
    y: Array

    def __init__(self, J: Array, slope: Array) -> None: ...

    def pseudo_inertias(self, y: Array) -> Array:
        """J at y, shape (B, 4, 4)."""

    def derivatives(self, y: Array) -> Array:
        """J's with respect to each body's own ten, shape (B, 10, 4, 4)."""


class LogCholesky:
    """The coordinates alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 of Rucker & Wensing; t is the centre of mass.

    Parameters
    ----------
    J
        Where to start, positive definite.
    slope
        Not used: one chart covers all bodies.
    """

    lower: ClassVar[Array] = np.full(SIZE, -np.inf)
    runs: ClassVar[int] = 1
    _rows: ClassVar[NDArray[np.intp]] = np.array([0, 1, 2, 0, 1, 0, 0, 1, 2])
    _columns: ClassVar[NDArray[np.intp]] = np.array([0, 1, 2, 1, 2, 2, 3, 3, 3])

    def __init__(self, J: Array, slope: Array) -> None:
        # Backwards, an upper triangle is a lower one.
        factor = np.linalg.cholesky(J[:, ::-1, ::-1])[:, ::-1, ::-1]
        size = factor[:, 3:, 3]
        self.y = np.column_stack([np.log(size), factor[:, self._rows, self._columns] / size])
        self.y[:, 1:4] = np.log(self.y[:, 1:4])

    def _factors(self, y: Array) -> Array:
        """e^alpha U, shape (B, 4, 4)."""
        U = np.zeros((len(y), 4, 4))
        U[:, self._rows, self._columns] = y[:, 1:]
        U[:, range(3), range(3)] = np.exp(y[:, 1:4])
        U[:, 3, 3] = 1
        return np.asarray(np.exp(y[:, 0])[:, None, None] * U)

    def pseudo_inertias(self, y: Array) -> Array:
        """See `Chart.pseudo_inertias`."""
        U = self._factors(y)
        return np.asarray(U @ U.swapaxes(-1, -2))

    def derivatives(self, y: Array) -> Array:
        """See `Chart.derivatives`."""
        U = self._factors(y)
        dU = np.zeros((len(y), SIZE, 4, 4))
        dU[:, 0] = U
        dU[:, np.arange(1, SIZE), self._rows, self._columns] = np.exp(y[:, :1])
        dU[:, range(1, 4), range(3), range(3)] = U[:, range(3), range(3)]
        half = dU @ U[:, None].swapaxes(-1, -2)
        return np.asarray(half + half.swapaxes(-1, -2))


class Manifold:
    """The coordinates m, c, mu and w of Thm 2, R = R₀ (1 + 2 (S(w) + S(w)²) / (1 + wᵀ w)): w turns about itself.

    J = T diag(mu, m) Tᵀ with T = [[R, c], [0, 1]].

    Where mu coincide, turning R changes nothing, and some changes of J are out of reach to first order. Then R₀ is laid
    along the axes in which the cost's slope is diagonal, so that none of them would make it less.

    Parameters
    ----------
    J
        Where to lay the chart, positive semidefinite.
    slope
        The cost's derivative with respect to J there, shape (B, 4, 4).
    """

    lower: ClassVar[Array] = np.array([0.0, *(-np.inf,) * 3, *(0.0,) * 3, *(-np.inf,) * 3])
    runs: ClassVar[int] = 12

    def __init__(self, J: Array, slope: Array) -> None:
        mass = J[:, 3, 3]
        c = J[:, :3, 3] / np.maximum(mass, np.finfo(float).tiny)[:, None]
        sigma = J[:, :3, :3] - J[:, :3, 3:] * c[:, None]
        down = slope[:, :3, :3]
        size = np.maximum(np.linalg.norm(down, axis=(1, 2), keepdims=True), np.finfo(float).tiny)
        R = np.linalg.eigh(sigma - _NUDGE * down / size)[1]
        self.R = R * np.linalg.det(R)[:, None, None]
        mu = np.einsum("bik,bij,bjk->bk", R, sigma, R)
        self.y = np.column_stack([mass, c, np.maximum(mu, 0), np.zeros((len(J), 3))])

    def _transformations(self, y: Array) -> tuple[Array, Array]:
        """T, and S(w), both (B, 4, 4) and (B, 3, 3)."""
        w = y[:, 7:]
        S = np.array([skew(row) for row in w])
        T = np.zeros((len(y), 4, 4))
        T[:, :3, :3] = self.R @ (np.eye(3) + 2 * (S + S @ S) / (1 + np.square(w).sum(axis=1))[:, None, None])
        T[:, :3, 3] = y[:, 1:4]
        T[:, 3, 3] = 1
        return T, S

    def pseudo_inertias(self, y: Array) -> Array:
        """See `Chart.pseudo_inertias`."""
        T, _ = self._transformations(y)
        return np.asarray((T * _moments(y)[:, None]) @ T.swapaxes(-1, -2))

    def derivatives(self, y: Array) -> Array:
        """See `Chart.derivatives`."""
        T, S = self._transformations(y)
        # dR = R S(u) with u = 2 (dw − w × dw) / (1 + wᵀ w)
        turns = 2 * (np.eye(3) - S) / (1 + np.square(y[:, 7:]).sum(axis=1))[:, None, None]
        dT = np.zeros((len(y), SIZE, 4, 4))
        dT[:, range(1, 4), range(3), 3] = 1
        dT[:, 7:, :3, :3] = np.einsum("bij,ljk,blw->bwik", T[:, :3, :3], _SKEW, turns)
        half = (dT * _moments(y)[:, None, None]) @ T[:, None].swapaxes(-1, -2)
        dJ = half + half.swapaxes(-1, -2)
        rays = T.swapaxes(-1, -2)[:, [3, 0, 1, 2]]  # the axis that each of m, mu stretches
        dJ[:, [0, 4, 5, 6]] += rays[..., :, None] * rays[..., None, :]
        return np.asarray(dJ)


def _moments(y: Array) -> Array:
    """(mu, m), shape (B, 4)."""
    return y[:, [4, 5, 6, 0]]


_SKEW = np.array([skew(e) for e in np.eye(3)])
#: The derivative of pi with respect to each entry of J, shape (4, 4, 10).
_FROM_J = from_pseudo_inertia(np.eye(16).reshape(4, 4, 4, 4))


class Residuals:
    """f as ‖r(z)‖² + constant, z given by a chart's y and the other coefficients: v = (y, others), shape (m,).

    Parameters
    ----------
    problem
        Each of its bodies one pseudo-inertia.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        #: Indices in z of each body's ten, shape (B, 10).
        self.own = np.array([part.first for part in problem.parts], dtype=np.intp)[:, None] + np.arange(SIZE)

    def z(self, chart: Chart, v: Array) -> Array:
        """The coefficients, shape (p',)."""
        z = np.empty(len(v))
        y = v[: self.own.size].reshape(-1, SIZE)
        z[self.own] = from_pseudo_inertia(chart.pseudo_inertias(y) + INTERIOR * np.eye(4))
        z[self._problem.others] = v[self.own.size :]
        return z

    def value(self, z: Array) -> Array:
        """r: the problem's p' rows and ten for every log-det."""
        parts = [spectral(term, z)[0] for term in self._problem.log_dets]
        return np.concatenate([self._problem.A @ z - self._problem.b, *parts])

    def derivative(self, z: Array) -> Array:
        """Of r with respect to z, shape (rows, p')."""
        rows = [self._problem.A]
        for term in self._problem.log_dets:
            rows.append(np.zeros((svec(term.G).shape[1], len(z))))
            rows[-1][:, term.own] = spectral(term, z)[1]
        return np.concatenate(rows)

    def jacobian(self, chart: Chart, v: Array) -> Array:
        """Of r with respect to v, shape (rows, m)."""
        D = self.derivative(self.z(chart, v))
        dpi = from_pseudo_inertia(chart.derivatives(v[: self.own.size].reshape(-1, SIZE)))
        bodies = D[:, self.own].swapaxes(0, 1) @ dpi.swapaxes(-1, -2)  # (B, rows, 10)
        return np.column_stack([*bodies, D[:, self._problem.others]])

    def slope(self, z: Array) -> Array:
        """The derivative of f with respect to each body's J, shape (B, 4, 4)."""
        gradient = 2 * self.derivative(z).T @ self.value(z)
        W = np.einsum("ijk,bk->bij", _FROM_J, gradient[self.own])
        return np.asarray(0.5 * (W + W.swapaxes(-1, -2)))


def spectral(term: LogDet, z: Array) -> tuple[Array, Array]:
    """A log-det as least squares: √weight · phi(X) with phi(λ)² = λ − 1 − log λ, phi of the sign of λ − 1.

    phi is analytic, and Σ phi(λ)² = ‖phi(X)‖² = −log det X + Tr X − n.

    Returns
    -------
    The entries of that matrix, shape (10,), and their derivatives with respect to the ten of z, shape (10, 10): in the
    axes of X those of X times the difference quotients of phi (Daleckii & Krein 1965).
    """
    values, V = np.linalg.eigh(np.tensordot(z[term.own], term.G, axes=1))
    values = np.maximum(values, np.finfo(float).tiny)
    phi, slope = _phi(values)
    gaps = values[:, None] - values
    middle = 0.5 * (values[:, None] + values)
    near = np.abs(gaps) < _EQUAL * middle
    quotients = np.where(near, _phi(middle)[1], (phi[:, None] - phi) / np.where(near, 1.0, gaps))
    weight = np.sqrt(term.weight)
    dphi = V @ (quotients * (V.T @ term.G @ V)) @ V.T
    return weight * svec((V * phi) @ V.T), weight * svec(dphi).T


def _phi(values: Array) -> tuple[Array, Array]:
    """Phi and its derivative: phi = e √h with e = λ − 1 and h = (e − log λ) / e², so phi' = 1 / (2 λ √h)."""
    e = values - 1
    near = np.abs(e) < _SERIES
    series = np.polynomial.polynomial.polyval(np.where(near, -e, 0.0), 1 / np.arange(2.0, 11.0))
    far = np.where(near, 1.0, e)
    root = np.sqrt(np.where(near, series, (far - np.log(values)) / far**2))
    return e * root, 1 / (2 * values * root)


def log_cholesky(problem: Problem, start: Array) -> Local:
    """Solve by log-Cholesky parameters.

    Parameters
    ----------
    problem
        From `problem.build_problem`, every body in the set ``full``.
    start
        z to start from, shape (p',): the prior. Bodies that are not realizable there, or only just, are moved inside.

    Raises
    ------
    SolverError
        If the problem holds what such a description cannot express.
    """
    check(problem, "log_cholesky")
    return _solve(problem, start, LogCholesky)


def manifold(problem: Problem, start: Array) -> Local:
    """Solve on the manifold of Thm 2; see `log_cholesky`."""
    check(problem, "manifold")
    return _solve(problem, start, Manifold)


#: The local estimators by name.
LOCAL = MappingProxyType({"log_cholesky": log_cholesky, "manifold": manifold})


def check(problem: Problem, name: str) -> None:
    """Refuse a problem that has other inequalities than J ⪰ 0 for every body, or exact facts.

    Raises
    ------
    SolverError
        With what to do about it.
    """
    for part in problem.parts:
        inequalities = part.piece.inequalities
        if len(inequalities) != 1 or inequalities[0] is not DENSITY:
            what = f"{name} knows only constraints: full, and {problem.labels[part.body]} has others; use clarabel"
            raise SolverError("solver.name", what)
    if len(problem.e):
        what = f"{name} cannot hold known masses or centres exactly; give them a standard_error, or use clarabel"
        raise SolverError("solver.name", what)


def _solve(problem: Problem, start: Array, kind: type[Chart]) -> Local:
    started = time.perf_counter()
    residuals = Residuals(problem)
    z = start.copy()
    z[residuals.own] = from_pseudo_inertia(_inside(pseudo_inertia(start[residuals.own])))
    z[problem.others] = np.maximum(start[problem.others], problem.lower)
    iterations, cost = 0, np.inf
    for _ in range(kind.runs):
        chart = kind(pseudo_inertia(z[residuals.own]) - INTERIOR * np.eye(4), residuals.slope(z))
        answer = _run(problem, residuals, chart, np.concatenate([chart.y.ravel(), z[problem.others]]))
        z, iterations = residuals.z(chart, answer.x), iterations + int(answer.nfev)
        gain, cost = cost - 2 * answer.cost, 2 * answer.cost
        if gain <= _SETTLED * max(cost + problem.constant, 1.0):
            break
    # S has one 1 in every row and column.
    return Local(problem.S.T @ z, str(answer.message), iterations, time.perf_counter() - started)


def _inside(J: Array) -> Array:
    """The nearest matrices without eigenvalues below ``_INNER``."""
    values, vectors = np.linalg.eigh(J)
    return np.asarray((vectors * np.maximum(values, _INNER)[:, None]) @ vectors.swapaxes(-1, -2))


def _run(problem: Problem, residuals: Residuals, chart: Chart, v: Array) -> Any:
    """Scipy's answer from v."""
    lower = np.concatenate([np.tile(chart.lower, len(residuals.own)), problem.lower])
    with np.errstate(over="ignore", invalid="ignore"):  # scipy takes a shorter step when one leads beyond all numbers
        return least_squares(
            lambda v: residuals.value(residuals.z(chart, v)),
            v,
            jac=lambda v: residuals.jacobian(chart, v),
            bounds=(lower, np.inf),
            **_SETTINGS,
        )

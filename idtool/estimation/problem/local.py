"""Estimators that keep every body realizable by how they describe it, with no inequality for the solver to see.

- log-Cholesky (Rucker & Wensing, "Smooth parameterization of rigid-body inertia", IEEE RA-L 2022): J = e^{2 alpha} U Uᵀ
  with U = [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]. Any ten numbers are a body.
- the manifold (Thm 2; Traversaro et al. 2016): pi(R, mu, c, m) with Sigma_C = R diag(mu) Rᵀ, R in SO(3), m ≥ 0. The
  triangle inequalities (13) are mu ≥ 0, by (21).

Both make (27) a nonlinear least-squares problem on the R-factors. In log-Cholesky parameters a stationary point is the
global optimum, since dJ may be any symmetric matrix; but an optimum on the boundary is at infinity, and the cost is
flat on the way to all of the boundary. On the manifold the first fails where mu coincide or m is zero.

Letters: B bodies; y (B, 10) coordinates; J (B, 4, 4) pseudo-inertias in units of the bodies, less ``INTERIOR``, so that
they fill the convex problem's set; r with f = ‖r‖² + constant; f, x, z as in `problem`, x being z in another order.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import SolverError
from idtool.estimation.problem.conic import svec
from idtool.estimation.problem.prior import LogDet
from idtool.estimation.problem.problem import Problem
from idtool.estimation.problem.variables import INTERIOR
from idtool.robot.inequality import REALIZABLE
from idtool.robot.inertia import PI_SIZE, from_pseudo_inertia, pseudo_inertia, skew

_SETTINGS: dict[str, Any] = {"method": "trf", "ftol": 1e-10, "xtol": 1e-10, "gtol": 1e-10, "max_nfev": 500}  # of scipy
_EDGE = 1e-3  # a start with a lesser eigenvalue, in units of the body, is moved inside
_INSIDE = 3e-2  # least eigenvalue that it is moved to
_LEAST_GAIN = 1e-9  # relative, of a run after which there is another
_NUDGE = 1e-7  # in units of the body, of J down the cost's slope before a chart is laid
_MASSLESS = 1e-12  # least mass, in units of the body, that has a centre
_SERIES = 1e-2  # |λ − 1| below which (λ − 1 − log λ) / (λ − 1)² is summed up
_EQUAL = 1e-5  # relative difference of eigenvalues below which a difference quotient is a derivative
_TINY = float(np.finfo(float).tiny)
_SKEW = np.array([skew(e) for e in np.eye(3)])
_FROM_J = from_pseudo_inertia(np.eye(16).reshape(4, 4, 4, 4))  # d pi / d J, shape (4, 4, 10)
_ROW, _COLUMN = np.array([0, 1, 2, 0, 1, 0, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 2, 3, 3, 3])  # of d, s and t in U


@dataclass(frozen=True)
class LocalSolution:
    """Solution of a local estimator.

    Attributes
    ----------
    x
        Shape (m,), inside all inequalities and bounds.
    status, iterations, seconds
        Reason why scipy stopped, in its words, number of evaluations of the residuals, and wall time.
    """

    x: Array
    status: str
    iterations: int
    seconds: float


class Chart(ABC):
    """Coordinates y of bodies, ten each, in which J = F diag(D) Fᵀ with D = fixed + y · stretch.

    Parameters
    ----------
    J
        Matrices to lay the chart around, shape (B, 4, 4), positive definite or, on the manifold, semidefinite.
    slope
        The cost's derivative with respect to J there, shape (B, 4, 4).
    """

    y: Array  # of J
    lower: ClassVar[Array]  # bounds of a body's ten, shape (10,)
    fixed: ClassVar[float]
    stretch: ClassVar[Array]  # (10, 4)
    runs: ClassVar[int]  # of scipy at the most, each on a chart laid around where it came to

    @abstractmethod
    def __init__(self, J: Array, slope: Array) -> None: ...

    @abstractmethod
    def factors(self, y: Array) -> tuple[Array, Array]:
        """F at y, shape (B, 4, 4), and its derivatives with respect to each body's own ten, shape (B, 10, 4, 4)."""

    def pseudo_inertias(self, y: Array) -> Array:
        """J at y, shape (B, 4, 4)."""
        F = self.factors(y)[0]
        return np.asarray((F * (self.fixed + y @ self.stretch)[:, None]) @ F.swapaxes(-1, -2))

    def derivatives(self, y: Array) -> Array:
        """J's derivatives with respect to each body's own ten, shape (B, 10, 4, 4)."""
        F, dF = self.factors(y)
        D, F = (self.fixed + y @ self.stretch)[:, None, None], F[:, None]
        half = (dF * D + 0.5 * F * self.stretch[:, None]) @ F.swapaxes(-1, -2)
        return np.asarray(half + half.swapaxes(-1, -2))


class LogCholesky(Chart):
    """The coordinates alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3 of Rucker & Wensing; F = e^alpha U."""

    lower = np.full(PI_SIZE, -np.inf)
    fixed = 1.0
    stretch = np.zeros((PI_SIZE, 4))
    runs = 1

    def __init__(self, J: Array, slope: Array) -> None:
        factor = np.linalg.cholesky(J[:, ::-1, ::-1])[:, ::-1, ::-1]  # backwards, a lower triangle is an upper one
        size = factor[:, 3:, 3]
        self.y = np.column_stack([np.log(size), factor[:, _ROW, _COLUMN] / size])
        self.y[:, 1:4] = np.log(self.y[:, 1:4])

    @override
    def factors(self, y: Array) -> tuple[Array, Array]:
        U = np.tile(np.eye(4), (len(y), 1, 1))
        U[:, _ROW, _COLUMN] = y[:, 1:]
        U[:, range(3), range(3)] = np.exp(y[:, 1:4])
        size = np.exp(y[:, :1])
        F = size[..., None] * U
        dF = np.zeros((len(y), PI_SIZE, 4, 4))
        dF[:, 0] = F
        dF[:, range(1, PI_SIZE), _ROW, _COLUMN] = size
        dF[:, range(1, 4), range(3), range(3)] = F[:, range(3), range(3)]
        return F, dF


class Manifold(Chart):
    """The coordinates m, c, mu, w of Thm 2 with R = R₀ (1 + 2 (S(w) + S(w)²) / (1 + wᵀ w)), a turn about w.

    F = [[R, c], [0, 1]]. Where mu coincide or m is zero, R and c may be any, and some changes of J are out of reach to
    first order. So the chart is laid around a point a little down the cost's slope, which tells them apart.
    """

    lower = np.repeat([0.0, -np.inf, 0.0, -np.inf], [1, 3, 3, 3])
    fixed = 0.0
    stretch = np.eye(5)[[3, 4, 4, 4, 0, 1, 2, 4, 4, 4], :4]  # D = (mu, m)
    runs = 12

    def __init__(self, J: Array, slope: Array) -> None:
        J = _with_least_eigenvalue(
            J - _NUDGE * slope / np.maximum(np.linalg.norm(slope, axis=(1, 2), keepdims=True), _TINY), 0.0
        )
        mass = np.maximum(J[:, 3:, 3], _MASSLESS)
        c = J[:, :3, 3] / mass
        mu, R = np.linalg.eigh(J[:, :3, :3] - J[:, :3, 3:] * c[:, None])
        self.R = R * np.linalg.det(R)[:, None, None]
        self.y = np.column_stack([mass, c, np.maximum(mu, 0), np.zeros((len(J), 3))])

    @override
    def factors(self, y: Array) -> tuple[Array, Array]:
        S = np.tensordot(y[:, 7:], _SKEW, axes=1)
        length = 1 + np.square(y[:, 7:]).sum(axis=1)[:, None, None]
        F = np.tile(np.eye(4), (len(y), 1, 1))
        F[:, :3, :3] = self.R @ (np.eye(3) + 2 * (S + S @ S) / length)
        F[:, :3, 3] = y[:, 1:4]
        dF = np.zeros((len(y), PI_SIZE, 4, 4))
        dF[:, range(1, 4), range(3), 3] = 1
        turns = 2 * (np.eye(3) - S) / length  # dR = R S(turns dw)
        dF[:, 7:, :3, :3] = F[:, None, :3, :3] @ np.tensordot(turns.swapaxes(-1, -2), _SKEW, axes=1)
        return F, dF


class Residuals:
    """A problem's r and its derivatives at a chart's y and the other coefficients: v = (y, others), shape (m,)."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.bodies = np.add.outer(
            [piece.first for piece in problem.pieces], np.arange(PI_SIZE)
        )  # indices in z, (B, 10)

    def z(self, chart: Chart, v: Array) -> Array:
        """The coefficients, shape (p',)."""
        z = np.empty(len(v))
        J = chart.pseudo_inertias(v[: self.bodies.size].reshape(-1, PI_SIZE))
        z[self.bodies] = from_pseudo_inertia(J + INTERIOR * np.eye(4))
        z[self._problem.other_coefficients] = v[self.bodies.size :]
        return z

    def at(self, z: Array) -> tuple[Array, Array]:
        """r, the p' rows of the quadratic part and ten for every log-det, and its derivative, shape (rows, p')."""
        residuals = [self._problem.A @ z - self._problem.b]
        derivatives = [self._problem.A]
        for term in self._problem.log_dets:
            r, derivative = spectral(term, z)
            D = np.zeros((len(r), len(z)))
            D[:, term.z_slice] = derivative
            residuals.append(r)
            derivatives.append(D)
        return np.concatenate(residuals), np.concatenate(derivatives)

    def value(self, v: Array, chart: Chart) -> Array:
        """r, shape (rows,)."""
        return self.at(self.z(chart, v))[0]

    def jacobian(self, v: Array, chart: Chart) -> Array:
        """Derivative of r with respect to v, shape (rows, m)."""
        D = self.at(self.z(chart, v))[1]
        dpi = from_pseudo_inertia(chart.derivatives(v[: self.bodies.size].reshape(-1, PI_SIZE)))
        of_bodies = D[:, self.bodies].swapaxes(0, 1) @ dpi.swapaxes(-1, -2)  # (B, rows, 10)
        return np.column_stack([*of_bodies, D[:, self._problem.other_coefficients]])

    def slope(self, z: Array) -> Array:
        """The cost's derivative with respect to each body's J, shape (B, 4, 4)."""
        r, D = self.at(z)
        W = np.einsum("ijk,bk->bij", _FROM_J, (2 * r @ D)[self.bodies])
        return np.asarray(0.5 * (W + W.swapaxes(-1, -2)))


def spectral(term: LogDet, z: Array) -> tuple[Array, Array]:
    """A log-det as least squares: √weight · phi(X), phi(λ) the root of λ − 1 − log λ of the sign of λ − 1, analytic.

    Returns
    -------
    That matrix as `conic.svec`, shape (10,), and its derivative with respect to the ten of z, shape (10, 10): in X's
    own axes the change of X times the difference quotients of phi (Daleckii & Krein 1965).
    """
    X = np.tensordot(z[term.z_slice], term.G, axes=1)
    if not np.isfinite(X).all():
        return np.full(PI_SIZE, np.inf), np.zeros((PI_SIZE, PI_SIZE))
    values, V = np.linalg.eigh(X)
    values = np.maximum(values, _TINY)
    phi, _ = _phi(values)
    gaps = values[:, None] - values
    middle = 0.5 * (values[:, None] + values)
    _, slope = _phi(middle)
    is_equal = np.abs(gaps) < _EQUAL * middle
    quotients = np.where(is_equal, slope, (phi[:, None] - phi) / np.where(is_equal, 1.0, gaps))
    change = V @ (quotients * (V.T @ term.G @ V)) @ V.T
    return np.sqrt(term.weight) * svec((V * phi) @ V.T), np.sqrt(term.weight) * svec(change).T


def _phi(values: Array) -> tuple[Array, Array]:
    """phi(λ) and its derivative: with e = λ − 1 and h = (e − log λ) / e², phi = e √h and phi' = 1 / (2 λ √h)."""
    e = values - 1
    is_small = np.abs(e) < _SERIES
    series = np.polynomial.polynomial.polyval(np.where(is_small, -e, 0.0), 1 / np.arange(2.0, 11.0))
    closed_form = (e - np.log(values)) / np.where(is_small, 1.0, e) ** 2
    root = np.sqrt(np.where(is_small, series, closed_form))
    return e * root, 1 / (2 * values * root)


def log_cholesky(problem: Problem, start: Array) -> LocalSolution:
    """Solve in log-Cholesky parameters.

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
    check_problem(problem, "log_cholesky")
    return _solve(problem, start, LogCholesky)


def manifold(problem: Problem, start: Array) -> LocalSolution:
    """Solve on the manifold of Thm 2; see `log_cholesky`."""
    check_problem(problem, "manifold")
    return _solve(problem, start, Manifold)


LOCAL = {"log_cholesky": log_cholesky, "manifold": manifold}  # by name


def check_problem(problem: Problem, name: str) -> None:
    """Raise a `SolverError` if a problem has exact constraints, or other inequalities than J ⪰ 0 for every body."""
    for variables in problem.pieces:
        inequalities = variables.piece.inequalities
        if len(inequalities) != 1 or inequalities[0] is not REALIZABLE:
            body = problem.body_names[variables.body]
            what = f"{name} supports only constraints: full, but {body} has others; use clarabel"
            raise SolverError("solver.name", what)
    if len(problem.e):
        what = (
            f"{name} cannot keep known masses or centres of mass exactly; give them a standard_error, or use clarabel"
        )
        raise SolverError("solver.name", what)


def _with_least_eigenvalue(J: Array, least: float) -> Array:
    """The nearest matrices with no eigenvalue below ``least``."""
    values, axes = np.linalg.eigh(J)
    return np.asarray((axes * np.maximum(values, least)[:, None]) @ axes.swapaxes(-1, -2))


def _solve(problem: Problem, start: Array, kind: type[Chart]) -> LocalSolution:
    from scipy.optimize import least_squares

    started = time.perf_counter()
    residuals = Residuals(problem)
    z = start.copy()
    J = pseudo_inertia(start[residuals.bodies])
    edge = np.linalg.eigvalsh(J)[:, 0] < _EDGE
    z[residuals.bodies[edge]] = from_pseudo_inertia(_with_least_eigenvalue(J[edge], _INSIDE))
    z[problem.other_coefficients] = np.maximum(start[problem.other_coefficients], problem.lower)
    lower = np.concatenate([np.tile(kind.lower, len(residuals.bodies)), problem.lower])
    iterations = 0
    cost = np.inf
    for _ in range(kind.runs):
        chart = kind(pseudo_inertia(z[residuals.bodies]) - INTERIOR * np.eye(4), residuals.slope(z))
        v = np.concatenate([chart.y.ravel(), z[problem.other_coefficients]])
        with np.errstate(over="ignore", invalid="ignore"):  # scipy goes less far where a step leads beyond all numbers
            answer = least_squares(residuals.value, v, residuals.jacobian, (lower, np.inf), args=(chart,), **_SETTINGS)
        z = residuals.z(chart, answer.x)
        iterations += int(answer.nfev)
        gain = cost - 2 * answer.cost
        cost = 2 * answer.cost
        if gain <= _LEAST_GAIN * max(cost + problem.constant, 1.0):
            break
    return LocalSolution(problem.S.T @ z, str(answer.message), iterations, time.perf_counter() - started)

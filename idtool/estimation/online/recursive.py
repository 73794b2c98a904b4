"""Least squares with forgetting and a bounded gain, within the sets of a problem, sample by sample.

After every sample, w_j (m,) its row on x in joint j's equation and tau_j its torque,

    Lambda_j ← gamma Lambda_j + w_j w_jᵀ,  eta_j ← gamma eta_j + w_j tau_j,
    x = argmin over the sets of ½ xᵀ (Σ_j Lambda_j / sigma_j² + M) x − (Σ_j eta_j / sigma_j² + M prior)ᵀ x,

which is the projection of the unconstrained estimate onto the sets (Remark 5) in the metric of the information;
`Barrier` follows it. The gain, the inverse of the matrix, is bounded by M⁻¹: a deviation from the prior by a body's own
mass and size, or a friction as large as what the joint carries, weighs as much as one standard error of the data. M
does not fade, so what is no longer excited returns to the prior rather than drift.

A joint's noise sigma_j is what the predictions one sample ahead were lately wrong by: no future is in it, and no fit to
the samples that it judges. It weighs all that is remembered alike. As long as the parameters do not fit, their error
counts as noise, so that few samples are not believed more than they deserve.

Letters: m variables x of the problem, theta = T x the p coefficients, nv joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.units import STANDARD_GRAVITY
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import empty
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel
from idtool.robot.sets import ConstraintSet

_GAP = 0.1  # that half the squared distance in standard errors may be above its least
_EARLY = 4.0  # the noise forgets the start, when the parameters were the prior's, with this power of the time
_LEAST_NOISE = 1e-2  # of a joint's torque


class RecursiveFit:
    """The estimate and the information that it follows from.

    Attributes
    ----------
    problem
        Variables x and their constraints.
    T
        theta = T x, shape (p, m).
    units
        Typical size of each coefficient, shape (p,).
    squares, predicted
        Sum of the squared errors of the predictions, each made before the sample was used [(N·m)² or N²], and their
        number; shape (nv,).
    samples
        Number of samples that were used.

    Parameters
    ----------
    equation
        The torque equation.
    model
        Its bodies.
    sets
        One set per body.
    kind
        Kind of prior. A divergence's second-order form takes its place; without one, the Euclidean, to bound the gain.
    equalities
        The equality constraints.

    Raises
    ------
    SolverError
        If nothing fulfils the sets and exact constraints.
    """

    def __init__(
        self,
        equation: LinearModel,
        model: RobotModel,
        sets: Sequence[ConstraintSet],
        kind: str,
        equalities: EqualityConstraints,
    ) -> None:
        data, noise = empty(equation.active()), np.ones(len(equation.joints))
        chosen = Regularization(kind="pullback" if kind in ("pullback", "entropic") else "euclidean", weight=1.0)
        without_prior = Regularization(kind="none")
        self.problem = build_problem(equation, model.bodies, data, sets, chosen, noise, equalities)
        constraints = build_problem(equation, model.bodies, data, sets, without_prior, noise, equalities)
        self.T: Array = (self.problem.K * self.problem.scale) @ self.problem.S
        self.units = units(equation, model)
        P_constraints, q_constraints = _normal(constraints)
        P_all, q_all = _normal(self.problem)
        free = np.array([c.scale is None for c in equation.coefficients]) / self.units
        rows, pull = free[:, None] * self.T, free * equation.prior
        self._of_constraints = (P_constraints, q_constraints)
        self._of_prior = (P_all - P_constraints + rows.T @ rows, q_all - q_constraints + rows.T @ pull)
        self._explaining = np.linalg.lstsq(self.T, np.where(free > 0, 0.0, equation.prior), rcond=None)[0]
        nv = len(equation.joints)
        self._joints = [_Information.of(self.T[active]) for active in equation.active()]
        self._measured, self._explained = np.zeros(nv), np.zeros(nv)
        self._counted = np.zeros(nv)
        self._noise, self._power = np.zeros(nv), np.zeros(nv)
        self.squares, self.predicted, self.samples = np.zeros(nv), np.zeros(nv, dtype=np.intp), 0
        self._barrier = Barrier(self.problem, *self.normal(), _GAP)

    @property
    def theta(self) -> Array:
        """The coefficients as they are estimated now, shape (p,)."""
        return np.asarray(self.T @ self._barrier.x)

    @property
    def noise(self) -> Array:
        """Noise sigma of each joint, shape (nv,) [N·m or N]; 1 where it is not known yet."""
        sigma = np.sqrt(np.maximum(self._noise, _LEAST_NOISE**2 * self._power))
        return np.where(sigma > 0, sigma, 1.0)

    def normal(self) -> tuple[Array, Array]:
        """The matrix, shape (m, m), and the vector, shape (m,), of the function that x minimises."""
        weight = self.noise**-2.0
        # A prior that only holds a place is weaker by as much as the bodies turn out to be heavier.
        explained = float(weight @ self._explained)
        grown = max(float(weight @ self._measured) / explained, 1.0) if explained > 0 else 1.0
        P = self._of_prior[0] / grown + self._of_constraints[0]
        q = self._of_prior[1] / grown + self._of_constraints[1]
        for joint, w in zip(self._joints, weight, strict=True):
            if len(joint.variables) == len(P):  # as with contacts, where this is much faster
                P += w * joint.matrix
            else:
                P[joint.variables[:, None], joint.variables] += w * joint.matrix
            q[joint.variables] += w * joint.vector
        return P, q

    def update(self, W: Array, tau: Array, shares: Array, gamma: float, lately: float, worth: float) -> None:
        """Take in a sample.

        Parameters
        ----------
        W, tau
            Rows on x, shape (nv, m), and torque, shape (nv,) [N·m or N].
        shares
            Share of each joint's row that counts, shape (nv,): 0 for one that does not hold; between 0 and 1 for what
            unknown contact forces leave of it, whose squared error is as much less.
        gamma
            Share of their weight that earlier samples keep.
        lately
            Share that a sample has in the noise.
        worth
            Independent samples that this one is worth.
        """
        defined = shares > 0
        error = np.where(defined, tau - W @ self._barrier.x, 0.0)
        self.squares += error**2
        self.predicted += defined
        self._counted += shares
        self.samples += 1
        positive_shares = np.where(defined, shares, 1.0)  # as divisors
        mean = shares / np.where(defined, self._counted, 1.0)
        self._power += mean * (tau**2 / positive_shares - self._power)
        rate = np.clip(_EARLY * mean, lately * shares, 1.0)
        self._noise += rate * (error**2 / positive_shares - self._noise)
        self._measured += defined * tau**2
        self._explained += defined * np.square(W @ self._explaining)
        for joint, row, torque, is_defined in zip(self._joints, W, tau, defined, strict=True):
            joint.update(row, torque, gamma, worth * float(is_defined))
        self._barrier.move(*self.normal())


@dataclass(frozen=True)
class _Information:
    """Information of one joint's equation: Lambda_j and eta_j on those variables that it depends on."""

    variables: Indices
    matrix: Array
    vector: Array

    @classmethod
    def of(cls, rows: Array) -> _Information:
        """Zero information about an equation whose coefficients are ``rows`` · x."""
        variables = np.flatnonzero(rows.any(axis=0))
        m = len(variables)
        return cls(variables, np.zeros((m, m)), np.zeros(m))

    def update(self, row: Array, torque: float, gamma: float, worth: float) -> None:
        self.matrix[:] *= gamma
        self.vector[:] *= gamma
        if worth:
            w = row[self.variables]
            self.matrix[:] += worth * w[:, None] * w
            self.vector[:] += worth * torque * w


def units(equation: LinearModel, model: RobotModel) -> Array:
    """Typical size of every coefficient, shape (p,): an inertia parameter's own; any other's as a torque.

    That is the weight of the bodies that its joint moves, times their size where it turns: for friction of a rad/s or
    m/s, for a spring of a rad or m.
    """
    coefficients = equation.coefficients
    mass, moment = (
        np.array([c.scale or 0.0 for c in coefficients[k : PI_SIZE * len(model.bodies) : PI_SIZE]]) for k in (0, 1)
    )
    turning = np.array([joint.kind != "prismatic" for joint in model.joints])
    carried = STANDARD_GRAVITY * np.where(turning, moment @ model.support(), mass @ model.support())
    load = {name: float(x) for name, x in zip(equation.joints, carried, strict=True) if x > 0}
    typical = max(load.values(), default=1.0)
    return np.array([c.scale or load.get(c.owner, typical) for c in coefficients])


def _normal(problem: Problem) -> tuple[Array, Array]:
    """The quadratic part of a problem's cost in x, shapes (m, m) and (m,)."""
    rows = problem.A @ problem.S
    return rows.T @ rows, rows.T @ problem.b

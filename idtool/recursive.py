"""Least squares with forgetting and a bounded gain, within the sets of a problem, sample by sample.

After every sample, W (nv, m) its rows on x in units of each joint's noise and tau (nv,) its torque in the same,

    Lambda ← gamma Lambda + Wᵀ W,  eta ← gamma eta + Wᵀ tau,
    x = argmin over the sets of ½ xᵀ (Lambda + M) x − (eta + M prior)ᵀ x,

which is the projection of the unconstrained estimate onto the sets (Remark 5) in the metric of the information;
`Barrier` follows it. The gain (Lambda + M)⁻¹ is bounded by M⁻¹: a deviation from the prior by a body's own mass and
size, or a friction as large as what the joint carries, weighs as much as one standard error of the data. M does not
fade, so what is no longer excited returns to the prior rather than drift.

A joint's noise is what the prediction one sample ahead was lately wrong by. There is no future in it; and as long as
the parameters do not fit, their error counts as noise, so that the first samples are not believed more than they
deserve.

Letters: m variables x of the problem, theta = T x the p coefficients, nv joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idtool.barrier import Barrier
from idtool.config import Regularization
from idtool.inertia import SIZE
from idtool.knowledge import Knowledge
from idtool.model import Model
from idtool.problem import Problem, build_problem
from idtool.reduction import empty
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet

Array = NDArray[np.float64]

_GAP = 0.1  # that half the squared distance in standard errors may be above its least
_LEAST_NOISE = 1e-2  # of a joint's torque
_GRAVITY = 9.81  # m/s²: what a joint carries, it carries on earth


class RecursiveFit:
    """The estimate and what it follows from.

    Attributes
    ----------
    problem
        What x is, and what it fulfils.
    T
        theta = T x, shape (p, m).
    units
        Typical size of each coefficient, shape (p,).
    squares, predicted
        Sum of the squared errors of the predictions, each made before the sample was used [(N·m)² or N²], and their
        number; shape (nv,).
    samples
        How many were used.

    Parameters
    ----------
    equation
        The torque equation.
    model
        Its bodies.
    sets
        One set a body.
    kind
        Of prior. A divergence's second-order form takes its place; without one, the Euclidean: the gain is bounded.
    known
        What is known otherwise.

    Raises
    ------
    SolverError
        If nothing fulfils the sets and what is known exactly.
    """

    def __init__(
        self, equation: LinearModel, model: Model, sets: Sequence[ConstraintSet], kind: str, known: Knowledge
    ) -> None:
        data, noise = empty(equation.active()), np.ones(len(equation.joints))
        chosen = Regularization(kind="pullback" if kind in ("pullback", "entropic") else "euclidean", weight=1.0)
        self.problem, facts = (
            build_problem(equation, model.bodies, data, sets, prior, noise, known)
            for prior in (chosen, Regularization(kind="none"))
        )
        self.T: Array = (self.problem.K * self.problem.scale) @ self.problem.S
        self.units = units(equation, model)
        self._facts, whole = _normal(facts), _normal(self.problem)
        free = np.array([c.scale is None for c in equation.coefficients]) / self.units
        rows, pull = free[:, None] * self.T, free * equation.prior
        self._prior = (whole[0] - self._facts[0] + rows.T @ rows, whole[1] - self._facts[1] + rows.T @ pull)
        self._explaining = np.linalg.lstsq(self.T, np.where(free > 0, 0.0, equation.prior), rcond=None)[0]
        self._measured = self._explained = 0.0
        m, nv = self.problem.variables, len(equation.joints)
        self._Lambda, self._eta = np.zeros((m, m)), np.zeros(m)
        self._noise, self._power = np.zeros(nv), np.zeros(nv)
        self.squares, self.predicted, self.samples = np.zeros(nv), np.zeros(nv, dtype=np.intp), 0
        self._barrier = Barrier(self.problem, *self.normal(), _GAP)

    @property
    def theta(self) -> Array:
        """The coefficients as they are estimated now, shape (p,)."""
        return np.asarray(self.T @ self._barrier.x)

    def normal(self) -> tuple[Array, Array]:
        """Lambda + M, shape (m, m), and eta + M prior, shape (m,)."""
        # A prior that only holds a place is weaker by as much as the bodies turn out to be heavier.
        grown = max(self._measured / self._explained, 1.0) if self._explained > 0 else 1.0
        P, q = (prior / grown + fact for prior, fact in zip(self._prior, self._facts, strict=True))
        P += self._Lambda
        q += self._eta
        return P, q

    def update(
        self, W: Array, tau: Array, defined: NDArray[np.bool_], gamma: float, lately: float, worth: float
    ) -> None:
        """Take in a sample.

        Parameters
        ----------
        W, tau
            Rows on x, shape (nv, m), and torque, shape (nv,) [N·m or N].
        defined
            Which of them hold, shape (nv,).
        gamma
            Share of their weight that earlier samples keep.
        lately
            Share that a sample has in the noise.
        worth
            Independent samples that this one is worth.
        """
        error = np.where(defined, tau - W @ self._barrier.x, 0.0)
        self.squares += error**2
        self.predicted += defined
        self.samples += 1
        weight = np.sqrt(worth) * defined / self._judged(error, np.where(defined, tau, 0.0), defined, lately)
        V, y = W * weight[:, None], tau * weight
        self._Lambda *= gamma
        self._Lambda += V.T @ V
        self._eta *= gamma
        self._eta += y @ V
        self._measured += float(y @ y)
        self._explained += float(np.square(V @ self._explaining).sum())
        self._barrier.move(*self.normal())

    def _judged(self, error: Array, tau: Array, defined: NDArray[np.bool_], lately: float) -> Array:
        """The joints' noise, shape (nv,), after the latest error."""
        mean = defined / np.maximum(self.predicted, 1)
        self._power += mean * (tau**2 - self._power)
        self._noise += np.where(defined, np.maximum(mean, lately), 0.0) * (error**2 - self._noise)
        sigma = np.sqrt(np.maximum(self._noise, _LEAST_NOISE**2 * self._power))
        return np.where(sigma > 0, sigma, 1.0)


def units(equation: LinearModel, model: Model) -> Array:
    """Typical size of every coefficient, shape (p,): an inertia parameter's own; any other's as a torque.

    That is the weight of the bodies that its joint moves, times their size where it turns: for friction of a rad/s or
    m/s, for a spring of a rad or m.
    """
    coefficients = equation.coefficients
    mass, moment = (
        np.array([c.scale or 0.0 for c in coefficients[k : SIZE * len(model.bodies) : SIZE]]) for k in (0, 1)
    )
    turning = np.array([joint.kind != "prismatic" for joint in model.joints])
    carried = _GRAVITY * np.where(turning, moment @ model.support(), mass @ model.support())
    load = {name: float(x) for name, x in zip(equation.joints, carried, strict=True) if x > 0}
    typical = max(load.values(), default=1.0)
    return np.array([c.scale or load.get(c.owner, typical) for c in coefficients])


def _normal(problem: Problem) -> tuple[Array, Array]:
    """The quadratic part of a problem's cost in x, shapes (m, m) and (m,)."""
    rows = problem.A @ problem.S
    return rows.T @ rows, rows.T @ problem.b

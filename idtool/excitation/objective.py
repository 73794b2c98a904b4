"""How good a motion is at telling the base parameters, and how that changes with every number that tells it.

The information of the samples' regressors depends on a sample's q, v and a only. So its derivative by them takes one
regressor more for each joint and each of q, v, a, however many numbers tell the motion; the pattern does the rest.

Letters: nv joints, N coarse samples, r base parameters, p coefficients; x (n,) the numbers that tell a motion.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.excitation.patterns import Pattern, Samples
from idtool.excitation.task import Task

RIDGE = 1e-6  # information that there is beforehand: a standard error of a thousand sizes
_ROUNDED = 0.02  # of the velocity limit over which sign(v) is rounded while searching
_STEPS = (1e-6, 1e-5, 1.0)  # of the differences by q, v, a; columns are linear in a
_FINE = 1.2  # times the clearance wanted: pairs farther apart do not matter
_TOUCH, _NEAR = 1e-3, 5.0  # m, least clearance that is aimed at, and weight of the share of it that is missing
_APART = 1e-4  # rad or m, of the differences of clearance
_SPARE = 0.97  # of the effort limits is used while searching: between coarse samples there may be more
_WEIGHT = 20.0  # of what is more: it is the weight of the robot, mostly, and hardly less where the way is shorter
_WORTH = 1.5  # by which power of a scale the standard errors go, about


class Objective:
    """The criterion's logarithm of a pattern's motions, more where they leave the limits; with its derivative.

    Attributes
    ----------
    best, score
        The best motion looked at so far, and how good it is when scaled to within the limits; less is better.
    evaluations
        How many motions were looked at.
    instants
        When the clearance is looked at, shape (M,) [s].
    price
        Of leaving the limits.

    Parameters
    ----------
    task
        What is to be told.
    pattern
        The family of motions.
    before
        Information there is without the motion, shape (r, r).
    repeats
        How often the motion is run.
    rate
        Of the coarse samples [Hz].
    """

    def __init__(self, task: Task, pattern: Pattern, before: Array, repeats: int, rate: float) -> None:
        self.task, self.pattern = task, pattern
        self.t: Array = np.linspace(0, pattern.seconds, max(int(np.ceil(rate * pattern.seconds)), 10) + 1)
        self.instants: Array = self.t.copy()
        self.price = 1.0
        self.best: Array | None = None
        self.score = np.inf
        self.evaluations = 0
        self._before = before + RIDGE * np.eye(len(before))
        worth = task.independent * float(self.t[1] - self.t[0]) * repeats
        self._units = [
            task.size[own, None] * np.sqrt(worth) / sigma
            for own, sigma in zip(task.columns.own, task.noise, strict=True)
        ]
        self._still = _ROUNDED * task.limits.velocity

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Value and derivative by x, shape (n,)."""
        task, samples = self.task, self.pattern.motion(x, self.t)
        self.evaluations += 1
        blocks = task.blocks(samples, self.t, self._still)
        value, weights = self._information(blocks)
        tau = np.array([theta @ b[:-1] - b[-1] for theta, b in zip(self._thetas(), blocks, strict=True)])
        outside, by, by_tau = self._outside(samples, tau)
        nearness, by_clearance, least = self._nearness(x)
        for w, theta, push in zip(weights, self._thetas(), by_tau, strict=True):
            w[:-1] += theta[:, None] * push
            w[-1] -= push
        total = self._differences(samples, blocks, weights, by)
        self._remember(x, value, samples, tau, least)
        return value + outside + nearness, self.pattern.gradient(x, self.t, total) + by_clearance

    def information(self, x: Array) -> Array:
        """All there would be with the motion, about the base parameters in units of their sizes, shape (r, r)."""
        return self._all(self.task.blocks(self.pattern.motion(x, self.t), self.t, self._still))[0]

    def _thetas(self) -> list[Array]:
        return [self.task.theta[active] for active in self.task.equation.active()]

    def _information(self, blocks: list[Array]) -> tuple[float, list[Array]]:
        """The criterion, and its derivative by the equation's columns, (m_j + 1, N) a joint; of the last it is 0."""
        M, scaled = self._all(blocks)
        value, by_M = self.task.aim.search(M)
        weights = []
        for j, Y in enumerate(scaled):
            own = self.task.columns.own[j]
            by = self.task.columns.back(j, 2 * self._units[j] * (by_M[np.ix_(own, own)] @ Y))
            weights.append(np.concatenate([by, np.zeros((1, by.shape[1]))]))
        return value, weights

    def _all(self, blocks: list[Array]) -> tuple[Array, list[Array]]:
        """The information with what was there before (r, r), and the base parameters' columns (r_j, N) it is of."""
        M, scaled = self._before.copy(), []
        for j, block in enumerate(blocks):
            own = self.task.columns.own[j]
            scaled.append(self.task.columns.of(j, block[:-1]) * self._units[j])
            M[np.ix_(own, own)] += scaled[-1] @ scaled[-1].T
        return M, scaled

    def _differences(self, samples: Samples, blocks: list[Array], weights: list[Array], by: Samples) -> Samples:
        """Derivatives by q, v and a of what has the derivatives ``weights`` by the columns, and ``by`` itself."""
        for which, step in enumerate(_STEPS):
            for k in range(len(samples.q)):
                moved = samples[which].copy()
                moved[k] += step
                near = samples._replace(**{samples._fields[which]: moved})
                other = self.task.blocks(near, self.t, self._still)
                for w, b, c in zip(weights, blocks, other, strict=True):
                    by[which][k] += np.einsum("mn,mn->n", w, c - b) / step
        return by

    def _outside(self, samples: Samples, tau: Array) -> tuple[float, Samples, Array]:
        """The price of leaving the limits, and its derivatives by q, v, a and tau."""
        limits, share = self.task.limits, self.price / len(self.t)
        parts = (
            (samples.q - limits.middle[:, None], limits.half),
            (samples.v, limits.velocity),
            (samples.a, limits.acceleration),
            (tau, _SPARE * limits.effort),
        )
        value, derivatives = 0.0, list[Array]()
        for x, limit in parts:
            excess = np.maximum(np.abs(x) / limit[:, None] - 1, 0.0)
            value += share * float(np.square(excess).sum())
            derivatives.append(2 * share * excess * np.sign(x) / limit[:, None])
        by_q, by_v, by_a, by_tau = derivatives
        return value, Samples(by_q, by_v, by_a), by_tau

    def _nearness(self, x: Array) -> tuple[float, Array, float]:
        """The price of links that come too near to each other, its derivative by x, and the least clearance [m]."""
        task = self.task
        if task.collision is None or not task.collision.pairs:
            return 0.0, np.zeros_like(x), np.inf
        q = self.pattern.motion(x, self.instants).q
        clearance = task.collision.clearance(q)
        wanted = max(_FINE * task.clearance, _TOUCH)
        excess = np.maximum(1 - clearance / wanted, 0.0)
        near, by = np.flatnonzero(excess), np.zeros_like(q)
        share = self.price / len(self.t)
        for k in range(len(q) if len(near) else 0):
            moved = q[:, near].copy()
            moved[k] += _APART
            change = (task.collision.clearance(moved) - clearance[near]) / _APART
            by[k, near] = -2 * share * excess[near] * change / wanted
        gradient = self.pattern.gradient(x, self.instants, Samples(by, np.zeros_like(by), np.zeros_like(by)))
        return share * float(np.square(excess).sum()), gradient, float(clearance.min())

    def watch(self, t: Array) -> None:
        """Look at the clearance at these instants too, and forget which motion was the best [s]."""
        self.instants = np.union1d(self.instants, t)
        self.score = np.inf

    def _remember(self, x: Array, value: float, samples: Samples, tau: Array, clearance: float) -> None:
        """Keep the motion if it is the best; one that leaves the limits counts as if it were scaled."""
        *motion, effort = self.task.limits.use(*samples, tau).max(axis=1)
        score = (
            value
            + _WORTH * np.log(max(*motion, 1.0))
            + _NEAR * max(1 - clearance / max(self.task.clearance, _TOUCH), 0.0)
        )
        score += _WEIGHT * max(effort / _SPARE - 1, 0.0)
        if score < self.score:
            self.best, self.score = x.copy(), score

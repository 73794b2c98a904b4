"""Objective of the trajectory design and its gradient.

The information of the samples' regressors depends on a sample's q, v and a only. So its derivatives with respect to
these take one more regressor for each joint and each of q, v, a, however many parameters the motion has; the pattern
applies the chain rule.

Letters: nv joints, N coarse samples, r base parameters, p coefficients; x (n,) the parameters of a motion.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.excitation.feasibility import collision_times
from idtool.excitation.patterns import MotionSamples, Pattern, TrajectorySegment
from idtool.excitation.task import DesignTask

RIDGE = 1e-6  # information that is always added: a standard error of a thousand scales
SIGN_WIDTH = 0.02  # of the velocity limit, over which sign(v) is smoothed while searching
_STEPS = (1e-6, 1e-5, 1.0)  # of the differences by q, v, a; columns are linear in a
_CLEARANCE_MARGIN = 1.2  # times the wanted clearance: farther pairs have no penalty
_MIN_CLEARANCE = 1e-3  # m, that is aimed at
_CLEARANCE_STEP = 1e-4  # rad or m, of the differences of clearance
_EFFORT_SHARE = 0.97  # of the effort limits is used while searching: between coarse samples there may be more
# A motion beyond the limits is compared with others as if it were scaled. These price the scaling:
_MOTION_PRICE = 1.5  # power of the scale with which the standard errors grow, about
_EFFORT_PRICE = 20.0  # high, since most of the effort is weight, which a smaller motion hardly reduces
_CLEARANCE_PRICE = 5.0  # for the missing share of the clearance


class Objective:
    """Logarithm of the criterion of a pattern's motions plus penalties outside the limits, with its gradient.

    Attributes
    ----------
    best, best_score
        The best motion so far, and its value when scaled to the limits; less is better.
    evaluations
        Number of motions evaluated.
    clearance_times
        Times at which the clearance is evaluated, shape (M,) [s].
    penalty_weight
        Weight of the penalties.

    Parameters
    ----------
    task
        Robot, limits and criterion.
    pattern
        The family of motions.
    information
        Information from other data, shape (r, r).
    repeats
        How often the motion is run.
    rate
        Of the coarse samples [Hz].
    """

    def __init__(self, task: DesignTask, pattern: Pattern, information: Array, repeats: int, rate: float) -> None:
        self.task = task
        self.pattern = pattern
        intervals = max(int(np.ceil(rate * pattern.duration)), 10)
        self.t: Array = np.linspace(0, pattern.duration, intervals + 1)
        self.clearance_times: Array = self.t.copy()
        self.penalty_weight = 1.0
        self.best: Array | None = None
        self.best_score = np.inf
        self.evaluations = 0
        self._other_information = information + RIDGE * np.eye(len(information))
        self._sign_width = SIGN_WIDTH * task.limits.velocity
        # Factors of each joint's rows, by base parameter: their scales over the noise, times √ of the independent
        # samples per row.
        samples_per_row = task.independent_rate * float(self.t[1] - self.t[0]) * repeats
        self._units: list[Array] = []
        for columns, noise in zip(task.columns.joint_columns, task.noise, strict=True):
            self._units.append(task.scales[columns, None] * np.sqrt(samples_per_row) / noise)

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Value, and gradient with respect to x, shape (n,)."""
        samples = self.pattern.motion(x, self.t)
        self.evaluations += 1
        blocks = self.task.blocks(samples, self.t, self._sign_width)
        value, by_columns = self._criterion(blocks)

        thetas = [self.task.theta[active] for active in self.task.equation.active()]
        tau = np.array([theta @ block[:-1] - block[-1] for theta, block in zip(thetas, blocks, strict=True)])
        limit_penalty, by_samples, by_tau = self._limit_penalty(samples, tau)
        for by_joint_columns, theta, by_joint_tau in zip(by_columns, thetas, by_tau, strict=True):
            by_joint_columns[:-1] += theta[:, None] * by_joint_tau
            by_joint_columns[-1] -= by_joint_tau
        self._add_column_gradient(by_samples, samples, blocks, by_columns)

        clearance_penalty, clearance_gradient, clearance = self._clearance_penalty(x)
        self._keep_if_best(x, value, samples, tau, clearance)
        gradient = self.pattern.gradient(x, self.t, by_samples) + clearance_gradient
        return value + limit_penalty + clearance_penalty, gradient

    def information(self, x: Array) -> Array:
        """Information on the base parameters in units of their scales, with the other data's, shape (r, r)."""
        blocks = self.task.blocks(self.pattern.motion(x, self.t), self.t, self._sign_width)
        return self._information(blocks)[0]

    def collision_times(self, x: Array) -> Array:
        """Times at which links are too near to each other, in the motion scaled to the motion limits [s]."""
        return collision_times(self.task, TrajectorySegment(self.pattern, x))

    def add_clearance_times(self, t: Array) -> None:
        """Evaluate the clearance at these times [s] too, and forget the score of the best motion."""
        self.clearance_times = np.union1d(self.clearance_times, t)
        self.best_score = np.inf

    def _criterion(self, blocks: list[Array]) -> tuple[float, list[Array]]:
        """Logarithm of the criterion, and its derivatives by the equation's columns, (m_j + 1, N) a joint.

        The derivatives by the last column are 0.
        """
        M, base_columns = self._information(blocks)
        value, by_M = self.task.criterion.smooth_log(M)
        derivatives = []
        for j, Y in enumerate(base_columns):
            columns = self.task.columns.joint_columns[j]
            by_Y = 2 * self._units[j] * (by_M[np.ix_(columns, columns)] @ Y)
            by_block = self.task.columns.project_gradient(j, by_Y)
            derivatives.append(np.concatenate([by_block, np.zeros((1, by_block.shape[1]))]))
        return value, derivatives

    def _information(self, blocks: list[Array]) -> tuple[Array, list[Array]]:
        """Information (r, r), and the scaled columns of the base parameters, (r_j, N) a joint."""
        M = self._other_information.copy()
        base_columns = []
        for j, block in enumerate(blocks):
            columns = self.task.columns.joint_columns[j]
            Y = self.task.columns.project(j, block[:-1]) * self._units[j]
            M[np.ix_(columns, columns)] += Y @ Y.T
            base_columns.append(Y)
        return M, base_columns

    def _add_column_gradient(
        self, gradient: MotionSamples, samples: MotionSamples, blocks: list[Array], by_columns: list[Array]
    ) -> None:
        """Add to derivatives by q, v, a those by the columns, by finite differences of the columns."""
        for signal, step in enumerate(_STEPS):
            for k in range(len(samples.q)):
                shifted = samples[signal].copy()
                shifted[k] += step
                shifted_samples = samples._replace(**{samples._fields[signal]: shifted})
                shifted_blocks = self.task.blocks(shifted_samples, self.t, self._sign_width)
                for by_block, block, shifted_block in zip(by_columns, blocks, shifted_blocks, strict=True):
                    change = shifted_block - block
                    gradient[signal][k] += np.einsum("mn,mn->n", by_block, change) / step

    def _limit_penalty(self, samples: MotionSamples, tau: Array) -> tuple[float, MotionSamples, Array]:
        """Penalty outside the limits, and its derivatives by q, v, a and by tau."""
        limits = self.task.limits
        weight = self.penalty_weight / len(self.t)
        signals = (
            (samples.q - limits.middle[:, None], limits.half_range),
            (samples.v, limits.velocity),
            (samples.a, limits.acceleration),
            (tau, _EFFORT_SHARE * limits.effort),
        )
        penalty = 0.0
        derivatives: list[Array] = []
        for values, limit in signals:
            excess = np.maximum(np.abs(values) / limit[:, None] - 1, 0.0)
            penalty += weight * float(np.square(excess).sum())
            derivatives.append(2 * weight * excess * np.sign(values) / limit[:, None])
        by_q, by_v, by_a, by_tau = derivatives
        return penalty, MotionSamples(by_q, by_v, by_a), by_tau

    def _clearance_penalty(self, x: Array) -> tuple[float, Array, float]:
        """Penalty of links that are too near to each other, its gradient by x, and the smallest clearance [m]."""
        task = self.task
        if task.collision is None or not task.collision.pairs:
            return 0.0, np.zeros_like(x), np.inf
        q = self.pattern.motion(x, self.clearance_times).q
        clearance = task.collision.clearance(q)
        wanted = max(_CLEARANCE_MARGIN * task.clearance, _MIN_CLEARANCE)
        missing = np.maximum(1 - clearance / wanted, 0.0)
        weight = self.penalty_weight / len(self.t)
        penalty = weight * float(np.square(missing).sum())

        too_near = np.flatnonzero(missing)
        by_q = np.zeros_like(q)
        if len(too_near):
            for k in range(len(q)):
                shifted = q[:, too_near].copy()
                shifted[k] += _CLEARANCE_STEP
                slope = (task.collision.clearance(shifted) - clearance[too_near]) / _CLEARANCE_STEP
                by_q[k, too_near] = -2 * weight * missing[too_near] * slope / wanted
        zero = np.zeros_like(by_q)
        gradient = self.pattern.gradient(x, self.clearance_times, MotionSamples(by_q, zero, zero))
        return penalty, gradient, float(clearance.min())

    def _keep_if_best(self, x: Array, value: float, samples: MotionSamples, tau: Array, clearance: float) -> None:
        """Keep the motion if it is the best; one that leaves the limits counts as if it were scaled."""
        *motion, effort = self.task.limits.utilization(*samples, tau).max(axis=1)
        wanted = max(self.task.clearance, _MIN_CLEARANCE)
        score = (
            value
            + _MOTION_PRICE * np.log(max(*motion, 1.0))
            + _CLEARANCE_PRICE * max(1 - clearance / wanted, 0.0)
            + _EFFORT_PRICE * max(effort / _EFFORT_SHARE - 1, 0.0)
        )
        if score < self.best_score:
            self.best = x.copy()
            self.best_score = score

"""Objective of the design of a standing trajectory, and its gradient.

Information and loads of a sample depend on the independent coordinates u, du/dt and d²u/dt² of this sample only. By
each of these, one more regressor gives the derivatives of all.

Letters: N coarse samples, d independent coordinates, r base parameters, n joints; x the parameters of a motion.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.excitation.objective import RIDGE, SIGN_WIDTH
from idtool.excitation.patterns import MotionSamples, Pattern
from idtool.excitation.standing.kinematics import StandingSamples, Tangents
from idtool.excitation.standing.robot import Loads
from idtool.excitation.standing.task import StandingTask, joint_samples

_STEPS = (1e-7, 1e-6, 1e-4)  # of the differences by u, du/dt and d²u/dt²
_EFFORT_SHARE = 0.95  # of the effort limits is used while searching
_LOAD_MARGIN = 0.02  # of an even load, by which the ground's limits are tightened while searching
_CLEARANCE_MARGIN = 1.2  # times the wanted clearance: farther pairs have no penalty
_CLEARANCE_PRICE = 5.0  # for the missing share of the clearance
_EXCESS_PRICE = 3.0  # for the largest violation, as a share of a limit; about what scaling costs
_UNREACHED = 10.0  # penalty of a sample in which the feet don't reach the ground


class StandingObjective:
    """Logarithm of the criterion of motions of a standing robot plus penalties outside the limits, with its gradient.

    Attributes
    ----------
    best, best_score
        The best motion so far, and its value with a price for what is beyond the limits; less is better.
    evaluations
        Number of motions evaluated.
    penalty_weight
        Weight of the penalties.
    sign_width
        Velocity over which sign(v) is smoothed, shape (nv,) [rad/s or m/s].
    selections
        See `StandingTask.base_selections`.

    Parameters
    ----------
    task
        Robot, limits and criterion.
    pattern
        The family of motions of the independent coordinates.
    information
        Information from other data, shape (r, r).
    repeats
        How often the motion is run.
    rate
        Of the coarse samples [Hz].
    """

    def __init__(self, task: StandingTask, pattern: Pattern, information: Array, repeats: int, rate: float) -> None:
        self.task = task
        self.pattern = pattern
        intervals = max(int(np.ceil(rate * pattern.duration)), 10)
        self.t: Array = np.linspace(0, pattern.duration, intervals + 1)
        self.penalty_weight = 1.0
        self.best: Array | None = None
        self.best_score = np.inf
        self.evaluations = 0
        self._other_information = information + RIDGE * np.eye(len(information))
        n = task.model.joint_count
        self.sign_width: Array = np.ones(len(task.model.joints))
        self.sign_width[:n] = SIGN_WIDTH * task.limits.velocity
        self._samples_per_row = task.independent_rate * float(self.t[1] - self.t[0]) * repeats
        self.selections = task.base_selections()
        self._guess: Array | None = None  # configurations of the motion that was evaluated before

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Value, and gradient with respect to x, shape (number of parameters,)."""
        self.evaluations += 1
        u = self.pattern.motion(x, self.t)
        samples = self._samples(u)
        center = _State(self, samples)
        value, by_blocks, by_projector = self._criterion(center)
        penalties = self._penalties(center)
        total = value + self.penalty_weight * float(penalties.mean()) + self._unreached_penalty(u, samples)[0]

        weight = self.penalty_weight / len(self.t)
        gradient = MotionSamples(*(np.zeros_like(signal) for signal in u))
        tangents = self.task.kinematics.tangents(samples)
        for signal, step in enumerate(_STEPS):
            for k in range(len(u.q)):
                moved = _moved(self.task, samples, tangents, signal, k, step)
                state = _State(self, moved, None if signal == 0 else center)
                change = np.zeros(len(self.t))
                for by_block, block, moved_block in zip(by_blocks, center.blocks, state.blocks, strict=True):
                    change += np.einsum("nm,mn->n", by_block, moved_block[:-1] - block[:-1])
                if signal == 0:
                    change += np.einsum("nij,nij->n", by_projector, state.projector - center.projector)
                change += weight * (self._penalties(state) - penalties)
                gradient[signal][k] = np.where(samples.is_reached, change / step, 0.0)
        gradient.q[:] += self._unreached_penalty(u, samples)[1]
        self._keep_if_best(x, value, center)
        return total, self.pattern.gradient(x, self.t, gradient)

    def information(self, x: Array) -> Array:
        """Information on the base parameters in units of their scales, with the other data's, shape (r, r)."""
        state = _State(self, self._samples(self.pattern.motion(x, self.t)))
        return self._information(state)[0]

    def collision_times(self, x: Array) -> Array:
        """No times: the clearance is evaluated at the coarse samples."""
        return np.zeros(0)

    def add_clearance_times(self, t: Array) -> None:
        """Do nothing: the clearance is evaluated at the coarse samples."""

    def _samples(self, u: MotionSamples) -> StandingSamples:
        """Motion of the robot; where the feet do not reach the ground, the stance."""
        samples = self.task.kinematics.samples(*u, guess=self._guess)
        if not samples.is_reached.all():
            samples = self.task.kinematics.samples(*u)
        self._guess = samples.w
        if samples.is_reached.all():
            return samples
        self._guess = None
        home = self.task.kinematics.home[:, None]
        replaced = MotionSamples(
            np.where(samples.is_reached, u.q, home),
            np.where(samples.is_reached, u.v, 0.0),
            np.where(samples.is_reached, u.a, 0.0),
        )
        return self.task.kinematics.samples(*replaced)._replace(is_reached=samples.is_reached)

    def _unreached_penalty(self, u: MotionSamples, samples: StandingSamples) -> tuple[float, Array]:
        """Penalty where the feet do not reach the ground, and its derivatives by u, shape (d, N)."""
        weight = self.penalty_weight * _UNREACHED / len(self.t)
        is_missing = ~samples.is_reached
        excursion = (u.q - self.task.kinematics.home[:, None]) / self.task.coordinate_limits.half_range[:, None]
        value = weight * float((1 + np.square(excursion).sum(axis=0))[is_missing].sum())
        slope = 2 * weight * excursion / self.task.coordinate_limits.half_range[:, None]
        return value, np.where(is_missing, slope, 0.0)

    def _criterion(self, state: _State) -> tuple[float, list[Array], Array]:
        """Logarithm of the criterion, its derivatives by each row's columns, (N, m_j), and by the projector."""
        M, rows = self._information(state)
        value, by_M = self.task.criterion.smooth_log(M)
        by_rows = 2 * self._samples_per_row * (rows @ by_M)  # by the rows before the projection
        by_blocks = []
        for row, selection in enumerate(self.selections):
            by_blocks.append((by_rows[:, row] / self.task.noise[row]) @ selection.T)
        free = state.free_rows
        by_projector = self._samples_per_row * (free @ by_M) @ free.transpose(0, 2, 1)
        return value, by_blocks, by_projector

    def _information(self, state: _State) -> tuple[Array, Array]:
        """Information (r, r), and the rows behind the elimination of contact forces, shape (N, nv, r)."""
        rows = state.projector @ state.free_rows
        flat = rows.reshape(-1, rows.shape[2])
        return self._other_information + self._samples_per_row * flat.T @ flat, rows

    def _penalties(self, state: _State) -> Array:
        """Squares of what is beyond the limits, as a share of these, summed for every sample, shape (N,)."""
        limits = self.task.limits
        q, v, a = joint_samples(self.task, state.samples)
        signals = (
            ((q - limits.middle[:, None]), limits.half_range),
            (v, limits.velocity),
            (a, limits.acceleration),
            (state.loads.torque, _EFFORT_SHARE * limits.effort),
        )
        robot = self.task.robot
        penalty = np.square(robot.forces.violations(state.loads.ground, robot.even_load, _LOAD_MARGIN))
        for values, limit in signals:
            penalty += np.square(np.maximum(np.abs(values) / limit[:, None] - 1, 0.0)).sum(axis=0)
        penalty += np.square(self.task.excess(state.samples)).sum(axis=0)
        return np.asarray(penalty + np.square(state.missing_clearance))

    def _keep_if_best(self, x: Array, value: float, state: _State) -> None:
        """Keep the motion if it is the best, with a price for what is beyond the limits."""
        if not state.samples.is_reached.all():
            return
        limits = self.task.limits
        use = limits.utilization(*joint_samples(self.task, state.samples), state.loads.torque)
        excess = max(float(use.max()) - 1, 0.0, float(self.task.excess(state.samples).max()))
        excess += float(state.loads.violation.max())
        missing = float(state.missing_clearance.max(initial=0.0))
        score = value + _EXCESS_PRICE * excess + _CLEARANCE_PRICE * missing
        if score < self.best_score:
            self.best = x.copy()
            self.best_score = score


class _State:
    """Columns of the torque equation, loads and clearance at samples.

    Parameters
    ----------
    objective
        Whose task, times and sign width are used.
    samples
        The samples.
    same_posture
        A state with the same postures, whose Jacobians are the same; None: there is none.
    """

    def __init__(
        self, objective: StandingObjective, samples: StandingSamples, same_posture: _State | None = None
    ) -> None:
        task = objective.task
        equation = task.equation
        self.samples = samples
        motion = task.standing_motion(samples, objective.t, objective.sign_width)
        self.blocks = equation.columns(motion)
        required = np.zeros_like(motion.tau)
        for row, (active, block) in enumerate(zip(equation.active_in_columns(), self.blocks, strict=True)):
            required[row] = task.theta[active] @ block[:-1] - block[-1]
        if same_posture is None:
            if equation.contacts is None:
                raise AssertionError  # a floating base has contacts
            self.jacobian = task.kinematics.foot_jacobian(samples.w)
            self.projector = equation.contacts.projector(motion, {})
            self.missing_clearance = self._missing_clearance(task)
        else:
            self.jacobian = same_posture.jacobian
            self.projector = same_posture.projector
            self.missing_clearance = same_posture.missing_clearance
        self.loads: Loads = task.robot.loads(required, self.jacobian, list(task.soles))
        self._selections = objective.selections
        self._noise = task.noise

    @property
    def free_rows(self) -> Array:
        """Rows of the base parameters in units of the noise, before the projection, shape (N, nv, r)."""
        rows = [block[:-1].T @ selection for block, selection in zip(self.blocks, self._selections, strict=True)]
        return np.asarray(np.stack(rows, axis=1) / self._noise[:, None])

    def _missing_clearance(self, task: StandingTask) -> Array:
        """Share of the wanted clearance that is missing, shape (N,)."""
        if task.collision is None or not task.collision.pairs or not task.clearance:
            return np.zeros(self.samples.w.shape[1])
        wanted = _CLEARANCE_MARGIN * task.clearance
        return np.maximum(1 - task.collision.clearance(self.samples.motion.q) / wanted, 0.0)


def _moved(
    task: StandingTask, samples: StandingSamples, tangents: Tangents, signal: int, coordinate: int, step: float
) -> StandingSamples:
    """Samples with one independent coordinate, or its first or second derivative, larger by a step."""
    first, rate, second = (step * tangent[:, :, coordinate].T for tangent in tangents)
    w, dw, ddw = samples.w, samples.dw, samples.ddw
    if signal == 0:
        return task.kinematics.assemble(w + first, dw + rate, ddw + second, samples.is_reached)
    if signal == 1:
        return task.kinematics.assemble(w, dw + first, ddw + 2 * rate, samples.is_reached)
    return task.kinematics.assemble(w, dw, ddw + first, samples.is_reached)

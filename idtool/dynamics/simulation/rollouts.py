"""`Rollouts`: forward dynamics with dry friction; many rollouts advance together, each in its own steps.

Between changes of the friction's direction the motion is smooth and is integrated by the classical Runge–Kutta method
of order 4, or, where springs and dampers are so stiff that it would take very short steps, by a linearly implicit
method of order 2. The moment at which a joint comes to rest is found (by the cubic through the velocities and
accelerations at both ends of the step), and sticking is a constraint, not a stiff force: the acceleration is zero as
long as the friction that this takes is within its level. So nothing drifts at rest, and the step need not be small for
friction's sake.

Shapes: nv joints, W rollouts, w of them in one step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.forces import BaseMotionFunction, Forces, InputTorqueFunction
from idtool.dynamics.simulation.integrators import linearly_implicit, runge_kutta
from idtool.dynamics.simulation.rollout_state import RolloutState, interpolate, solve_acceleration
from idtool.dynamics.simulation.stiction import resolve_stiction, transition_fractions

StepCallback = Callable[[Indices, RolloutState, RolloutState], None]  # rollouts, start and end of a step of theirs

LONGEST_STEP = 5e-3  # s
_STABLE = 2.0  # step times the fastest rate; the explicit method is stable to 2.8
_STIFF_RATE = 6e3  # 1/s: faster forces are integrated implicitly
_STIFF_STEP = 1e-3  # s, the longest then
_MAX_ERROR = 1e-4  # accepted error of a step's velocity, to order 3 [rad/s or m/s, and relative]
_SHORTEST = 1e-3  # of the longest step
_MAX_EVENTS = 30  # changes of direction between two grid points that are looked for one by one
_BISECTIONS = 14  # of a step that straddles the beginning of a spring
_STEPS_PER_RATE = 64  # steps between two evaluations of the rates
_SLOWEST = 1e-6  # 1/s
_ROUNDING = 1e-9  # of a step


class Rollouts:
    """A mechanism run forwards from many states.

    Parameters
    ----------
    mechanism
        The forward model.
    t
        Start times [s], shape (W,).
    q, v
        Positions and velocities at the start, shape (nv, W).
    input_torque
        The torque that acts, a continuous function of time and of the state of the motor sides.
    step
        The longest step of each [s], shape (W,), or of all. All whole multiples of it after the start are ends of
        steps.
    log
        File name of the log whose torque acts; empty: none, or several.
    base_motion
        Measured motion of a floating base; None: the base is fixed.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        t: Array,
        q: Array,
        v: Array,
        input_torque: InputTorqueFunction,
        step: Array | float = LONGEST_STEP,
        log: str = "",
        base_motion: BaseMotionFunction | None = None,
    ) -> None:
        self._forces = Forces(mechanism, input_torque, log, base_motion)
        self._state = self._forces.initial_state(t, q, v)
        count = len(t)
        self._grid_start = t.copy()
        self._step = np.broadcast_to(step, count)
        self._max_step = self._step.copy()
        self._rates = np.zeros(count)
        self._step_count = np.zeros(count, dtype=np.intp)
        self._event_count = np.zeros(count, dtype=np.intp)
        self._damping = np.zeros(self._state.M.shape)
        self._stiffness = np.zeros(self._state.M.shape)

    @property
    def t(self) -> Array:
        """Time of each rollout [s], shape (W,)."""
        return self._state.t

    @property
    def motor_coordinates(self) -> Indices:
        """Coordinates of the motor sides, shape (nv,)."""
        return self._forces.motor_coordinates

    @property
    def q(self) -> Array:
        """Positions of the motor sides, shape (nv, W)."""
        return self._state.q[self.motor_coordinates]

    @property
    def v(self) -> Array:
        """Velocities of the motor sides, shape (nv, W)."""
        return self._state.v[self.motor_coordinates]

    @property
    def state_vector(self) -> Array:
        """All that the future depends on besides the input torque, shape (states, W)."""
        return np.concatenate([self._state.q, self._state.v, self._state.hysteresis])

    @property
    def mass_matrix(self) -> Array:
        """M at the present positions, shape (W, n, n)."""
        return self._state.M

    def restart(self, rollout_ids: Indices, state_vector: Array, t: Array) -> None:
        """Set rollouts to times t, shape (w,) [s], and to states, shape (states, w)."""
        n = len(self._state.q)
        q, v, hysteresis = np.split(state_vector, [n, 2 * n])
        state = self._forces.state_at(rollout_ids, t, q, v, hysteresis)
        self._state.assign(rollout_ids, state)
        self._grid_start[rollout_ids] = t
        self._step_count[rollout_ids] = 0
        self._max_step[rollout_ids] = self._step[rollout_ids]

    def advance(self, until: Array, on_step: StepCallback | None = None) -> None:
        """Advance the rollouts to later times.

        Parameters
        ----------
        until
            Where to stop, shape (W,) [s]; a rollout that is already there stays.
        on_step
            Called after every step.
        """
        slack = _ROUNDING * self._step
        rollout_ids = np.flatnonzero(until > self.t + slack)
        while rollout_ids.size:
            due = rollout_ids[self._step_count[rollout_ids] % _STEPS_PER_RATE == 0]
            if due.size:
                self._update_rates(due)
            self._step_count[rollout_ids] += 1
            stiff = self._rates[rollout_ids] > _STIFF_RATE
            for some_ids in (rollout_ids[stiff], rollout_ids[~stiff]):
                if some_ids.size:
                    self._take_step(some_ids, until, on_step)
            rollout_ids = rollout_ids[until[rollout_ids] > (self.t + slack)[rollout_ids]]
        np.maximum(self.t, until, out=self.t)

    def _take_step(self, rollout_ids: Indices, until: Array, on_step: StepCallback | None) -> None:
        """One step of rollouts that are all stiff or all not."""
        is_all = rollout_ids.size == len(self.t)
        start = self._with_friction_direction(self._state if is_all else self._state.select(rollout_ids))
        end = self._step_to_transition(start, self._step_lengths(rollout_ids, until))
        if is_all:
            self._state = end
        else:
            self._state.assign(rollout_ids, end)
        if on_step is not None:
            on_step(rollout_ids, start, end)

    def _step_lengths(self, rollout_ids: Indices, until: Array) -> Array:
        """Longest admissible length of the next steps [s], shape (w,)."""
        t = self.t[rollout_ids]
        grid_start = self._grid_start[rollout_ids]
        step = self._step[rollout_ids]
        grid_steps = np.floor((t - grid_start) / step + _ROUNDING)
        at_grid_point = t - grid_start - grid_steps * step < _ROUNDING * step
        self._event_count[rollout_ids[at_grid_point]] = 0

        next_grid_point = grid_start + (grid_steps + 1) * step
        remaining = np.minimum(until[rollout_ids], next_grid_point) - t
        rates = self._rates[rollout_ids]
        stable = np.where(rates > _STIFF_RATE, _STIFF_STEP, _STABLE / np.maximum(rates, _SLOWEST))
        longest = np.minimum(stable, self._max_step[rollout_ids])
        return np.asarray(remaining / np.ceil(remaining / longest - _ROUNDING))

    def _update_rates(self, rollout_ids: Indices) -> None:
        """Set the stiffness of the joints' springs and dampers, and the fastest rate at which they act [1/s]."""
        state = self._state.select(rollout_ids)
        damping, stiffness = self._forces.damping_and_stiffness(state)
        self._damping[rollout_ids] = damping
        self._stiffness[rollout_ids] = stiffness
        # The eigenvalues of M⁻¹ X are those of L⁻¹ X L⁻ᵀ.
        L_inverse = np.linalg.inv(np.linalg.cholesky(state.M))
        L_inverse_T = L_inverse.transpose(0, 2, 1)
        damping_rate = np.linalg.eigvalsh(L_inverse @ damping @ L_inverse_T)[:, -1]
        squared_frequency = np.linalg.eigvalsh(L_inverse @ stiffness @ L_inverse_T)[:, -1]
        frequency = np.sqrt(np.maximum(squared_frequency, 0.0))
        self._rates[rollout_ids] = np.maximum(damping_rate, frequency)

    def _step_to_transition(self, start: RolloutState, step: Array) -> RolloutState:
        """End of a step, or of the part of it before the first change of a force's form."""
        end, step = self._accurate_step(start, step)
        if len(self._forces.gap_slopes):
            step = self._cut_at_breakpoints(start, end, step)
        if not self._forces.any_dry_friction:
            return end
        fraction = transition_fractions(start, end, step)
        first = fraction.min(axis=0)
        self._event_count[start.rollout_ids] += first < 1
        first[self._event_count[start.rollout_ids] > _MAX_EVENTS] = 1.0
        stops = (fraction <= first) & np.isfinite(fraction) & (start.s != 0)
        cut = np.flatnonzero(first < 1)
        if cut.size:
            start_cut = start.select(cut)
            q, v = interpolate(start_cut.motion, end.motion[:, :, cut], step[cut], first[cut])
            v[stops[:, cut]] = 0.0
            end.assign(cut, self._forces.state_after(start_cut, first[cut] * step[cut], q, v))
        end.v[stops] = 0.0
        return end

    def _cut_at_breakpoints(self, start: RolloutState, end: RolloutState, step: Array) -> Array:
        """Let steps end just beyond where the first spring begins or ends; their lengths [s], shape (w,).

        By bisection, since the result of a step across such a point is not accurate on the motion before it.
        """
        gaps = self._forces.gaps
        crossing = np.flatnonzero((gaps(start.q) * gaps(end.q) < 0).any(axis=0))
        crossing = crossing[self._event_count[start.rollout_ids[crossing]] < _MAX_EVENTS]
        if not crossing.size:
            return step
        self._event_count[start.rollout_ids[crossing]] += 1
        start_crossing = start.select(crossing)
        gaps_before = gaps(start.q[:, crossing])
        low = np.zeros(crossing.size)
        high = step[crossing]
        for _ in range(_BISECTIONS):
            part = self._single_step(start_crossing, (low + high) / 2)
            length = part.t - start_crossing.t
            beyond = (gaps_before * gaps(part.q) < 0).any(axis=0)
            low = np.where(beyond, low, length)
            high = np.where(beyond, length, high)
        end.assign(crossing, self._single_step(start_crossing, high))
        step = step.copy()
        step[crossing] = high
        return step

    def _with_friction_direction(self, state: RolloutState) -> RolloutState:
        """State with the direction of every joint's dry friction, and with the joints at rest that it holds."""
        if not self._forces.any_dry_friction:
            return state
        s = np.where(self._forces.has_dry_friction, np.sign(state.v), 0.0)
        sticking = self._forces.has_dry_friction & (state.v == 0)
        if ((s != state.s) | (sticking != state.sticking)).any():
            a = solve_acceleration(state.M, state.force - s * state.friction_level, sticking)
            state = replace(state, s=s, sticking=sticking, a=a)
        return resolve_stiction(state) if sticking.any() else state

    def _single_step(self, start: RolloutState, step: Array) -> RolloutState:
        """One step whose length is known to be short enough."""
        if self._is_stiff(start):
            ids = start.rollout_ids
            return linearly_implicit(self._forces, start, step, self._damping[ids], self._stiffness[ids])
        end, _ = runge_kutta(self._forces, start, step)
        return end

    def _is_stiff(self, start: RolloutState) -> bool:
        return bool((self._rates[start.rollout_ids] > _STIFF_RATE).any())

    def _accurate_step(self, start: RolloutState, step: Array) -> tuple[RolloutState, Array]:
        """Step of the given length, or a shorter one where its error would be too large; and the lengths."""
        if self._is_stiff(start):
            return self._single_step(start, step), step
        rollout_ids = start.rollout_ids
        end, error = runge_kutta(self._forces, start, step)
        max_error = _MAX_ERROR * (1 + np.abs(start.v).max(axis=0))
        max_step = self._max_step[rollout_ids]
        longest = self._step[rollout_ids]
        self._max_step[rollout_ids] = np.where(error > max_error, max_step, np.minimum(2 * max_step, longest))
        shortest = _SHORTEST * longest
        rejected = np.flatnonzero((error > max_error) & (step > shortest))
        if rejected.size:
            step = step.copy()
        while rejected.size:
            step[rejected] /= 2
            part, error = runge_kutta(self._forces, start.select(rejected), step[rejected])
            end.assign(rejected, part)
            self._max_step[rollout_ids[rejected]] = step[rejected]
            rejected = rejected[(error > max_error[rejected]) & (step[rejected] > shortest[rejected])]
        return end, step

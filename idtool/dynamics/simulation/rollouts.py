"""Forward dynamics with dry friction: many rollouts advance together, each in its own steps.

Between changes of the friction's direction the motion is smooth and is integrated by the classical Runge–Kutta method
of order 4, or, where springs and dampers are so stiff that it would take very short steps, by a linearly implicit
method of order 2. The moment at which a joint comes to rest is found (by the cubic through the velocities and
accelerations at both ends of the step), and sticking is a constraint, not a stiff force: the acceleration is zero as
long as the friction that this takes is within its level. So nothing drifts at rest, and the step need not be small for
friction's sake.

Shapes: nv joints, W rollouts, w of them that are looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.forces import Forces, InputTorqueFunction
from idtool.dynamics.simulation.integrators import linearly_implicit, runge_kutta
from idtool.dynamics.simulation.rollout_state import RolloutState, interpolate, solve_acceleration
from idtool.dynamics.simulation.stiction import resolve_stiction, transition_times

StepCallback = Callable[
    [Indices, RolloutState, RolloutState], None
]  # which rollouts, where a step of theirs began, where it ended

LONGEST_STEP = 5e-3  # s
_STABLE = 2.0  # step times the fastest rate; the explicit method is stable to 2.8
_STIFF = 6e3  # 1/s: rates above it are dealt with implicitly
_STIFF_STEP = 1e-3  # s, the longest then
_ROUGH = 1e-4  # error of a step's velocity that is accepted, to order 3 [rad/s or m/s, and relative]
_SHORTEST = 1e-3  # of the longest step
_EVENTS = 30  # changes of direction between two grid points, beyond which they are no longer looked for one by one
_HALVINGS = 14  # of a step that straddles the beginning of a spring
_RATES_EVERY = 64  # steps
_SLOWEST = 1e-6  # 1/s


class Rollouts:
    """A mechanism run forwards from many states.

    Parameters
    ----------
    mechanism
        What moves.
    t
        Where each begins [s], shape (W,).
    q, v
        Positions and velocities there, shape (nv, W).
    drive
        The torque that acts, a continuous function of time and of the state of the motors' sides.
    step
        The longest step [s]. All whole numbers of it after the beginning are ends of steps.
    """

    def __init__(
        self, mechanism: Mechanism, t: Array, q: Array, v: Array, drive: InputTorqueFunction, step: float = LONGEST_STEP
    ) -> None:
        self._forces = Forces(mechanism, drive)
        self._now = self._forces.initial_state(t, q, v)
        self._grid, self._step = t.copy(), step
        self._limit = np.full(len(t), step)
        self._rates, self._count = np.zeros(len(t)), np.zeros(len(t), dtype=np.intp)
        self._events = np.zeros(len(t), dtype=np.intp)
        self._damping, self._stiffness = np.zeros((2, *self._now.M.shape))

    @property
    def t(self) -> Array:
        """Where each rollout is [s], shape (W,)."""
        return self._now.t

    @property
    def motor_coordinates(self) -> Indices:
        """The coordinates of the motors' sides, shape (nv,)."""
        return self._forces.motor_coordinates

    @property
    def q(self) -> Array:
        """Positions of the motors' sides, shape (nv, W)."""
        return self._now.q[self.motor_coordinates]

    @property
    def v(self) -> Array:
        """Velocities of the motors' sides, shape (nv, W)."""
        return self._now.v[self.motor_coordinates]

    @property
    def state_vector(self) -> Array:
        """All that the future depends on beside the drive, shape (states, W)."""
        return np.concatenate([self._now.q, self._now.v, self._now.hysteresis])

    @property
    def mass_matrix(self) -> Array:
        """M at the present positions, shape (W, n, n)."""
        return self._now.M

    def restart(self, rollout_ids: Indices, state: Array, t: Array) -> None:
        """Set rollouts to t, shape (w,) [s], and to states, shape (states, w)."""
        n = len(self._now.q)
        self._now.assign(
            rollout_ids, self._forces.state_at(rollout_ids, t, state[:n], state[n : 2 * n], state[2 * n :])
        )
        self._grid[rollout_ids], self._count[rollout_ids], self._limit[rollout_ids] = t, 0, self._step

    def advance(self, until: Array, keep: StepCallback | None = None) -> None:
        """Take the rollouts to a later moment.

        Parameters
        ----------
        until
            When to stop, shape (W,) [s]; where it is not later nothing happens.
        keep
            Told of every step.
        """
        slack = 1e-9 * self._step
        rollout_ids = np.flatnonzero(until > self.t + slack)
        while rollout_ids.size:
            due = rollout_ids[self._count[rollout_ids] % _RATES_EVERY == 0]
            if due.size:
                self._look_at(due)
            self._count[rollout_ids] += 1
            stiff = self._rates[rollout_ids] > _STIFF
            for some in (rollout_ids[stiff], rollout_ids[~stiff]):
                if some.size:
                    self._move(some, until, keep)
            rollout_ids = rollout_ids[until[rollout_ids] > self.t[rollout_ids] + slack]
        np.maximum(self.t, until, out=self.t)

    def _move(self, rollout_ids: Indices, until: Array, keep: StepCallback | None) -> None:
        """One step of rollouts that are all stiff or all not."""
        every = rollout_ids.size == len(self.t)
        start = self._settled(self._now if every else self._now.select(rollout_ids))
        end = self._stepped(start, self._lengths(rollout_ids, until))
        if every:
            self._now = end
        else:
            self._now.assign(rollout_ids, end)
        if keep is not None:
            keep(rollout_ids, start, end)

    def _lengths(self, rollout_ids: Indices, until: Array) -> Array:
        """How long the next steps may be [s], shape (w,)."""
        t, grid = self.t[rollout_ids], self._grid[rollout_ids]
        gone = np.floor((t - grid) / self._step + 1e-9)
        at_grid = t - grid - gone * self._step < 1e-9 * self._step
        self._events[rollout_ids[at_grid]] = 0
        left = np.minimum(until[rollout_ids], grid + (gone + 1) * self._step) - t
        rates = self._rates[rollout_ids]
        longest = np.where(rates > _STIFF, _STIFF_STEP, _STABLE / np.maximum(rates, _SLOWEST))
        return np.asarray(left / np.ceil(left / np.minimum(longest, self._limit[rollout_ids]) - 1e-9))

    def _look_at(self, rollout_ids: Indices) -> None:
        """How stiff the joints' own springs and dampers are, and the fastest rate at which they act [1/s]."""
        now = self._now.select(rollout_ids)
        damping, stiffness = self._forces.damping_and_stiffness(now)
        self._damping[rollout_ids], self._stiffness[rollout_ids] = damping, stiffness
        L = np.linalg.inv(np.linalg.cholesky(now.M))  # the eigenvalues of M⁻¹ X are those of L⁻¹ X L⁻ᵀ
        rates = [np.linalg.eigvalsh(L @ x @ L.transpose(0, 2, 1))[:, -1] for x in (damping, stiffness)]
        self._rates[rollout_ids] = np.maximum(rates[0], np.sqrt(np.maximum(rates[1], 0.0)))

    def _stepped(self, start: RolloutState, step: Array) -> RolloutState:
        """The end of a step, or of the part of it before the first change of a force's form."""
        end, step = self._smooth_enough(start, step)
        if len(self._forces.gap_slopes):
            step = self._up_to_a_stop(start, end, step)
        if not self._forces.any_dry_friction:
            return end
        rollout_ids, share = start.rollout_ids, transition_times(start, end, step)
        first = share.min(axis=0)
        self._events[rollout_ids] += first < 1
        first[self._events[rollout_ids] > _EVENTS] = 1.0
        cut = np.flatnonzero(first < 1)
        stops = (share <= first) & (share < 2) & (start.s != 0)
        if cut.size:
            q, v = interpolate(start.select(cut), end.select(cut), step[cut], first[cut])
            v[stops[:, cut]] = 0.0
            end.assign(cut, self._forces.state_after(start.select(cut), first[cut] * step[cut], q, v))
        end.v[stops] = 0.0
        return end

    def _up_to_a_stop(self, start: RolloutState, end: RolloutState, step: Array) -> Array:
        """Let steps end just beyond where the first spring with a beginning is met or left; their lengths [s], (w,).

        By bisection: what a step that straddles the place says of the motion before it is not to be trusted.
        """
        gaps = self._forces.gaps
        some = np.flatnonzero((gaps(start.q) * gaps(end.q) < 0).any(axis=0))
        some = some[self._events[start.rollout_ids[some]] < _EVENTS]
        if not some.size:
            return step
        self._events[start.rollout_ids[some]] += 1
        short, before = start.select(some), gaps(start.q[:, some])
        low, high = np.zeros(some.size), step[some]
        for _ in range(_HALVINGS):
            part = self._whole(short, (low + high) / 2)
            beyond = (before * gaps(part.q) < 0).any(axis=0)
            low, high = np.where(beyond, low, part.t - short.t), np.where(beyond, part.t - short.t, high)
        end.assign(some, self._whole(short, high))
        step = step.copy()
        step[some] = high
        return step

    def _settled(self, now: RolloutState) -> RolloutState:
        """The moment with the direction of every joint's dry friction, which of those at rest it holds among them."""
        if not self._forces.any_dry_friction:
            return now
        s = np.where(self._forces.has_dry_friction, np.sign(now.v), 0.0)
        held = self._forces.has_dry_friction & (now.v == 0)
        if not ((s != now.s) | (held != now.sticking)).any():
            return now if not held.any() else resolve_stiction(now)
        now = replace(now, s=s, sticking=held, a=solve_acceleration(now.M, now.force - s * now.friction_level, held))
        return resolve_stiction(now) if held.any() else now

    def _whole(self, start: RolloutState, step: Array) -> RolloutState:
        """A step of a length that is known to be short enough."""
        rollout_ids = start.rollout_ids
        if self._is_stiff(start):
            return linearly_implicit(
                self._forces, start, step, self._damping[rollout_ids], self._stiffness[rollout_ids]
            )
        return runge_kutta(self._forces, start, step)[0]

    def _is_stiff(self, start: RolloutState) -> bool:
        return bool((self._rates[start.rollout_ids] > _STIFF).any())

    def _smooth_enough(self, start: RolloutState, step: Array) -> tuple[RolloutState, Array]:
        """A step in which the forces do not change too much, shorter than the given one where they would."""
        rollout_ids = start.rollout_ids
        if self._is_stiff(start):
            return self._whole(start, step), step
        end, rough = runge_kutta(self._forces, start, step)
        most = _ROUGH * (1 + np.abs(start.v).max(axis=0))
        limit = self._limit[rollout_ids]
        self._limit[rollout_ids] = np.where(rough > most, limit, np.minimum(2 * limit, self._step))
        again = np.flatnonzero((rough > most) & (step > _SHORTEST * self._step))
        if again.size:
            step = step.copy()
        while again.size:
            step[again] /= 2
            part, rough = runge_kutta(self._forces, start.select(again), step[again])
            end.assign(again, part)
            self._limit[rollout_ids[again]] = step[again]
            again = again[(rough > most[again]) & (step[again] > _SHORTEST * self._step)]
        return end, step

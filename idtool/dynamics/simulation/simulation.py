"""The model along a log as a simulation: under the logged torque, or closed loop under the joint controller.

A rollout starts from the measured state. Those of many windows advance together.

Shapes: nv joints, W rollouts, N samples of the longest. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import ModelError
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.input_torque import InputTorque, samples_per_step
from idtool.dynamics.simulation.rollout_state import RolloutState, interpolate
from idtool.dynamics.simulation.rollouts import LONGEST_STEP, Rollouts
from idtool.dynamics.simulation.windows import measured_states, start_times

_AT_ONCE = 256  # rollouts that advance together
_FEW = 8  # rollouts, fewer than which are cut into pieces
_PIECE = 1.0  # s
_SAME = 1e-6  # of a sample
_JOINED = 1e-7  # SI: by how much a piece may begin elsewhere than the one before it ended
_PASSES = 5  # over all pieces together, before they are done one by one
_FASTEST = 1e4  # rad/s or m/s: a rollout beyond it has lost its way


@dataclass(frozen=True)
class SimulatedWindows:
    """Rollouts along windows of a log.

    Attributes
    ----------
    windows
        The samples of the log that each covers, the first being its start.
    q, v, tau
        Position, velocity and torque as sensors would give them, shape (nv, W, N); of a window that is shorter than the
        longest, what lies beyond it means nothing.
    lost
        Which of them ran away and were stopped where they were, shape (W,).
    """

    windows: tuple[slice, ...]
    q: Array
    v: Array
    tau: Array
    diverged: Mask


def simulate(
    mechanism: Mechanism, signals: Signals, windows: Sequence[slice], tell: Callable[[float], None]
) -> Iterator[SimulatedWindows]:
    """Run a model along windows of a log.

    Parameters
    ----------
    mechanism
        The model.
    signals
        The log.
    windows
        Samples of the log, no gap within one.
    tell
        Told the share that is done.

    Yields
    ------
    The windows in their order, a bounded number of them at a time.

    Raises
    ------
    ModelError
        If the model cannot move: its mass matrix is not positive definite.
    """
    total, done = max(sum(window.stop - window.start for window in windows), 1), 0
    longest = max((window.stop - window.start for window in windows), default=0)
    chained = len(windows) < _FEW and longest > 2 * _piece(signals)
    for first in range(0, len(windows), 1 if chained else _AT_ONCE):
        some = tuple(windows[first : first + (1 if chained else _AT_ONCE)])
        size = sum(window.stop - window.start for window in some)
        part = partial(_tell_part, tell, done / total, size / total)
        yield (_chained if chained else _together)(mechanism, signals, some, part)
        done += size


def _together(
    mechanism: Mechanism, signals: Signals, windows: tuple[slice, ...], tell: Callable[[float], None]
) -> SimulatedWindows:
    """Rollouts that advance together."""
    run = _Run(mechanism, signals, windows)
    run.advance(np.arange(len(windows)), tell)
    return run.result()


def _tell_part(tell: Callable[[float], None], before: float, size: float, share: float) -> None:
    tell(before + size * share)


def _piece(signals: Signals) -> int:
    return max(round(_PIECE / signals.log.dt), 1)


def _chained(
    mechanism: Mechanism, signals: Signals, windows: tuple[slice, ...], tell: Callable[[float], None]
) -> SimulatedWindows:
    """One long rollout, section by section, each in pieces that advance together."""
    (window,) = windows
    q, v, tau = np.empty((3, len(signals.joints), 1, window.stop - window.start))
    lost, state, size = False, None, _AT_ONCE * _piece(signals)
    for first in range(window.start, window.stop - 1, size):
        section, here = slice(first, min(first + size + 1, window.stop)), first - window.start
        done = partial(_tell_part, tell, here / q.shape[2], (section.stop - first) / q.shape[2])
        run = _settled(mechanism, signals, section, state, done)
        state = run.rollouts.state_vector[:, -1:]
        some = run.result()
        for w, part in enumerate(some.windows):
            at, length = slice(part.start - window.start, part.stop - window.start), part.stop - part.start
            if lost:  # what comes after a rollout that ran away would have begun nowhere
                q[:, 0, at], v[:, 0, at], tau[:, 0, at] = q[:, 0, at.start, None], 0.0, tau[:, 0, at.start, None]
            else:
                q[:, 0, at], v[:, 0, at], tau[:, 0, at] = (x[:, w, :length] for x in (some.q, some.v, some.tau))
            lost |= bool(some.diverged[w])
    return SimulatedWindows(windows, q, v, tau, np.array([lost]))


def _settled(
    mechanism: Mechanism, signals: Signals, section: slice, state: Array | None, tell: Callable[[float], None]
) -> _Run:
    """A section from a state, shape (states, 1), or the measured one, in pieces that each begin where the last ended.

    At first each but the first begins in the measured state, and those that did not begin where the piece before them
    ended are done again from there. A controller makes motions forget how they began, so that few passes settle all;
    where it does not, they are done one after the other.
    """
    size = _piece(signals)
    firsts = range(section.start, section.stop - 1, size)
    run = _Run(mechanism, signals, tuple(slice(first, min(first + size + 1, section.stop)) for first in firsts))
    if state is not None:
        run.resume(np.zeros(1, dtype=np.intp), state)
    todo, passes = np.arange(len(firsts)), 0
    while todo.size:
        if passes:
            run.resume(todo, run.rollouts.state_vector[:, todo - 1])
        run.advance(todo, partial(_tell_part, tell, 1 - todo.size / len(firsts), todo.size / len(firsts)))
        passes += 1
        todo = 1 + np.flatnonzero((np.abs(run.begun[:, 1:] - run.rollouts.state_vector[:, :-1]) > _JOINED).any(axis=0))
        todo = todo if passes < _PASSES else todo[:1]
    return run


class _Run:
    """Rollouts that advance together, and what they have left behind.

    Attributes
    ----------
    rollouts
        Where they are.
    begun
        The states that they began in, shape (states, W).
    """

    def __init__(self, mechanism: Mechanism, signals: Signals, windows: tuple[slice, ...]) -> None:
        self._signals, self._windows = signals, windows
        self._t0, self._last = start_times(signals, windows), np.array([w.stop - w.start - 1 for w in windows])
        self._drive, self._offset = InputTorque(signals, windows, mechanism), mechanism.position_offset[:, None]
        q, v = measured_states(signals, [window.start for window in windows])
        step = samples_per_step(signals) * signals.log.dt
        self._mechanism = mechanism
        with _movable(mechanism):
            self.rollouts = Rollouts(mechanism, self._t0, q + self._offset, v, self._drive, min(step, LONGEST_STEP))
            np.linalg.cholesky(self.rollouts.mass_matrix)
        self.begun = self.rollouts.state_vector
        self._q, self._v = np.zeros((2, len(q), len(windows), self._last.max() + 1))
        self._lost = np.zeros(len(windows), dtype=bool)

    def resume(self, rollout_ids: Indices, state: Array) -> None:
        """Begin some again, in states, shape (states, w)."""
        self.rollouts.restart(rollout_ids, state, self._t0[rollout_ids])
        self.begun[:, rollout_ids] = self.rollouts.state_vector[:, rollout_ids]
        self._lost[rollout_ids] = False

    def advance(self, rollout_ids: Indices, tell: Callable[[float], None]) -> None:
        """Take some to their ends."""
        rollouts, dt = self.rollouts, self._signals.log.dt
        self._q[:, rollout_ids, 0] = rollouts.q[:, rollout_ids] - self._offset
        self._v[:, rollout_ids, 0] = rollouts.v[:, rollout_ids]
        until = rollouts.t.copy()
        until[rollout_ids] = self._t0[rollout_ids] + self._last[rollout_ids] * dt

        def keep(rollout_ids: Indices, start: RolloutState, end: RolloutState) -> None:
            self._keep(rollout_ids, start, end)
            gone = np.abs(end.v).max(axis=0)
            lost = rollout_ids[~(gone < _FASTEST)]
            if lost.size:
                self._lose(lost, until)
            tell(float(np.min((rollouts.t - self._t0)[rollout_ids] / (self._last[rollout_ids] * dt))))

        with _movable(self._mechanism):
            rollouts.advance(until, keep)

    def _lose(self, rollout_ids: Indices, until: Array) -> None:
        """Stop rollouts that have run away: they stay where they last were."""
        for rollout_id in rollout_ids:
            k = int((self.rollouts.t[rollout_id] - self._t0[rollout_id]) / self._signals.log.dt)
            self._q[:, rollout_id, k:] = self._q[:, rollout_id, max(k - 1, 0)][:, None]
            self._v[:, rollout_id, k:] = 0.0
        self._lost[rollout_ids] = True
        until[rollout_ids] = -np.inf

    def _keep(self, rollout_ids: Indices, start: RolloutState, end: RolloutState) -> None:
        """Take down the samples that lie in a step."""
        rate, t0, motor = 1 / self._signals.log.dt, self._t0[rollout_ids], self.rollouts.motor_coordinates
        begun, ended = ((moment.t - t0) * rate for moment in (start, end))
        first, last = np.floor(begun + _SAME).astype(np.intp) + 1, np.floor(ended + _SAME).astype(np.intp)
        for k in range(int((last - first).max()) + 1):
            some = np.flatnonzero(first + k <= last)
            at, h = first[some] + k, (end.t - start.t)[some]
            share = np.minimum((at - begun[some]) / (ended - begun)[some], 1.0)
            every = some.size == len(rollout_ids)
            q, v = interpolate(start if every else start.select(some), end if every else end.select(some), h, share)
            self._q[:, rollout_ids[some], at] = q[motor] - self._offset
            self._v[:, rollout_ids[some], at] = v[motor]

    def result(self) -> SimulatedWindows:
        """What was simulated, as sensors would give it."""
        tau = np.empty_like(self._q)
        rollout_ids = np.arange(len(self._windows))
        for k in range(tau.shape[2]):
            t = self._t0 + np.minimum(k, self._last) * self._signals.log.dt
            tau[:, :, k] = self._drive.measured_torque(t, self._q[:, :, k], self._v[:, :, k], rollout_ids)
        return SimulatedWindows(self._windows, self._q, self._v, tau, self._lost)


@contextmanager
def _movable(mechanism: Mechanism) -> Iterator[None]:
    """What cannot be solved for accelerations as an error that a user can act on."""
    try:
        yield
    except np.linalg.LinAlgError:
        raise ModelError(
            mechanism.model.robot.path,
            "cannot be simulated: a joint has no inertia, or less than none; fit within `full` or tighter, or give the "
            "rotors of its light joints",
        ) from None

"""Simulation of a model along a log: under the logged torque, or closed loop under the joint controller.

A rollout starts from the measured state. Those of many windows advance together. A floating base moves as measured, so
that the joints are those of a robot on a moving platform; the windows are without forces on other links.

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
from idtool.dynamics.simulation.signal_interpolation import SignalInterpolation
from idtool.dynamics.simulation.windows import measured_states, start_times, usable_range

_MAX_TOGETHER = 256  # rollouts that advance together
_FEW = 8  # windows, fewer than which are cut into pieces
_PIECE = 1.0  # s
_ROUNDING = 1e-6  # of a sample
_MAX_JUMP = 1e-7  # SI: between the end of a piece and the start of the next
_MAX_PASSES = 5  # over all pieces together, before they are done one by one
# A rollout has diverged if it is faster than both:
_MAX_SPEED = 1e3  # rad/s or m/s, which hardly any robot's joint reaches
_MAX_SPEEDUP = 100.0  # times the fastest joint that was measured in its window

Report = Callable[[float], None]  # told the share that is done


@dataclass(frozen=True)
class SimulatedWindows:
    """Rollouts along windows of a log.

    Attributes
    ----------
    windows
        The samples of the log that each covers, the first being its start.
    q, v, tau
        Position, velocity and torque as sensors would give them, shape (nv, W, N); samples beyond the end of a shorter
        window are undefined.
    diverged
        True for rollouts that diverged and were stopped, shape (W,).
    """

    windows: tuple[slice, ...]
    q: Array
    v: Array
    tau: Array
    diverged: Mask


def simulate(
    mechanism: Mechanism, signals: Signals, windows: Sequence[slice], report: Report
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
    report
        Callback for the share that is done.

    Yields
    ------
    The windows in their order, a bounded number of them at a time.

    Raises
    ------
    ModelError
        If the model can't move: its mass matrix is not positive definite.
    """
    lengths = [window.stop - window.start for window in windows]
    total = max(sum(lengths), 1)
    in_pieces = len(windows) < _FEW and max(lengths, default=0) > 2 * _piece_length(signals)
    count = 1 if in_pieces else _MAX_TOGETHER
    done = 0
    for first in range(0, len(windows), count):
        some = tuple(windows[first : first + count])
        size = sum(lengths[first : first + count])
        report_part = partial(_report_part, report, done / total, size / total)
        if in_pieces:
            yield _simulate_in_pieces(mechanism, signals, some[0], report_part)
        else:
            run = _Run(mechanism, signals, some)
            run.advance(np.arange(len(some)), report_part)
            yield run.result()
        done += size


def _report_part(report: Report, before: float, size: float, share: float) -> None:
    report(before + size * share)


def _piece_length(signals: Signals) -> int:
    """Samples of a piece."""
    return max(round(_PIECE / signals.log.dt), 1)


def _simulate_in_pieces(mechanism: Mechanism, signals: Signals, window: slice, report: Report) -> SimulatedWindows:
    """One long rollout, section by section, each in pieces that advance together."""
    count = window.stop - window.start
    q, v, tau = np.empty((3, len(signals.joints), 1, count))
    diverged = False
    state_vector = None
    section_length = _MAX_TOGETHER * _piece_length(signals)
    for first in range(window.start, window.stop - 1, section_length):
        section = slice(first, min(first + section_length + 1, window.stop))
        before = (first - window.start) / count
        size = (section.stop - section.start) / count
        run = _simulate_section(mechanism, signals, section, state_vector, partial(_report_part, report, before, size))
        state_vector = run.rollouts.state_vector[:, -1:]
        pieces = run.result()
        for w, piece in enumerate(pieces.windows):
            start = piece.start - window.start
            at = slice(start, piece.stop - window.start)
            length = piece.stop - piece.start
            if diverged:  # no state to begin in: stay where the rollout was stopped
                q[:, 0, at] = q[:, 0, start, None]
                v[:, 0, at] = 0.0
                tau[:, 0, at] = tau[:, 0, start, None]
            else:
                q[:, 0, at] = pieces.q[:, w, :length]
                v[:, 0, at] = pieces.v[:, w, :length]
                tau[:, 0, at] = pieces.tau[:, w, :length]
            diverged |= bool(pieces.diverged[w])
    return SimulatedWindows((window,), q, v, tau, np.array([diverged]))


def _simulate_section(
    mechanism: Mechanism, signals: Signals, section: slice, state_vector: Array | None, report: Report
) -> _Run:
    """A section from a state, shape (states, 1), or the measured one, in pieces that each begin where the last ended.

    At first each but the first begins in the measured state, and those that did not begin where the piece before them
    ended are done again from there. A controller makes motions forget how they began, so that few passes settle all;
    where it does not, they are done one after the other.
    """
    length = _piece_length(signals)
    firsts = range(section.start, section.stop - 1, length)
    pieces = tuple(slice(first, min(first + length + 1, section.stop)) for first in firsts)
    run = _Run(mechanism, signals, pieces)
    if state_vector is not None:
        run.restart(np.zeros(1, dtype=np.intp), state_vector)
    todo = np.arange(len(pieces))
    passes = 0
    while todo.size:
        if passes:
            run.restart(todo, run.rollouts.state_vector[:, todo - 1])
        share = todo.size / len(pieces)
        run.advance(todo, partial(_report_part, report, 1 - share, share))
        passes += 1
        jumps = np.abs(run.initial_state_vector[:, 1:] - run.rollouts.state_vector[:, :-1])
        todo = 1 + np.flatnonzero((jumps > _MAX_JUMP).any(axis=0))
        if passes >= _MAX_PASSES:
            todo = todo[:1]
    return run


class _Run:
    """Rollouts that advance together, and their motion at the log's samples.

    Attributes
    ----------
    rollouts
        The rollouts, each at its present time.
    initial_state_vector
        The states that they began in, shape (states, W).
    """

    def __init__(self, mechanism: Mechanism, signals: Signals, windows: tuple[slice, ...]) -> None:
        from idtool.dynamics.simulation.rollouts import LONGEST_STEP, Rollouts

        self._mechanism = mechanism
        self._signals = signals
        self._windows = windows
        self._t0 = start_times(signals, windows)
        self._last = np.array([window.stop - window.start - 1 for window in windows])  # samples
        self._input_torque = InputTorque(signals, windows, mechanism)
        self._offset = mechanism.position_offset[:, None]
        q, v = measured_states(signals, [window.start for window in windows])
        measured_speeds = np.array([_fastest_measured(signals, window) for window in windows])
        self._max_speed = np.maximum(_MAX_SPEED, _MAX_SPEEDUP * measured_speeds)
        step = min(samples_per_step(signals) * signals.log.dt, LONGEST_STEP)
        base = _base_motion(signals, windows, mechanism) if mechanism.model.has_floating_base else None
        with _immovable_as_error(mechanism):
            log = signals.log.path.name
            self.rollouts = Rollouts(mechanism, self._t0, q + self._offset, v, self._input_torque, step, log, base)
            np.linalg.cholesky(self.rollouts.mass_matrix)
        self.initial_state_vector = self.rollouts.state_vector
        shape = (len(q), len(windows), self._last.max() + 1)
        self._q = np.zeros(shape)
        self._v = np.zeros(shape)
        self._diverged = np.zeros(len(windows), dtype=bool)

    def restart(self, rollout_ids: Indices, state_vector: Array) -> None:
        """Restart some rollouts from states, shape (states, w)."""
        self.rollouts.restart(rollout_ids, state_vector, self._t0[rollout_ids])
        self.initial_state_vector[:, rollout_ids] = self.rollouts.state_vector[:, rollout_ids]
        self._diverged[rollout_ids] = False

    def advance(self, rollout_ids: Indices, report: Report) -> None:
        """Advance some rollouts to their ends."""
        rollouts = self.rollouts
        dt = self._signals.log.dt
        self._q[:, rollout_ids, 0] = rollouts.q[:, rollout_ids] - self._offset
        self._v[:, rollout_ids, 0] = rollouts.v[:, rollout_ids]
        durations = self._last * dt
        until = rollouts.t.copy()
        until[rollout_ids] = self._t0[rollout_ids] + durations[rollout_ids]

        def on_step(stepped_ids: Indices, start: RolloutState, end: RolloutState) -> None:
            self._record_samples(stepped_ids, start, end)
            fastest = np.abs(end.v).max(axis=0)
            diverged_ids = stepped_ids[~(fastest < self._max_speed[stepped_ids])]  # NaN has diverged, too
            if diverged_ids.size:
                self._stop(diverged_ids, until)
            elapsed = (rollouts.t - self._t0)[stepped_ids]
            report(float(np.min(elapsed / durations[stepped_ids])))

        with _immovable_as_error(self._mechanism):
            rollouts.advance(until, on_step)

    def _stop(self, rollout_ids: Indices, until: Array) -> None:
        """Stop diverged rollouts: they stay where they last were."""
        for rollout_id in rollout_ids:
            elapsed = self.rollouts.t[rollout_id] - self._t0[rollout_id]
            k = int(elapsed / self._signals.log.dt)
            self._q[:, rollout_id, k:] = self._q[:, rollout_id, max(k - 1, 0)][:, None]
            self._v[:, rollout_id, k:] = 0.0
        self._diverged[rollout_ids] = True
        until[rollout_ids] = -np.inf

    def _record_samples(self, rollout_ids: Indices, start: RolloutState, end: RolloutState) -> None:
        """Record the motion at the samples that lie in a step."""
        rate = 1 / self._signals.log.dt
        t0 = self._t0[rollout_ids]
        motor = self.rollouts.motor_coordinates
        start_sample = (start.t - t0) * rate
        end_sample = (end.t - t0) * rate
        first = np.floor(start_sample + _ROUNDING).astype(np.intp) + 1
        last = np.floor(end_sample + _ROUNDING).astype(np.intp)
        for k in range(int((last - first).max()) + 1):
            columns = np.flatnonzero(first + k <= last)
            sample = first[columns] + k
            h = (end.t - start.t)[columns]
            share = np.minimum((sample - start_sample[columns]) / (end_sample - start_sample)[columns], 1.0)
            if columns.size == len(rollout_ids):
                q, v = interpolate(start, end, h, share)
            else:
                q, v = interpolate(start.select(columns), end.select(columns), h, share)
            self._q[:, rollout_ids[columns], sample] = q[motor] - self._offset
            self._v[:, rollout_ids[columns], sample] = v[motor]

    def result(self) -> SimulatedWindows:
        """Motion and torque as sensors would give them."""
        tau = np.empty_like(self._q)
        rollout_ids = np.arange(len(self._windows))
        for k in range(tau.shape[2]):
            t = self._t0 + np.minimum(k, self._last) * self._signals.log.dt
            tau[:, :, k] = self._input_torque.measured_torque(t, self._q[:, :, k], self._v[:, :, k], rollout_ids)
        return SimulatedWindows(self._windows, self._q, self._v, tau, self._diverged)


def _fastest_measured(signals: Signals, window: slice) -> float:
    """Greatest measured speed of any joint in a window [rad/s or m/s]; 0 if none was measured."""
    return float(np.fmax.reduce(np.abs(signals.velocity(window)), axis=None, initial=0.0))


def _base_motion(signals: Signals, windows: Sequence[slice], mechanism: Mechanism) -> SignalInterpolation:
    """Measured velocity and acceleration of a floating base along windows within the log's ``ranges``."""
    base = mechanism.model.base_coordinates

    def read(part: slice) -> Array:
        motion = signals.motion(part)
        return np.concatenate([motion.v[base], motion.a[base]])

    return SignalInterpolation(signals, windows, read, delay=-mechanism.imu_delay, known_range=usable_range)


@contextmanager
def _immovable_as_error(mechanism: Mechanism) -> Iterator[None]:
    """Turn a mass matrix that is not positive definite into an error that a user can act on."""
    try:
        yield
    except np.linalg.LinAlgError:
        raise ModelError(
            mechanism.model.robot.path,
            "cannot be simulated: a joint has zero or negative inertia; fit with constraints: full or tighter, "
            "or add the rotors of its light joints",
        ) from None

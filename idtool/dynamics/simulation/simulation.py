"""Simulation of a model along logs: under the logged torque, or closed loop under the joint controller.

A rollout starts from the measured state. Rollouts of many windows advance together, as a batch. They may be of several
logs, unless torques differ by log. Long windows are cut into sections, which are simulated in turn, and these into
pieces, which advance together.

A floating base moves as measured. No contact forces act, in the windows, on links that the joints move.

Shapes: nv joints, W rollouts, N samples of the longest. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.input_torque import InputTorque, samples_per_step
from idtool.dynamics.simulation.rollout_state import RolloutState, interpolate
from idtool.dynamics.simulation.signal_interpolation import SignalInterpolation
from idtool.dynamics.simulation.windows import Window, measured_states, usable_range

_MAX_ROLLOUTS = 256  # rollouts that advance together
_MAX_ARRAY_ELEMENTS = 1 << 22  # of one signal of theirs, padded to the longest
_PIECE_DURATION = 1.0  # s
_EXPECTED_PASSES = 3  # over the pieces of a window, until each begins where the one before it ends
_SAMPLE_TOLERANCE = 1e-6  # of a sample
_MAX_STEPS = 64  # whose samples are recorded together
_MAX_STEP_ELEMENTS = 1 << 20  # of the motion at their ends
_SAMPLES_AT_ONCE = 1 << 16  # of a window, whose torque is evaluated together
_MAX_JUMP = 1e-7  # SI: between the end of a piece and the start of the next
_MAX_PARALLEL_PASSES = 5  # over all pieces together, before they are done one by one
# A rollout has diverged if it is faster than both:
_MAX_SPEED = 1e3  # rad/s or m/s, which hardly any robot's joint reaches
_MAX_SPEED_RATIO = 100.0  # times the fastest joint that was measured in its window

Report = Callable[[float], None]  # told the share that is done


@dataclass(frozen=True)
class SimulatedWindows:
    """Rollouts along windows of logs.

    Attributes
    ----------
    windows
        The samples that each covers.
    q, v, tau
        Position, velocity and torque as sensors would give them, shape (nv, W, N); samples beyond the end of a shorter
        window are undefined.
    diverged
        True for rollouts that diverged and were stopped, shape (W,).
    """

    windows: tuple[Window, ...]
    q: Array
    v: Array
    tau: Array
    diverged: Mask


def simulate(mechanism: Mechanism, windows: Sequence[Window], report: Report) -> Iterator[SimulatedWindows]:
    """Run a model along windows of logs.

    Parameters
    ----------
    mechanism
        The model.
    windows
        Samples of logs that have the same joints.
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
    total = max(sum(map(len, windows)), 1)
    done = 0
    for batch in _batches(mechanism, windows):
        simulate_batch = _in_pieces if _is_cut_into_pieces(mechanism, batch) else _together
        size = sum(map(len, batch))
        yield from simulate_batch(mechanism, batch, partial(_report_part, report, done / total, size / total))
        done += size


def _batches(mechanism: Mechanism, windows: Sequence[Window]) -> Iterator[tuple[Window, ...]]:
    """As many consecutive windows as memory allows to advance together, of one log where torques differ by log."""
    batch: list[Window] = []
    longest = 0
    for window in windows:
        longest = max(longest, len(window))
        is_full = len(batch) == _MAX_ROLLOUTS or (len(batch) + 1) * longest > _most_samples(mechanism)
        is_of_other_log = mechanism.differs_by_log and bool(batch) and window.signals is not batch[0].signals
        if batch and (is_full or is_of_other_log):
            yield tuple(batch)
            batch = []
            longest = len(window)
        batch.append(window)
    if batch:
        yield tuple(batch)


def _together(mechanism: Mechanism, batch: tuple[Window, ...], report: Report) -> Iterator[SimulatedWindows]:
    """All windows at once, each from its start to its end."""
    run = _Run(mechanism, batch)
    run.advance(np.arange(len(batch)), report)
    yield run.result()


def _in_pieces(mechanism: Mechanism, batch: tuple[Window, ...], report: Report) -> Iterator[SimulatedWindows]:
    """One window after the other, each cut into pieces that advance together."""
    for k, window in enumerate(batch):
        report_part = partial(_report_part, report, k / len(batch), 1 / len(batch))
        yield _simulate_in_pieces(mechanism, window, report_part)


def _is_cut_into_pieces(mechanism: Mechanism, batch: Sequence[Window]) -> bool:
    """True if windows are to be simulated one after the other, in pieces.

    This is done if one of them needs much memory. It is also done if it takes fewer steps: if the windows are long and
    few, and there is a controller, which makes motions forget how they began.
    """
    if max(map(len, batch)) > _most_samples(mechanism):
        return True
    has_controller = any(window.signals.controller.joints.any() for window in batch)
    cost_together = max(len(window) / _piece_spacing(window) for window in batch)  # in those of a piece
    cost_in_pieces = _EXPECTED_PASSES * len(batch)
    return has_controller and cost_in_pieces < cost_together


def _most_samples(mechanism: Mechanism) -> int:
    """Largest number of samples of all windows that advance together, each counted as long as the longest."""
    return _MAX_ARRAY_ELEMENTS // mechanism.model.joint_count


def _report_part(report: Report, before: float, size: float, share: float) -> None:
    report(before + size * share)


def _piece_spacing(window: Window) -> int:
    """Samples from the start of a piece to that of the next."""
    return max(round(_PIECE_DURATION / window.dt), 1)


def _simulate_in_pieces(mechanism: Mechanism, window: Window, report: Report) -> SimulatedWindows:
    """One long rollout, section by section, each in pieces that advance together."""
    count = len(window)
    q, v, tau = np.empty((3, len(window.signals.joints), 1, count))
    diverged = False
    state_vector = None
    for section in _cut(window, _MAX_ROLLOUTS * _piece_spacing(window)):
        before = (section.part.start - window.part.start) / count
        size = len(section) / count
        run = _simulate_section(mechanism, section, state_vector, partial(_report_part, report, before, size))
        state_vector = run.rollouts.state_vector[:, -1:]
        simulated = run.result()
        for w, piece in enumerate(simulated.windows):
            length = len(piece)
            start = piece.part.start - window.part.start
            at = slice(start, start + length)
            if diverged:  # no state to begin in: stay at the first sample, which is also the last of the piece before
                q[:, 0, at] = q[:, 0, start, None]
                v[:, 0, at] = 0.0
                tau[:, 0, at] = tau[:, 0, start, None]
            else:
                q[:, 0, at] = simulated.q[:, w, :length]
                v[:, 0, at] = simulated.v[:, w, :length]
                tau[:, 0, at] = simulated.tau[:, w, :length]
            diverged |= bool(simulated.diverged[w])
    return SimulatedWindows((window,), q, v, tau, np.array([diverged]))


def _cut(window: Window, spacing: int) -> tuple[Window, ...]:
    """Parts of a window that begin a number of samples apart; each ends with the first sample of the next."""
    signals, whole = window.signals, window.part
    parts = []
    for first in range(whole.start, whole.stop - 1, spacing):
        parts.append(Window(signals, slice(first, min(first + spacing + 1, whole.stop))))
    return tuple(parts)


def _simulate_section(mechanism: Mechanism, section: Window, start_state: Array | None, report: Report) -> _Run:
    """A section from a state, shape (states, 1), or the measured one, in pieces that each begin where the last ended.

    At first each but the first begins in the measured state, and those that did not begin where the piece before them
    ended are done again from there. A controller makes motions forget how they began, so that few passes settle all;
    where it does not, they are done one after the other. What follows a diverged piece is not used. It need not begin
    in the state of that piece, which may be no number.
    """
    pieces = _cut(section, _piece_spacing(section))
    run = _Run(mechanism, pieces)
    if start_state is not None:
        first_piece = np.array([0])
        run.restart(first_piece, start_state)
    todo = np.arange(len(pieces))
    passes = 0
    done = 0.0
    while todo.size:
        if passes:
            run.restart(todo, run.rollouts.state_vector[:, todo - 1])
        share = (1 - done) / 2  # how many passes are to come is not known
        run.advance(todo, partial(_report_part, report, done, share))
        done += share
        passes += 1
        jumps = np.abs(run.initial_state_vector[:, 1:] - run.rollouts.state_vector[:, :-1])
        todo = 1 + np.flatnonzero((jumps > _MAX_JUMP).any(axis=0))
        if passes >= _MAX_PARALLEL_PASSES:
            todo = todo[:1]
    report(1.0)
    return run


class _Run:
    """Rollouts that advance together, and their motion at the samples of their logs.

    Attributes
    ----------
    rollouts
        The rollouts, each at its present time.
    initial_state_vector
        The states that they began in, shape (states, W).
    """

    def __init__(self, mechanism: Mechanism, windows: tuple[Window, ...]) -> None:
        from idtool.dynamics.simulation.rollouts import LONGEST_STEP, Rollouts

        self._mechanism = mechanism
        self._windows = windows
        self._dt = np.array([window.dt for window in windows])
        self._t0 = np.array([window.start_time for window in windows])
        self._last = np.array([len(window) - 1 for window in windows])  # samples
        self._input_torque = InputTorque(windows, mechanism)
        self._offset = mechanism.position_offset[:, None]
        states = [measured_states(window.signals, [window.part.start]) for window in windows]
        q, v = np.concatenate(states, axis=2)
        measured_speeds = np.array([_fastest_measured_speed(window) for window in windows])
        self._max_speed = np.maximum(_MAX_SPEED, _MAX_SPEED_RATIO * measured_speeds)
        step = np.minimum([samples_per_step(dt) * dt for dt in self._dt], LONGEST_STEP)
        base = _base_motion(windows, mechanism) if mechanism.model.has_floating_base else None
        names = {window.signals.log.path.name for window in windows}
        log = names.pop() if len(names) == 1 else ""
        with _immovable_as_error(mechanism):
            self.rollouts = Rollouts(mechanism, self._t0, q + self._offset, v, self._input_torque, step, log, base)
            np.linalg.cholesky(self.rollouts.mass_matrix)  # raises where it is not positive definite
        self.initial_state_vector = self.rollouts.state_vector
        shape = (len(q), len(windows), self._last.max() + 1)
        self._q = np.zeros(shape)
        self._v = np.zeros(shape)
        self._diverged = np.zeros(len(windows), dtype=bool)
        self._steps: list[_Steps] = []  # whose samples are still to be recorded
        step_elements = 2 * 3 * self.rollouts.q.size  # position, velocity and acceleration at both ends
        self._most_steps = min(_MAX_STEPS, max(_MAX_STEP_ELEMENTS // step_elements, 1))

    def restart(self, rollout_ids: Indices, state_vector: Array) -> None:
        """Restart some rollouts from states, shape (states, w)."""
        self.rollouts.restart(rollout_ids, state_vector, self._t0[rollout_ids])
        self.initial_state_vector[:, rollout_ids] = self.rollouts.state_vector[:, rollout_ids]
        self._diverged[rollout_ids] = False

    def advance(self, rollout_ids: Indices, report: Report) -> None:
        """Advance some rollouts to their ends."""
        rollouts = self.rollouts
        self._q[:, rollout_ids, 0] = rollouts.q[:, rollout_ids] - self._offset
        self._v[:, rollout_ids, 0] = rollouts.v[:, rollout_ids]
        durations = self._last * self._dt
        until = rollouts.t.copy()
        until[rollout_ids] = self._t0[rollout_ids] + durations[rollout_ids]

        def on_step(stepped_ids: Indices, start: RolloutState, end: RolloutState) -> None:
            times = start.t.copy(), end.t.copy()  # the state that a step ends with changes with later steps
            self._steps.append(_Steps(stepped_ids, *times, start.motion, end.motion))
            fastest = np.abs(end.v).max(axis=0)
            diverged_ids = stepped_ids[~(fastest < self._max_speed[stepped_ids])]  # NaN has diverged, too
            if diverged_ids.size or len(self._steps) >= self._most_steps:
                self._record_samples()
                elapsed = (rollouts.t - self._t0)[stepped_ids]
                report(float(np.min(elapsed / durations[stepped_ids])))
            if diverged_ids.size:
                self._stop(diverged_ids, until)

        with _immovable_as_error(self._mechanism):
            rollouts.advance(until, on_step)
        self._record_samples()
        report(1.0)

    def _stop(self, rollout_ids: Indices, until: Array) -> None:
        """Stop diverged rollouts, also in ``until``: they stay where they were a sample before."""
        for rollout_id in rollout_ids:
            elapsed = self.rollouts.t[rollout_id] - self._t0[rollout_id]
            k = int(elapsed / self._dt[rollout_id])
            self._q[:, rollout_id, k:] = self._q[:, rollout_id, max(k - 1, 0)][:, None]
            self._v[:, rollout_id, k:] = 0.0
        self._diverged[rollout_ids] = True
        until[rollout_ids] = -np.inf

    def _record_samples(self) -> None:
        """Record the motion at the samples that lie in the steps since the last call."""
        if not self._steps:
            return
        step = _joined(self._steps)
        self._steps.clear()
        rate = 1 / self._dt[step.rollout_ids]
        t0 = self._t0[step.rollout_ids]
        motor = self.rollouts.motor_coordinates
        start_sample = (step.start_time - t0) * rate
        end_sample = (step.end_time - t0) * rate
        first = np.floor(start_sample + _SAMPLE_TOLERANCE).astype(np.intp) + 1
        last = np.floor(end_sample + _SAMPLE_TOLERANCE).astype(np.intp)
        for k in range(int((last - first).max()) + 1):
            columns = np.flatnonzero(first + k <= last)
            sample = first[columns] + k
            h = (step.end_time - step.start_time)[columns]
            share = np.minimum((sample - start_sample[columns]) / (end_sample - start_sample)[columns], 1.0)
            q, v = interpolate(step.start_motion[:, :, columns], step.end_motion[:, :, columns], h, share)
            self._q[:, step.rollout_ids[columns], sample] = q[motor] - self._offset
            self._v[:, step.rollout_ids[columns], sample] = v[motor]

    def result(self) -> SimulatedWindows:
        """Motion and torque as sensors would give them."""
        tau = np.zeros_like(self._q)
        for w, window in enumerate(self._windows):
            for first in range(0, len(window), _SAMPLES_AT_ONCE):
                samples = np.arange(first, min(first + _SAMPLES_AT_ONCE, len(window)))
                t = self._t0[w] + samples * self._dt[w]
                q, v = self._q[:, w, samples], self._v[:, w, samples]
                rollout_ids = np.full(len(t), w)
                tau[:, w, samples] = self._input_torque.measured_torque(t, q, v, rollout_ids)
        return SimulatedWindows(self._windows, self._q, self._v, tau, self._diverged)


@dataclass(frozen=True)
class _Steps:
    """Steps of w rollouts side by side; a rollout may be there several times.

    Attributes
    ----------
    rollout_ids
        Indices of the rollouts, shape (w,).
    start_time, end_time
        Shape (w,) [s].
    start_motion, end_motion
        Position, velocity and acceleration of the n coordinates, shape (3, n, w).
    """

    rollout_ids: Indices
    start_time: Array
    end_time: Array
    start_motion: Array
    end_motion: Array


def _joined(steps: Sequence[_Steps]) -> _Steps:
    """Steps side by side."""
    return _Steps(
        rollout_ids=np.concatenate([step.rollout_ids for step in steps]),
        start_time=np.concatenate([step.start_time for step in steps]),
        end_time=np.concatenate([step.end_time for step in steps]),
        start_motion=np.concatenate([step.start_motion for step in steps], axis=2),
        end_motion=np.concatenate([step.end_motion for step in steps], axis=2),
    )


def _fastest_measured_speed(window: Window) -> float:
    """Greatest measured speed of any joint in a window [rad/s or m/s]; 0 if none was measured."""
    return float(np.fmax.reduce(np.abs(window.signals.velocity(window.part)), axis=None, initial=0.0))


def _base_motion(windows: Sequence[Window], mechanism: Mechanism) -> SignalInterpolation:
    """Measured velocity and acceleration of a floating base along windows within the log's ``ranges``."""
    base = mechanism.model.base_coordinates

    def read(signals: Signals, part: slice) -> Array:
        motion = signals.motion(part)
        return np.concatenate([motion.v[base], motion.a[base]])

    delay = np.full(len(windows), -mechanism.imu_delay)
    return SignalInterpolation(windows, read, delay, known_range=usable_range)


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

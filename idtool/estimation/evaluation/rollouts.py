"""Errors of simulated rollouts against a log: position and velocity, against time since the rollout was started.

Open loop, under the logged torque, started again from the measured state every window; its baseline stays at that
state. Closed loop, where joints have no torque but a command and a controller, over whole stretches; its baseline takes
the command for the motion.

Shapes: nv joints, N samples. Units: rad or m, s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.notice import Notice
from idtool.common.processes import in_processes
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import Window, measured_states, split_into_windows, stretches_without_contact
from idtool.estimation.dataset.envelope import Envelope, Trace
from idtool.estimation.dataset.experiment import Experiment, Progress

HORIZONS = (0.01, 0.05, 0.1, 0.5)  # s
_LONGEST = 60.0  # s of open-loop motion that are simulated of few joints; of a longer log, windows spread over it
_MANY_JOINTS = 12  # above which it is less, since a step takes about as long as the square of their number
_DRAWN = 1000  # stretches of time in which the least and greatest position are drawn

Kind = Literal["open_loop", "closed_loop"]
_Job = tuple[Signals, Sequence[slice]]  # windows of a log to simulate


@dataclass
class RolloutError:
    """Sums of squared errors, per joint, for one model or baseline.

    Attributes
    ----------
    position, velocity
        Shape (nv,) [rad² or m², and per s²].
    samples, speeds
        Number of samples of position and of velocity.
    after
        Horizon [s] to the squared position error so long after a start, shape (nv,), and the number of starts.
    """

    position: Array
    velocity: Array
    samples: int = 0
    speeds: int = 0
    after: dict[float, tuple[Array, int]] = field(default_factory=dict)

    @classmethod
    def none(cls, joints: int) -> RolloutError:
        """Errors without any samples, for a number of joints."""
        return cls(np.zeros(joints), np.zeros(joints))

    def add(self, measured: _MeasuredMotion, q: Array, v: Array, dt: float) -> None:
        """Count all samples of a rollout with motion q and v, shape (nv, N), but the first, where it was started."""
        errors = np.square(q - measured.q)
        self.position += errors[:, 1:].sum(axis=1)
        self.samples += errors.shape[1] - 1
        is_known = np.isfinite(measured.v[:, 1:]).all(axis=0)
        self.velocity += np.square(v - measured.v)[:, 1:][:, is_known].sum(axis=1)
        self.speeds += int(np.count_nonzero(is_known))
        for seconds in HORIZONS:
            k = round(seconds / dt)
            if 0 < k < errors.shape[1]:
                squares, count = self.after.get(seconds, (np.zeros(len(errors)), 0))
                self.after[seconds] = squares + errors[:, k], count + 1

    def rmse(self, joints: Sequence[str], quantity: Literal["position", "velocity"]) -> dict[str, float]:
        """Root mean square by joint, and ``overall`` joints and samples."""
        if quantity == "position":
            return _root_mean(joints, self.position, self.samples)
        return _root_mean(joints, self.velocity, self.speeds)

    def horizon(self, joints: Sequence[str], seconds: float) -> dict[str, float] | None:
        """RMS position error a given time after the start, as in `rmse`; None if no rollout is that long."""
        if seconds not in self.after:
            return None
        squares, count = self.after[seconds]
        return _root_mean(joints, squares, count)


def _root_mean(joints: Sequence[str], squares: Array, count: int) -> dict[str, float]:
    means = squares / max(count, 1)
    by_joint = {name: float(value) for name, value in zip(joints, np.sqrt(means), strict=True)}
    return {**by_joint, "overall": float(np.sqrt(means.mean()))}


@dataclass(frozen=True)
class RolloutEvaluation:
    """Models against logs, as simulations.

    Attributes
    ----------
    kind
        Open loop: the torque was the logged one; closed loop: the controller's.
    window
        Time after which the rollouts were started again [s]; None: never.
    errors
        By model, and ``baseline``.
    traces
        Measured and simulated positions for drawing, one per log.
    windows, available
        Number of rollouts that were simulated, and that the logs hold.
    diverged
        Number of rollouts that ran away, by model.
    failed
        Reason why a model cannot be simulated, by model; it has no errors.
    """

    kind: Kind
    window: float | None
    errors: Mapping[str, RolloutError]
    traces: tuple[Trace, ...]
    windows: int
    available: int
    diverged: Mapping[str, int]
    failed: Mapping[str, str]


def evaluate_rollouts(
    experiment: Experiment, models: Mapping[str, Array], held_out: bool, progress: Progress
) -> RolloutEvaluation | None:
    """Simulate the training or the held-out parts with one or more models.

    Where some logs hold torque and others only a command, it is done for the latter. With contacts, it is done while no
    force acts at those on links that the joints move; the motion of a floating base is given. None if nothing can be
    simulated: the torque of a joint is not known, or such a force acts all the time.

    Parameters
    ----------
    experiment
        Model and data.
    models
        Name to coefficients, shape (p,).
    held_out
        If true the held-out parts, else the training parts.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    if any(run.signals.unknown_torque for run in experiment.runs):
        return None
    contacts = experiment.equation.contacts
    parts = []
    for run in experiment.runs:
        own_parts: Sequence[slice] = run.parts(held_out)
        if contacts is not None:
            own_parts = stretches_without_contact(run.signals, own_parts, contacts)
        parts.append((run.signals, own_parts))
    closed = any(signals.controller.joints.any() for signals, ranges in parts if ranges)
    window = None if closed else experiment.config.simulation.window
    jobs, available = _windows(parts, window, closed, experiment.model.joint_count)
    if contacts is not None and not jobs:
        return None
    baseline, envelopes = _evaluate_baseline(jobs, experiment.model.joint_count, closed)

    def simulate_one(name: str, progress: Progress) -> _ModelRollouts:
        return _simulate_model(experiment, name, models[name], jobs, closed, progress)

    errors = {}
    diverged = {}
    failed = {}
    for name, simulated in zip(models, in_processes(simulate_one, list(models), progress), strict=True):
        diverged[name] = simulated.diverged
        if simulated.failure is None:
            errors[name] = simulated.error
        else:
            failed[name] = simulated.failure
        for envelope, own in zip(envelopes, simulated.envelopes, strict=False):  # of a failure, fewer
            envelope.merge(own)
    errors["baseline"] = baseline
    names = [signals.log.path.name for signals, _ in jobs]
    return RolloutEvaluation(
        kind="closed_loop" if closed else "open_loop",
        window=window,
        errors=errors,
        traces=tuple(envelope.trace(name) for name, envelope in zip(names, envelopes, strict=True)),
        windows=sum(len(windows) for _, windows in jobs),
        available=available,
        diverged=diverged,
        failed=failed,
    )


@dataclass
class _ModelRollouts:
    """Rollouts of one model: errors, curves log by log, the number of rollouts that ran away, and why it fails."""

    error: RolloutError
    envelopes: list[Envelope] = field(default_factory=list)
    diverged: int = 0
    failure: str | None = None


def _evaluate_baseline(jobs: Sequence[_Job], joints: int, closed: bool) -> tuple[RolloutError, list[Envelope]]:
    """Errors of the baseline, and the measured positions for drawing, log by log."""
    baseline = RolloutError.none(joints)
    envelopes = []
    for signals, windows in jobs:
        envelope = Envelope(windows, signals.log.t, _DRAWN)
        for part in windows:
            motion = _MeasuredMotion(signals, part, closed)
            baseline.add(motion, *motion.baseline, signals.log.dt)
            envelope.add(motion.t, {"measured": motion.q})
        envelopes.append(envelope)
    return baseline, envelopes


def _simulate_model(
    experiment: Experiment, name: str, theta: Array, jobs: Sequence[_Job], closed: bool, progress: Progress
) -> _ModelRollouts:
    """Rollouts of a model with coefficients ``theta``, shape (p,), in the windows of logs."""
    simulated = _ModelRollouts(RolloutError.none(experiment.model.joint_count))
    mechanism = experiment.equation.mechanism(experiment.model, theta)
    rollouts = _rollouts(mechanism, jobs, progress)
    try:
        for signals, parts in jobs:
            envelope = Envelope(parts, signals.log.t, _DRAWN)
            simulated.envelopes.append(envelope)
            for part in parts:
                q, v, has_diverged = next(rollouts)
                motion = _MeasuredMotion(signals, part, closed)
                simulated.error.add(motion, q, v, signals.log.dt)
                simulated.diverged += has_diverged
                envelope.add(motion.t, {name: q})
    except ModelError as error:
        simulated.failure = str(error)
    return simulated


def _rollouts(mechanism: Mechanism, jobs: Sequence[_Job], progress: Progress) -> Iterator[tuple[Array, Array, bool]]:
    """Position and velocity in each window, shape (nv, N), and true if the rollout diverged; log after log."""
    windows = [Window(signals, part) for signals, parts in jobs for part in parts]
    stage = f"simulating {jobs[0][0].log.path.name if len(jobs) == 1 else 'the logs'}"
    for simulated in simulate(mechanism, windows, lambda share: progress(stage, share)):
        for w, window in enumerate(simulated.windows):
            length = len(window)
            yield simulated.q[:, w, :length], simulated.v[:, w, :length], bool(simulated.diverged[w])


class _MeasuredMotion:
    """Measured motion in a window, and the prediction of its baseline, shape (nv, N)."""

    def __init__(self, signals: Signals, part: slice, closed: bool) -> None:
        self.t = signals.channels.times(part)
        self.q = signals.channels.signal("q", part)
        self.v = signals.velocity(part)
        self.baseline = self._commanded_motion(signals, part) if closed else self._first_state(signals, part)

    def _first_state(self, signals: Signals, part: slice) -> tuple[Array, Array]:
        """The measured state at the start, for all samples."""
        q, v = measured_states(signals, [part.start])
        return np.broadcast_to(q, self.q.shape), np.broadcast_to(v, self.q.shape)

    def _commanded_motion(self, signals: Signals, part: slice) -> tuple[Array, Array]:
        """The commanded motion; joints that have no command stay as they are."""
        by_command = signals.controller.joints[:, None]
        q, v = self._first_state(signals, part)
        q_command = signals.channels.signal("qcmd", part)
        if q_command.shape[1] > 1:
            v_command = np.gradient(q_command, signals.log.dt, axis=1)
        else:
            v_command = np.zeros_like(q_command)
        if "vcmd" in signals.log.signals:
            logged = signals.channels.signal("vcmd", part)
            v_command = np.where(np.isfinite(logged), logged, v_command)
        return np.where(by_command, q_command, q), np.where(by_command, v_command, v)


def _windows(
    parts: Sequence[tuple[Signals, Sequence[slice]]], window: float | None, closed: bool, joints: int
) -> tuple[list[tuple[Signals, list[slice]]], int]:
    """Windows to simulate of every log that is driven in the same way, and the number of windows that there are."""
    jobs = [
        (signals, split_into_windows(signals, ranges, window, share_ends=True))
        for signals, ranges in parts
        if ranges and signals.controller.joints.any() == closed
    ]
    available = sum(len(windows) for _, windows in jobs)
    most = available if window is None else max(int(_longest(joints) / window), 1)
    if available > most:
        kept = np.linspace(0, available, most, endpoint=False).astype(int)
        first = 0
        for i, (signals, windows) in enumerate(jobs):
            in_log = kept[(kept >= first) & (kept < first + len(windows))] - first
            first += len(windows)
            jobs[i] = (signals, [windows[k] for k in in_log])
    return [(signals, windows) for signals, windows in jobs if windows], available


def _longest(joints: int) -> float:
    """Longest open-loop motion that is simulated of a robot with so many joints, all windows together [s]."""
    return _LONGEST * min(_MANY_JOINTS / joints, 1.0) ** 2


def simulation_notices(rollouts: RolloutEvaluation | None, model: str) -> list[Notice]:
    """Notices about rollouts.

    Parameters
    ----------
    rollouts
        The model's simulation and, where there is one, that of ``prior``; None: not asked for.
    model
        The model's name there.
    """
    if rollouts is None:
        return []
    notices = []
    for name in (model, "prior"):
        which = "the prior" if name == "prior" else "the model"
        if name in rollouts.failed:
            message = f"{which} was not simulated: {rollouts.failed[name]}"
            advice = "fit with constraints: full or tighter; add missing inertias to the links and rotors of the prior"
            notices.append(Notice("simulation_failed", "warning", None, message, advice))
        elif diverged := rollouts.diverged.get(name):
            message = f"{diverged} of {rollouts.windows} simulations of {which} diverged and were stopped"
            advice = "use a shorter simulation.window; look for a joint with little inertia"
            notices.append(Notice("simulation_diverged", "warning", None, message, advice))
    return notices

"""How far a model's simulation departs from a log: position and velocity, against time since it was started.

Open loop, under the logged torque, started again from the measured state every window; its baseline stays at that
state. Closed loop, where joints have no torque but a command and a controller, over whole stretches; its baseline takes
the command for the motion.

Shapes: nv joints, N samples. Units: rad or m, s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import measured_states, split_into_windows
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.evaluation.envelope import Envelope, Trace

HORIZONS = (0.01, 0.05, 0.1, 0.5)  # s
_LONGEST = 120.0  # s of open-loop motion that are simulated; of a longer log, windows spread over it
_DRAWN = 1000  # stretches of time in which the least and greatest position are drawn


@dataclass
class Departure:
    """Sums of squared errors, per joint, for one model or baseline.

    Attributes
    ----------
    position, velocity
        Shape (nv,) [rad² or m², and per s²].
    samples, speeds
        How many samples of position and of velocity.
    after
        Horizon [s] to the squared position error so long after a start, shape (nv,), and the number of starts.
    """

    position: Array
    velocity: Array
    samples: int = 0
    speeds: int = 0
    after: dict[float, tuple[Array, int]] = field(default_factory=dict)

    @classmethod
    def none(cls, joints: int) -> Departure:
        """Nothing yet, for so many joints."""
        return cls(np.zeros(joints), np.zeros(joints))

    def add(self, measured: _Measured, q: Array, v: Array, dt: float) -> None:
        """Count a rollout that was at q and v, shape (nv, N), all but the first sample, where it was started."""
        errors = np.square(q - measured.q)
        self.position += errors[:, 1:].sum(axis=1)
        self.samples += errors.shape[1] - 1
        known = np.isfinite(measured.v[:, 1:]).all(axis=0)
        self.velocity += np.square(v - measured.v)[:, 1:][:, known].sum(axis=1)
        self.speeds += int(np.count_nonzero(known))
        for seconds in HORIZONS:
            k = round(seconds / dt)
            if 0 < k < errors.shape[1]:
                squares, count = self.after.get(seconds, (np.zeros(len(errors)), 0))
                self.after[seconds] = squares + errors[:, k], count + 1

    def rmse(self, joints: Sequence[str], quantity: Literal["position", "velocity"]) -> dict[str, float]:
        """Root mean square by joint, and ``overall`` joints and samples."""
        count = self.samples if quantity == "position" else self.speeds
        return _root_mean(joints, getattr(self, quantity), count)

    def horizon(self, joints: Sequence[str], seconds: float) -> dict[str, float] | None:
        """The same of the position so long after a start; None where no rollout is that long."""
        squares, count = self.after.get(seconds, (self.position, 0))
        return _root_mean(joints, squares, count) if count else None


def _root_mean(joints: Sequence[str], squares: Array, count: int) -> dict[str, float]:
    means = squares / max(count, 1)
    by_joint = {name: float(value) for name, value in zip(joints, np.sqrt(means), strict=True)}
    return {**by_joint, "overall": float(np.sqrt(means.mean()))}


@dataclass(frozen=True)
class Replay:
    """Models against logs, as simulations.

    Attributes
    ----------
    kind
        Whether the torque was the logged one or the controller's.
    window
        How often the rollouts were started again [s]; None: never.
    departures
        By model, and ``baseline``.
    traces
        Measured and simulated positions for drawing, one a log.
    windows, of
        How many rollouts were simulated, and how many the logs hold.
    lost
        By model, how many of them ran away.
    failed
        By model that cannot be simulated, why; it has no departure.
    """

    kind: Literal["open_loop", "closed_loop"]
    window: float | None
    departures: Mapping[str, Departure]
    traces: tuple[Trace, ...]
    windows: int
    of: int
    lost: Mapping[str, int]
    failed: Mapping[str, str]


def replay(experiment: Experiment, models: Mapping[str, Array], held_out: bool, progress: Progress) -> Replay:
    """Simulate the training or the held-out parts with one or more models.

    Where some logs hold torque and others only a command, it is done for the latter.

    Parameters
    ----------
    experiment
        Model and data.
    models
        Name to coefficients, shape (p,).
    held_out
        Which parts.
    progress
        Told how far it has come.
    """
    parts = [(run.signals, run.held_out if held_out else run.train) for run in experiment.runs]
    closed = any(signals.command.joints.any() for signals, some in parts if some)
    window = None if closed else experiment.config.simulation.window
    jobs, of = _spread(parts, window, closed)
    departures = {name: Departure.none(len(experiment.model.joints)) for name in (*models, "baseline")}
    lost, failed, traces = dict.fromkeys(models, 0), {}, []
    for signals, windows in jobs:
        measured = [_Measured(signals, part, closed) for part in windows]
        envelope = Envelope(windows, signals.log.t, _DRAWN)
        for one in measured:
            departures["baseline"].add(one, *one.baseline, signals.log.dt)
            envelope.add(one.t, {"measured": one.q})
        for name, theta in models.items():
            if name in failed:
                continue
            mechanism = experiment.equation.mechanism(experiment.model, theta)
            try:
                for one, (q, v, ran_away) in zip(measured, _lanes(mechanism, signals, windows, progress), strict=True):
                    departures[name].add(one, q, v, signals.log.dt)
                    lost[name] += ran_away
                    envelope.add(one.t, {name: q})
            except ModelError as error:
                failed[name] = str(error)
                del departures[name]
        traces.append(envelope.trace(signals.log.path.name))
    kind: Literal["open_loop", "closed_loop"] = "closed_loop" if closed else "open_loop"
    count = sum(len(windows) for _, windows in jobs)
    return Replay(kind, window, departures, tuple(traces), count, of, lost, failed)


def _lanes(
    mechanism: Mechanism, signals: Signals, windows: Sequence[slice], progress: Progress
) -> Iterator[tuple[Array, Array, bool]]:
    """Position and velocity in each window, shape (nv, N), and whether the rollout ran away."""
    stage = f"simulating {signals.log.path.name}"
    for simulated in simulate(mechanism, signals, windows, lambda share: progress(stage, share)):
        for w, window in enumerate(simulated.windows):
            length = window.stop - window.start
            yield simulated.q[:, w, :length], simulated.v[:, w, :length], bool(simulated.diverged[w])


class _Measured:
    """What was measured in a window, and what its baseline predicts, shape (nv, N)."""

    def __init__(self, signals: Signals, part: slice, closed: bool) -> None:
        self.t = signals.channels.times(part)
        self.q = signals.channels.signal("q", part)
        self.v = signals.velocity(part)
        self.baseline = self._command(signals, part) if closed else self._state(signals, part)

    def _state(self, signals: Signals, part: slice) -> tuple[Array, Array]:
        q, v = measured_states(signals, [part.start])
        return np.broadcast_to(q, self.q.shape), np.broadcast_to(v, self.q.shape)

    def _command(self, signals: Signals, part: slice) -> tuple[Array, Array]:
        """The commanded motion; joints that have no command stay as they are."""
        by_command = signals.command.joints[:, None]
        q, v = self._state(signals, part)
        commanded = signals.channels.signal("qcmd", part)
        speed = np.gradient(commanded, signals.log.dt, axis=1) if commanded.shape[1] > 1 else np.zeros_like(commanded)
        if "vcmd" in signals.log.signals:
            speed = np.where(np.isfinite(given := signals.channels.signal("vcmd", part)), given, speed)
        return np.where(by_command, commanded, q), np.where(by_command, speed, v)


def _spread(
    parts: Sequence[tuple[Signals, Sequence[slice]]], window: float | None, closed: bool
) -> tuple[list[tuple[Signals, list[slice]]], int]:
    """The windows that are simulated of every log that is driven in the same way, and how many there are."""
    jobs = [
        (signals, split_into_windows(signals, some, window, share_ends=True))
        for signals, some in parts
        if some and signals.command.joints.any() == closed
    ]
    of = sum(len(windows) for _, windows in jobs)
    most = of if window is None else max(int(_LONGEST / window), 1)
    if of > most:
        keep = np.linspace(0, of, most, endpoint=False).astype(int)
        first = 0
        for i, (signals, windows) in enumerate(jobs):
            mine = keep[(keep >= first) & (keep < first + len(windows))] - first
            first += len(windows)
            jobs[i] = (signals, [windows[k] for k in mine])
    return [job for job in jobs if job[1]], of


def simulation_notes(replay: Replay | None, model: str) -> list[str]:
    """What a user should know of a replay, a plain sentence each.

    Parameters
    ----------
    replay
        The model's simulation and, where there is one, that of ``prior``; None: not asked for.
    model
        The model's name there.
    """
    if replay is None:
        return []
    notes = []
    for name in (model, "prior"):
        which = "the prior" if name == "prior" else "the model"
        if name in replay.failed:
            notes.append(f"no simulation of {which}: {replay.failed[name]}")
        elif lost := replay.lost.get(name):
            notes.append(f"{lost} of {replay.windows} simulations of {which} ran away and were stopped")
    return notes

"""A model along a log → a log: under the logged torque, under the joint controller, or tracking a trajectory.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError, ModelError
from idtool.data.logs import Log, make_log
from idtool.data.signals import Signals
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import split_into_windows
from idtool.estimation.dataset.experiment import Experiment, Progress


@dataclass(frozen=True)
class SimulatedLog:
    """What `idtool simulate` finds.

    Attributes
    ----------
    log
        The motion, of the model's joints: q, v, tau, and qcmd and vcmd where they drove it.
    measured
        The positions that were measured at the same times, shape (N, nv).
    kind
        Whether the torque was the logged one or the controller's.
    window
        How often it was started again from the measured state [s]; None: never.
    seconds
        How much was simulated [s].
    position, velocity
        RMS difference from what was measured, by joint and ``overall``, without the samples at which it was started;
        empty where nothing was measured.
    rollouts, lost
        How often it was started, and how many of these ran away; they end where they did.
    """

    log: Log
    measured: Array
    kind: Literal["open_loop", "closed_loop"]
    window: float | None
    seconds: float
    position: dict[str, float]
    velocity: dict[str, float]
    rollouts: int
    lost: int


def as_logged(log: Log) -> Log:
    """A log as it is.

    Raises
    ------
    LogError
        If nothing in it moves a joint.
    """
    if not {"tau", "qcmd"} & log.signals.keys():
        raise LogError(log.path, "holds neither torque nor command; --track has the controller follow its q")
    return log


def under_controller(log: Log) -> Log:
    """A log without its torque, so that the controller drives the joints on the logged command.

    Raises
    ------
    LogError
        If there is no command.
    """
    if "qcmd" not in log.signals:
        raise LogError(log.path, "holds no command; --closed-loop needs qcmd_<joint>, or --track to follow q itself")
    return replace(log, signals={name: x for name, x in log.signals.items() if name != "tau"})


def as_command(log: Log) -> Log:
    """A log taken for a trajectory that the controller tracks: its command where it has one, else its motion."""
    command = {"q": "qcmd", "v": "vcmd"} if "qcmd" in log.signals else {"q": "q", "v": "v"}
    q = log.signals[command["q"]]
    speed = np.full_like(q, np.nan)
    for part in log.segments:
        speed[part] = np.gradient(q[part], log.dt, axis=0)
    return replace(log, signals={"q": q, "v": speed, "qcmd": q, "vcmd": log.signals.get(command["v"], speed)})


def simulated_log(
    experiment: Experiment, theta: Array, window: float | None, path: Path, progress: Progress
) -> SimulatedLog:
    """Run a model along the first log of an experiment.

    Parameters
    ----------
    experiment
        Model and data, all of it to be simulated held out.
    theta
        Coefficients, shape (p,).
    window
        Start again from the measured state this often [s]; None: never.
    path
        The file that the log is to be written to.
    progress
        Told how far it has come.

    Raises
    ------
    ModelError
        If the model cannot be simulated, or runs away as soon as it is started.
    """
    run = experiment.runs[0]
    signals, joints = run.signals, experiment.equation.joints
    windows = split_into_windows(signals, run.held_out, window)
    stage = f"simulating {signals.log.path.name}"
    mechanism = experiment.equation.mechanism(experiment.model, theta)
    pieces, lost = [], 0
    for some in simulate(mechanism, signals, windows, lambda share: progress(stage, share)):
        for w, part in enumerate(some.windows):
            q, v, tau = (x[:, w, : part.stop - part.start] for x in (some.q, some.v, some.tau))
            lost += bool(some.diverged[w])
            kept = _followed(v) if some.diverged[w] else v.shape[1]
            if kept > 1 or not some.diverged[w]:
                part = slice(part.start, part.start + kept)
                pieces.append(_Piece(signals, part, q[:, :kept], v[:, :kept], tau[:, :kept]))
    if not pieces:
        raise ModelError(experiment.model.robot.path, "runs away as soon as it is started; its inertias are too small")
    return SimulatedLog(
        log=_joined(path, joints, pieces),
        measured=np.concatenate([piece.measured_q.T for piece in pieces]),
        kind="closed_loop" if signals.command.joints.any() else "open_loop",
        window=window,
        seconds=sum(piece.q.shape[1] for piece in pieces) * signals.log.dt,
        position=_rmse(joints, [piece.q - piece.measured_q for piece in pieces]),
        velocity=_rmse(joints, [piece.v - piece.measured_v for piece in pieces]),
        rollouts=len(windows),
        lost=lost,
    )


class _Piece:
    """One rollout, shape (nv, N) each, beside what was measured."""

    def __init__(self, signals: Signals, part: slice, q: Array, v: Array, tau: Array) -> None:
        self.t = signals.channels.times(part)
        self.q, self.v = q, v
        self.measured_q, self.measured_v = signals.channels.signal("q", part), signals.velocity(part)
        self.signals: dict[str, Array] = {"q": q, "v": v, "tau": tau}
        driven = signals.command.joints[:, None]
        for name in ("qcmd", "vcmd"):
            if driven.any() and name in signals.log.signals:
                self.signals[name] = np.where(driven, signals.channels.signal(name, part), np.nan)


def _followed(v: Array) -> int:
    """How many samples a rollout that ran away was followed for; from then on it stands still where it last was."""
    moving = np.flatnonzero(v.any(axis=0))
    return int(moving[-1]) + 1 if moving.size else 0


def _joined(path: Path, joints: tuple[str, ...], pieces: Sequence[_Piece]) -> Log:
    t = np.concatenate([piece.t for piece in pieces])
    names = pieces[0].signals
    return make_log(path, t, joints, {n: np.concatenate([piece.signals[n].T for piece in pieces]) for n in names})


def _rmse(joints: Sequence[str], differences: Sequence[Array]) -> dict[str, float]:
    """Root mean square by joint, and ``overall`` joints and samples, of what was measured."""
    every = np.concatenate([x[:, 1:] for x in differences], axis=1)
    every = every[:, np.isfinite(every).all(axis=0)]
    if not every.shape[1]:
        return {}
    means = np.square(every).mean(axis=1)
    by_joint: dict[str, Any] = dict(zip(joints, np.sqrt(means).tolist(), strict=True))
    return {**by_joint, "overall": float(np.sqrt(means.mean()))}

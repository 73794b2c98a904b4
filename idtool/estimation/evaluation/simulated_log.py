"""Simulation along a log: under the logged torque, under the joint controller, or tracking a trajectory.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError, ModelError
from idtool.common.names import join_names
from idtool.data.base_sensors import needed_channels
from idtool.data.logs import JointLog, make_log
from idtool.data.logs.sensor_channels import channels_as_logged
from idtool.data.signals import Signals
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import Window, split_into_windows, stretches_without_contact
from idtool.estimation.dataset.experiment import Experiment, Progress


@dataclass(frozen=True)
class SimulatedLog:
    """Result of `idtool simulate`.

    Attributes
    ----------
    log
        The motion, of the model's joints: q, v, tau, and qcmd and vcmd where they drove it; and the logged channels of
        the sensors of a base and of contacts. Wrench sensors would read something else along another motion.
    measured
        The positions that were measured at the same times, shape (N, nv).
    kind
        Open loop: the torque was the logged one; closed loop: the controller's.
    window
        Time after which it was started again from the measured state [s]; None: never.
    seconds
        Simulated time [s].
    log_seconds
        Time in the log that has samples of all signals [s].
    stretches
        Number of stretches that were simulated: of the log without gaps, and without contact forces on links that the
        joints move.
    position, velocity
        RMS difference from what was measured, by joint and ``overall``, without the samples at which it was started;
        empty where nothing was measured.
    rollouts, diverged
        Number of rollouts, and of those that ran away, which end where they did.
    """

    log: JointLog
    measured: Array
    kind: Literal["open_loop", "closed_loop"]
    window: float | None
    seconds: float
    log_seconds: float
    stretches: int
    position: dict[str, float]
    velocity: dict[str, float]
    rollouts: int
    diverged: int


def as_logged(log: JointLog) -> JointLog:
    """The log itself, unchanged.

    Raises
    ------
    LogError
        If nothing in it moves a joint.
    """
    if not {"tau", "qcmd"} & log.signals.keys():
        raise LogError(log.path, "contains neither torque nor command; use --track to let the controller follow q")
    return log


def under_controller(log: JointLog) -> JointLog:
    """A log without its torque, so that the controller drives the joints on the logged command.

    Raises
    ------
    LogError
        If there is no command.
    """
    if "qcmd" not in log.signals:
        raise LogError(log.path, "contains no command; --closed-loop needs qcmd_<joint>; use --track to follow q")
    signals = {name: x for name, x in log.signals.items() if name != "tau"}
    return replace(log, signals=signals, unknown_torque=())


def as_command(log: JointLog) -> JointLog:
    """A log taken for a trajectory that the controller tracks: its command where it has one, else its motion."""
    command = {"q": "qcmd", "v": "vcmd"} if "qcmd" in log.signals else {"q": "q", "v": "v"}
    q = log.signals[command["q"]]
    speed = np.full_like(q, np.nan)
    for part in log.segments:
        speed[part] = np.gradient(q[part], log.dt, axis=0)
    signals = {"q": q, "v": speed, "qcmd": q, "vcmd": log.signals.get(command["v"], speed)}
    return replace(log, signals=signals, unknown_torque=())


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
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    LogError
        If the torque of a joint is not known, or a contact force acts on the joints all the time.
    ModelError
        If the model cannot be simulated, or runs away as soon as it is started.
    """
    run = experiment.runs[0]
    signals, joints = run.signals, experiment.model.joint_names
    stretches = _simulated_stretches(experiment)
    windows = [Window(signals, part) for part in split_into_windows(signals, stretches, window)]
    stage = f"simulating {signals.log.path.name}"
    mechanism = experiment.equation.mechanism(experiment.model, theta)
    rollouts = []
    diverged = 0
    for batch in simulate(mechanism, windows, lambda share: progress(stage, share)):
        for w, simulated in enumerate(batch.windows):
            part = simulated.part
            q, v, tau = (x[:, w, : len(simulated)] for x in (batch.q, batch.v, batch.tau))
            has_diverged = bool(batch.diverged[w])
            diverged += has_diverged
            kept = _samples_before_divergence(v) if has_diverged else v.shape[1]
            if kept > 1 or not has_diverged:
                part = slice(part.start, part.start + kept)
                rollouts.append(_Rollout(signals, part, q[:, :kept], v[:, :kept], tau[:, :kept]))
    if not rollouts:
        raise ModelError(experiment.model.robot.path, "diverges as soon as it is simulated; its inertias are too small")
    without_wrench_sensors = experiment.config.model_copy(update={"wrench_sensors": ()})
    channels = channels_as_logged(signals.log, needed_channels(without_wrench_sensors))
    return SimulatedLog(
        log=replace(_log_of(path, joints, rollouts), channels=channels),
        measured=np.concatenate([rollout.measured_q.T for rollout in rollouts]),
        kind="closed_loop" if signals.controller.joints.any() else "open_loop",
        window=window,
        seconds=sum(rollout.q.shape[1] for rollout in rollouts) * signals.log.dt,
        log_seconds=sum(part.stop - part.start for part in signals.log.segments) * signals.log.dt,
        stretches=len(stretches),
        position=_rmse(joints, [rollout.q - rollout.measured_q for rollout in rollouts]),
        velocity=_rmse(joints, [rollout.v - rollout.measured_v for rollout in rollouts]),
        rollouts=len(windows),
        diverged=diverged,
    )


def _simulated_stretches(experiment: Experiment) -> Sequence[slice]:
    """Stretches of the first log that can be simulated; LogError, with the reason, if there are none."""
    run = experiment.runs[0]
    signals, contacts = run.signals, experiment.equation.contacts
    if signals.unknown_torque:
        names = join_names([signals.joints[j] for j in signals.unknown_torque])
        raise LogError(signals.log.path, f"has no torque of {names}; a simulation needs that of every joint")
    if contacts is None:
        return run.held_out
    stretches = stretches_without_contact(signals, run.held_out, contacts)
    stretches = [stretch for stretch in stretches if stretch.stop - stretch.start > 1]
    if not stretches:
        what = "cannot be simulated: a contact force acts on the joints all the time"
        if experiment.model.has_floating_base:
            advice = "give a log in which the robot hangs free"
        else:
            advice = "give a log with motion without contact, or check the flags of the contacts"
        raise LogError(signals.log.path, f"{what}; {advice}")
    return stretches


class _Rollout:
    """One rollout, shape (nv, N) each, beside what was measured."""

    def __init__(self, signals: Signals, part: slice, q: Array, v: Array, tau: Array) -> None:
        self.t = signals.channels.times(part)
        self.q, self.v = q, v
        self.measured_q, self.measured_v = signals.channels.signal("q", part), signals.velocity(part)
        self.signals: dict[str, Array] = {"q": q, "v": v, "tau": tau}
        driven = signals.controller.joints[:, None]
        for name in ("qcmd", "vcmd"):
            if driven.any() and name in signals.log.signals:
                self.signals[name] = np.where(driven, signals.channels.signal(name, part), np.nan)


def _samples_before_divergence(v: Array) -> int:
    """Number of samples before a rollout diverged; from then on it stands still where it last was."""
    moving = np.flatnonzero(v.any(axis=0))
    return int(moving[-1]) + 1 if moving.size else 0


def _log_of(path: Path, joints: tuple[str, ...], rollouts: Sequence[_Rollout]) -> JointLog:
    t = np.concatenate([rollout.t for rollout in rollouts])
    signals = {}
    for name in rollouts[0].signals:
        signals[name] = np.concatenate([rollout.signals[name].T for rollout in rollouts])
    return make_log(path, t, joints, signals)


def _rmse(joints: Sequence[str], differences: Sequence[Array]) -> dict[str, float]:
    """Root mean square by joint, and ``overall`` joints and samples, of samples that were measured."""
    samples = np.concatenate([x[:, 1:] for x in differences], axis=1)
    samples = samples[:, np.isfinite(samples).all(axis=0)]
    if not samples.shape[1]:
        return {}
    means = np.square(samples).mean(axis=1)
    by_joint: dict[str, Any] = dict(zip(joints, np.sqrt(means).tolist(), strict=True))
    return {**by_joint, "overall": float(np.sqrt(means.mean()))}

"""Logs of robots with hidden effects: a drive follows a command, sensors read what happens.

Each millisecond, a PD controller sets the actuators' torque from what the sensors read a millisecond before. Its
feed-forward is the designer's inverse dynamics and about the true friction. A sample lies in the middle of its
torque's millisecond.

Letters: q, v, a, tau (n, N) at 1 kHz in the motion, and (N, n) in `Recording`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hidden_effects.effects import Channels, Hidden, act
from hidden_effects.motion import Motion, nominal_torque
from hidden_effects.plant import RATE, Physics, Plant, needed
from hidden_effects.robots import Robot, Truth, rotor

Array = NDArray[np.float64]

_BANDWIDTH = 60.0  # rad/s of the position loop
_DAMPING = 0.8
_TUNED = (0.9, 1.1)  # friction in the feed-forward, of the true one
_CALM = 200.0  # 1/s, the damping of a motor by itself
_LOST = 0.6  # rad from the command
_STEPS, _FINE = 4, 10  # steps a sample; with gears that give way or bristles


@dataclass(frozen=True)
class Sensors:
    """What the drives read.

    Attributes
    ----------
    bits
        Of the encoder, a turn of the joint; None: the robot's own.
    lag
        By which the velocity lags, differenced from the encoder and smoothed [s].
    velocity
        Whether the log has it.
    noise
        White, on the torque, as a share of each joint's rms torque.
    jitter
        Of the time stamps, as a share of a millisecond.
    """

    bits: int | None = None
    lag: float = 1.0e-3
    velocity: bool = True
    noise: float = 0.005
    jitter: float = 0.0


@dataclass(frozen=True)
class Recording:
    """As measured: t (N,), q, v, tau (N, n); ``noise`` on each joint's torque [N m], (n,)."""

    t: Array
    q: Array
    v: Array
    tau: Array
    noise: Array


def record(
    robot: Robot, truth: Truth, hidden: tuple[Hidden, ...], motion: Motion, sensors: Sensors, seed: int
) -> Recording:
    """Run the robot along a motion.

    Raises
    ------
    RuntimeError
        If a joint departs from its command by more than 0.6 rad.
    """
    rng = np.random.default_rng([seed, 13])
    tuned = np.array([truth.viscous, truth.coulomb]) * rng.uniform(*_TUNED, (2, len(robot.joints)))
    fed = nominal_torque(robot, motion, tuned).T
    truth, physics, channels = act(robot, truth, hidden)
    fine = physics.gears or any(one.effect == "presliding_hysteresis" for one in hidden)
    steps = _FINE if fine else _STEPS
    plant = Plant(robot, truth, physics, 1 / (RATE * steps), motion.q[:, 0] + channels.offset, motion.v[:, 0])
    gains = _gains(robot, motion, physics)
    true, q, v = _run(plant, robot, motion, fed, gains, channels, sensors, steps)
    tau = _measured(true, channels)
    noise = sensors.noise * np.sqrt(np.mean(np.square(tau), axis=0))
    t = motion.t + sensors.jitter / RATE * rng.normal(size=len(motion.t))
    return Recording(t, q, v, tau + noise * rng.normal(size=tau.shape), noise)


def _run(
    plant: Plant,
    robot: Robot,
    motion: Motion,
    fed: Array,
    gains: tuple[Array, Array],
    channels: Channels,
    sensors: Sensors,
    steps: int,
) -> tuple[Array, Array, Array]:
    """The true torque, position and velocity as read."""
    step = 2 * np.pi / 2 ** (sensors.bits or robot.bits)
    keep = 1 / (0.5 + sensors.lag * RATE)
    kp, kd = gains
    limit = np.array([joint.effort for joint in robot.joints])
    q_cmd, v_cmd = motion.q.T, motion.v.T
    tau, q, v = np.zeros((3, *q_cmd.shape))
    asked, speed = fed[0], v_cmd[0]
    before = np.round((q_cmd[0] - v_cmd[0] / RATE) / step) * step
    for k in range(len(q_cmd)):
        tau[k] = np.clip(asked, -limit, limit)
        for _ in range(steps // 2):
            plant.step(tau[k])
        at = plant.x[plant.motors] - plant.v[plant.motors] / (2 * steps * RATE) - channels.offset
        for _ in range(steps // 2):
            plant.step(tau[k])
        q[k] = np.round(at / step) * step
        speed = speed + keep * ((q[k] - before) * RATE - speed)
        v[k], before = speed, q[k]
        if np.abs(q[k] - q_cmd[k]).max() > _LOST:
            raise RuntimeError(f"{robot.name}: a joint lost its command after {k / RATE:.2f} s: {q[k] - q_cmd[k]} rad")
        asked = fed[min(k + 1, len(fed) - 1)] + kp * (q_cmd[k] - q[k]) + kd * (v_cmd[k] - v[k])
    return tau, q, v


def _gains(robot: Robot, motion: Motion, physics: Physics) -> tuple[Array, Array]:
    """Of the PD controller, by what each joint moves in the middle of its travel, (n,).

    Less where the motor can move without its link, lest it chatter.
    """
    n = len(robot.joints)
    middle = np.repeat(np.median(motion.q, axis=1)[:, None], n + 1, axis=1)
    rotors = {joint.name: rotor(joint) for joint in robot.joints}
    torque = needed(robot, robot.links, rotors, middle, np.zeros((n, n + 1)), np.eye(n, n + 1))
    inertia = np.diag(torque[:, :n] - torque[:, n:])
    bandwidth = np.full(n, _BANDWIDTH)
    for j in physics.gears:
        bandwidth[j] = min(_BANDWIDTH, _CALM * robot.joints[j].reflected / (2 * _DAMPING * inertia[j]))
    return bandwidth**2 * inertia, 2 * _DAMPING * bandwidth * inertia


def _measured(true: Array, channels: Channels) -> Array:
    """Torque as the channels give it, (N, n): late, then bent or scaled."""
    total = np.vstack([np.zeros(true.shape[1]), np.cumsum(true, axis=0)])  # its integral at the samples' ends
    ends = np.arange(len(total), dtype=float)
    tau = true.copy()
    for j in np.flatnonzero(channels.late):
        late = ends - channels.late[j] * RATE
        past = np.interp(late, ends, total[:, j]) + np.minimum(late, 0.0) * true[0, j]
        tau[:, j] = np.diff(past)
    for j, sensor in channels.sensors:
        tau[:, j] = sensor(tau[:, j])
    return tau


def write_log(path: Path, robot: Robot, recording: Recording, velocity: bool = True) -> None:
    """A recording as CSV."""
    signals = {"q": recording.q, "v": recording.v, "tau": recording.tau}
    if not velocity:
        del signals["v"]
    names = [f"{signal}_{joint}" for signal in signals for joint in robot.names]
    table = np.column_stack([recording.t, *signals.values()])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(["t", *names]), comments="")

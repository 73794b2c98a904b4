"""Logs of robots with hidden effects: a drive follows a command, and sensors record the motion.

Every millisecond, a PD controller sets the torque of the actuators from the sensor values of the millisecond before.
Its feed-forward is the designer's inverse dynamics with nearly the true friction. A sample lies in the middle of the
millisecond of its torque.

Letters: q, v, tau at 1 kHz; shape (n, N) in a `Motion`, (N, n) in a `Recording`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hidden_effects.effects import HiddenEffect, SensorErrors, apply_effects
from hidden_effects.friction import Friction
from hidden_effects.motion import Motion, nominal_torque
from hidden_effects.plant import RATE, AddedPhysics, Plant, inverse_dynamics
from hidden_effects.robots import Robot, Truth, rotor

Array = NDArray[np.float64]

_BANDWIDTH = 60.0  # rad/s, of the position loop
_DAMPING_RATIO = 0.8
_FRICTION_FACTORS = (0.9, 1.1)  # friction in the feed-forward over the true one
_MAX_MOTOR_DAMPING = 200.0  # 1/s, of a motor that moves by itself in an elastic transmission
_MAX_TRACKING_ERROR = 0.6  # rad
_STEPS, _FINE_STEPS = 4, 10  # simulation steps per sample; with elastic transmissions or stiff friction
_CORRELATION_TIMES = (0.02, 0.08)  # s, of coloured noise
_QUANTUM = 0.005  # of the peak torque
_STICKING = Friction("sign")

NOISE_KINDS = ("white", "coloured", "quantised", "none")


@dataclass(frozen=True)
class Sensors:
    """The sensors of a log.

    Attributes
    ----------
    encoder_bits
        Resolution per turn of the joint; None: the robot's own.
    velocity_lag
        Lag of the velocity, which is differenced from the encoder and smoothed [s].
    has_velocity
        True if the log has velocities.
    torque_noise
        Rms of ``white`` and ``coloured`` noise on the torque, as a share of each joint's rms torque.
    noise
        Kind of the noise on the torque, one of `NOISE_KINDS`.
    time_jitter
        Noise of the time stamps, as a share of a millisecond.
    """

    encoder_bits: int | None = None
    velocity_lag: float = 1.0e-3
    has_velocity: bool = True
    torque_noise: float = 0.005
    noise: str = "white"
    time_jitter: float = 0.0


@dataclass(frozen=True)
class Recording:
    """Measured signals: t (N,); q, v, tau (N, n); and the rms noise on each joint's torque, shape (n,) [N m]."""

    t: Array
    q: Array
    v: Array
    tau: Array
    noise: Array


def record(
    robot: Robot,
    truth: Truth,
    hidden: tuple[HiddenEffect, ...],
    motion: Motion,
    sensors: Sensors,
    seed: int,
    friction: Friction = _STICKING,
    index: int = 0,
) -> Recording:
    """Run a robot along a commanded motion.

    Parameters
    ----------
    robot, truth, hidden
        The robot, and the effects with their parameters.
    motion, sensors, seed
        The commanded motion, the sensors, and the seed of what is random.
    friction
        The way in which dry friction is simulated.
    index
        Number of the log among those of the robot.

    Raises
    ------
    RuntimeError
        If a joint departs from its command by more than 0.6 rad.
    """
    rng = np.random.default_rng([seed, 13, index])  # zeros at the end do not change a seed
    friction_factors = rng.uniform(*_FRICTION_FACTORS, (2, len(robot.joints)))
    feed_forward = nominal_torque(robot, motion, np.array([truth.viscous, truth.coulomb]) * friction_factors).T
    truth, physics, errors = apply_effects(robot, truth, hidden)
    has_presliding = any(effect.effect == "presliding_hysteresis" for effect in hidden)
    is_stiff = physics.transmissions or has_presliding or friction.is_stiff
    steps = _FINE_STEPS if is_stiff else _STEPS
    start = motion.q[:, 0] + errors.position_offset
    plant = Plant(robot, truth, physics, 1 / (RATE * steps), start, motion.v[:, 0], friction)
    gains = _controller_gains(robot, truth, motion, physics)
    commanded_tau, q, v = _track(plant, robot, motion, feed_forward, gains, physics, errors, sensors, steps)
    tau = measured_torque(commanded_tau, errors)
    t = motion.t + sensors.time_jitter / RATE * rng.normal(size=len(motion.t))
    tau, noise = noisy_torque(tau, sensors, rng)
    return Recording(t, q, v, tau, noise)


def noisy_torque(tau: Array, sensors: Sensors, rng: np.random.Generator) -> tuple[Array, Array]:
    """Torque with the sensors' noise, shape (N, n), and the rms of the noise on each joint, shape (n,) [N m]."""
    if sensors.noise == "none":
        return tau, np.zeros(tau.shape[1])
    if sensors.noise == "quantised":
        quantum = _QUANTUM * np.abs(tau).max(axis=0)
        return np.round(tau / quantum) * quantum, quantum / np.sqrt(12)
    rms_noise = sensors.torque_noise * np.sqrt(np.mean(np.square(tau), axis=0))
    noise = rng.normal(size=tau.shape)
    if sensors.noise == "coloured":
        noise = _coloured(noise, float(rng.uniform(*_CORRELATION_TIMES)))
    return tau + rms_noise * noise, rms_noise


def _coloured(white: Array, correlation_time: float) -> Array:
    """Noise of unit size from white noise, shape (N, n), whose correlation decays by 1/e in a time [s]."""
    decay = np.exp(-1 / (RATE * correlation_time))
    innovation = np.sqrt(1 - decay**2)
    start = (1 - innovation) * white[:1]  # so that the first sample has unit size too
    coloured, _ = lfilter([innovation], [1.0, -decay], white, axis=0, zi=start)
    return np.asarray(coloured)


def _track(
    plant: Plant,
    robot: Robot,
    motion: Motion,
    feed_forward: Array,
    gains: tuple[Array, Array],
    physics: AddedPhysics,
    errors: SensorErrors,
    sensors: Sensors,
    steps: int,
) -> tuple[Array, Array, Array]:
    """Track a motion with the PD controller: its torque, and measured position and velocity, shape (N, n) each."""
    resolution = 2 * np.pi / 2 ** (sensors.encoder_bits or robot.encoder_bits)
    smoothing = 1 / (0.5 + sensors.velocity_lag * RATE)
    kp, kd = gains
    limit = np.array([physics.command_limits.get(j, joint.effort) for j, joint in enumerate(robot.joints)])
    q_cmd, v_cmd = motion.q.T, motion.v.T
    tau, q, v = np.zeros((3, *q_cmd.shape))
    requested = feed_forward[0]
    v_filtered = v_cmd[0]
    q_last = np.round((q_cmd[0] - v_cmd[0] / RATE) / resolution) * resolution
    for k in range(len(q_cmd)):
        tau[k] = np.clip(requested, -limit, limit)
        motor_torque = physics.motor_torque(tau[k])
        for _ in range(steps // 2):
            plant.step(motor_torque)
        x, dx = plant.x[plant.motors], plant.v[plant.motors]
        q_true = x - dx / (2 * steps * RATE)  # semi-implicit Euler: x is half a step ahead of v
        for _ in range(steps // 2):
            plant.step(motor_torque)
        q[k] = np.round((q_true - errors.position_offset) / resolution) * resolution
        v_filtered = v_filtered + smoothing * ((q[k] - q_last) * RATE - v_filtered)
        v[k] = v_filtered
        q_last = q[k]
        error = q_cmd[k] - q[k]
        if np.abs(error).max() > _MAX_TRACKING_ERROR:
            raise RuntimeError(f"{robot.name}: a joint lost its command after {k / RATE:.2f} s: {-error} rad")
        requested = feed_forward[min(k + 1, len(q_cmd) - 1)] + kp * error + kd * (v_cmd[k] - v[k])
    return tau, q, v


def _controller_gains(robot: Robot, truth: Truth, motion: Motion, physics: AddedPhysics) -> tuple[Array, Array]:
    """Gains kp and kd, shape (n,) each, by the inertia that each joint moves in the middle of its travel.

    They are lower where the motor can move without its link, as it would chatter otherwise.
    """
    n = len(robot.joints)
    middle = np.repeat(np.median(motion.q, axis=1)[:, None], n + 1, axis=1)
    rotors = {joint.name: rotor(joint) for joint in robot.joints}
    torque = inverse_dynamics(robot, robot.links, rotors, middle, np.zeros((n, n + 1)), np.eye(n, n + 1))
    inertia = np.diag(torque[:, :n] - torque[:, n:])
    bandwidth = np.full(n, _BANDWIDTH)
    for j in physics.transmissions:
        joint = robot.joints[j]
        axis = np.array(joint.axis, float)
        motor_inertia = joint.gear**2 * float(axis @ truth.rotors[joint.name].inertia @ axis)
        bandwidth[j] = min(_BANDWIDTH, _MAX_MOTOR_DAMPING * motor_inertia / (2 * _DAMPING_RATIO * inertia[j]))
    return bandwidth**2 * inertia, 2 * _DAMPING_RATIO * bandwidth * inertia


def measured_torque(true_tau: Array, errors: SensorErrors) -> Array:
    """Torque that the sensors give, shape (N, n): delayed, then scaled or saturated."""
    integral = np.vstack([np.zeros(true_tau.shape[1]), np.cumsum(true_tau, axis=0)])  # at the ends of the samples
    ends = np.arange(len(integral), dtype=float)
    tau = true_tau.copy()
    for j in np.flatnonzero(errors.torque_delay):
        delayed_ends = ends - errors.torque_delay[j] * RATE
        before_start = np.minimum(delayed_ends, 0.0) * true_tau[0, j]
        tau[:, j] = np.diff(np.interp(delayed_ends, ends, integral[:, j]) + before_start)
    for j, torque_map in errors.torque_maps:
        tau[:, j] = torque_map(tau[:, j])
    return tau


def write_log(path: Path, robot: Robot, recording: Recording, has_velocity: bool = True) -> None:
    """Write a recording as CSV."""
    signals = {"q": recording.q, "v": recording.v, "tau": recording.tau}
    if not has_velocity:
        del signals["v"]
    names = [f"{signal}_{joint}" for signal in signals for joint in robot.names]
    table = np.column_stack([recording.t, *signals.values()])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(["t", *names]), comments="")

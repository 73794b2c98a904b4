"""Commanded motions within a robot's limits: random sines, with slow stretches that are full of reversals.

In a slow stretch, the sines pass at a twentieth of their speed, and small slow waves of 0.03 to 0.25 rad/s are added.

Letters: q [rad], v [rad/s], a [rad/s^2], shape (n, N) each, at 1 kHz; t [s].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from hidden_effects.plant import RATE, inverse_dynamics
from hidden_effects.robots import Robot, rotor

Array = NDArray[np.float64]

_LIMIT_SHARE = 0.8
_SINES = 6
_SLOW_RATE = 0.05  # of the usual rate, in slow stretches
_SLOW_STRETCHES = ((0.22, 0.1), (0.53, 0.1), (0.84, 0.1))  # start and length, as shares of the whole
_MIN_SECONDS = 8.0  # s; shorter motions have no slow stretches
_RAMP = 0.4  # s in which a slow stretch begins and ends
_SMALL_WAVES_HZ = ((0.3, 0.6), (0.6, 1.3))
_FRICTION_WIDTH = 0.005  # rad/s over which the designer's friction changes its sign
_MAX_TRIES = 30
_TORQUE_STRIDE = 25  # samples between those whose torque is checked


@dataclass(frozen=True)
class Motion:
    """A commanded motion: times t, shape (N,), and q, v, a, shape (n, N)."""

    t: Array
    q: Array
    v: Array
    a: Array


def draw_motion(robot: Robot, seed: int, seconds: float, index: int = 0, relative_pace: float = 1.0) -> Motion:
    """Draw a motion, slowed down until it is within 80 % of the robot's limits.

    Parameters
    ----------
    robot, seed, seconds
        The robot, the seed, and the length [s].
    index
        Number of the motion among those of the seed.
    relative_pace
        Pace relative to the motion within the limits, which is as much longer; above 1.25 it may exceed the limits.

    Raises
    ------
    RuntimeError
        If no motion is within the limits.
    """
    pace = 1.0
    for _ in range(_MAX_TRIES):
        # Zeros at the end do not change a seed.
        motion = _random_motion(robot, np.random.default_rng([seed, 12, index]), seconds, pace)
        utilization = _limit_utilization(robot, motion)
        if utilization <= 1:
            if relative_pace == 1:
                return motion
            rng = np.random.default_rng([seed, 12, index])
            return _random_motion(robot, rng, seconds / relative_pace, relative_pace * pace)
        pace *= max(0.97 / np.sqrt(utilization), 0.6)
    raise RuntimeError(f"{robot.name}: no motion of {seconds} s within its limits")


def nominal_torque(robot: Robot, motion: Motion, friction: Array | None = None) -> Array:
    """Torque of the designer's model along a motion, shape (n, N) [N m].

    Parameters
    ----------
    robot, motion
        The robot and its motion.
    friction
        Viscous and Coulomb friction instead of the designer's, shape (2, n).
    """
    if friction is None:
        friction = np.transpose([(joint.viscous, joint.coulomb) for joint in robot.joints])
    viscous, coulomb = friction[..., None]
    friction_torque = viscous * motion.v + coulomb * np.tanh(motion.v / _FRICTION_WIDTH)
    rotors = {joint.name: rotor(joint) for joint in robot.joints}
    return np.asarray(inverse_dynamics(robot, robot.links, rotors, motion.q, motion.v, motion.a) + friction_torque)


def _limit_utilization(robot: Robot, motion: Motion) -> float:
    """Largest share of the permitted velocity or torque that a motion takes."""
    coarse = slice(None, None, _TORQUE_STRIDE)
    few = Motion(motion.t[coarse], motion.q[:, coarse], motion.v[:, coarse], motion.a[:, coarse])
    velocity, effort = np.transpose([(joint.velocity, joint.effort) for joint in robot.joints])
    velocity_share = np.abs(few.v).max(axis=1) / velocity
    torque_share = np.abs(nominal_torque(robot, few)).max(axis=1) / effort
    return float(np.max([velocity_share, torque_share]) / _LIMIT_SHARE)


def _random_motion(robot: Robot, rng: np.random.Generator, seconds: float, pace: float) -> Motion:
    t = np.arange(round(seconds * RATE)) / RATE
    slowness = np.zeros((3, len(t)))  # from 0 to 1, and its first two derivatives
    if seconds >= _MIN_SECONDS:
        for start, length in _SLOW_STRETCHES:
            slowness += _window(t, (start + rng.uniform(-0.04, 0.04)) * seconds, length * seconds)
    # The sines are functions of s, which passes at this rate.
    rate = pace * (1 - (1 - _SLOW_RATE) * slowness[0])
    rate_change = -pace * (1 - _SLOW_RATE) * slowness[1]
    s = cumulative_trapezoid(rate, dx=1 / RATE, initial=0.0)
    sines = np.array([_joint_sines(robot, j, s, rate, rate_change, rng) for j in range(len(robot.joints))])
    small = np.array([_small_waves(t, slowness, rng) for _ in robot.joints])
    q, v, a = np.moveaxis(sines + small, 1, 0)
    return Motion(t, q, v, a)


def _joint_sines(
    robot: Robot, j: int, s: Array, rate: Array, rate_change: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Sum of sines of similar velocities over 0.74 of a joint's travel: q, v and a, shape (N,)."""
    edges = np.geomspace(robot.min_frequency, robot.max_frequency, _SINES + 1)
    omega = 2 * np.pi * rng.uniform(edges[:-1], edges[1:])[:, None]
    amplitude = rng.uniform(0.5, 1.0, (_SINES, 1)) / omega
    phase = rng.uniform(0, 2 * np.pi, (_SINES, 1))
    total = np.sum(amplitude * np.sin(omega * s + phase), axis=0)
    joint = robot.joints[j]
    middle = (joint.upper + joint.lower) / 2
    half_range = (joint.upper - joint.lower) / 2
    scale = (_LIMIT_SHARE - 0.06) * half_range / np.abs(total).max()
    first = scale * np.sum(amplitude * omega * np.cos(omega * s + phase), axis=0)
    second = -scale * np.sum(amplitude * omega**2 * np.sin(omega * s + phase), axis=0)
    return middle + scale * total, first * rate, second * rate**2 + first * rate_change


def _small_waves(t: Array, slowness: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Small waves in the slow stretches: q, v and a, shape (N,)."""
    g = np.zeros((3, len(t)))
    for low, high in _SMALL_WAVES_HZ:
        omega = 2 * np.pi * rng.uniform(low, high)
        speed = np.exp(rng.uniform(np.log(0.03), np.log(0.25)))
        angle = omega * t + rng.uniform(0, 2 * np.pi)
        g += speed * np.array([np.sin(angle) / omega, np.cos(angle), -omega * np.sin(angle)])
    w = slowness
    return w[0] * g[0], w[0] * g[1] + w[1] * g[0], w[0] * g[2] + 2 * w[1] * g[1] + w[2] * g[0]


def _window(t: Array, start: float, length: float) -> Array:
    """Window that rises from 0 to 1 and falls to 0 again, with its first two derivatives, shape (3, N)."""
    return _smooth_step(t - start) - _smooth_step(t - start - length + _RAMP)


def _smooth_step(t: Array) -> Array:
    """Smooth step from 0 to 1 that begins at t = 0, with its first two derivatives, shape (3, N)."""
    x = np.clip(t / _RAMP, 0.0, 1.0)
    value = x**3 * (10 - 15 * x + 6 * x**2)
    first = 30 * x**2 * (1 - x) ** 2 / _RAMP
    second = 60 * x * (1 - x) * (1 - 2 * x) / _RAMP**2
    return np.array([value, first, second])

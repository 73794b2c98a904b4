"""Commanded motions within 80 % of a robot's limits: random sines, with slow stretches full of reversals.

In a slow stretch the sines creep, a twentieth as fast, and small slow waves of 0.03 to 0.25 rad/s are laid over them.

Letters: q [rad], v [rad/s], a [rad/s^2], each (n, N), at 1 kHz; t [s].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from hidden_effects.plant import RATE, needed
from hidden_effects.robots import Robot, rotor

Array = NDArray[np.float64]

_SHARE = 0.8  # of the limits
_WAVES = 6
_CREEP = 0.05  # of its speed, in slow stretches
_SLOW = ((0.22, 0.1), (0.53, 0.1), (0.84, 0.1))  # where they begin, and how long they are, of the whole
_LONG = 8.0  # s; shorter logs have none
_TURN = 0.4  # s in which a stretch comes and goes
_SMOOTH = 0.005  # rad/s over which the friction that is reckoned with changes its sign
_TRIES = 30
_EVERY = 25  # samples between those whose torque is looked at


@dataclass(frozen=True)
class Motion:
    """A commanded motion; t (N,), the others (n, N)."""

    t: Array
    q: Array
    v: Array
    a: Array


def draw_motion(robot: Robot, seed: int, seconds: float) -> Motion:
    """A motion, slower than drawn where it would take more than the robot has.

    Raises
    ------
    RuntimeError
        If none was found.
    """
    pace = 1.0
    for _ in range(_TRIES):
        motion = _drawn(robot, np.random.default_rng([seed, 12]), seconds, pace)
        excess = _excess(robot, motion)
        if excess <= 1:
            return motion
        pace *= max(0.97 / np.sqrt(excess), 0.6)
    raise RuntimeError(f"{robot.name}: no motion of {seconds} s within its limits")


def nominal_torque(robot: Robot, motion: Motion, friction: Array | None = None) -> Array:
    """What the designer thinks that it takes, (n, N) [N m]; with other viscous and Coulomb friction, (2, n)."""
    rotors = {joint.name: rotor(joint) for joint in robot.joints}
    typical = np.transpose([(joint.viscous, joint.coulomb) for joint in robot.joints])
    viscous, coulomb = (typical if friction is None else friction)[..., None]
    rubbing = viscous * motion.v + coulomb * np.tanh(motion.v / _SMOOTH)
    return np.asarray(needed(robot, robot.links, rotors, motion.q, motion.v, motion.a) + rubbing)


def _excess(robot: Robot, motion: Motion) -> float:
    """The largest share of velocity and torque limits, of what is allowed."""
    few = Motion(motion.t[::_EVERY], *(x[:, ::_EVERY] for x in (motion.q, motion.v, motion.a)))
    velocity, effort = np.transpose([(joint.velocity, joint.effort) for joint in robot.joints])
    shares = [np.abs(few.v).max(axis=1) / velocity, np.abs(nominal_torque(robot, few)).max(axis=1) / effort]
    return float(np.max(shares) / _SHARE)


def _drawn(robot: Robot, rng: np.random.Generator, seconds: float, pace: float) -> Motion:
    t = np.arange(round(seconds * RATE)) / RATE
    slow = np.zeros((3, len(t)))  # how slow, from 0 to 1, and its first two derivatives
    for start, length in _SLOW if seconds >= _LONG else ():
        slow += _window(t, (start + rng.uniform(-0.04, 0.04)) * seconds, length * seconds)
    rate, change = pace * (1 - (1 - _CREEP) * slow[0]), -pace * (1 - _CREEP) * slow[1]
    s = cumulative_trapezoid(rate, dx=1 / RATE, initial=0.0)
    rows = np.array([_joint(robot, j, s, rate, change, rng) for j in range(len(robot.joints))])
    small = np.array([_small(t, slow, rng) for _ in robot.joints])
    return Motion(t, *np.moveaxis(rows + small, 1, 0))


def _joint(
    robot: Robot, j: int, s: Array, rate: Array, change: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Sines of like velocities along s, which passes at this rate; as far as 0.74 of the travel."""
    edges = np.geomspace(robot.slowest, robot.fastest, _WAVES + 1)
    omega = 2 * np.pi * rng.uniform(edges[:-1], edges[1:])[:, None]
    size = rng.uniform(0.5, 1.0, (_WAVES, 1)) / omega
    phase = rng.uniform(0, 2 * np.pi, (_WAVES, 1))
    along = np.sum(size * np.sin(omega * s + phase), axis=0)
    joint = robot.joints[j]
    middle, half = (joint.upper + joint.lower) / 2, (joint.upper - joint.lower) / 2
    scale = (_SHARE - 0.06) * half / np.abs(along).max()
    first = scale * np.sum(size * omega * np.cos(omega * s + phase), axis=0)
    second = -scale * np.sum(size * omega**2 * np.sin(omega * s + phase), axis=0)
    return middle + scale * along, first * rate, second * rate**2 + first * change


def _small(t: Array, slow: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Slow waves where it is slow."""
    g = np.zeros((3, len(t)))
    for low, high in ((0.3, 0.6), (0.6, 1.3)):
        omega, speed = 2 * np.pi * rng.uniform(low, high), np.exp(rng.uniform(np.log(0.03), np.log(0.25)))
        x = omega * t + rng.uniform(0, 2 * np.pi)
        g += speed * np.array([np.sin(x) / omega, np.cos(x), -omega * np.sin(x)])
    w = slow
    return w[0] * g[0], w[0] * g[1] + w[1] * g[0], w[0] * g[2] + 2 * w[1] * g[1] + w[2] * g[0]


def _window(t: Array, start: float, length: float) -> Array:
    """From 0 to 1 and back, with its first two derivatives, shape (3, N)."""
    return _step(t - start) - _step(t - start - length + _TURN)


def _step(t: Array) -> Array:
    """A smooth step from 0 to 1 from t = 0 on, with its first two derivatives."""
    x = np.clip(t / _TURN, 0.0, 1.0)
    value = x**3 * (10 - 15 * x + 6 * x**2)
    first = 30 * x**2 * (1 - x) ** 2 / _TURN
    second = 60 * x * (1 - x) * (1 - 2 * x) / _TURN**2
    return np.array([value, first, second])

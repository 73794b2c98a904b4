"""The belt arm's experiment: every joint follows a sum of sines under PD control.

The elbow's motor sits in the turret and drives the forearm by a belt over the shoulder, so its rotor turns with
shoulder and elbow together: eight times the forearm's angle against the turret.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from bodies import Array
from sensors import Recording, Sensors
from two_mass import RATE, Friction, Robot, simulate

FRICTION = {"waist": Friction(0.08, 0.5), "shoulder": Friction(0.12, 0.7), "elbow": Friction(0.05, 0.4)}
SENSORS = Sensors(position_step=2 * np.pi / 2**17, torque_noise=0.25, velocity_step=1e-3)
GEAR_STIFFNESS, GEAR_DAMPING = 1e5, 25.0  # rotor against link: 500 to 800 Hz, damping ratio 0.4 to 0.6

REST = np.array([0.0, -0.4, 0.9])  # the sines swing about it [rad]
HARMONICS = np.array([1, 2, 3, 5, 8, 13, 21])
OMEGA = 2 * np.pi * 0.15 * HARMONICS  # [rad/s]
AMPLITUDE = np.array([[0.4], [0.4], [0.45]]) * HARMONICS**-0.5  # [rad]
KP, KD = np.array([1500.0, 1500.0, 600.0]), np.array([40.0, 40.0, 15.0])  # [N m/rad, N m s/rad]

SETTLE = 1.0  # s until the start's transient has died away
SECONDS = {"train": 10.0, "validate": 8.0}


def target(t: float, phases: Array) -> tuple[Array, Array]:
    """Angles [rad] and velocities [rad/s] the joints should have; phases (nj, harmonics)."""
    angle = OMEGA * t + phases
    return REST + (AMPLITUDE * np.sin(angle)).sum(axis=1), (AMPLITUDE * OMEGA * np.cos(angle)).sum(axis=1)


def controller(robot: Robot, phases: Array) -> Callable[[float, mujoco.MjData], Array]:
    """PD control with a friction feed-forward, without which the joints would stick at reversals."""
    coulomb = np.array([friction.coulomb for friction in robot.friction])

    def control(t: float, data: mujoco.MjData) -> Array:
        q, v = target(t, phases)
        feedback = KP * (q - data.qpos[robot.links]) + KD * (v - data.qvel[robot.links])
        return np.asarray(feedback + coulomb * np.tanh(v / 0.01))

    return control


def record(robot: Robot, rng: np.random.Generator) -> dict[str, Recording]:
    """Run the experiment once per log, each with phases of its own: log name to recording."""
    logs = {}
    for name, seconds in SECONDS.items():
        phases = rng.uniform(0, 2 * np.pi, AMPLITUDE.shape)
        run = simulate(robot, controller(robot, phases), *target(0.0, phases), SETTLE + seconds)
        kept = run.part(slice(round(SETTLE * RATE), None))
        logs[name] = Recording(0.0, kept, SENSORS.read(kept, rng))
    return logs

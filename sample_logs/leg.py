"""The leg's experiment: its foot swings on an ellipsoidal shell under Cartesian impedance control.

The motion is that of Wensing, Kim and Slotine (arXiv 1701.04395, section V): spherical angles phi and theta with
rates A_phi sin(w_phi t) and A_theta sin(w_theta t). What the paper leaves open is chosen here: the shell, its pole
along x so that phi swings the foot up and sideways, and a friction feed-forward. Without the latter the joints stick
for milliseconds at every reversal, and a sticking joint's friction is not c sign(v).
"""

from __future__ import annotations

import mujoco
import numpy as np
from bodies import Array
from sensors import Recording, Sensors
from two_mass import RATE, Friction, Robot, simulate

FRICTION = {"abad": Friction(0.25, 3.12), "hip": Friction(0.15, 1.25), "knee": Friction(0.10, 0.95)}
SENSORS = Sensors(
    position_step=2 * np.pi / 2**14 / 10.604,  # 14 bit on the motor, behind the gear: 3.6e-5 rad
    torque_noise=0.4,  # 0.04 N m at the motor
    velocity_lag=1e-3,
)
GEAR_STIFFNESS, GEAR_DAMPING = 5e5, 150.0  # rotor against link: 500 to 900 Hz, damping ratio 0.5 to 0.8

PHI, THETA = 12.0, 3.4  # amplitudes of the rates [rad/s]
PHI_FREQUENCY, THETA_FREQUENCY = 1.63, 0.265  # [rad/s]
CENTER = np.array([0.12, 0.08, -0.42])  # of the shell, in the base [m]
RADII = np.array([0.17, 0.25, 0.175])  # [m]
STIFFNESS, DAMPING = 15e3, 300.0  # of the foot [N/m, N s/m]

START = np.array([0.1, 0.9, -1.6])  # near the shell [rad]
SETTLE = 2.5  # s until the foot is under way
SECONDS = 20.0


def foot_target(t: float) -> tuple[Array, Array]:
    """Position [m] and velocity [m/s] that the foot should have."""
    phi = np.pi + PHI / PHI_FREQUENCY * (1 - np.cos(PHI_FREQUENCY * t))
    theta = THETA / THETA_FREQUENCY * (1 - np.cos(THETA_FREQUENCY * t))
    phi_rate, theta_rate = PHI * np.sin(PHI_FREQUENCY * t), THETA * np.sin(THETA_FREQUENCY * t)
    out, along = np.sin(theta), np.cos(theta)
    position = np.array([along, out * np.cos(phi), out * np.sin(phi)])
    by_phi = np.array([0, -position[2], position[1]])
    by_theta = np.array([-out, along * np.cos(phi), along * np.sin(phi)])
    return CENTER + RADII * position, RADII * (by_phi * phi_rate + by_theta * theta_rate)


def record(robot: Robot, rng: np.random.Generator) -> dict[str, Recording]:
    """Run the experiment once and cut it in two: log name to recording."""
    model = robot.model
    foot, jacobian = model.body("foot").id, np.zeros((3, model.nv))
    coulomb = np.array([friction.coulomb for friction in robot.friction])

    def control(t: float, data: mujoco.MjData) -> Array:
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_jacBody(model, data, jacobian, None, foot)
        J = jacobian[:, robot.links]
        position, velocity = foot_target(t)
        force = STIFFNESS * (position - data.xpos[foot]) + DAMPING * (velocity - J @ data.qvel[robot.links])
        joint_velocity = np.linalg.solve(J, velocity)
        return np.asarray(J.T @ force + coulomb * np.tanh(joint_velocity / 0.01))

    run = simulate(robot, control, START, np.zeros(3), SETTLE + SECONDS)
    signals = SENSORS.read(run, rng)
    start, n = round(SETTLE * RATE), round(SECONDS * RATE) // 2
    parts = {"train": slice(start, start + n), "validate": slice(start + n, start + 2 * n)}
    return {
        name: Recording((part.start - start) / RATE, run.part(part), {x: signals[x][part] for x in signals})
        for name, part in parts.items()
    }

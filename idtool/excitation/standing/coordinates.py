"""Limits of the independent coordinates of a robot that stands, for the magnitude of a motion about the stance.

They are those of each coordinate by itself, at rest or from rest, as far as joints, torques and ground allow. A motion
of all coordinates may still be beyond these limits, and is scaled.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.excitation.limits import Limits
from idtool.excitation.patterns import MotionSamples
from idtool.excitation.standing.kinematics import BASE_MOTION, StandingKinematics
from idtool.excitation.standing.robot import Loads, StandingRobot

_STEPS = 25  # to the largest excursion or acceleration
_MAX_EXCURSION = (0.2, 0.2, 0.2, 0.35, 0.35, 0.35)  # m and rad, of the base
_MAX_ACCELERATION = (8.0, 8.0, 8.0, 40.0, 40.0, 40.0)  # m/s² and rad/s², of the base
_MIN_SHARE = 1e-3  # of the largest, so that no limit is 0
_DEADBAND = 1.0  # rad/s or m/s: friction takes either side


def coordinate_limits(robot: StandingRobot, kinematics: StandingKinematics, soles: list[Array]) -> Limits:
    """Limits of the independent coordinates; the efforts are not limited.

    Parameters
    ----------
    robot
        The robot, whose joints have limits.
    kinematics
        Its motion from a stance.
    soles
        Rotation of every foot's link to the world, shape (3, 3) each.
    """
    joints = robot.limits.joints
    home = kinematics.home
    n = len(joints)
    lower, upper, velocity, acceleration = np.zeros((4, len(home)))
    tangents = _tangents(kinematics)
    for i, name in enumerate(kinematics.coordinates):
        if name in BASE_MOTION:
            largest = np.full(2, _MAX_EXCURSION[BASE_MOTION.index(name)])
            max_acceleration = _MAX_ACCELERATION[BASE_MOTION.index(name)]
        else:
            j = joints.index(name)
            largest = np.array([home[i] - robot.limits.lower[j], robot.limits.upper[j] - home[i]])
            max_acceleration = float(robot.limits.acceleration[j])
        down, up = _excursions(robot, kinematics, soles, i, largest)
        lower[i], upper[i] = home[i] - down, home[i] + up

        per_unit = np.abs(tangents[:n, i])  # motion of the joints
        moves = per_unit > 0
        velocity[i] = (robot.limits.velocity[moves] / per_unit[moves]).min()
        by_joints = (robot.limits.acceleration[moves] / per_unit[moves]).min()
        acceleration[i] = _acceleration(robot, kinematics, soles, i, min(by_joints, max_acceleration))
    effort = np.full(len(home), np.inf)
    return Limits(kinematics.coordinates, lower, upper, velocity, acceleration, effort)


def _tangents(kinematics: StandingKinematics) -> Array:
    """Derivatives of the configuration by the independent coordinates at the stance, shape (n + 6, d)."""
    home = kinematics.home[:, None]
    zero = np.zeros_like(home)
    return np.asarray(kinematics.tangents(kinematics.samples(home, zero, zero)).first[0])


def _excursions(
    robot: StandingRobot, kinematics: StandingKinematics, soles: list[Array], coordinate: int, largest: Array
) -> tuple[float, float]:
    """Excursions of a coordinate down and up that the robot can hold at rest, up to the largest ones, shape (2,)."""
    excursions = []
    for sign, most in zip((-1.0, 1.0), largest, strict=True):
        steps = np.linspace(0, 1, _STEPS + 1)[1:] * most
        u = np.repeat(kinematics.home[:, None], _STEPS, axis=1)
        u[coordinate] += sign * steps
        w, is_reached = kinematics.configurations(u)
        q = w[: len(robot.limits.joints)]
        loads = robot.static_loads(q, kinematics.base_to_world(w), soles)
        is_within = (q > robot.limits.lower[:, None]) & (q < robot.limits.upper[:, None])
        feasible = is_reached & is_within.all(axis=0) & _is_feasible(robot, loads)
        feasible_steps = _STEPS if feasible.all() else int(np.argmin(feasible))
        excursions.append(max(feasible_steps / _STEPS, _MIN_SHARE) * most)
    return excursions[0], excursions[1]


def _acceleration(
    robot: StandingRobot, kinematics: StandingKinematics, soles: list[Array], coordinate: int, largest: float
) -> float:
    """Largest acceleration of a coordinate from rest at the stance to either side."""
    count = 2 * _STEPS
    steps = np.linspace(0, 1, _STEPS + 1)[1:] * largest
    u = np.repeat(kinematics.home[:, None], count, axis=1)
    ddu = np.zeros_like(u)
    ddu[coordinate] = np.concatenate([steps, -steps])
    samples = kinematics.samples(u, np.zeros_like(u), ddu)
    t = np.arange(count, dtype=float)
    deadband = np.full(len(robot.model.joints), _DEADBAND)
    motion = robot.motion(MotionSamples(*samples.motion), samples.base_to_world, t, deadband)
    required = robot.equation.torque(motion, robot.theta)
    loads = robot.loads(required, kinematics.foot_jacobian(samples.w), soles)
    feasible = _is_feasible(robot, loads).reshape(2, _STEPS).all(axis=0)
    feasible_steps = _STEPS if feasible.all() else int(np.argmin(feasible))
    return max(feasible_steps / _STEPS, _MIN_SHARE) * largest


def _is_feasible(robot: StandingRobot, loads: Loads) -> Mask:
    """True where torques and ground are within their limits, shape (N,)."""
    torque = (np.abs(loads.torque) <= robot.limits.effort[:, None]).all(axis=0)
    return np.asarray(torque & (loads.violation == 0))

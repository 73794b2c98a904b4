"""Motions of the humanoid: standing and swaying, stepping, and hanging with all joints swinging.

Standing and stepping are given by the course of the centre of mass, the pelvis and the soles; the legs follow by
inverse kinematics. While it steps, the centre of mass c moves as that of a pendulum of constant height h whose point of
zero moment p goes from foot to foot: c - h/g d2c/dt2 = p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded
from scipy.spatial.transform import Rotation

from ground.humanoid import LEG_PARTS, SIDES, WAIST_PARTS
from ground.motions import Motion, swinging, tones
from ground.robot import Array, Robot, rotation_about

_GRID = 0.01  # s, between samples of a course
_BEND = 0.06  # m, by which the pelvis is lower than with straight legs
_HANGING_HEIGHT = 1.3  # m
_SWAY = np.array([0.01, 0.02, 0.01, 0.07, 0.09, 0.1])  # m and rad, of the pelvis
_SWAY_OF_STEPS = np.array([0.0, 0.0, 0.006, 0.02, 0.03, 0.04])
_WAIST = np.array([0.15, 0.05, 0.08])  # rad
_ARM = np.array([0.3, 0.12, 0.25, 0.3])
_LEG = np.array([0.3, 0.12, 0.15, 0.3, 0.2, 0.15])
_ARM_STANCE = np.array([0.1, 0.25, 0.0, -0.8])  # rad, of the left one
_BEFORE_STEPS = 1.0  # s
_SHIFT, _SWING = 1.1, 0.8  # s, on both feet and on one
_LIFT = 0.04  # m
_STEP = np.array([0.03, 0.01])  # m, that a foot is put beside its place, forward and to the left

_LEG_KP = np.array([4000.0, 6000.0, 2000.0, 4000.0, 4000.0, 4000.0])  # N m/rad
_LEG_KD = np.array([50.0, 60.0, 25.0, 40.0, 20.0, 20.0])  # N m s/rad
_WAIST_KP, _WAIST_KD = np.full(3, 1000.0), np.full(3, 15.0)
_ARM_KP, _ARM_KD = np.full(4, 150.0), np.full(4, 3.0)
_BALANCE = 800.0  # N m/m, torque of each ankle per distance of the pelvis from its course
_PENDULUM_RATE = 3.9  # 1/s, at which it falls
_HANGING = 0.2  # share of the gains
_COM_ITERATIONS = 2  # the legs' mass moves less than the pelvis


@dataclass
class _Course:
    """Samples of what the joints follow, shapes (N, 6), (2, N, 3) and (N, n).

    Attributes
    ----------
    pelvis
        Place of the centre of mass, x and y, and height of the pelvis [m]; its angles about x, y, z [rad].
    soles
        Places of the left and right sole [m], which stay level.
    others
        Positions of all joints; those of the legs are not used [rad].
    """

    pelvis: Array
    soles: Array
    others: Array


def humanoid_motion(robot: Robot, kind: str, seconds: float, seed: int) -> Motion:
    """A motion of a kind, ``stand``, ``walk`` or ``hang``, with a chance of its own.

    Raises
    ------
    RuntimeError
        If the legs are too short for it.
    """
    rng = np.random.default_rng([seed, 3])
    kp = np.concatenate([_LEG_KP, _LEG_KP, _WAIST_KP, _ARM_KP, _ARM_KP])
    kd = np.concatenate([_LEG_KD, _LEG_KD, _WAIST_KD, _ARM_KD, _ARM_KD])
    stance = _stance(robot)
    if kind == "hang":
        size = np.concatenate([_LEG, _LEG, _WAIST, _ARM, _ARM])
        return Motion(swinging(rng, stance, size), _HANGING * kp, _HANGING * kd, _HANGING_HEIGHT, is_held=True)
    count = round((seconds + 1) / _GRID)
    course = _swaying(robot, stance, rng, count) if kind == "stand" else _stepping(robot, stance, rng, count)
    q, pelvis = _followed(robot, course, stance)
    ankles = np.zeros((len(robot.joints), 2))
    for side in SIDES:
        ankles[robot.joints.index(f"{side}_ankle_pitch_joint"), 0] = _BALANCE
        ankles[robot.joints.index(f"{side}_ankle_roll_joint"), 1] = -_BALANCE
    rate, pelvis_rate = q.derivative(), pelvis.derivative()

    def reference(t: float) -> tuple[Array, Array]:
        return q(t), rate(t)

    def balance(t: float, position: Array, velocity: Array) -> Array:
        ahead = position[:2] - pelvis(t) + (velocity[:2] - pelvis_rate(t)) / _PENDULUM_RATE
        return np.asarray(ankles @ ahead)

    return Motion(reference, kp, kd, float(course.pelvis[0, 2]), balance=balance)


def _stance(robot: Robot) -> Array:
    """Joints with bent knees and arms beside the body, shape (n,)."""
    mirrored = _ARM_STANCE * [1, -1, -1, 1]
    q = np.concatenate([np.zeros(2 * len(LEG_PARTS) + len(WAIST_PARTS)), _ARM_STANCE, mirrored])
    bent = np.array([-0.4, 0.0, 0.0, 0.8, -0.4, 0.0])
    places = _standing_soles(robot)
    for side, place in zip(SIDES, places, strict=True):
        legs = _leg_joints(robot, side)
        q[legs] = bent
        q[legs] = _leg_angles(robot, side, q, np.eye(3), place)
    return q


def _standing_soles(robot: Robot) -> Array:
    """Places of both soles in the pelvis as it stands, shape (2, 3) [m]."""
    straight = robot.poses(np.zeros(len(robot.joints)))
    places = []
    for foot in robot.feet:
        R, p = straight[foot.link]
        places.append(p + R @ foot.position + [0.0, 0.0, _BEND])
    return np.array(places)


def _swaying(robot: Robot, stance: Array, rng: np.random.Generator, count: int) -> _Course:
    """Pelvis, waist and arms move in all directions while the feet stay."""
    sway = _sampled(rng, _SWAY, 0.1, 0.8, count)
    others = stance + _upper_body(rng, count)
    soles = _standing_soles(robot)
    middle = [*soles[:, :2].mean(axis=0), -soles[0, 2], 0.0, 0.0, 0.0]
    return _Course(sway + middle, _on_ground(soles, count), others)


def _stepping(robot: Robot, stance: Array, rng: np.random.Generator, count: int) -> _Course:
    """The feet step in turn, each a little beside its place."""
    home = _standing_soles(robot)
    soles = _on_ground(home, count)
    t = np.arange(count) * _GRID
    zero_moment = np.tile(home[:, :2].mean(axis=0), (count, 1))
    foot = int(rng.integers(2))
    start = _BEFORE_STEPS
    while start < t[-1]:
        standing = 1 - foot
        shifted = _smooth((t - start) / _SHIFT)[:, None]
        goal = soles[standing, -1, :2]
        zero_moment += shifted * (goal - zero_moment[-1])
        swung = np.clip((t - start - _SHIFT) / _SWING, 0.0, 1.0)
        place = home[foot, :2] + _STEP * rng.uniform(-1, 1, 2)
        soles[foot, :, :2] += _smooth(1.5 * swung - 0.25)[:, None] * (place - soles[foot, -1, :2])
        soles[foot, :, 2] += _LIFT * rng.uniform(0.7, 1.3) * np.sin(np.pi * swung) ** 2
        start += _SHIFT + _SWING
        foot = standing
    pelvis = _sampled(rng, _SWAY_OF_STEPS, 0.1, 0.8, count)
    pelvis[:, 2] -= home[0, 2]
    height = robot.center_of_mass_at(stance)[2] - home[0, 2]
    pelvis[:, :2] += _pendulum(zero_moment, height)
    return _Course(pelvis, soles, stance + 0.5 * _upper_body(rng, count))


def _pendulum(zero_moment: Array, height: float) -> Array:
    """Course of the centre of mass above that of the point of zero moment, shape (N, 2) both [m]."""
    k = height / 9.81 / _GRID**2
    bands = np.zeros((3, len(zero_moment)))
    bands[0, 2:] = bands[2, :-2] = -k
    bands[1] = 1 + 2 * k
    bands[1, [0, -1]] = 1.0
    return np.asarray(solve_banded((1, 1), bands, zero_moment))


def _on_ground(soles: Array, count: int) -> Array:
    """Courses of soles that stay on the ground, shape (2, N, 3)."""
    places = np.tile(soles[:, None], (1, count, 1))
    places[:, :, 2] = 0.0
    return places


def _upper_body(rng: np.random.Generator, count: int) -> Array:
    """Changes of the joints of waist and arms, shape (N, n)."""
    legs = np.zeros(2 * len(LEG_PARTS))
    return _sampled(rng, np.concatenate([legs, _WAIST, _ARM, _ARM]), 0.1, 1.2, count)


def _sampled(rng: np.random.Generator, size: Array, low: float, high: float, count: int) -> Array:
    """Samples of tones, shape (N, len(size))."""
    at = tones(rng, size, low, high)
    return np.array([at(i * _GRID)[0] for i in range(count)])


def _smooth(x: Array) -> Array:
    """From 0 to 1 with x, without jerks at the ends."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x * x))


def _followed(robot: Robot, course: _Course, stance: Array) -> tuple[CubicSpline, CubicSpline]:
    """Courses of the joints, by inverse kinematics, and of the pelvis from where it begins, x and y."""
    q = course.others.copy()
    to_com = robot.center_of_mass_at(stance)
    before = stance
    places = np.zeros((len(q), 2))
    for i, pose in enumerate(course.pelvis):
        R = Rotation.from_rotvec(pose[3:]).as_matrix()
        for _ in range(_COM_ITERATIONS):
            place = np.array([*(pose[:2] - to_com[:2]), pose[2]])
            for side, sole in zip(SIDES, course.soles[:, i], strict=True):
                legs = _leg_joints(robot, side)
                q[i, legs] = _leg_angles(robot, side, before, R.T, R.T @ (sole - place))
            to_com = R @ robot.center_of_mass_at(q[i])
            before = q[i]
        places[i] = place[:2]
    t = np.arange(len(q)) * _GRID
    return CubicSpline(t, q), CubicSpline(t, places - places[0])


def _leg_joints(robot: Robot, side: str) -> slice:
    first = robot.joints.index(f"{side}_{LEG_PARTS[0]}_joint")
    return slice(first, first + len(LEG_PARTS))


def _leg_angles(robot: Robot, side: str, q: Array, R: Array, p: Array) -> Array:
    """Angles of a leg with its sole at a pose in the pelvis, by Newton's method from those of ``q``; shape (6,)."""
    (foot,) = (foot for foot in robot.feet if foot.name.startswith(side))
    angles = q[_leg_joints(robot, side)].copy()
    for _ in range(20):
        R_sole, p_sole, J = _sole(robot, side, foot.position, angles)
        error = np.concatenate([p - p_sole, Rotation.from_matrix(R @ R_sole.T).as_rotvec()])
        if np.abs(error).max() < 1e-9:
            return angles
        angles += np.linalg.solve(J, error)
    raise RuntimeError("the legs are too short")


def _sole(robot: Robot, side: str, position: Array, angles: Array) -> tuple[Array, Array, Array]:
    """Pose of a sole in the pelvis, and its Jacobian, linear part first, shape (6, 6)."""
    R, p = np.eye(3), np.zeros(3)
    axes, origins = [], []
    for part, angle in zip(LEG_PARTS, angles, strict=True):
        mount = robot.mounts[f"{side}_{part}_joint"]
        assert mount.axis is not None
        p = p + R @ mount.position
        axes.append(R @ mount.axis)
        origins.append(p)
        R = R @ rotation_about(mount.axis, angle)
    (fixed,) = (mount for mount in robot.mounts.values() if mount.child == f"{side}_foot")
    p = p + R @ (fixed.position + position)
    J = np.stack([np.concatenate([np.cross(w, p - o), w]) for w, o in zip(axes, origins, strict=True)], axis=1)
    return R, p, J

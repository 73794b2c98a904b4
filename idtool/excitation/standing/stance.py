"""The stance: posture in which a robot stands at the start and the end of a trajectory.

It is given by the joints' positions, or found: every leg is bent with its foot below the hip, where its longest links
begin, the base upright and all feet at one height. Of several ways of bending, the one counts in which gravity takes
the smallest share of the torque limits.

Shapes: n joints, N postures. Units: rad or m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import suggestion
from idtool.common.number_text import short_number
from idtool.excitation.standing.kinematics import FootKinematics, FootPose, Stance
from idtool.excitation.standing.robot import Loads, StandingRobot
from idtool.robot.collision import SelfCollision
from idtool.robot.kinematics import body_placements

_HEIGHTS = (0.78, 0.85, 0.92)  # of a straight leg, that hips are above the feet, in the order in which they are tried
_LONG_LINK = 0.7  # of the longest distance between neighbouring joints of a leg: the hip is where such a one begins
_BEND = 0.7  # rad, of each joint before the search
_MAX_BENT_JOINTS = 4  # of a leg, that are bent to either side; those nearest to the foot
_ITERATIONS = 80
_MAX_STEP = 0.2  # rad
_DAMPING = 0.02  # of the squared error
_REACHED = 1e-6  # m and rad
_STATIC_SHARE = 0.7  # of the torque limits that gravity may take
_MIDDLE_PRICE = 0.05  # of a posture at the ends of the joints' ranges
_MAX_UNEVEN = 0.005  # m, of the feet of a given posture above or below one plane
_MAX_TILT = 0.03  # rad, of a sole against that plane
_LEVELINGS = 5  # of the plane, which depends on the tilt through the lowest points of balls


def find_stance(
    robot: StandingRobot, collision: SelfCollision | None, clearance: float, start: Mapping[str, float]
) -> Stance:
    """The stance, with the given positions where there are any.

    Parameters
    ----------
    robot
        The robot on its feet.
    collision, clearance
        The robot's geometry, None without any, and the smallest distance that links may have [m].
    start
        Positions of joints, by name [rad or m]. If a joint of a leg is among them, the whole posture is taken as it is
        given: other joints are in the middle of their ranges.

    Raises
    ------
    ConfigError
        If ``start`` names an unknown joint or a position outside the limits, or the feet are not on one plane.
    ModelError
        If no stance was found.
    """
    limits = robot.limits
    q = _start_positions(robot, start)
    legs = _leg_joints(robot.feet)
    is_given = any(limits.joints.index(name) in legs for name in start)
    if is_given:
        stance = _level_stance(robot.feet, q)
        loads = _static_loads(robot, stance.q[:, None], stance.R[None])
        _check_stance(robot, collision, clearance, stance, loads, "--start")
        return stance
    stance = _bent_stance(robot, collision, clearance, q, legs)
    loads = _static_loads(robot, stance.q[:, None], stance.R[None])
    _check_stance(robot, collision, clearance, stance, loads, str(robot.model.robot.path))
    return stance


def foot_rotations(feet: FootKinematics, stance: Stance) -> list[Array]:
    """Rotation of every foot's link to the world at the stance, shape (3, 3) each."""
    return [stance.R @ pose.R[0] for pose in feet.poses(stance.q[:, None])]


def _start_positions(robot: StandingRobot, start: Mapping[str, float]) -> Array:
    """The middle of the ranges, or what is given, shape (n,)."""
    limits = robot.limits
    q = limits.middle.copy()
    for name, value in start.items():
        if name not in limits.joints:
            raise ConfigError("--start", f"{name} is not a moving joint; {suggestion(name, limits.joints)}")
        j = limits.joints.index(name)
        if not limits.lower[j] < value < limits.upper[j]:
            between = (
                f"between {short_number(limits.lower[j], 4)} and {short_number(limits.upper[j], 4)}, the "
                "limits with the margin"
            )
            raise ConfigError("--start", f"{name} = {value:g} is not {between}")
        q[j] = value
    return q


def _leg_joints(feet: FootKinematics) -> Indices:
    """Joints that move a foot against the base."""
    support = feet.model.support()[:, : feet.model.joint_count]
    return np.flatnonzero(support[[foot.body for foot in feet.feet]].any(axis=0))


def _static_loads(robot: StandingRobot, q: Array, R: Array) -> Loads:
    """Loads at rest; all postures are taken to have the soles' axes of the first one."""
    soles = foot_rotations(robot.feet, Stance(q[:, 0], R[0]))
    return robot.static_loads(q, R, soles)


def _level_stance(feet: FootKinematics, q: Array) -> Stance:
    """A given posture, with the base turned so that the feet are on a horizontal plane; ConfigError if none is."""
    poses = feet.poses(q[:, None])
    R = np.eye(3)
    for _ in range(_LEVELINGS):
        normal = _plane_normal(feet, poses, R)
        correction, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [normal])
        R = correction.as_matrix() @ R
    heights = _lowest_points(feet, poses, R)[:, 2]
    uneven = float(np.ptp(heights))
    if uneven > _MAX_UNEVEN:
        what = f"the feet are {short_number(1000 * uneven)} mm above and below one plane in this posture"
        raise ConfigError("--start", f"{what}; give the positions of all joints of the legs, or of none")
    for foot, pose in zip(feet.feet, poses, strict=True):
        tilt = float(np.arccos(np.clip((R @ pose.R[0])[2, 2], -1, 1)))
        if foot.sole is not None and tilt > _MAX_TILT:
            what = (
                f"the z axis of link {foot.contact.link} is {short_number(np.degrees(tilt))}° off the vertical "
                "in this posture"
            )
            raise ConfigError("--start", f"{what}; give a posture in which the soles are level")
    return Stance(q, R)


def _lowest_points(feet: FootKinematics, poses: Sequence[FootPose], R: Array) -> Array:
    """Points of contact along the axes of the world, from the base's origin, shape (feet, 3)."""
    points = []
    for foot, pose in zip(feet.feet, poses, strict=True):
        points.append(R @ pose.p[0] - [0.0, 0.0, foot.contact.radius])
    return np.array(points)


def _plane_normal(feet: FootKinematics, poses: Sequence[FootPose], R: Array) -> Array:
    """Upward normal of the plane of the feet in the world, in which the base is turned by R, shape (3,)."""
    soles = [R @ pose.R[0][:, 2] for foot, pose in zip(feet.feet, poses, strict=True) if foot.sole is not None]
    if soles:
        normal = np.sum(soles, axis=0)
    else:
        points = _lowest_points(feet, poses, R)
        normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
        normal = normal * (1.0 if normal[2] > 0 else -1.0)
    return np.asarray(normal / np.linalg.norm(normal))


def _bent_stance(
    robot: StandingRobot, collision: SelfCollision | None, clearance: float, q: Array, legs: Indices
) -> Stance:
    """Posture with bent legs and the base upright; ModelError if none is found."""
    for height in _HEIGHTS:
        postures = _postures(robot, q, legs, height)
        if not postures.shape[1]:
            continue
        loads = _static_loads(robot, postures, np.broadcast_to(np.eye(3), (postures.shape[1], 3, 3)))
        share = (np.abs(loads.torque) / robot.limits.effort[:, None]).max(axis=0)
        off_middle = np.square((postures - robot.limits.middle[:, None]) / robot.limits.half_range[:, None])
        score = share + loads.violation + _MIDDLE_PRICE * off_middle.mean(axis=0)
        is_feasible = (share < _STATIC_SHARE) & (loads.violation == 0)
        if collision is not None:
            is_feasible &= collision.clearance(_all_coordinates(robot, postures)) >= clearance
        if is_feasible.any():
            best = int(np.argmin(np.where(is_feasible, score, np.inf)))
            return Stance(postures[:, best], np.eye(3))
    what = "no posture was found in which all feet stand on level ground below their hips and hold the weight"
    advice = "give the positions of all joints of the legs with --start JOINT=VALUE"
    raise ModelError(robot.model.robot.path, f"{what}; {advice}")


def _all_coordinates(robot: StandingRobot, q: Array) -> Array:
    """Positions of the joints among all coordinates of the model, from shape (n, N) to (nv, N)."""
    return np.concatenate([q, np.zeros((len(robot.model.joints) - len(q), q.shape[1]))])


def _postures(robot: StandingRobot, q: Array, legs: Indices, height: float) -> Array:
    """Postures with the feet below the hips, each from legs that are bent another way, shape (n, N)."""
    feet, limits = robot.feet, robot.limits
    guesses = _bent_guesses(feet, q, legs)
    guesses = np.clip(guesses, limits.lower[:, None], limits.upper[:, None])
    targets = _targets(feet, q, height)
    postures, is_reached = _place_feet(robot, guesses, targets, legs)
    return postures[:, is_reached]


def _bent_guesses(feet: FootKinematics, q: Array, legs: Indices) -> Array:
    """The posture with the last joints of every leg bent to all combinations of sides, alike in all legs, (n, N)."""
    support = feet.model.support()[:, : feet.model.joint_count]
    chains = [np.flatnonzero(support[foot.body])[::-1] for foot in feet.feet]
    bent = min(_MAX_BENT_JOINTS, max(len(chain) for chain in chains))
    guesses = []
    for signs in product((-1.0, 1.0), repeat=bent):
        guess = q.copy()
        for chain in chains:
            for joint, sign in zip(chain, signs, strict=False):
                guess[joint] += _BEND * sign
        guesses.append(guess)
    return np.array(guesses).T


def _targets(feet: FootKinematics, q: Array, height: float) -> list[tuple[Array, Array]]:
    """Place of every foot in the base's frame, (3,), and its rotation, (3, 3), as with all joints at zero."""
    model = feet.model
    count = len(model.joints)
    at_q = np.zeros((count, 1))
    at_q[: len(q), 0] = q
    placements = body_placements(model, at_q)
    support = model.support()
    upright = feet.poses(np.zeros((len(q), 1)))
    poses = feet.poses(q[:, None])
    hips, lengths = [], []
    moving_links = [i for i, body in enumerate(model.bodies) if body.kind == "link" and not body.is_base]
    for foot, pose in zip(feet.feet, poses, strict=True):
        chain = [i for i in moving_links if not (support[i] & ~support[foot.body]).any()]  # from the base to the foot
        points = np.array([placements[i][1][0] for i in chain] + [pose.p[0]])
        distances = np.linalg.norm(np.diff(points, axis=0), axis=1)
        hip = int(np.argmax(distances > _LONG_LINK * distances.max()))
        hips.append(points[hip])
        lengths.append(float(distances[hip:].sum()))
    hip_heights = np.array([hip[2] for hip in hips])
    bent = float((hip_heights - height * np.array(lengths)).min())
    straight = float((hip_heights - np.array(lengths)).max())
    ground = max(bent, straight)  # no leg can reach lower than straight
    targets = []
    for foot, hip, pose in zip(feet.feet, hips, upright, strict=True):
        place = np.array([hip[0], hip[1], ground + foot.contact.radius])
        targets.append((place, pose.R[0]))
    return targets


def _place_feet(
    robot: StandingRobot, guesses: Array, targets: Sequence[tuple[Array, Array]], legs: Indices
) -> tuple[Array, Mask]:
    """Postures with the feet at their targets by damped Newton steps within the limits, and those that get there."""
    q = guesses.copy()
    lower, upper = robot.limits.lower[legs, None], robot.limits.upper[legs, None]
    error, J = _foot_errors(robot.feet, q, targets)
    for _ in range(_ITERATIONS):
        J_legs = J[:, :, legs]
        transposed = J_legs.transpose(0, 2, 1)
        damping = _DAMPING * np.square(error).sum(axis=1) + 1e-9
        gram = J_legs @ transposed + damping[:, None, None] * np.eye(J.shape[1])
        step = -(transposed @ np.linalg.solve(gram, error[:, :, None]))[:, :, 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        step *= _MAX_STEP / np.maximum(largest, _MAX_STEP)
        q[legs] = np.clip(q[legs] + step.T, lower, upper)
        error, J = _foot_errors(robot.feet, q, targets)
    is_inside = ((q[legs] > lower) & (q[legs] < upper)).all(axis=0)
    return q, is_inside & (np.abs(error).max(axis=1) < _REACHED)


def _foot_errors(feet: FootKinematics, q: Array, targets: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Errors of the feet's places and soles' rotations, shape (N, m), and their Jacobian, shape (N, m, n)."""
    errors, jacobians = [], []
    for foot, pose, (place, R) in zip(feet.feet, feet.poses(q), targets, strict=True):
        errors.append(pose.p - place)
        jacobians.append(pose.linear)
        if foot.sole is not None:
            errors.append(Rotation.from_matrix(pose.R @ R.T).as_rotvec())
            jacobians.append(pose.angular)
    return np.concatenate(errors, axis=1), np.concatenate(jacobians, axis=1)


def _ground_fault(robot: StandingRobot, loads: Loads) -> str:
    """Clause that tells which limit of the ground a stance exceeds."""
    names = [foot.name for foot in robot.feet.feet]
    limits = robot.forces.limits
    normal = loads.ground.normal[:, 0]
    pressure = loads.ground.pressure[:, 0]
    if normal.min() < limits.min_load:
        lightest = names[int(np.argmin(normal))]
        return f"at the stance, foot {lightest} presses on the ground with {short_number(normal.min())} N only"
    if pressure.max() > limits.sole_share:
        worst = names[int(np.argmax(pressure))]
        return f"at the stance, the centre of pressure of {worst} is not inside its sole"
    friction = float(loads.ground.friction[:, 0].max())
    return f"at the stance, the feet need a friction coefficient of {short_number(friction)}"


def _check_stance(
    robot: StandingRobot,
    collision: SelfCollision | None,
    clearance: float,
    stance: Stance,
    loads: Loads,
    where: str,
) -> None:
    """Refuse a stance that the robot cannot hold; ModelError."""
    share = np.abs(loads.torque[:, 0]) / robot.limits.effort
    if share.max() > 1:
        joint = robot.limits.joints[int(np.argmax(share))]
        what = f"at the stance, {joint} needs {short_number(100 * share.max())} % of its effort limit with the margin"
        raise ModelError(where, f"{what}; give another --start, or a larger limit")
    if loads.violation[0] > 0:
        what = _ground_fault(robot, loads)
        raise ModelError(where, f"{what}; give another --start")
    if collision is None:
        return
    (one, other), distance, _ = collision.nearest(_all_coordinates(robot, stance.q[:, None]))
    if distance < clearance:
        what = f"links {one} and {other} are {short_number(1000 * distance)} mm apart at the stance"
        advice = f"give another --start, or a smaller --clearance than {1000 * clearance:g} mm"
        raise ModelError(where, f"{what}; {advice}")

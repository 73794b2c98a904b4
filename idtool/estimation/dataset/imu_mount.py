"""Compares a gyroscope with the joints: orientation of the IMU on the base, and scale of the angular velocity.

While feet are on the ground and do not slip, their points of contact have the same velocity by joints and gyroscope,
relative to the base's origin (see `foot_kinematics`): the differences of v_i + (M g) × p_i among the feet are 0 with
the matrix M that takes the gyroscope's reading g to the axes of the base. That is linear in M, so that the sum of
squares for any M follows from one set of normal equations: two feet contribute too, though not about the line between
them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.estimation.dataset.foot_kinematics import FootMotion, without_mean
from idtool.robot.config import Base
from idtool.robot.inertia import skew
from idtool.robot.rotation import rpy_from_rotation
from idtool.robot.urdf.reading import Robot

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_CONTACT_EDGE = 0.08  # s, after each touchdown and before each lift-off, in which a foot may scuff
_AVERAGE = 0.05  # s
_MIN_SECONDS = 2.0  # with two feet on the ground
_MIN_SPEED = 0.01  # m/s, rms, with which the joints must move the feet against each other
_MIN_EXPLAINED = 0.8  # share of the squares that the right orientation explains at least
_MIN_MARGIN = 0.1  # of that share, by which another orientation must be better
_MIN_TURN = np.deg2rad(8)  # by which an IMU that is not exactly aligned may be off
_MAX_REMAINING = 0.4  # of the unexplained squares that a better orientation leaves
_MIN_EXPLAINED_BY_SCALE = 0.9  # of the squares, if the scale alone is wrong: with a foot that slips, it is less
_MAX_SCALE_ERROR = 0.15  # soft feet and a wrong radius account for less
_MIN_AXIS_SHARE = 0.99  # of an axis along x, y or z, which is named by its letter
_BY_FEET = "according to the kinematics of the feet on the ground"


@dataclass(frozen=True)
class GyroscopeFit:
    """Normal equations of the matrix M, shape (3, 3), that takes the gyroscope's reading to the axes of the base.

    Attributes
    ----------
    A, b, c
        The sum of squares is m·A m − 2 b·m + c with the rows of M one after the other in m; shapes (9, 9), (9,), ().
    seconds
        Time with two feet on the ground [s].
    velocities
        Number of velocities that are compared.
    """

    A: Array
    b: Array
    c: float
    seconds: float
    velocities: int

    def __add__(self, other: GyroscopeFit) -> GyroscopeFit:
        return GyroscopeFit(
            self.A + other.A,
            self.b + other.b,
            self.c + other.c,
            self.seconds + other.seconds,
            self.velocities + other.velocities,
        )

    def explained(self, M: Array) -> float:
        """Share of the squares that a rotation M explains with the best scale of at least 0."""
        along = max(float(self.b @ M.ravel()), 0.0)
        square = float(M.ravel() @ self.A @ M.ravel())
        return along**2 / (square * self.c) if square > 0 else 0.0

    def scale(self, M: Array) -> float:
        """Best scale of a rotation M: true over measured angular velocity."""
        return float(self.b @ M.ravel()) / float(M.ravel() @ self.A @ M.ravel())

    @property
    def is_telling(self) -> bool:
        """True if the base turns enough, for long enough."""
        moves = self.c > _MIN_SPEED**2 * self.velocities
        return moves and self.seconds > _MIN_SECONDS

    def best_rotation(self) -> Array:
        """The rotation nearest to the best matrix M of any kind, shape (3, 3)."""
        M = np.linalg.lstsq(self.A, self.b, rcond=None)[0].reshape(3, 3)
        U, _, V_transposed = np.linalg.svd(M)
        handedness = np.diag([1.0, 1.0, np.linalg.det(U @ V_transposed)])
        return np.asarray(U @ handedness @ V_transposed)


def fit_gyroscope(motion: FootMotion, imu_to_base: Array) -> GyroscopeFit:
    """The normal equations over a stretch of a log.

    Parameters
    ----------
    motion
        Motion of the feet.
    imu_to_base
        Rotation of the IMU's axes to those of the base as configured, shape (3, 3).
    """
    is_settled = motion.settled(_CONTACT_EDGE)
    weights = is_settled * (is_settled.sum(axis=0) > 1.0)
    by_joints = motion.average(motion.by_joints, _AVERAGE)
    g = imu_to_base.T @ motion.average(motion.angular_velocity, _AVERAGE)
    # entry (i, j) of M contributes g_j (unit vector i × p) to (M g) × p
    of_rows = np.stack([_cross_unit(i, motion.position) for i in range(3)], axis=1)  # (feet, 3, 3, N)
    columns = np.einsum("fidn,jn->fijdn", of_rows, g).reshape(len(by_joints), 9, 3, -1)
    columns = without_mean(columns, weights)
    target = -without_mean(by_joints, weights)
    return GyroscopeFit(
        A=np.einsum("fpdn,fqdn->pq", columns, columns, optimize=True),
        b=np.einsum("fpdn,fdn->p", columns, target, optimize=True),
        c=float(np.square(target).sum()),
        seconds=motion.dt * float((weights.sum(axis=0) > 0).sum()),
        velocities=int(weights.sum()),
    )


def mount_notice(fit: GyroscopeFit, robot: Robot, base: Base, imu_to_base: Array) -> Notice | None:
    """Notice about an IMU that is rotated relative to its link in the URDF, or of which a sign is wrong.

    Parameters
    ----------
    fit
        From `fit_gyroscope`.
    robot
        From the URDF.
    base
        Configuration of the sensor of the base.
    imu_to_base
        As in `fit_gyroscope`.
    """
    from scipy.spatial.transform import Rotation

    if not fit.is_telling:
        return None
    configured = fit.explained(imu_to_base)
    needed = max(_MIN_EXPLAINED, configured + _MIN_MARGIN)
    best = fit.best_rotation()
    if configured > _MIN_EXPLAINED:
        turn = Rotation.from_matrix(imu_to_base.T @ best)
        is_better = 1 - fit.explained(best) < _MAX_REMAINING * (1 - configured)
        return _turned_notice(turn, robot, base) if is_better and turn.magnitude() > _MIN_TURN else None

    right_angles = Rotation.create_group("O")  # all turns that take the axes to axes
    shares = np.array([fit.explained(imu_to_base @ turn.as_matrix()) for turn in right_angles])
    next_index, best_index = np.argsort(shares)[-2:]
    best_share, next_share = shares[best_index], shares[next_index]
    mirrored_share, axes = max((fit.explained(imu_to_base @ np.diag(signs)), axes) for axes, signs in _mirrors())
    if not base.uses_pose and mirrored_share > needed and 1 - mirrored_share < _MAX_REMAINING * (1 - best_share):
        message = f"its gyroscope has the wrong sign about {axes}, {_BY_FEET}"
        return Notice("imu_mount", "problem", "imu", message, "correct the sign when you log it")
    if best_share > max(needed, next_share + _MIN_MARGIN):
        return _turned_notice(right_angles[best_index], robot, base)
    if fit.explained(best) > max(needed, best_share + _MIN_MARGIN):
        return _turned_notice(Rotation.from_matrix(imu_to_base.T @ best), robot, base)
    return None


def scale_notice(fit: GyroscopeFit, base: Base, imu_to_base: Array) -> Notice | None:
    """Notice about an angular velocity that differs from feet and joints in scale alone.

    Parameters
    ----------
    fit, base, imu_to_base
        As in `mount_notice`, which gave none.
    """
    if not fit.is_telling or fit.explained(imu_to_base) < _MIN_EXPLAINED_BY_SCALE:
        return None
    gain = 1 / fit.scale(imu_to_base)
    if abs(gain - 1) < _MAX_SCALE_ERROR:
        return None
    message = f"its angular velocity is {gain:.2f} times the one computed from the joints and the feet on the ground"
    advice = "check its unit and calibration, and the lengths of the legs in the URDF"
    return Notice("imu_against_feet", "warning", base.sensor_name, message, advice)


def disagreement_notice(fit: GyroscopeFit, base: Base, imu_to_base: Array) -> Notice | None:
    """Notice about an angular velocity that has little to do with feet and joints; as `scale_notice`."""
    if not fit.is_telling:
        return None
    explained = fit.explained(imu_to_base)
    if explained > _MIN_EXPLAINED:
        return None
    message = (
        f"its angular velocity explains {100 * explained:.0f} % of how the joints move the feet on the ground against "
        "each other; it should explain nearly all"
    )
    key = f"base.{base.sensor_name}.link"
    advice = f"compare the axes of {key}, order and signs of the joints, and the flags of the feet"
    return Notice("imu_against_feet", "warning", base.sensor_name, message, advice)


def _mirrors() -> Iterator[tuple[str, Array]]:
    """Names of the axes with a wrong sign, an odd number of them, and the signs of all axes, shape (3,)."""
    for signs in itertools.product((1.0, -1.0), repeat=3):
        if np.prod(signs) < 0:
            axes = [axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0]
            yield join_names(axes), np.array(signs)


def _turned_notice(turn: Rotation, robot: Robot, base: Base) -> Notice:
    """Notice that the sensor is rotated relative to its link, with the rpy that is right."""
    link = base.sensor.link or robot.root
    vector = turn.as_rotvec()
    angle = float(np.linalg.norm(vector))
    axis = vector / angle
    k = int(np.abs(axis).argmax())
    if abs(axis[k]) > _MIN_AXIS_SHARE:
        about = f"{np.rad2deg(angle * np.sign(axis[k])):+.0f}° about the {'xyz'[k]} axis"
    else:
        components = ", ".join(f"{x:.2f}" for x in axis + 0.0)
        about = f"{np.rad2deg(angle):.0f}° about the axis ({components})"
    message = f"it is rotated by {about} of {link}, {_BY_FEET}"
    mounts = [joint for joint in robot.joints.values() if joint.child == link]
    if mounts:
        rpy = _rpy(mounts[0].R @ turn.as_matrix())
        advice = f'set rpy="{rpy}" in the origin of the joint {mounts[0].name}'
    else:
        rpy = _rpy(turn.as_matrix())
        key = f"base.{base.sensor_name}.link"
        advice = f'add a link for it to the URDF, fixed to {link} with rpy="{rpy}", and name it in {key}'
    return Notice("imu_mount", "problem", base.sensor_name, message, advice)


def _rpy(R: Array) -> str:
    """Angles of a rotation about the fixed axes x, y, z, as in a URDF [rad]."""
    return " ".join(short_number(angle + 0.0) for angle in np.round(rpy_from_rotation(R), 4))


def _cross_unit(i: int, position: Array) -> Array:
    """Unit vector i × position, shape (feet, 3, N)."""
    unit = np.zeros(3)
    unit[i] = 1.0
    return np.asarray(np.einsum("ab,fbn->fan", skew(unit), position))

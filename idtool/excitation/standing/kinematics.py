"""`StandingKinematics`: motion of a robot whose feet stay where they are.

The configuration w has the positions of the joints, the position of the base [m] and the rotation vector of its turn
from the stance [rad], along the axes of the world. The feet on the ground constrain it:

    g(w) = 0,  C dw/dt = 0  with  C = dg/dw.

A sole does not move. A ball rolls: its centre c moves by the radius r times the ball's turn phi,

    g = c − c_0 + r z × phi.

This is exact if the ball turns about one axis. Otherwise the ground slips below it by about r times the product of the
turns, which is less than 1 mm for an ordinary foot, and which the softness of the foot takes.

Some entries u of w are independent, those of the base first, as many as the constraints leave free. All others follow
from them by Newton's method. So every sample of a motion is a function of u and its two derivatives at this sample.

Shapes: N samples, n joints, m constraints, d independent coordinates; w (n + 6, N), u (d, N).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.units import STANDARD_GRAVITY
from idtool.excitation.patterns import MotionSamples
from idtool.excitation.standing.feet import Foot
from idtool.excitation.standing.rotations import (
    angular_velocity_to_rate,
    rate_to_angular_velocity,
    skew_matrices,
)
from idtool.robot.kinematics import body_jacobians, body_motions, body_placements, cross
from idtool.robot.model import RobotModel

BASE_MOTION = ("base_x", "base_y", "base_z", "base_roll", "base_pitch", "base_yaw")
_BASE_SIZE = len(BASE_MOTION)
_MIN_INDEPENDENT_SHARE = 0.03  # of a unit of an independent coordinate, that constraints and other coordinates leave
_MIN_SINGULAR_RATIO = 0.003  # smallest over largest singular value of independent constraints
_MAX_ITERATIONS = 20
_TOLERANCE = 1e-12  # m and rad, of the constraints
_MAX_STEP = 0.5  # m and rad, of an iteration
_DAMPING = 1e-9  # of the constraints' matrix, near postures in which it is singular
_RATE_STEP = 1e-4  # of the difference of C along the motion
_TANGENT_STEP = 1e-3  # likewise, for its second rate too
_UP = np.array([0.0, 0.0, 1.0])


class StandingSamples(NamedTuple):
    """Samples of a robot that stands.

    Attributes
    ----------
    w, dw, ddw
        The configuration and its derivatives, shape (n + 6, N).
    motion
        Positions, velocities and accelerations of the model's coordinates, those of the base as in `RobotModel`; shape
        (nv, N) each.
    base_to_world
        Rotation of the base, shape (N, 3, 3).
    is_reached
        True where the constraints hold, shape (N,).
    """

    w: Array
    dw: Array
    ddw: Array
    motion: MotionSamples
    base_to_world: Array
    is_reached: Mask


class Tangents(NamedTuple):
    """Derivatives of w by the independent coordinates, and their first and second rate, shape (N, n + 6, d) each."""

    first: Array
    rate: Array
    second: Array


@dataclass(frozen=True)
class Stance:
    """Posture in which a robot stands at first.

    Attributes
    ----------
    q
        Positions of the joints, shape (n,).
    R
        Rotation of the base to the world, whose z axis is upward, shape (3, 3).
    """

    q: Array
    R: Array


class FootPose(NamedTuple):
    """A foot in the frame of the base.

    Attributes
    ----------
    p, R
        Its place, or the centre of its ball, shape (N, 3), and the rotation of its link, shape (N, 3, 3).
    linear, angular
        Its velocities per unit of the joints', shape (N, 3, n).
    """

    p: Array
    R: Array
    linear: Array
    angular: Array


class FootKinematics:
    """Poses of the feet as functions of the joints.

    Attributes
    ----------
    model, feet
        The robot, with a floating base, and its feet.
    """

    def __init__(self, model: RobotModel, feet: Sequence[Foot]) -> None:
        self.model = model
        self.feet = tuple(feet)
        links = tuple(body for body in model.bodies if body.kind == "link")
        self._links = replace(model, bodies=links)  # rotors move no foot

    def poses(self, q: Array) -> list[FootPose]:
        """Pose of every foot with the joints at q, shape (n, N)."""
        n, count = q.shape
        all_q = np.zeros((len(self.model.joints), count))
        all_q[:n] = q
        zero = np.zeros_like(all_q)
        jacobians = body_jacobians(self._links, body_motions(self._links, all_q, zero, zero))
        placements = body_placements(self._links, all_q)
        poses = []
        for foot in self.feet:
            jacobian = jacobians[foot.body]
            R_body, p_body = placements[foot.body]
            at_point = jacobian.S_v + cross(jacobian.S_w, foot.point[:, None, None])
            is_joint = jacobian.coordinates < n
            joints = jacobian.coordinates[is_joint]
            linear, angular = np.zeros((2, count, 3, n))
            linear[:, :, joints] = R_body @ np.moveaxis(at_point[:, is_joint], -1, 0)
            angular[:, :, joints] = R_body @ np.moveaxis(jacobian.S_w[:, is_joint], -1, 0)
            R_link = R_body @ self.model.frames[foot.contact.link].R
            poses.append(FootPose(p_body + R_body @ foot.point, R_link, linear, angular))
        return poses

    def jacobian(self, q: Array, R_base: Array) -> Array:
        """Jacobian of the points of contact along the axes of the world, of soles also that of their turn.

        Parameters
        ----------
        q
            Positions of the joints, shape (n, N).
        R_base
            Rotation of the base to the world, shape (N, 3, 3).

        Returns
        -------
        Velocities per unit of the model's velocities, shape (N, k, nv).
        """
        n, count = q.shape
        nv = len(self.model.joints)
        base = self.model.base_coordinates
        rows = []
        for foot, pose in zip(self.feet, self.poses(q), strict=True):
            up_in_base = R_base[:, 2, :]
            from_center = -foot.contact.radius * up_in_base
            linear = np.zeros((count, 3, nv))
            linear[:, :, :n] = pose.linear - skew_matrices(from_center) @ pose.angular
            linear[:, :, base.start : base.start + 3] = np.eye(3)
            linear[:, :, base.start + 3 : base.stop] = -skew_matrices(pose.p + from_center)
            rows.append(R_base @ linear)
            if foot.sole is not None:
                angular = np.zeros((count, 3, nv))
                angular[:, :, :n] = pose.angular
                angular[:, :, base.start + 3 : base.stop] = np.eye(3)
                rows.append(R_base @ angular)
        return np.concatenate(rows, axis=1)


class StandingKinematics:
    """Motion of a robot whose feet stay where they are.

    Attributes
    ----------
    stance
        The posture at the start, in which w is its joints and zeros.
    coordinates
        Names of the independent coordinates: of joints, and of `BASE_MOTION`.
    independent
        Their indices in w, shape (d,).

    Parameters
    ----------
    feet
        The feet on the ground.
    stance
        The posture at the start.
    """

    def __init__(self, feet: FootKinematics, stance: Stance) -> None:
        self.feet = feet
        self.model = feet.model
        self.stance = stance
        self._joints = feet.model.joint_count
        self.w0: Array = np.concatenate([stance.q, np.zeros(_BASE_SIZE)])
        poses = self._foot_poses(self.w0[:, None])
        self._places = [(center[0], R[0]) for _, center, R in poses]
        self.independent: Indices = self._find_independent()
        names = (*feet.model.joint_names, *BASE_MOTION)
        self.coordinates = tuple(names[i] for i in self.independent)
        self._dependent = np.setdiff1d(np.arange(len(self.w0)), self.independent)

    @property
    def home(self) -> Array:
        """The independent coordinates at the stance, shape (d,)."""
        return np.asarray(self.w0[self.independent])

    def configurations(self, u: Array, guess: Array | None = None) -> tuple[Array, Mask]:
        """Configurations w, shape (n + 6, N), and True where the constraints hold, shape (N,).

        Parameters
        ----------
        u
            The independent coordinates, shape (d, N).
        guess
            Configurations near the solution; None: the stance.
        """
        w = np.repeat(self.w0[:, None], u.shape[1], axis=1) if guess is None else guess.copy()
        w[self.independent] = u
        is_reached = np.zeros(u.shape[1], dtype=bool)
        for _ in range(_MAX_ITERATIONS):
            g, C = self._constraints(w)
            is_reached = np.abs(g).max(axis=1) < _TOLERANCE
            if is_reached.all():
                break
            D = C[:, :, self._dependent]
            step = -_least_squares(D, g[:, :, None])[:, :, 0]
            largest = np.abs(step).max(axis=1, keepdims=True)
            step *= np.minimum(1.0, _MAX_STEP / np.maximum(largest, _MAX_STEP))
            step[is_reached] = 0.0
            w[self._dependent] += step.T
        return w, is_reached

    def samples(self, u: Array, du: Array, ddu: Array, guess: Array | None = None) -> StandingSamples:
        """Motion of the robot with independent coordinates u and their derivatives, shape (d, N) each.

        Parameters
        ----------
        u, du, ddu
            The coordinates and their derivatives.
        guess
            Configurations near the solution; None: the stance.
        """
        w, is_reached = self.configurations(u, guess)
        _, C = self._constraints(w)
        dw = self._rates(C, du, np.zeros(C.shape[:2]))
        step = _RATE_STEP / np.abs(dw).max(initial=1.0)
        _, C_after = self._constraints(w + step * dw)
        _, C_before = self._constraints(w - step * dw)
        bias = np.einsum("nij,jn->ni", (C_after - C_before) / (2 * step), dw)
        ddw = self._rates(C, ddu, bias)
        return self.assemble(w, dw, ddw, is_reached)

    def assemble(self, w: Array, dw: Array, ddw: Array, is_reached: Mask) -> StandingSamples:
        """Motion of the robot from configurations and their derivatives, shape (n + 6, N) each.

        Parameters
        ----------
        w, dw, ddw
            The configurations and their derivatives.
        is_reached
            True where the constraints hold, shape (N,).
        """
        n = self._joints
        R, to_turn = self._base_rotation(w)
        step = _RATE_STEP / np.abs(dw).max(initial=1.0)
        _, to_turn_after = self._base_rotation(w + step * dw)
        _, to_turn_before = self._base_rotation(w - step * dw)
        to_turn_rate = (to_turn_after - to_turn_before) / (2 * step)
        dphi, ddphi = dw[n + 3 :].T[:, :, None], ddw[n + 3 :].T[:, :, None]
        turn = to_turn @ dphi
        turn_acceleration = to_turn @ ddphi + to_turn_rate @ dphi
        proper = (ddw[n : n + 3].T + STANDARD_GRAVITY * _UP)[:, :, None]
        to_base = R.transpose(0, 2, 1)

        q, v, a = np.zeros((3, len(self.model.joints), w.shape[1]))
        q[:n], v[:n], a[:n] = w[:n], dw[:n], ddw[:n]
        base = self.model.base_coordinates
        v[base][3:] = (to_base @ turn)[:, :, 0].T
        a[base][:3] = (to_base @ proper)[:, :, 0].T
        a[base][3:] = (to_base @ turn_acceleration)[:, :, 0].T
        return StandingSamples(w, dw, ddw, MotionSamples(q, v, a), R, is_reached)

    def tangents(self, samples: StandingSamples) -> Tangents:
        """Derivatives of w by u along a motion, and their rates.

        They are those of the motion too: of dw/dt by u it is the first rate, of d²w/dt² by du/dt twice the first rate,
        and by u the second one.
        """
        w, dw, ddw = samples.w, samples.dw, samples.ddw
        size = max(np.abs(dw).max(initial=1.0), np.sqrt(np.abs(ddw).max(initial=1.0)))
        step = _TANGENT_STEP / size
        _, C = self._constraints(w)
        _, C_after = self._constraints(w + step * dw + step**2 / 2 * ddw)
        _, C_before = self._constraints(w - step * dw + step**2 / 2 * ddw)
        C_rate = (C_after - C_before) / (2 * step)
        C_second = (C_after - 2 * C + C_before) / step**2
        dependent = C[:, :, self._dependent]

        def completed(right: Array, of_independent: float) -> Array:
            """Tangent whose part of the independent coordinates is the identity times a number."""
            tangent = np.zeros((len(C), C.shape[2], len(self.independent)))
            tangent[:, self.independent, np.arange(len(self.independent))] = of_independent
            tangent[:, self._dependent] = -_least_squares(dependent, right)
            return tangent

        first = completed(C[:, :, self.independent], 1.0)
        rate = completed(C_rate @ first, 0.0)
        second = completed(C_second @ first + 2 * C_rate @ rate, 0.0)
        return Tangents(first, rate, second)

    def base_to_world(self, w: Array) -> Array:
        """Rotation of the base, shape (N, 3, 3)."""
        return self._base_rotation(w)[0]

    def foot_displacements(self, w: Array) -> Array:
        """Distances of the feet's places from those at the stance, shape (feet, N) [m]."""
        distances = []
        for (_, center, _), (first, _) in zip(self._foot_poses(w), self._places, strict=True):
            distances.append(np.linalg.norm(center - first, axis=1))
        return np.array(distances)

    def _rates(self, C: Array, du: Array, bias: Array) -> Array:
        """Rates of w with those of u, so that C times them is −bias, shape (n + 6, N)."""
        right = bias + np.einsum("nij,jn->ni", C[:, :, self.independent], du)
        rates = np.zeros((C.shape[2], C.shape[0]))
        rates[self.independent] = du
        rates[self._dependent] = -_least_squares(C[:, :, self._dependent], right[:, :, None])[:, :, 0].T
        return rates

    def _base_rotation(self, w: Array) -> tuple[Array, Array]:
        """Rotation of the base, and the matrix from the rate of phi to its angular velocity, shape (N, 3, 3) each."""
        phi = w[self._joints + 3 :].T
        return Rotation.from_rotvec(phi).as_matrix() @ self.stance.R, rate_to_angular_velocity(phi)

    def _foot_poses(self, w: Array) -> list[tuple[FootPose, Array, Array]]:
        """Pose of every foot in the base's frame, and its place (N, 3) and rotation (N, 3, 3) in the world."""
        n = self._joints
        R_base, _ = self._base_rotation(w)
        poses = []
        for pose in self.feet.poses(w[:n]):
            center = w[n : n + 3].T + (R_base @ pose.p[:, :, None])[:, :, 0]
            poses.append((pose, center, R_base @ pose.R))
        return poses

    def _constraints(self, w: Array) -> tuple[Array, Array]:
        """The constraints g, shape (N, m), and their Jacobian C, shape (N, m, n + 6)."""
        n, count = self._joints, w.shape[1]
        R_base, to_turn = self._base_rotation(w)
        rows, jacobian_rows = [], []
        poses = zip(self.feet.feet, self._foot_poses(w), self._places, strict=True)
        for foot, (pose, center, R), (first, R_0) in poses:
            lever = (R_base @ pose.p[:, :, None])[:, :, 0]
            linear = np.zeros((count, 3, n + _BASE_SIZE))
            linear[:, :, :n] = R_base @ pose.linear
            linear[:, :, n : n + 3] = np.eye(3)
            linear[:, :, n + 3 :] = -skew_matrices(lever) @ to_turn
            displacement = center - first
            radius = foot.contact.radius
            if foot.sole is None and not radius:
                rows.append(displacement)
                jacobian_rows.append(linear)
                continue
            phi = Rotation.from_matrix(R @ R_0.T).as_rotvec()
            angular = np.zeros((count, 3, n + _BASE_SIZE))
            angular[:, :, :n] = R_base @ pose.angular
            angular[:, :, n + 3 :] = to_turn
            turn = angular_velocity_to_rate(phi) @ angular
            if foot.sole is not None:
                rows += [displacement, phi]
                jacobian_rows += [linear, turn]
                continue
            rows.append(displacement + radius * np.cross(_UP, phi))
            jacobian_rows.append(linear + radius * skew_matrices(_UP) @ turn)
        return np.concatenate(rows, axis=1), np.concatenate(jacobian_rows, axis=1)

    def foot_jacobian(self, w: Array) -> Array:
        """Jacobian of the feet, as that of `FootKinematics`, shape (N, k, nv)."""
        R_base, _ = self._base_rotation(w)
        return self.feet.jacobian(w[: self._joints], R_base)

    def _find_independent(self) -> Indices:
        """Indices in w of coordinates that determine all others at the stance, the base's first."""
        _, C = self._constraints(self.w0[:, None])
        _, s, Vt = np.linalg.svd(C[0])
        rank = int(np.count_nonzero(s > _MIN_SINGULAR_RATIO * s[0]))
        taken = Vt[:rank]  # orthonormal directions that the constraints take, and then the coordinates chosen so far
        n = self._joints
        moves_feet = np.abs(C[0, :, :n]).max(axis=0) > 0
        order = [*range(n, n + _BASE_SIZE), *np.flatnonzero(~moves_feet), *np.flatnonzero(moves_feet)]
        independent: list[int] = []
        for i in order:
            unit = np.zeros(n + _BASE_SIZE)
            unit[i] = 1.0
            rest = unit - taken.T @ (taken @ unit)
            size = float(np.linalg.norm(rest))
            if size > _MIN_INDEPENDENT_SHARE:
                independent.append(int(i))
                taken = np.vstack([taken, rest / size])
            if len(taken) == n + _BASE_SIZE:
                break
        return np.array(sorted(independent, key=order.index), dtype=np.intp)


def _least_squares(A: Array, b: Array) -> Array:
    """Solutions of A x = b, shapes (N, m, k) and (N, m, 1), of least norm, damped where A is nearly singular."""
    if A.shape[1] == A.shape[2]:
        conditioned = np.abs(np.linalg.det(A)) > 0
        if conditioned.all():
            return np.asarray(np.linalg.solve(A, b))
    At = A.transpose(0, 2, 1)
    gram = A @ At + _DAMPING * np.eye(A.shape[1])
    return np.asarray(At @ np.linalg.solve(gram, b))

"""Motion of every body of the tree, for a whole batch of samples at once.

Letters, all in the body's own frame, component first: w angular velocity [rad/s] and alpha its derivative [rad/s²],
acc acceleration of the frame's origin less gravity [m/s²], each (3, N); for the k coordinates that move the body, S_w
and S_v its angular and linear velocity per unit of that coordinate's, each (3, k, N). q, v, a are (nv, N). A last axis
of length 1 stands for all samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.robot.body import Body, Frame
from idtool.robot.joint_rotation import JointRotation
from idtool.robot.model import RobotModel
from idtool.robot.rotation import rotation_about


@dataclass(frozen=True)
class BodyMotion:
    """One body's motion.

    Attributes
    ----------
    rotation, p
        Rotation from the parent's frame to the body's, and the origin of the body's frame in the parent's, shape (3, N)
        or (3, 1) [m].
    w, alpha, acc
        Angular velocity, angular acceleration, and linear acceleration less gravity; shape (3, N) or (3, 1).
    """

    rotation: JointRotation
    p: Array
    w: Array
    alpha: Array
    acc: Array

    @cached_property
    def M(self) -> Array:  # noqa: N802
        """A point x of the body has the acceleration acc + M x: M = S(alpha) + S(w)², shape (3, 3, N) [1/s²]."""
        w, alpha = self.w, self.alpha
        M = w[:, None] * w
        square = M[0, 0] + M[1, 1] + M[2, 2]
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            M[i, i] -= square
            M[i, j] -= alpha[k]
            M[j, i] += alpha[k]
        return M


@dataclass(frozen=True)
class BodyJacobian:
    """Velocity of one body per unit of each coordinate's.

    Attributes
    ----------
    S_w, S_v
        Angular and linear velocity, shape (3, k, N) or (3, k, 1).
    coordinates
        The k coordinates that move the body, ascending.
    """

    S_w: Array
    S_v: Array
    coordinates: Indices


_NO_COLUMNS = np.zeros((3, 0, 1))
_GROUND = BodyJacobian(_NO_COLUMNS, _NO_COLUMNS, np.zeros(0, dtype=np.intp))


def cross(a: Array, b: Array) -> Array:
    """Cross product along the first axis; much faster than numpy's for long last axes."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def body_motions(model: RobotModel, q: Array, v: Array, a: Array) -> list[BodyMotion]:
    """The motion of every body, by the forward recursion of Newton and Euler (2), (3).

    Parameters
    ----------
    model
        The tree.
    q, v, a
        Positions, velocities, accelerations of the joints, shape (nv, N). For a floating base, v has its angular
        velocity, and a its proper and its angular acceleration.
    """
    zero = np.zeros((3, 1))
    base = BodyMotion(JointRotation(), zero, zero, zero, -model.gravity[:, None])
    motions: list[BodyMotion] = []
    for body in model.bodies:
        if body.is_base:
            motions.append(_base_motion(model, base, v, a))
            continue
        parent = base if body.mount.body < 0 else motions[body.mount.body]
        coordinates = np.flatnonzero(body.ratios)
        ratios = body.ratios[coordinates]
        phi = ratios @ q[coordinates] + body.offset
        dphi = ratios @ v[coordinates]
        ddphi = ratios @ a[coordinates]
        motions.append(_propagate(body, parent, phi, dphi, ddphi))
    return motions


def body_jacobians(model: RobotModel, motions: Sequence[BodyMotion]) -> list[BodyJacobian]:
    """The Jacobian of every body, along the motions that `body_motions` gives."""
    return list(iterate_jacobians(model, motions))


def jacobians_of(model: RobotModel, motions: Sequence[BodyMotion], bodies: Iterable[int]) -> dict[int, BodyJacobian]:
    """The Jacobians of some bodies, by their indices, and of those that carry them; much less work than of all."""
    chosen: set[int] = set()
    for body in bodies:
        while body >= 0 and body not in chosen:
            chosen.add(body)
            body = model.bodies[body].mount.body
    jacobians = {-1: _GROUND}
    support = model.support()
    for body in sorted(chosen):
        parent = jacobians[model.bodies[body].mount.body]
        jacobians[body] = _jacobian(model.bodies[body], motions[body], parent, np.flatnonzero(support[body]))
    return jacobians


def iterate_jacobians(model: RobotModel, motions: Sequence[BodyMotion]) -> Iterator[BodyJacobian]:
    """The Jacobian of one body after the other; those that no later body is mounted on are not kept in memory."""
    jacobians = {-1: _GROUND}
    last_child = {body.mount.body: i for i, body in enumerate(model.bodies)}
    for i, (body, motion, support) in enumerate(zip(model.bodies, motions, model.support(), strict=True)):
        jacobian = _jacobian(body, motion, jacobians[body.mount.body], np.flatnonzero(support))
        if last_child.get(body.mount.body) == i:
            del jacobians[body.mount.body]
        if i in last_child:
            jacobians[i] = jacobian
        yield jacobian


def _base_motion(model: RobotModel, ground: BodyMotion, v: Array, a: Array) -> BodyMotion:
    """Motion of a floating base, whose coordinates are along the axes of its own frame."""
    angular_velocity = v[model.base_coordinates][3:]
    acceleration = a[model.base_coordinates]
    return BodyMotion(ground.rotation, ground.p, angular_velocity, acceleration[3:], acceleration[:3])


def body_placements(model: RobotModel, q: Array) -> dict[int, tuple[Array, Array]]:
    """Placement of every body's frame in the root link, by index; −1 is the root link.

    Parameters
    ----------
    model
        The tree.
    q
        Positions of the joints, shape (nv, N).

    Returns
    -------
    Rotation R, shape (N, 3, 3) or (1, 3, 3), and position p [m], shape (N, 3) or (1, 3).
    """
    placements = {-1: (np.eye(3)[None], np.zeros((1, 3)))}
    for i, body in enumerate(model.bodies):
        R_parent, p_parent = placements[body.mount.body]
        R = R_parent @ body.mount.R
        p = p_parent + R_parent @ body.mount.p
        phi = body.ratios @ q + body.offset
        if body.prismatic:
            placements[i] = R, p + R @ body.axis * phi[:, None]
        else:
            placements[i] = R @ rotation_about(body.axis, phi), p
    return placements


def frame_jacobian(model: RobotModel, frame: Frame, q: Array) -> tuple[Array, Array, Array]:
    """Jacobian of a frame along the axes of the root link.

    Parameters
    ----------
    model
        The tree.
    frame
        The frame, on one of its bodies.
    q
        Positions of the joints, shape (nv, N).

    Returns
    -------
    Linear and angular velocity of the frame per unit of each joint's velocity, shape (nv, 3, N) each, and the frame's
    rotation, shape (N, 3, 3).
    """
    zero = np.zeros_like(q)
    motions = body_motions(model, q, zero, zero)
    body = body_jacobians(model, motions)[frame.body]
    R, _ = body_placements(model, q)[frame.body]
    R = np.broadcast_to(R, (q.shape[1], 3, 3))
    at_frame = body.S_v + cross(body.S_w, frame.p[:, None, None])
    linear, angular = np.zeros((2, len(q), 3, q.shape[1]))
    linear[body.coordinates] = np.einsum("nij,jkn->kin", R, np.broadcast_to(at_frame, body.S_v.shape))
    angular[body.coordinates] = np.einsum("nij,jkn->kin", R, body.S_w)
    return linear, angular, R @ frame.R


def _propagate(body: Body, parent: BodyMotion, phi: Array, dphi: Array, ddphi: Array) -> BodyMotion:
    """A body's motion from its parent's and its own along its axis: phi and its derivatives, shape (N,) each."""
    axis = body.axis[:, None]
    p = body.mount.p[:, None]
    if body.prismatic:
        p = p + (body.mount.R @ axis) * phi
    if body.prismatic:
        rotation = JointRotation.constant(body.mount.R)
    else:
        rotation = JointRotation.about(body.mount.R, body.axis, phi)
    w = rotation.to_body(parent.w)
    alpha = rotation.to_body(parent.alpha)
    acc = rotation.to_body(parent.acc + rotate(parent.M, p))
    if body.prismatic:
        acc = acc + 2 * cross(w, axis * dphi) + axis * ddphi
    else:
        spin = axis * dphi
        alpha = alpha + axis * ddphi + cross(w, spin)
        w = w + spin
    return BodyMotion(rotation, p, w, alpha, acc)


def _jacobian(body: Body, motion: BodyMotion, parent: BodyJacobian, coordinates: Indices) -> BodyJacobian:
    """A body's Jacobian from its parent's, which a floating base does not have."""
    if body.is_base:
        identity = np.eye(6)[:, :, None]
        return BodyJacobian(identity[3:], identity[:3], coordinates)
    return _moved_jacobian(body, motion, parent, coordinates)


def _moved_jacobian(body: Body, motion: BodyMotion, parent: BodyJacobian, coordinates: Indices) -> BodyJacobian:
    """A body's Jacobian from its parent's and its own axis."""
    at_origin = parent.S_v + cross(parent.S_w, motion.p[:, None])
    inherited_w = motion.rotation.to_body(parent.S_w)
    inherited_v = motion.rotation.to_body(at_origin)
    samples = max(inherited_w.shape[-1], inherited_v.shape[-1])
    S_w, S_v = np.zeros((2, 3, len(coordinates), samples))
    parent_columns = np.searchsorted(coordinates, parent.coordinates)
    is_chain = np.array_equal(parent_columns, np.arange(len(parent_columns)))
    inherited = slice(len(parent_columns)) if is_chain else parent_columns  # a slice is faster
    S_w[:, inherited] = inherited_w
    S_v[:, inherited] = inherited_v
    own_columns = body.axis[:, None, None] * body.ratios[coordinates, None]
    if body.first_free_coordinate is not None:
        first = int(np.searchsorted(coordinates, body.first_free_coordinate))
        S_v[:, first : first + 3] = np.eye(3)[:, :, None]
        S_w[:, first + 3 : first + 6] = np.eye(3)[:, :, None]
    elif body.prismatic:
        S_v += own_columns
    else:
        S_w += own_columns
    return BodyJacobian(S_w, S_v, coordinates)


def rotate(R: Array, x: Array) -> Array:
    """Matrices (3, 3, N) times vectors (3, N) or (3, k, N)."""
    return np.asarray(np.einsum("ij...,j...->i...", R, x))

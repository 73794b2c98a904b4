"""`RigidBodyDynamics`: mass matrix and bias of a mechanism, M(q) and h(q, v), batch after batch.

Every body, rotors included, is a joint of a tree of its own, in which M and h are found by the composite-rigid-body and
the Newton–Euler algorithm (Featherstone, Rigid Body Dynamics Algorithms, 2008, sections 6.2 and 5.3). With
phi = G q + offset, virtual work gives M = Gᵀ M_tree G and h = Gᵀ h_tree.

Shapes: n coordinates: the nv joints, then the motor side of each joint that has a `Transmission`, in the joints' order.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ModelError
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Body


class RigidBodyDynamics:
    """Mass matrix and bias of the rigid bodies, links and rotors.

    Parameters
    ----------
    mechanism
        Its bodies with their parameters, and further inertia on the joints.

    Raises
    ------
    ModelError
        If a body has a first moment or an inertia but no mass.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        bodies = mechanism.model.bodies
        order = _depth_first(bodies)
        tree_joints = {-1: 0}  # by index of the body; -1: the base
        self._tree = pin.Model()
        self._tree.gravity.linear = np.array(mechanism.gravity)
        for index in order:
            body = bodies[index]
            parent = tree_joints[body.mount.body]
            mount = pin.SE3(body.mount.R, body.mount.p)
            joint = self._tree.addJoint(parent, _joint_model(body), mount, str(index))
            self._tree.appendBodyToJoint(joint, _inertia(body, mechanism.pi[index]), pin.SE3.Identity())
            tree_joints[index] = joint
        self._data = self._tree.createData()
        self._G = np.stack([_ratios(bodies[index], mechanism) for index in order])  # (bodies, n)
        self._offset = np.array([[bodies[index].offset] for index in order])
        armature = np.zeros(self._G.shape[1])
        np.add.at(armature, motor_coordinates(mechanism), mechanism.armature)
        self._armature = np.diag(armature)

    def __call__(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Mass matrix and bias.

        Parameters
        ----------
        q, v
            Positions and velocities, shape (n, W).

        Returns
        -------
        M, shape (W, n, n), and h, shape (n, W): Coriolis, centrifugal and gravity torque.
        """
        G = self._G
        phi = np.ascontiguousarray((G @ q + self._offset).T)
        dphi = np.ascontiguousarray((G @ v).T)
        count, size = phi.shape
        M = np.empty((count, size, size))
        h = np.empty((count, size))
        tree, data = self._tree, self._data
        for w in range(count):
            M[w] = pin.crba(tree, data, phi[w])
            h[w] = pin.nonLinearEffects(tree, data, phi[w], dphi[w])
        return G.T @ M @ G + self._armature, (h @ G).T


def motor_coordinates(mechanism: Mechanism) -> Indices:
    """Coordinate of each joint's motor side, shape (nv,): the joint's own where it has no transmission."""
    nv = len(mechanism.model.joints)
    coordinates = np.arange(nv)
    coordinates[sorted(mechanism.transmissions)] = nv + np.arange(len(mechanism.transmissions))
    return coordinates


def _ratios(body: Body, mechanism: Mechanism) -> Array:
    """Motion of a body per coordinate, shape (n,): links by the link side, rotors by the motor side."""
    nv = len(body.ratios)
    coordinates = motor_coordinates(mechanism) if body.kind == "rotor" else np.arange(nv)
    ratios = np.zeros(nv + len(mechanism.transmissions))
    ratios[coordinates] = body.ratios
    return ratios


def _depth_first(bodies: tuple[Body, ...]) -> list[int]:
    """Indices of the bodies, every subtree in one piece, as the composite-rigid-body algorithm needs it."""
    children: dict[int, list[int]] = {}
    for i, body in enumerate(bodies):
        children.setdefault(body.mount.body, []).append(i)
    order = []
    stack = children.get(-1, [])[::-1]
    while stack:
        index = stack.pop()
        order.append(index)
        stack += children.get(index, [])[::-1]
    return order


def _joint_model(body: Body) -> pin.JointModel:
    kind = pin.JointModelPrismaticUnaligned if body.prismatic else pin.JointModelRevoluteUnaligned
    return kind(np.array(body.axis))


def _inertia(body: Body, pi: Array) -> pin.Inertia:
    if not pi.any():
        return pin.Inertia.Zero()
    if not pi[0]:
        raise ModelError(
            body.name, "has inertia but no mass, and cannot be simulated; fit it with constraints: full or tighter"
        )
    return pin.Inertia.FromDynamicParameters(pi)

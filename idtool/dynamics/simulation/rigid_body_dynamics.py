"""`RigidBodyDynamics`: mass matrix and bias of a mechanism, M(q) and h(q, v), batch after batch.

Every body, rotors included, is a joint of a tree of its own, in which M and h are found by the composite-rigid-body and
the Newton–Euler algorithm (Featherstone, Rigid Body Dynamics Algorithms, 2008, sections 6.2 and 5.3). With
phi = G q + offset, virtual work gives M = Gᵀ M_tree G and h = Gᵀ h_tree.

A floating base is a free joint of the tree, whose velocity and acceleration are given. What a wrench sensor carries is
fixed to what carries the sensor.

Shapes: n coordinates: the nv joints, then the motor side of each joint that has a `Transmission`, in the joints' order.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ModelError
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Body
from idtool.robot.model import WRENCH_SIZE


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
        self._has_floating_base = mechanism.model.has_floating_base
        self._tree = pin.Model()
        self._tree.gravity.linear = np.array(mechanism.gravity)
        carriers = {-1: (0, pin.SE3.Identity())}  # by index of the body: its joint in the tree, and its place there
        moving = []
        for index in _depth_first(bodies):
            body = bodies[index]
            carrier, place = carriers[body.mount.body]
            mount = place * pin.SE3(body.mount.R, body.mount.p)
            if body.is_base:
                joint, place = (
                    self._tree.addJoint(carrier, pin.JointModelFreeFlyer(), mount, "base"),
                    pin.SE3.Identity(),
                )
            elif body.first_free_coordinate is not None:
                joint, place = carrier, mount
            else:
                joint = self._tree.addJoint(carrier, _joint_model(body), mount, str(index))
                place = pin.SE3.Identity()
                moving.append(index)
            self._tree.appendBodyToJoint(joint, _inertia(body, mechanism.pi[index]), place)
            carriers[index] = joint, place
        self._data = self._tree.createData()
        self._G = np.stack([_ratios(bodies[index], mechanism) for index in moving])  # (moving bodies, n)
        self._offset = np.array([[bodies[index].offset] for index in moving])
        armature = np.zeros(self._G.shape[1])
        np.add.at(armature, motor_coordinates(mechanism), mechanism.armature)
        self._armature = np.diag(armature)

    def __call__(self, q: Array, v: Array, base: Array | None = None) -> tuple[Array, Array]:
        """Mass matrix and bias.

        Parameters
        ----------
        q, v
            Positions and velocities, shape (n, W).
        base
            Velocity and acceleration of a floating base, as `RobotModel` has them, shape (12, W); default: 0.

        Returns
        -------
        M, shape (W, n, n), and h, shape (n, W): Coriolis, centrifugal and gravity torque, and that which the motion of
        the base takes.
        """
        G = self._G
        phi = np.ascontiguousarray((G @ q + self._offset).T)
        dphi = np.ascontiguousarray((G @ v).T)
        count, size = phi.shape
        M = np.empty((count, size, size))
        h = np.empty((count, size))
        tree, data = self._tree, self._data
        if not self._has_floating_base:
            for w in range(count):
                M[w] = pin.crba(tree, data, phi[w])
                h[w] = pin.nonLinearEffects(tree, data, phi[w], dphi[w])
            return G.T @ M @ G + self._armature, (h @ G).T
        base = np.zeros((2 * WRENCH_SIZE, count)) if base is None else base
        at_origin = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        at_rest = np.zeros(size)
        for w in range(count):
            q_tree = np.concatenate([at_origin, phi[w]])
            v_tree = np.concatenate([base[:WRENCH_SIZE, w], dphi[w]])
            a_tree = np.concatenate([base[WRENCH_SIZE:, w], at_rest])
            M[w] = pin.crba(tree, data, q_tree)[WRENCH_SIZE:, WRENCH_SIZE:]
            h[w] = pin.rnea(tree, data, q_tree, v_tree, a_tree)[WRENCH_SIZE:]
        return G.T @ M @ G + self._armature, (h @ G).T


def motor_coordinates(mechanism: Mechanism) -> Indices:
    """Coordinate of each joint's motor side, shape (nv,): the joint's own where it has no transmission."""
    nv = mechanism.model.joint_count
    coordinates = np.arange(nv)
    coordinates[sorted(mechanism.transmissions)] = nv + np.arange(len(mechanism.transmissions))
    return coordinates


def _ratios(body: Body, mechanism: Mechanism) -> Array:
    """Motion of a body per coordinate, shape (n,): links by the link side, rotors by the motor side."""
    nv = mechanism.model.joint_count
    coordinates = motor_coordinates(mechanism) if body.kind == "rotor" else np.arange(nv)
    ratios = np.zeros(nv + len(mechanism.transmissions))
    ratios[coordinates] = body.ratios[:nv]
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

"""Pinocchio's torque equation of a URDF with mimic joints and rotors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from lxml import etree
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Reference:
    """Pinocchio's tree with mimic joints and rotors as joints of their own, coupled by phi = G q + offset.

    By virtual work, tau = Gᵀ tau_tree.
    """

    def __init__(self, text: str, names: Sequence[str], config: Mapping[str, Any]) -> None:
        self.tree = pin.buildModelFromXML(text)
        self.tree.gravity.linear = np.array(config["gravity"])
        self.names = list(names)
        root = etree.fromstring(text.encode())
        self.joints = {str(j.get("name")): j for j in root.iterfind("joint")}
        couplings = {name: self._coupling(name) for name in list(self.tree.names)[1:]}
        self.owners = {self._child(name): name for name in couplings}
        for name, rotor in config.get("rotors", {}).items():
            self._add_rotor(name, rotor)
            rows = [ratio * self._coupling(joint) for joint, ratio in rotor["coupling"].items()]
            couplings[name] = np.sum(rows, axis=0)
            self.owners[name] = name
        self.index = {name: self.tree.getJointId(name) for name in couplings}
        self.G, self.offset = np.zeros((self.tree.nv, len(names))), np.zeros(self.tree.nv)
        for name, row in couplings.items():
            place = self.tree.joints[self.index[name]].idx_v
            self.G[place], self.offset[place] = row[:-1], row[-1]
        self.data = self.tree.createData()

    def _child(self, joint: str) -> str:
        return str(self.joints[joint].find("child").get("link"))  # type: ignore[union-attr]

    def _coupling(self, name: str) -> Array:
        """How much of each coordinate moves a joint, and its offset behind them; shape (nv + 1,)."""
        mimic = self.joints[name].find("mimic")
        if mimic is None:
            return np.array([*(float(name == other) for other in self.names), 0.0])
        row = float(mimic.get("multiplier", 1)) * self._coupling(str(mimic.get("joint")))
        row[-1] += float(mimic.get("offset", 0))
        return row

    def _add_rotor(self, name: str, rotor: Mapping[str, Any]) -> None:
        frame = self.tree.frames[self.tree.getFrameId(rotor["parent"])]
        xyz, rpy = (np.array(rotor["origin"][key]) for key in ("xyz", "rpy"))
        placement = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
        axis = np.array(rotor["axis"]) / np.linalg.norm(rotor["axis"])
        joint = self.tree.addJoint(frame.parentJoint, pin.JointModelRevoluteUnaligned(axis), placement, name)
        xx, xy, yy, xz, yz, zz = rotor["inertial"]["inertia"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pin.Inertia(rotor["inertial"]["mass"], np.array(rotor["inertial"]["com"]), inertia)
        self.tree.appendBodyToJoint(joint, body, pin.SE3.Identity())

    def _state(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        phi = self.G @ q + self.offset
        place = pin.neutral(self.tree)
        for joint in list(self.tree.joints)[1:]:
            angle = phi[joint.idx_v]
            place[joint.idx_q : joint.idx_q + joint.nq] = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        return place, self.G @ v, self.G @ a

    def regressor(self, bodies: Sequence[str], q: Array, v: Array, a: Array) -> Array:
        """The bodies' columns in all joints' equations, shape (nv, 10 bodies)."""
        Y = self.G.T @ pin.computeJointTorqueRegressor(self.tree, self.data, *self._state(q, v, a))
        by_joint = Y.reshape(len(self.names), -1, 10)
        return np.concatenate([by_joint[:, self.index[self.owners[body]] - 1] for body in bodies], axis=1)

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Shape (nv,)."""
        return np.asarray(self.G.T @ pin.rnea(self.tree, self.data, *self._state(q, v, a)))

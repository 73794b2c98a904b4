"""The quadruped of benchmarks/ground as idtool reads it, and in Pinocchio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from ground.logs import config_text
from ground.quadruped import JOINTS
from ground.robot import Array, Robot, urdf_text
from numpy.random import Generator

from idtool.common.safe_yaml import parse_yaml
from idtool.data.contact_channels import ContactSamples
from idtool.data.signals import Motion
from idtool.robot.config import Config, parse_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import read_robot

BASE = slice(12, 18)  # coordinates of the base


def quadruped_model(folder: Path, robot: Robot, forces: str = "unknown", **config: Any) -> tuple[RobotModel, Config]:
    """The robot and its configuration, without rotors unless ``config`` has them."""
    path = folder / "quadruped.urdf"
    path.write_text(urdf_text(robot))
    content = parse_yaml(path, config_text(robot, forces).encode())
    settings = parse_config({**content, "rotors": {}, **config}, "")
    return build_model(read_robot(path), settings, JOINTS), settings


def random_state(rng: Generator, samples: int = 5) -> Motion:
    """States of joints and base that have nothing to do with each other."""
    q, v, a = rng.normal(size=(3, 18, samples))
    q[BASE] = 0
    v[12:15] = 0
    rotations = np.linalg.qr(rng.normal(size=(samples, 3, 3)))[0]
    rotations *= np.linalg.det(rotations)[:, None, None]
    contacts = ContactSamples(
        world_to_base=rotations.transpose(1, 2, 0),
        is_closed=rng.random((5, samples)) < 0.7,
        wrenches=rng.normal(size=(5, 6, samples)),
    )
    t = np.arange(samples) * 1.0
    return Motion(t, q, v, a, np.zeros_like(q), np.zeros_like(q), np.ones(18), 0.0, contacts=contacts)


class PinocchioQuadruped:
    """The robot on a free-flyer in Pinocchio, in the order of idtool's coordinates.

    Parameters
    ----------
    urdf
        The robot.
    """

    def __init__(self, urdf: Path) -> None:
        self.model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        joints = [self.model.joints[self.model.getJointId(name)] for name in JOINTS]
        self._q = [joint.idx_q for joint in joints]
        self._v = [*(joint.idx_v for joint in joints), *range(6)]

    def configuration(self, motion: Motion, k: int) -> Array:
        """Configuration of a sample, the base at the origin."""
        assert motion.contacts is not None
        q = pin.neutral(self.model)
        q[3:7] = pin.Quaternion(motion.contacts.world_to_base[:, :, k].T).coeffs()
        q[self._q] = motion.q[:12, k]
        return np.asarray(q)

    def torque(self, motion: Motion, k: int) -> Array:
        """Generalized force of a sample, shape (18,)."""
        assert motion.contacts is not None
        v, a = np.zeros((2, self.model.nv))
        v[self._v], a[self._v] = motion.v[:, k], motion.a[:, k]
        gravity = motion.contacts.world_to_base[:, :, k] @ self.model.gravity.linear
        a[:3] += gravity  # a proper acceleration is one without gravity
        return np.asarray(pin.rnea(self.model, self.data, self.configuration(motion, k), v, a)[self._v])

    def contact_jacobian(self, motion: Motion, k: int, link: str, radius: float) -> Array:
        """Velocity of the lowest point of a ball about a link's origin along the world's axes, shape (6, 18)."""
        q = self.configuration(motion, k)
        frame = self.model.getFrameId(link)
        J = pin.computeFrameJacobian(self.model, self.data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        at_point = J[:3] + np.cross(J[3:], [0.0, 0.0, -radius], axisa=0, axisc=0)
        return np.concatenate([at_point, J[3:]])[:, self._v]

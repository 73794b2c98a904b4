"""A model with a floating base in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from ground.logs import config_text
from ground.quadruped import GEAR, JOINTS, true_quadruped
from ground.robot import urdf_text
from standing_quadruped import random_state

import idtool
from idtool.common.exceptions import ConfigError
from idtool.common.safe_yaml import parse_yaml
from idtool.robot.config import read_config
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

TRUTH = true_quadruped(0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a fit writes, without rotors, which armature represents only in part."""
    config = dict(parse_yaml(Path("model.yaml"), config_text(TRUTH).encode()))
    del config["rotors"]
    friction = {joint: {"viscous": 0.1, "coulomb": 0.3, "offset": False} for joint in JOINTS}
    (tmp_path / "identified.urdf").write_text(urdf_text(TRUTH))
    (tmp_path / "model.yaml").write_bytes(
        yaml.safe_dump({**config, "joints": list(JOINTS), "friction": friction}).encode()
    )
    return tmp_path


def test_mujoco_has_a_free_joint_and_the_same_dynamics(folder: Path, rng: np.random.Generator) -> None:
    path = idtool.export(folder, "mujoco").save()
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    assert (model.nq, model.nv) == (7 + 12, 6 + 12)
    assert model.body_subtreemass[1] == pytest.approx(sum(body.mass for body in TRUTH.links.values()))
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.81])
    joints = [model.joint(name) for name in JOINTS]
    np.testing.assert_allclose([joint.damping[0] for joint in joints], 0.1)

    robot = build_model(read_robot(folder / "identified.urdf"), read_config(folder / "model.yaml"), JOINTS)
    pi = np.stack([body.pi for body in robot.bodies])
    motion = random_state(rng, 1)
    assert motion.contacts is not None
    expected = inverse_dynamics(robot, pi, motion.q, motion.v, motion.a)[:, 0]

    rotation = motion.contacts.world_to_base[:, :, 0].T
    mujoco.mju_mat2Quat(data.qpos[3:7], rotation.ravel())
    places = [joint.dofadr[0] for joint in joints]
    data.qpos[[joint.qposadr[0] for joint in joints]] = motion.q[:12, 0]
    data.qvel[places], data.qvel[3:6] = motion.v[:12, 0], motion.v[15:, 0]
    data.qacc[places], data.qacc[3:6] = motion.a[:12, 0], motion.a[15:, 0]
    data.qacc[:3] = rotation @ motion.a[12:15, 0] + model.opt.gravity  # along the axes of the world
    model.dof_damping[:] = 0
    model.dof_frictionloss[:] = 0
    mujoco.mj_inverse(model, data)
    found = data.qfrc_inverse
    np.testing.assert_allclose(found[places], expected[:12], atol=1e-8)
    np.testing.assert_allclose(rotation.T @ found[:3], expected[12:15], atol=1e-8)
    np.testing.assert_allclose(found[3:6], expected[15:], atol=1e-8)


def test_rotors_are_armature_whatever_turns_their_carriers(folder: Path) -> None:
    content = dict(parse_yaml(Path("model.yaml"), config_text(TRUTH).encode()))
    path = folder / "model.yaml"
    path.write_bytes(yaml.safe_dump({**content, "joints": list(JOINTS)}).encode())
    exported = idtool.export(folder, "mujoco")
    model = mujoco.MjModel.from_xml_path(str(exported.save()))
    inertia = TRUTH.rotors[JOINTS[0]].inertia[0, 0] * GEAR**2
    np.testing.assert_allclose(model.dof_armature, [0] * 6 + [inertia] * 12)
    assert model.body_subtreemass[1] == pytest.approx(TRUTH.mass)
    assert any("rotation of its carrier" in part.detail for part in exported.not_carried)


def test_other_forms_of_export_say_that_they_need_a_fixed_base(folder: Path) -> None:
    with pytest.raises(ConfigError, match="idtool export --to drake needs a fixed base"):
        idtool.export(folder, "drake")

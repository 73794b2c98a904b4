"""A model with a floating base for simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml
from ground.logs import config_text
from ground.quadruped import GEAR, JOINTS, true_quadruped
from ground.robot import prior_robot, urdf_text
from lxml import etree
from scipy.spatial.transform import Rotation
from standing_quadruped import random_state

import idtool
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


def mass_matrix_and_bias(urdf: str, rng: np.random.Generator) -> tuple[Any, Any]:
    """M and h of the free robot in a URDF by Pinocchio, in a random state."""
    tree = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    data = tree.createData()
    q = pin.neutral(tree)
    q[3:7] = Rotation.random(random_state=int(rng.integers(100))).as_quat()
    q[7:] = rng.normal(size=12)
    M = pin.crba(tree, data, q)
    return np.triu(M) + np.triu(M, 1).T, pin.nonLinearEffects(tree, data, q, rng.normal(size=tree.nv))


def test_drake_has_a_free_base_and_the_same_dynamics(folder: Path) -> None:
    exported = idtool.export(folder, "drake")
    text = exported.save().read_text()
    parts = {part.what: part.of for part in exported.carried}
    assert parts["floating_base"] == "trunk"
    assert "fixed_base" not in [part.what for part in exported.not_carried]
    root = etree.fromstring(text.encode())
    children = {child.get("link") for child in root.iterfind("joint/child")}
    roots = [link.get("name") for link in root.iterfind("link") if link.get("name") not in children]
    assert roots == ["trunk"]  # which Drake leaves free, as no joint holds it
    assert {joint.get("name") for joint in root.iterfind("transmission/joint")} == set(JOINTS)
    original = (folder / "identified.urdf").read_text()
    of_drake = mass_matrix_and_bias(text, np.random.default_rng(1))
    of_urdf = mass_matrix_and_bias(original, np.random.default_rng(1))
    for own, expected in zip(of_drake, of_urdf, strict=True):
        np.testing.assert_allclose(own, expected, atol=1e-9)


def test_rotors_of_the_hips_are_dead_weight_of_the_trunk_in_drake(folder: Path) -> None:
    content = dict(parse_yaml(Path("model.yaml"), config_text(TRUTH).encode()))
    (folder / "model.yaml").write_bytes(yaml.safe_dump({**content, "joints": list(JOINTS)}).encode())
    exported = idtool.export(folder, "drake")
    text = exported.save().read_text()
    tree = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    assert pin.computeTotalMass(tree) == pytest.approx(TRUTH.mass)
    reflected = TRUTH.rotors[JOINTS[0]].inertia[0, 0] * GEAR**2
    values = [part.value for part in exported.carried if part.detail == f"reflected inertia on {JOINTS[0]}"]
    np.testing.assert_allclose(values, [reflected])
    assert any("rotation of its carrier" in part.detail for part in exported.not_carried)


def test_urdf_is_patched(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "simulator.urdf"
    other.write_text(urdf_text(prior_robot(TRUTH, 0)))
    patched = idtool.export(folder, patch=other).save().read_text()
    found = mass_matrix_and_bias(patched, np.random.default_rng(2))
    expected = mass_matrix_and_bias((folder / "identified.urdf").read_text(), np.random.default_rng(2))
    for own, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, theirs, atol=1e-8)


@pytest.mark.parametrize("is_free", [True, False])
def test_mjcf_is_patched(folder: Path, tmp_path: Path, is_free: bool) -> None:
    text = idtool.export(folder, "mujoco").save().read_text()
    text = text.replace('damping="0.1"', 'damping="0.7"')
    if not is_free:
        text = text.replace("<freejoint/>", "")
    other = tmp_path / "simulator.xml"
    other.write_text(text)
    exported = idtool.export(folder, patch=other)
    model = mujoco.MjModel.from_xml_path(str(exported.save()))
    np.testing.assert_allclose([model.joint(name).damping[0] for name in JOINTS], 0.1)
    assert model.nv == 12 + 6 * is_free
    missing = [part.of for part in exported.not_carried if part.what == "floating_base"]
    assert missing == ([] if is_free else ["trunk"])

"""Contacts of an arm on a fixed base, against MuJoCo's Jacobians."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
from sensor_arm import JOINTS, mujoco_arm, urdf_text

from idtool.data.contact_channels import ContactSamples
from idtool.data.signals import Motion
from idtool.dynamics.contact_model import ContactModel
from idtool.robot.config import parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

GRAVITY = (4.0, -3.0, -8.0)  # of an arm that is mounted on a slope
CENTER = np.array([0.2, 0.01, 0.03])
RADIUS = 0.04
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


def contact_model(tmp_path: Path, **contact: Any) -> ContactModel:
    """The arm with a ball on its hand."""
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_text())
    ball = {"name": "ball", "link": "hand", "kind": "surface", "point": CENTER.tolist(), "radius": RADIUS, **contact}
    config = parse_config({"gravity": GRAVITY, "contacts": [ball]}, "")
    model = build_model(read_robot(path), config, JOINTS)
    return ContactModel(model, config.contacts, noise=np.ones(len(JOINTS)))


def random_motion(samples: int = 5) -> Motion:
    """Random positions and wrenches."""
    rng = np.random.default_rng(0)
    q = rng.normal(size=(3, samples))
    contacts = ContactSamples(
        world_to_base=np.broadcast_to(np.eye(3)[:, :, None], (3, 3, samples)),
        is_closed=np.ones((1, samples), dtype=bool),
        wrenches=rng.normal(size=(1, 6, samples)),
    )
    zero = np.zeros_like(q)
    return Motion(np.arange(samples) * 1.0, q, zero, zero, zero, zero, np.ones(3), 0.0, contacts=contacts)


def by_mujoco(q: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Jacobian of the lowest point of the ball along the axes of the base, shape (6, 3), and rotation of the hand."""
    arm = mujoco_arm(GRAVITY)
    data = mujoco.MjData(arm)
    data.qpos[:] = q
    mujoco.mj_forward(arm, data)
    hand = arm.body("hand").id
    R = data.xmat[hand].reshape(3, 3).copy()
    down = np.array(GRAVITY) / np.linalg.norm(GRAVITY)
    lowest = data.xpos[hand] + R @ CENTER + RADIUS * down
    J = np.zeros((6, 3))
    mujoco.mj_jac(arm, data, J[:3], J[3:], lowest, hand)
    return J, R


@pytest.mark.parametrize("frame", ["world", "link"])
def test_measured_wrench_acts_at_the_lowest_point_by_gravity(tmp_path: Path, frame: str) -> None:
    contacts = contact_model(tmp_path, frame=frame, force=WRENCH[:3], moment=WRENCH[3:])
    motion = random_motion()
    found = contacts.measured_force(motion)
    assert motion.contacts is not None
    for k in range(motion.q.shape[1]):
        J, R = by_mujoco(motion.q[:, k])
        to_base = np.eye(3) if frame == "world" else R
        wrench = np.concatenate([to_base @ part for part in motion.contacts.wrenches[0, :, k].reshape(2, 3)])
        np.testing.assert_allclose(found[:, k], J.T @ wrench, atol=1e-12)


def test_unknown_wrench_can_exert_what_the_jacobian_says(tmp_path: Path) -> None:
    """Along the axes of the hand, whatever they are."""
    motion = random_motion()
    directions = contact_model(tmp_path).unknown_directions(motion)
    for k in range(motion.q.shape[1]):
        J, R = by_mujoco(motion.q[:, k])
        in_hand = np.concatenate([R.T @ J[:3], R.T @ J[3:]])
        np.testing.assert_allclose(directions[:, :, k], in_hand, atol=1e-12)


def test_small_moment_counts_as_a_contact(tmp_path: Path) -> None:
    """A tool that is turned takes a moment without a force."""
    contacts = contact_model(tmp_path, force=WRENCH[:3], moment=WRENCH[3:])
    samples = random_motion(samples=3).contacts
    assert samples is not None
    samples.wrenches[:] = 0.0
    samples.wrenches[0, 5, 1] = 0.5
    np.testing.assert_array_equal(contacts.acts_on_joints(samples), [False, True, False])

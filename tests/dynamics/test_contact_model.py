"""Contact forces: measured ones as generalized forces, unknown ones eliminated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ground.quadruped import FEET, FOOT_RADIUS, true_quadruped
from standing_quadruped import PinocchioQuadruped, quadruped_model, random_state

from idtool.data.signals import Motion
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.row_filter import multiply_by_sample

ROBOT = true_quadruped(0)
SURFACE = {"name": "rope", "link": "trunk", "kind": "surface", "flag": "contact_rope"}


IS_CORRELATED = (False, True)


def contact_forces(folder: Path, rng: np.random.Generator, is_correlated: bool = False) -> ContactModel:
    model, config = quadruped_model(folder, ROBOT)
    contacts = ContactModel(model, config.contacts, np.exp(rng.normal(size=18)))
    return contacts.with_correlation(np.corrcoef(rng.normal(size=(18, 40)))) if is_correlated else contacts


def exerted(reference: PinocchioQuadruped, motion: Motion, k: int, forces: np.ndarray) -> np.ndarray:
    """Generalized force of forces on the feet along the world's axes, shape (4, 3), those of closed contacts only."""
    assert motion.contacts is not None
    torque = np.zeros(18)
    for i, foot in enumerate(FEET):
        if motion.contacts.is_closed[i, k]:
            torque += reference.contact_jacobian(motion, k, foot, FOOT_RADIUS)[:3].T @ forces[i]
    return torque


@pytest.mark.parametrize("is_correlated", IS_CORRELATED)
def test_projector_eliminates_what_contacts_exert_and_nothing_else(
    tmp_path: Path, rng: np.random.Generator, is_correlated: bool
) -> None:
    contacts = contact_forces(tmp_path, rng, is_correlated)
    reference = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    motion = random_state(rng, 40)
    assert motion.contacts is not None
    motion.contacts.is_closed[4] = False  # without the rope, which can exert anything on the base
    projector = contacts.projector(motion, {})
    np.testing.assert_allclose(projector, projector.transpose(0, 2, 1), atol=1e-12)
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-6)
    closed = motion.contacts.is_closed[:4].sum(axis=0)
    np.testing.assert_allclose(np.trace(projector, axis1=1, axis2=2), 18 - 3 * closed, atol=1e-6)

    torque = np.stack([exerted(reference, motion, k, rng.normal(size=(4, 3))) for k in range(40)], axis=1)
    np.testing.assert_allclose(multiply_by_sample(contacts.gains(projector), torque), 0, atol=1e-6)
    other = rng.normal(size=(18, 40))
    assert np.abs(multiply_by_sample(contacts.gains(projector), other)).max() > 0.1


def test_surface_on_the_base_leaves_no_row_of_the_base(tmp_path: Path, rng: np.random.Generator) -> None:
    contacts = contact_forces(tmp_path, rng)
    motion = random_state(rng, 10)
    assert motion.contacts is not None
    motion.contacts.is_closed[:4] = False
    motion.contacts.is_closed[4] = True
    expected = np.diag([1.0] * 12 + [0.0] * 6)
    np.testing.assert_allclose(contacts.projector(motion, {}), np.broadcast_to(expected, (10, 18, 18)), atol=1e-8)


@pytest.mark.parametrize("is_correlated", IS_CORRELATED)
def test_unknown_friction_of_a_joint_is_eliminated_with_the_contact_forces(
    tmp_path: Path, rng: np.random.Generator, is_correlated: bool
) -> None:
    contacts = contact_forces(tmp_path, rng, is_correlated)
    reference = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    motion = random_state(rng, 10)
    assert motion.contacts is not None
    motion.contacts.is_closed[4] = False  # without the rope, which leaves nothing of a standing leg
    resting = np.arange(10) < 6
    torque = np.stack([exerted(reference, motion, k, rng.normal(size=(4, 3))) for k in range(10)], axis=1)
    torque[5, resting] += 3.0
    projector = contacts.projector(motion, {5: resting})
    np.testing.assert_allclose(multiply_by_sample(contacts.gains(projector), torque), 0, atol=1e-6)
    unknown = 3 * motion.contacts.is_closed[:4].sum(axis=0) + resting
    np.testing.assert_allclose(np.trace(projector, axis1=1, axis2=2), 18 - unknown, atol=1e-5)


@pytest.mark.parametrize("is_correlated", IS_CORRELATED)
def test_least_squares_is_that_with_free_forces(tmp_path: Path, rng: np.random.Generator, is_correlated: bool) -> None:
    """Theorem of Frisch, Waugh and Lovell, for whitened rows."""
    contacts = contact_forces(tmp_path, rng, is_correlated)
    correlation = np.eye(18) if contacts.correlation is None else contacts.correlation
    whitening = np.linalg.inv(np.linalg.cholesky(correlation)) / contacts.noise
    reference = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    motion = random_state(rng, 6)
    assert motion.contacts is not None
    motion.contacts.is_closed[4] = False
    Y, tau = rng.normal(size=(18, 4, 6)), rng.normal(size=(18, 6))
    projector = contacts.projector(motion, {})
    gains = contacts.gains(projector)
    rows = np.moveaxis(multiply_by_sample(gains, Y), 1, -1) / contacts.noise[:, None, None]
    right = multiply_by_sample(gains, tau) / contacts.noise[:, None]
    theta = np.linalg.lstsq(rows.reshape(-1, 4), right.ravel())[0]

    whole = []
    for k in range(6):
        forces = np.zeros((18, 12 * 6))
        for i, foot in enumerate(FEET):
            if motion.contacts.is_closed[i, k]:
                place = slice(12 * k + 3 * i, 12 * k + 3 * i + 3)
                forces[:, place] = reference.contact_jacobian(motion, k, foot, FOOT_RADIUS)[:3].T
        whole.append(whitening @ np.hstack([Y[:, :, k], forces]))
    expected = np.linalg.lstsq(np.vstack(whole), (whitening @ tau).T.ravel())[0][:4]
    np.testing.assert_allclose(theta, expected, rtol=1e-5)


@pytest.mark.parametrize("frame", ["world", "link"])
def test_measured_force_acts_at_the_lowest_point_of_the_ball(
    tmp_path: Path, rng: np.random.Generator, frame: str
) -> None:
    foot = FEET[1]
    contact = {"name": foot, "link": foot, "radius": FOOT_RADIUS, "frame": frame, "force": ["x", "y", "z"]}
    model, config = quadruped_model(tmp_path, ROBOT, contacts=[contact])
    reference = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    motion = random_state(rng)
    assert motion.contacts is not None
    motion.contacts.wrenches[:, 3:] = 0  # which a point does not take
    found = ContactModel(model, config.contacts, np.ones(18)).measured_force(motion)
    for k in range(5):
        force = motion.contacts.wrenches[0, :3, k]
        J = reference.contact_jacobian(motion, k, foot, FOOT_RADIUS)  # which places the frame
        if frame == "link":
            force = reference.data.oMf[reference.model.getFrameId(foot)].rotation @ force
        np.testing.assert_allclose(found[:, k], J[:3].T @ force, atol=1e-10)


def test_measured_moment_of_a_surface(tmp_path: Path, rng: np.random.Generator) -> None:
    contact = {"name": "sole", "link": FEET[2], "kind": "surface", "force": ["x"] * 3, "moment": ["x"] * 3}
    model, config = quadruped_model(tmp_path, ROBOT, contacts=[contact])
    reference = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    motion = random_state(rng)
    assert motion.contacts is not None
    found = ContactModel(model, config.contacts, np.ones(18)).measured_force(motion)
    for k in range(5):
        J = reference.contact_jacobian(motion, k, FEET[2], 0.0)
        np.testing.assert_allclose(found[:, k], J.T @ motion.contacts.wrenches[0, :, k], atol=1e-10)

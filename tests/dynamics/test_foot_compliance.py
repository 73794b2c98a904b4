"""Balls that give way under load: the contact comes nearer to their centre."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.quadruped import FEET, FOOT_RADIUS, true_quadruped
from numpy.random import Generator
from standing_quadruped import PinocchioQuadruped, quadruped_model, random_state

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects import build_effects
from idtool.dynamics.effects.foot_compliance import FootCompliance
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.robot.config import Config, parse_config
from idtool.robot.model import RobotModel

COMPLIANCE = 4e-5  # m/N
UP = np.array([0.0, 0.0, 1.0])


def compliance_column(model: RobotModel, config: Config, motion: Motion) -> Array:
    """Torque per compliance, shape (nv, N)."""
    (effect,) = (effect for effect in build_effects(model, config) if isinstance(effect, FootCompliance))
    out = [np.empty((1, len(motion.t))) for _ in model.joints]
    effect.columns(motion, out)
    return np.concatenate(out)


def foot_forces(rng: Generator, count: int) -> Array:
    """Forces on the feet along the world's axes, upward on the whole, shape (4, 3, N) [N]."""
    forces = rng.normal(scale=20.0, size=(4, 3, count))
    forces[:, 2] = np.abs(forces[:, 2]) + 60.0  # within the cone of any friction
    return forces


def softened(witness: PinocchioQuadruped, motion: Motion, forces: Array, compliance: float) -> Array:
    """Generalized force on balls that give way, by Pinocchio, shape (18, N)."""
    torque = np.zeros((18, len(motion.t)))
    for k in range(len(motion.t)):
        for foot, force in zip(FEET, forces[:, :, k], strict=True):
            J = witness.contact_jacobian(motion, k, foot, FOOT_RADIUS - compliance * force[2])
            torque[:, k] += J[:3].T @ force
    return torque


def test_measured_forces_act_where_soft_balls_touch_the_ground_in_pinocchio(tmp_path: Path, rng: Generator) -> None:
    model, config = quadruped_model(tmp_path, true_quadruped(0), "measured")
    motion = random_state(rng)
    assert motion.contacts is not None
    forces = foot_forces(rng, len(motion.t))
    motion.contacts.wrenches[:4, :3] = forces
    witness = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    change = softened(witness, motion, forces, COMPLIANCE) - softened(witness, motion, forces, 0.0)
    np.testing.assert_allclose(COMPLIANCE * compliance_column(model, config, motion), -change, atol=1e-9)


def test_unknown_forces_follow_from_the_torque(tmp_path: Path, rng: Generator) -> None:
    """With the true masses, all forces do; with masses that are 20 % off, those of the legs still nearly do."""
    robot = true_quadruped(0)
    model, config = quadruped_model(tmp_path, robot)
    motion = random_state(rng, 40)
    assert motion.contacts is not None
    motion.contacts.is_closed[:4] = True
    motion.contacts.is_closed[4] = False  # the rope
    bodies = RigidBodies(model)
    pi = np.array([coefficient.prior for coefficient in bodies.coefficients])
    forces = foot_forces(rng, len(motion.t))
    witness = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    rigid = softened(witness, motion, forces, 0.0)
    motion = replace(motion, tau=bodies.torque(pi, motion) - rigid)
    change = softened(witness, motion, forces, COMPLIANCE) - rigid
    np.testing.assert_allclose(COMPLIANCE * compliance_column(model, config, motion), -change, atol=1e-6)

    heavier = replace(model, bodies=tuple(replace(body, pi=1.2 * body.pi) for body in model.bodies))
    with_wrong_masses = COMPLIANCE * compliance_column(heavier, config, motion)
    deviation = np.linalg.norm(with_wrong_masses + change) / np.linalg.norm(change)
    assert deviation < 0.15


@pytest.mark.parametrize("compliance", ["none", "fit", 2e-5])
def test_rigid_balls_add_no_unknown(tmp_path: Path, compliance: str | float) -> None:
    model, config = quadruped_model(tmp_path, true_quadruped(0))
    contacts = [contact.model_copy(update={"compliance": compliance}) for contact in config.contacts]
    effects = build_effects(model, config.model_copy(update={"contacts": tuple(contacts)}))
    unknowns = [c for effect in effects for c in effect.coefficients if isinstance(effect, FootCompliance)]
    expected = {"none": [], "fit": [0.0], 2e-5: [2e-5]}[compliance]
    assert [unknown.prior for unknown in unknowns] == pytest.approx(expected)


@pytest.mark.parametrize("compliance", ["soft", True, -1e-5, 1.0, None])
def test_a_compliance_that_cannot_be_is_refused(compliance: object) -> None:
    contact = {"name": "foot", "link": "foot", "radius": FOOT_RADIUS, "compliance": compliance}
    with pytest.raises(ConfigError, match="is not a compliance; give fit, none, or a number in m/N"):
        parse_config({"base": {"kind": "floating"}, "contacts": [contact]}, "")

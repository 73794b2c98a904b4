"""Feet that are larger than configured: the contacts move along the vertical."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.quadruped import FOOT_RADIUS, true_quadruped
from numpy.random import Generator
from standing_quadruped import PinocchioQuadruped, quadruped_model, random_state

from idtool.common.exceptions import ConfigError
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import build_effects, effect_from_entry
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import EffectEntry

CHANGE = 0.013  # m


def entry(change: float = CHANGE, **target: str) -> EffectEntry:
    return EffectEntry(effect="foot_radius", parameters={"change": change}, **target)


def test_contacts_are_those_of_larger_balls_in_pinocchio(tmp_path: Path, rng: Generator) -> None:
    model, config = quadruped_model(tmp_path, true_quadruped(0), "measured")
    motion = random_state(rng)
    larger = effect_from_entry(entry(), model).correct_motion(motion)
    assert motion.contacts is not None
    force = ContactModel(model, config.contacts, np.ones(18)).measured_force(larger)
    witness = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    for k in range(len(motion.t)):
        expected = np.zeros(18)
        for i, contact in enumerate(config.contacts):
            if contact.is_measured:
                J = witness.contact_jacobian(motion, k, contact.link, FOOT_RADIUS + CHANGE)
                expected += J.T @ motion.contacts.wrenches[i, :, k]
        np.testing.assert_allclose(force[:, k], expected, atol=1e-10)


@pytest.mark.parametrize("forces", ["unknown", "measured"])
def test_change_of_the_torque_is_that_of_the_changed_model(tmp_path: Path, rng: Generator, forces: str) -> None:
    """The unknown forces are the same in both."""
    model, config = quadruped_model(tmp_path, true_quadruped(0), forces)
    motion = replace(random_state(rng, 400), dt=0.01)
    contacts = ContactModel(model, config.contacts, np.ones(18))
    equation = LinearModel(model.names, build_effects(model, config), {}, contacts)
    changed = replace(equation, effects=(*equation.effects, effect_from_entry(entry(), model)))
    linearized = LinearizedModel(equation, equation.prior, motion)
    displaced = LinearizedModel(changed, equation.prior, motion, with_contacts_of=linearized)
    expected = displaced.predicted_torque - linearized.predicted_torque
    change = CHANGE * linearized.torque_change_by_ball_radius()
    np.testing.assert_allclose(change, expected, atol=1e-8 * np.abs(linearized.contact_torque).max() + 1e-9)
    assert np.abs(expected).max() > 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [(entry(joint="FL_hip_joint"), "acts on all feet"), (entry(2.0), "too large"), (entry(link="FL_foot"), "all feet")],
)
def test_a_change_that_cannot_be_is_refused(tmp_path: Path, wrong: EffectEntry, message: str) -> None:
    model, _ = quadruped_model(tmp_path, true_quadruped(0))
    with pytest.raises(ConfigError, match=message):
        effect_from_entry(wrong, model)

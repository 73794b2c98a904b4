"""Reaction of a spinning rotor on the link that carries it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ground.quadruped import true_quadruped
from numpy.random import Generator
from standing_quadruped import quadruped_model, random_state

from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects import effect_from_entry
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import PI_SIZE

JOINT = "RL_calf_joint"
RATIO = 7.0
AXIAL = 3e-4  # kg·m²


def entry(inverse_ratio: float) -> EffectEntry:
    parameters = {"inertia": AXIAL * RATIO**2, "inverse_gear_ratio": inverse_ratio}
    return EffectEntry(effect="rotor_inertia", joint=JOINT, parameters=parameters)


def test_torque_is_that_of_a_spinning_body_less_that_of_one_at_rest(tmp_path: Path, rng: Generator) -> None:
    """The rotor as a body of its own, whose spin agrees with MuJoCo in the benchmarks' quadruped."""
    robot = true_quadruped(0)

    def torque_of_rotor(ratio: float) -> np.ndarray:
        inertial = {"mass": 1e-6, "com": [0, 0, 0], "inertia": [1e-9, 0, AXIAL, 0, 0, 1e-9]}
        rotor = {"joint": JOINT, "gear_ratio": ratio, "inertial": inertial}
        model, _ = quadruped_model(tmp_path, robot, rotors={"rotor": rotor})
        bodies = RigidBodies(model)
        pi = np.zeros(len(bodies.coefficients))
        (k,) = (k for k, body in enumerate(model.bodies) if body.kind == "rotor")
        pi[PI_SIZE * k :] = np.array([c.prior for c in bodies.coefficients])[PI_SIZE * k :]
        pi[PI_SIZE * (k + 1) :] = 0
        return bodies.torque(pi, motion)

    motion = random_state(rng, 30)
    model, _ = quadruped_model(tmp_path, robot)
    effect = effect_from_entry(entry(1 / RATIO), model)
    out = [np.empty((len(active), 30)) for active in effect.active]
    effect.columns(motion, out)
    reaction = np.zeros((18, 30))
    for row, own in enumerate(out):
        if len(own):
            reaction[row] = AXIAL * RATIO**2 * own[0]
    expected = torque_of_rotor(RATIO) - torque_of_rotor(1e-9)
    np.testing.assert_allclose(reaction, expected, atol=1e-6)
    assert np.abs(expected[12:]).max() > 1e-3


def test_without_a_ratio_it_acts_on_its_joint_alone(tmp_path: Path) -> None:
    model, _ = quadruped_model(tmp_path, true_quadruped(0))
    effect = effect_from_entry(entry(0.0), model)
    assert [model.names[row] for row, active in enumerate(effect.active) if len(active)] == [JOINT]


def test_a_ratio_below_one_is_refused(tmp_path: Path) -> None:
    model, _ = quadruped_model(tmp_path, true_quadruped(0))
    with pytest.raises(ConfigError, match="out of range"):
        effect_from_entry(entry(1.5), model)

"""An IMU that is late: the motion of the base and its orientation are shifted back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.quadruped import true_quadruped
from numpy.random import Generator
from standing_quadruped import quadruped_model, random_state

from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects import effect_from_entry
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

DELAY = 6.3e-3  # s
STEP = 1e-3  # s


@pytest.fixture
def model(tmp_path: Path) -> RobotModel:
    model, _ = quadruped_model(tmp_path, true_quadruped(0))
    return model


def entry(delay: float = DELAY, **target: str) -> EffectEntry:
    return EffectEntry(effect="imu_delay", parameters={"delay": delay}, **target)


def test_motion_of_the_base_is_shifted_back_and_that_of_the_joints_is_not(model: RobotModel, rng: Generator) -> None:
    t = np.arange(600) * STEP
    phase = rng.uniform(0, 6, (18, 1))

    def motion_at(times: np.ndarray) -> np.ndarray:
        return np.asarray(np.sin(9 * times + phase))

    late = np.where(np.arange(18)[:, None] < 12, motion_at(t), motion_at(t - DELAY))
    state = random_state(rng, len(t))
    assert state.contacts is not None
    angle = 0.3 * np.sin(5 * (t - DELAY))
    turned = np.zeros((3, 3, len(t)))
    turned[0, 0] = turned[1, 1] = np.cos(angle)
    turned[0, 1], turned[1, 0], turned[2, 2] = -np.sin(angle), np.sin(angle), 1
    measured = replace(
        state, t=t, dt=STEP, q=motion_at(t), v=late, a=late, contacts=replace(state.contacts, world_to_base=turned)
    )
    effect = effect_from_entry(entry(), model)
    true = effect.correct_motion(measured)
    inner = slice(30, -30)
    np.testing.assert_allclose(true.v[:, inner], motion_at(t)[:, inner], atol=1e-6)
    np.testing.assert_allclose(true.a[:, inner], motion_at(t)[:, inner], atol=1e-6)
    assert true.q is measured.q
    assert true.contacts is not None
    expected = np.cos(0.3 * np.sin(5 * t))
    np.testing.assert_allclose(true.contacts.world_to_base[0, 0, inner], expected[inner], atol=1e-6)
    (mask, *others) = effect.invalid_mask(measured).values()
    assert mask[-7:].all()
    assert not mask[:-7].any()
    assert len(others) == 17  # the motion of the base is in all rows


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (entry(joint="FL_hip_joint"), "acts on the base"),
        (entry(link="trunk"), "acts on the base"),
        (entry(2.0), "too long"),
    ],
)
def test_a_delay_that_cannot_be_is_refused(model: RobotModel, wrong: EffectEntry, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        effect_from_entry(wrong, model)


def test_a_fixed_base_has_no_imu(model: RobotModel) -> None:
    fixed = replace(model, bodies=model.bodies[1:])
    with pytest.raises(ConfigError, match="needs a floating base"):
        effect_from_entry(entry(), fixed)

"""Friction: the sign of velocity near zero and away from it, joints at rest, and coefficients found again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from robots import chain, joint
from swings import JOINTS, clock, joined, signals_of, swing, swinging

from idtool.data.signals import Motion
from idtool.dynamics.effects import build_effects, effect_types
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]

ONE = chain(joint("hip", "revolute", "l0", "l1"))
TWO = chain(joint("hip", "revolute", "l0", "l1"), joint("knee", "prismatic", "l1", "l2"))

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def motion_of(v: Array, still: float = 1e-2) -> Motion:
    """Samples of one joint's velocity, shape (N,)."""
    nothing = np.zeros((1, len(v)))
    t = np.arange(float(len(v)))
    return Motion(t, nothing, v[None], nothing, nothing, nothing, np.array([still]), 1.0)


def column(build: Build, effect: str, motion: Motion) -> Array:
    """An effect's column on the only joint of a robot."""
    return effect_types()[effect](build(ONE, ["hip"]), 0).column(motion)


def friction_only(build: Build, friction: dict[str, Any]) -> LinearModel:
    """The torque equation of a chain whose links weigh nothing."""
    model = build(TWO, JOINTS, friction=friction)
    return LinearModel(model.names, build_effects(model, parse_config({"friction": friction}, ""))[1:])


def test_away_from_zero_the_coulomb_column_is_the_sign_of_the_velocity(build: Build) -> None:
    v = np.concatenate([np.linspace(0.2, 5, 200), np.linspace(5, 0.2, 50), -np.linspace(0.2, 5, 200)])
    coulomb = column(build, "coulomb_friction", motion_of(v))
    apart = np.setdiff1d(np.arange(len(v)), [249, 250])  # the two samples that the turn lies between
    np.testing.assert_allclose(coulomb[apart], np.sign(v)[apart], atol=1e-11)
    np.testing.assert_array_equal(column(build, "viscous_friction", motion_of(v)), v)
    np.testing.assert_array_equal(column(build, "torque_offset", motion_of(v)), np.ones(len(v)))


@pytest.mark.parametrize("step", [0.0003, 0.003, 0.04, 0.5, 5.0])
def test_where_the_velocity_turns_the_column_is_the_mean_sign_over_the_sample(build: Build, step: float) -> None:
    """A straight passage through zero, in steps small and large against the width of the sign: by quadrature."""
    still = 1e-2
    v = np.asarray(step * (np.arange(-30, 31) + 0.37), dtype=np.float64)
    within = np.linspace(-0.5, 0.5, 20001)
    mean = np.tanh((v[:, None] + step * within) / still).mean(axis=1)
    coulomb = column(build, "coulomb_friction", motion_of(v, still))
    np.testing.assert_allclose(coulomb[1:-1], mean[1:-1], atol=5e-4)
    assert np.abs(coulomb).max() <= 1 + 1e-12


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seeds)
def test_the_coulomb_column_turns_with_the_direction_of_motion(build: Build, rng: np.random.Generator) -> None:
    v = rng.normal(size=100) * 10 ** rng.uniform(-4, 1)
    there, back = (column(build, "coulomb_friction", motion_of(x)) for x in (v, -v))
    np.testing.assert_allclose(back, -there, atol=1e-9)


@pytest.mark.parametrize("velocity", ["measured", "differentiated"])
def test_the_coefficients_of_a_swing_with_friction_are_found(build: Build, velocity: str) -> None:
    """Torque written down from the true velocity; columns from the log, both through the same filters."""
    friction = {"viscous": True, "coulomb": True, "offset": True}
    truth = np.array([[0.3, 0.8, -0.15], [0.05, 2.0, 0.4]])
    t = clock(20)
    v = swing(t, 1)
    tau = truth[:, 0] * v + truth[:, 1] * np.sign(v) + truth[:, 2]
    linear = friction_only(build, friction)
    signals = signals_of(swinging(t, tau=tau), velocity=velocity)
    blocks = [np.concatenate(parts, axis=1) for parts in zip(*map(linear.block, signals.batches()), strict=True)]
    for block, expected in zip(blocks, truth, strict=True):
        found = np.linalg.lstsq(block[:-1].T, block[-1], rcond=None)[0]
        np.testing.assert_allclose(found, expected, rtol=5e-3, atol=2e-3)


def resting() -> tuple[Array, Array]:
    """A swing of 12 s, in which the hip moves on and the knee, slowed down and sped up again, rests for 4 s."""
    t = clock(12)
    pace = np.clip(np.abs(t - 6) - 2, 0, 1) ** 2
    phase = np.cumsum(pace) * 1e-3
    q = np.stack([swing(t)[:, 0], np.sin(6 * phase)], axis=1)
    v = np.stack([swing(t, 1)[:, 0], 6 * pace * np.cos(6 * phase)], axis=1)
    return q, v


def test_samples_of_a_joint_at_rest_are_left_out_of_that_joints_rows_only(build: Build) -> None:
    q, v = resting()
    linear = friction_only(build, {"viscous": True, "coulomb": True})
    signals = signals_of(swinging(clock(12), q=q, v=v, tau=v), velocity="measured")
    batches = list(signals.batches())
    hip, knee = (sum(block.shape[1] for block in blocks) for blocks in zip(*map(linear.block, batches), strict=True))
    times = np.concatenate([batch.t for batch in batches])
    rest = np.count_nonzero(np.abs(times - 6) < 2)
    assert len(times) - knee > rest
    assert len(times) - knee < 1.3 * rest
    turns = np.count_nonzero(np.diff(np.sign(v[:, 0])))
    assert len(times) - hip <= 3 * turns  # the few samples around each
    for block in zip(*map(linear.block, batches), strict=True):
        coulomb = np.concatenate(block, axis=1)[1]
        assert np.abs(coulomb).max() <= 1.2  # a step's overshoot in the band, and no more


def test_a_joint_without_coulomb_friction_keeps_its_samples_at_rest(build: Build) -> None:
    q, v = resting()
    friction = {"hip": {"viscous": True}, "knee": {"viscous": True, "coulomb": False, "offset": True}}
    linear = friction_only(build, friction)
    signals = signals_of(swinging(clock(12), q=q, v=v, tau=v), velocity="measured")
    for batch in signals.batches():
        assert linear.block(batch)[1].shape[1] == len(batch.t)


def test_the_sign_is_as_wide_as_the_noise_of_the_velocity_that_is_used(rng: np.random.Generator) -> None:
    """The measured velocity of one joint, and the differentiated one of the other, whose sensor is worse."""
    t = clock(20)
    q = swing(t) + 1e-4 * rng.normal(size=(len(t), 2))
    v = swing(t, 1) + np.array([0.01, 0.3]) * rng.normal(size=(len(t), 2))
    signals = signals_of(swinging(t, q=q, v=v))
    np.testing.assert_array_equal(signals.velocity_from_position, [False, True])
    error = joined(signals, lambda m: m.v) - swing(joined(signals, lambda m: m.t), 1).T
    expected = np.maximum(3e-3, 1.25 * error.std(axis=1))
    assert expected[1] > 1.5 * expected[0]
    np.testing.assert_allclose(signals.velocity_deadband, expected, rtol=0.2)

    differentiated = signals_of(swinging(t, q=q, v=v), velocity="differentiated")
    assert differentiated.velocity_deadband[0] > 1.5 * signals.velocity_deadband[0]
    assert differentiated.velocity_deadband[1] == pytest.approx(signals.velocity_deadband[1])


@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.1])
def test_the_sign_is_as_wide_as_the_velocitys_noise_asks(rng: np.random.Generator, sigma: float) -> None:
    """1.25 times its standard deviation, and at least 3 mrad/s: after the signals' filter, which leaves part of it."""
    t = clock(20)
    noise = sigma * rng.normal(size=(len(t), 2))
    signals = signals_of(swinging(t, v=swing(t, 1) + noise), velocity="measured")
    left = joined(signals, lambda m: m.v) - swing(joined(signals, lambda m: m.t), 1).T
    expected = max(3e-3, 1.25 * float(left.std()))
    np.testing.assert_allclose(signals.velocity_deadband, expected, rtol=0.2)


def test_friction_is_never_negative_and_an_offset_may_be(build: Build) -> None:
    linear = friction_only(build, {"viscous": True, "coulomb": True, "offset": True})
    lower = {c.name: c.lower for c in linear.coefficients}
    assert lower == {"viscous": 0.0, "coulomb": 0.0, "offset": -np.inf}


def test_priors_are_the_configurations_values_else_the_urdfs(build: Build) -> None:
    dynamics = '<axis xyz="0 0 1"/><dynamics damping="0.7" friction="1.3"/>'
    text = chain(joint("hip", "revolute", "l0", "l1", dynamics), joint("knee", "prismatic", "l1", "l2"))
    friction = {"hip": {"coulomb": 2.5}, "knee": {"offset": -0.4}}
    model = build(text, JOINTS, friction=friction)
    effects = build_effects(model, parse_config({"friction": friction}, ""))[1:]
    found = {(c.owner, c.name): (c.prior, c.unit) for effect in effects for c in effect.coefficients}
    assert found == {
        ("hip", "viscous"): (0.7, "N·m·s/rad"),
        ("hip", "coulomb"): (2.5, "N·m"),
        ("knee", "viscous"): (0.0, "N·s/m"),
        ("knee", "coulomb"): (0.0, "N"),
        ("knee", "offset"): (-0.4, "N"),
    }

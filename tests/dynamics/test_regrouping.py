"""Dependent columns of bodies: a theorem, on random trees with rotors, and what is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import actuated, axis, inertial, joint, origin, random_rotors, random_urdf
from test_regressor import random_motion

from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.regrouping import regrouped
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]


def random_model(seed: int, robot_of: ReadRobot) -> tuple[RobotModel, LinearModel]:
    """A random tree with rotors, and its equation with friction."""
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=8))
    settings = {"gravity": (5 * rng.normal(size=3)).tolist()}
    if seed % 2:
        settings["rotors"] = random_rotors(rng, robot)
    config = parse_config(settings, "")
    model = build_model(robot, config, actuated(robot))
    return model, LinearModel(model.names, build_effects(model, config))


@pytest.mark.parametrize("seed", range(24))
def test_columns_that_are_kept_give_all(seed: int, robot_of: ReadRobot) -> None:
    model, equation = random_model(seed, robot_of)
    kept_model = regrouped(equation)
    assert len(kept_model.equation.coefficients) < len(equation.coefficients)
    motion = random_motion(np.random.default_rng(seed), len(model.names), 8)
    kept_columns = kept_model.equation.columns(motion)
    for i, expected in enumerate(equation.columns(motion)):
        restored = kept_model.all_columns(i, kept_columns[i].T).T
        np.testing.assert_allclose(restored, expected, rtol=0, atol=1e-12 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize("seed", range(24))
def test_regrouped_values_give_the_same_torque(seed: int, robot_of: ReadRobot) -> None:
    model, equation = random_model(seed, robot_of)
    kept_model = regrouped(equation)
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, len(model.names), 8)
    theta = equation.prior * rng.uniform(0.5, 1.5, len(equation.prior))
    expected = equation.torque(motion, theta)
    torque = kept_model.equation.torque(motion, kept_model.regrouped_values(theta))
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-12 * max(1, np.abs(expected).max()))


def test_of_a_general_chain_nothing_more_can_be_left_out(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """Gautier & Khalil (1990): 7 n − 4 parameters of n revolute joints in general position determine the torque."""
    count = 4
    names = [f"j{i}" for i in range(count)]
    joints = [joint(name, "revolute", f"l{i}", f"l{i + 1}", origin(rng) + axis(rng)) for i, name in enumerate(names)]
    links = "".join(f'<link name="l{i}">{inertial(rng)}</link>' for i in range(count + 1))
    config = parse_config({"gravity": [1.0, 2.0, -9.0]}, "")
    model = build_model(robot_of(f'<robot name="chain">{links}{"".join(joints)}</robot>'), config, names)
    equation = regrouped(LinearModel(model.names, build_effects(model, config)[:1])).equation
    samples = 200
    Y = np.zeros((count, samples, len(equation.coefficients)))
    for row, columns, active in zip(
        Y, equation.columns(random_motion(rng, count, samples)), equation.active(), strict=True
    ):
        row[:, active] = columns[:-1].T
    assert Y.shape[-1] == np.linalg.matrix_rank(Y.reshape(-1, Y.shape[-1])) == 7 * count - 4


def test_what_is_regrouped_stays_as_it_is(robot_of: ReadRobot) -> None:
    _, equation = random_model(0, robot_of)
    kept = regrouped(equation).equation
    assert len(kept.coefficients) < len(equation.coefficients)
    assert regrouped(kept).equation is kept
    known_bodies = np.zeros(10)
    assert regrouped(replace(equation, known_bodies=known_bodies)).bodies == ()

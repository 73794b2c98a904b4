"""Dry friction of several joints: what stops together, lets go together or keeps the others from moving.

Letters: M mass matrix, h bias, c levels of the friction (nv,) [N or N·m], W rollouts, N samples.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from forward import friction, mechanism, run_rollouts, sliders, torque_of_one_state, torque_of_time, zero_torque
from mujoco_robots import Tree
from numpy.typing import NDArray
from robots import random_rotors, random_urdf
from scipy.integrate import solve_ivp
from stick_slip import StickSlip

from idtool.dynamics.effects.stribeck_friction import StribeckFriction
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.rollouts import Rollouts
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]


def pair(robot_of: ReadRobot, masses: tuple[float, float], c: tuple[float, float], carried: bool = True) -> Mechanism:
    """A carriage on a rail with a mass that slides on it, or two masses on a rail each."""
    names = ["x1", "x2"]
    return mechanism(robot_of(sliders(*masses, carried=carried)), {"friction": friction(names, [0, 0], c)})


@pytest.mark.parametrize("carried", [False, True])
@pytest.mark.parametrize("apart", [0.0, 1e-12, -1e-12, 1e-7, -1e-7, 1e-3])
def test_two_joints_stop_at_the_same_time(robot_of: ReadRobot, carried: bool, apart: float) -> None:
    """Both after a second, or one a little later; the mass pulls its carriage along."""
    machine = pair(robot_of, (1.0, 1.0), (3.0, 2.0) if carried else (1.0, 1.0), carried)
    samples = np.linspace(0, 2, 41)
    q, v = run_rollouts(machine, [0, 0], [1.0, 1.0 + apart], zero_torque, samples)
    t = np.minimum(samples, 1.0)
    np.testing.assert_allclose(q[0, 0], t - t**2 / 2, rtol=0, atol=abs(apart) + 1e-12)
    np.testing.assert_allclose(q[1, 0], t - t**2 / 2, rtol=0, atol=2 * abs(apart) + 1e-12)
    np.testing.assert_array_equal(v[:, 0, samples > 1.01], 0)


@pytest.mark.parametrize("c", [(3.0, 2.0), (2.0, 2.0)])
@pytest.mark.parametrize("at_once", [False, True])
def test_what_lets_go_unloads_the_other(robot_of: ReadRobot, c: tuple[float, float], at_once: bool) -> None:
    """A force on the mass alone is more than the carriage's friction; but the mass slips first, and spares it."""
    force = (lambda t: 10 + 0 * t) if at_once else (lambda t: 10 * t)
    input_torque = torque_of_time(
        lambda t: np.stack([force(t), force(t)])
    )  # in both coordinates: the mass is on the carriage
    samples = np.linspace(0, 2, 41)
    q, v = run_rollouts(pair(robot_of, (1.0, 2.0), c), [0, 0], [0, 0], input_torque, samples)
    assert np.abs(q[0]).max() < 1e-12
    assert np.abs(v[0]).max() < 1e-12
    t0 = 0.0 if at_once else 0.2
    t = np.maximum(samples - t0, 0)
    expected = (10 - 2) / 2 * t**2 / 2 if at_once else 10 * t**3 / 6 / 2
    np.testing.assert_allclose(q[1, 0], expected, rtol=0, atol=1e-9)


def test_what_lets_go_takes_the_other_along(robot_of: ReadRobot) -> None:
    """The carriage's friction is the smaller: from 0.1 s both move as one, from 1 s on the mass slips on the carriage.

    As one, (10 t − 1) / 3 is their acceleration, and 10 t − 2 a, which is less than 4 until then, holds the mass.
    """
    input_torque = torque_of_time(lambda t: np.stack([10 * t, 10 * t]))  # on the mass
    samples = np.linspace(0, 2, 81)
    q, _ = run_rollouts(pair(robot_of, (1.0, 2.0), (1.0, 4.0)), [0, 0], [0, 0], input_torque, samples)
    as_one, slipping = np.clip(samples - 0.1, 0, 0.9), np.maximum(samples - 1, 0)
    carriage = 10 / 3 * as_one**3 / 6 + 10 / 3 * 0.9**2 / 2 * slipping + 3 * slipping**2 / 2
    np.testing.assert_allclose(q[0, 0], carriage, rtol=0, atol=1e-9)
    np.testing.assert_allclose(q[1, 0], 5 * slipping**3 / 6, rtol=0, atol=1e-9)


def test_a_level_of_zero_is_no_friction(robot_of: ReadRobot) -> None:
    input_torque = torque_of_time(lambda t: np.stack([np.sin(5 * t), np.sin(5 * t)]))
    samples = np.linspace(0, 3, 31)
    q, _ = run_rollouts(pair(robot_of, (1.0, 1.0), (0.0, 0.9), carried=False), [0, 0], [0, 0], input_torque, samples)
    np.testing.assert_allclose(q[0, 0], samples / 5 - np.sin(5 * samples) / 25, rtol=0, atol=1e-9)
    np.testing.assert_allclose(q[1, 0, :3], 0, rtol=0, atol=0)


@pytest.mark.parametrize("force", [0.0, 1e-3, -0.5])
def test_where_friction_is_nothing_any_load_moves(robot_of: ReadRobot, force: float) -> None:
    """A level of 2 − 3 exp(−v²), less than nothing being nothing."""
    machine = mechanism(robot_of(sliders(1.0)), {"friction": friction(["x1"], [0], [2.0])})
    machine.dry_friction_terms.append((StribeckFriction(machine.model, 0, 0.0, {"velocity": 1.0}), -3.0))
    samples = np.linspace(0, 5, 11)
    q, _ = run_rollouts(machine, [0], [0], torque_of_time(lambda t: force + 0 * t[None]), samples)

    def slope(t: float, x: Array) -> Array:
        return np.array([x[1], abs(force) - max(2 - 3 * np.exp(-(x[1] ** 2)), 0)])

    expected = np.sign(force) * solve_ivp(slope, (0, 5), [0, 0], t_eval=samples, rtol=1e-9, atol=1e-12).y[0]
    np.testing.assert_allclose(q[0, 0], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("force", [0.0, 2.0, -2.0])
def test_at_rest_without_load_or_at_the_limit_nothing_moves(robot_of: ReadRobot, force: float) -> None:
    """The load is exactly what friction can hold, on both."""
    machine = pair(robot_of, (1.0, 3.0), (2.0, 2.0), carried=False)
    load = torque_of_time(lambda t: np.full((2, len(t)), force))
    q, _ = run_rollouts(machine, [0.3, -0.2], [0, 0], load, np.linspace(0, 3, 11))
    np.testing.assert_allclose(q[:, 0], np.repeat([[0.3], [-0.2]], 11, axis=1), rtol=0, atol=1e-9)


def belt(robot_of: ReadRobot, count: int) -> tuple[Mechanism, StickSlip, Callable[..., Array]]:
    """Masses on a belt of 0.3 m/s, held by springs to the ground and to each other; q is relative to the belt.

    Friction is 4 N at rest and falls to 2 N.
    """
    masses, names = 1 + 0.3 * np.arange(count), [f"x{i + 1}" for i in range(count)]
    config: dict[str, Any] = {"friction": friction(names, [0.1] * count, [2.0] * count)}
    config["effects"] = [
        {"effect": "stribeck_friction", "joint": name, "parameters": {"stribeck": 2.0, "velocity": 0.2}}
        for name in names
    ]
    springs = 60.0 * (3 * np.eye(count) - np.ones((count, count)))

    def input_torque(t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
        return -springs @ (q + 0.3 * t)

    torque = torque_of_one_state(input_torque)
    witness = StickSlip(
        lambda q, v: (np.diag(masses), np.zeros(count)),
        lambda t, q, v: torque(t, q, v) - 0.1 * v,
        lambda v: 2 + 2 * np.exp(-((v / 0.2) ** 2)),
    )
    return mechanism(robot_of(sliders(*masses)), config), witness, input_torque


def test_the_period_of_stick_and_slip(robot_of: ReadRobot) -> None:
    """Of a mass on a belt, nine times over."""
    machine, witness, input_torque = belt(robot_of, 1)
    samples = np.linspace(0, 6.5, 1301)
    expected, _ = witness.run(np.zeros(1), np.zeros(1), samples)
    slips = [t for t, _, s in witness.changes if s]
    periods = np.diff(slips[1:])
    assert len(periods) >= 8
    np.testing.assert_allclose(periods, periods[0], rtol=1e-8)
    q, v = run_rollouts(machine, [0.0], [0.0], input_torque, samples)
    np.testing.assert_allclose(q[:, 0], expected, rtol=0, atol=1e-5)
    # Carried, the mass rests on the belt where it was caught; a period later it rests that much further back.
    rests = q[0, 0, np.flatnonzero((v[0, 0, 1:] == 0) & (v[0, 0, :-1] != 0)) + 1]
    np.testing.assert_allclose(np.diff(rests)[1:] / -0.3, periods[0], rtol=1e-6)


def test_coupled_stick_and_slip(robot_of: ReadRobot) -> None:
    machine, witness, input_torque = belt(robot_of, 2)
    samples = np.linspace(0, 4, 401)
    expected, speeds = witness.run(np.array([0.0, 0.05]), np.zeros(2), samples)
    assert len({s for _, _, s in witness.changes}) > 1
    assert len(witness.changes) > 12
    q, v = run_rollouts(machine, [0.0, 0.05], [0, 0], input_torque, samples)
    np.testing.assert_allclose(q[:, 0], expected, rtol=0, atol=1e-5)
    assert np.count_nonzero((v[:, 0] == 0) != (np.abs(speeds) < 1e-9)) <= 3


def random_machine(read: ReadRobot, seed: int) -> tuple[Mechanism, Tree, Array, Array]:
    """A tree of up to four moving joints with rotors; its equations by MuJoCo, viscous coefficients and levels."""
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, size=4, kinds=("revolute", "continuous", "prismatic"), massless=0, mimic=0)
    robot = read(text)
    names = list(robot.joints)
    config: dict[str, Any] = {"gravity": [0, 0, -9.81], "rotors": random_rotors(rng, robot)}
    for rotor in config["rotors"].values():
        rotor["inertial"]["com"] = [0.02 * x for x in rotor["inertial"]["com"]]
    b, c = rng.uniform(0, 0.5, 4), rng.uniform(0.5, 4, 4)
    machine = mechanism(robot, {**config, "friction": friction(names, b, c)}, names)
    return machine, Tree(text, names, config), b, c


@pytest.mark.parametrize("seed", range(8))
def test_random_machines_move_as_scipy_moves_them(robot_of: ReadRobot, seed: int) -> None:
    machine, tree, b, c = random_machine(robot_of, seed)
    rng = np.random.default_rng([seed, 1])
    size, rate, phase = (
        rng.normal(size=(4, 3)) * 1.5 * c[:, None],
        rng.uniform(2, 20, (4, 3)),
        rng.uniform(0, 6, (4, 3)),
    )
    springs = rng.uniform(5, 50, (4, 1))
    q0, v0 = 0.3 * rng.normal(size=4), 2 * rng.normal(size=4) * (rng.random(4) < 0.6)

    def input_torque(t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
        return np.sum(size[..., None] * np.sin(rate[..., None] * t + phase[..., None]), axis=1) - springs * q

    torque, samples = torque_of_one_state(input_torque), np.linspace(0, 1, 51)
    witness = StickSlip(tree, lambda t, q, v: torque(t, q, v) - b * v, lambda v: c)
    expected, _ = witness.run(q0, v0, samples)
    assert len(witness.changes) > 1
    q, _ = run_rollouts(machine, q0, v0, input_torque, samples)
    np.testing.assert_allclose(q[:, 0], expected, rtol=0, atol=1e-5)


def starts(machine: Mechanism, tree: Tree, c: Array, q0: Array, seed: int) -> set[int]:
    """Checks which joints start from rest at positions (nv, W) under random loads; how many of them slid."""
    rng, moment, rest, sliding = np.random.default_rng(seed), 1e-7, np.zeros_like(q0), set()
    weight = np.transpose([tree(q, v)[1] for q, v in zip(q0.T, rest.T, strict=True)])
    tau = weight + 2 * c[:, None] * rng.normal(size=q0.shape)
    rollouts = Rollouts(machine, np.zeros(q0.shape[1]), q0, rest, lambda t, q, v, rollout_ids: tau[:, rollout_ids])
    rollouts.advance(np.full(q0.shape[1], moment))
    for w in range(q0.shape[1]):
        witness = StickSlip(tree, lambda t, q, v, w=w: tau[:, w], lambda v: c)
        state = np.concatenate([q0[:, w], rest[:, w]])
        s = witness.directions(0.0, state)
        sliding.add(np.count_nonzero(s))
        a = witness.forces(0.0, state, s)[0]
        np.testing.assert_allclose(rollouts.v[:, w] / moment, a, rtol=1e-4, atol=1e-5 * np.abs(a).max() + 1e-9)
    return sliding


@pytest.mark.parametrize("seed", range(6))
def test_which_joints_start_from_rest(robot_of: ReadRobot, seed: int) -> None:
    """Of all combinations of held and sliding, the one that fits the laws of friction."""
    machine, tree, _, c = random_machine(robot_of, 100 + seed)
    assert starts(machine, tree, c, np.random.default_rng(seed).normal(size=(4, 50)), seed) >= {1, 2, 3, 4}


@pytest.mark.parametrize("seed", range(6))
def test_which_of_strongly_coupled_masses_start_from_rest(robot_of: ReadRobot, seed: int) -> None:
    """Light masses that belts tie to heavy rotors: what starts one can stop another that was about to start."""
    rng, names = np.random.default_rng(seed), ["x1", "x2", "x3"]
    rotor = {"parent": "m0", "origin": {"xyz": [0, 0, 0], "rpy": [0, 0, 0]}, "axis": [0, 0, 1]}
    rotor["inertial"] = {"mass": 1.0, "com": [0, 0, 0], "inertia": [0.01, 0, 0.01, 0, 0, 0.01]}
    belts = {f"r{i}": {**rotor, "coupling": dict(zip(names, rng.normal(size=3) * 10, strict=True))} for i in range(3)}
    c, text = rng.uniform(0.2, 3, 3), sliders(0.05, 0.05, 0.05)
    machine = mechanism(robot_of(text), {"rotors": belts, "friction": friction(names, [0] * 3, c)})
    assert starts(machine, Tree(text, names, {"rotors": belts}), c, np.zeros((3, 100)), seed) >= {1, 2, 3}

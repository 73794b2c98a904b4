"""Smooth motion and the leg's: energy, order, and the same motion as MuJoCo's and scipy's.

Shapes: nv joints, W rollouts, N samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from forward import (
    LEG,
    LEG_JOINTS,
    LEG_ROTORS,
    LEG_SPINS,
    NO_FRICTION,
    InputTorqueFunction,
    friction,
    hinge,
    mechanism,
    run_rollouts,
    torque_of_one_state,
    torque_of_time,
    zero_torque,
)
from mujoco_robots import Simulation, Tree
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid, solve_ivp
from stick_slip import StickSlip

from idtool.dynamics.simulation.rollouts import Rollouts
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

# Axes that are not parallel, inertias turned against the links; the elbow's rotor sits in the first link, leans against
# everything, is not balanced, and a belt turns it with both joints.
PENDULUM = """<robot name="pendulum"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.03 0.02 -0.2" rpy="0.2 -0.3 0.5"/><mass value="1.5"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.025" iyz="0" izz="0.008"/></inertial></link>
<link name="lower"><inertial><origin xyz="-0.02 0.01 -0.15" rpy="0.2 -0.3 0.5"/><mass value="0.8"/>
<inertia ixx="0.008" ixy="0" ixz="0" iyy="0.006" iyz="0" izz="0.003"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="1 0 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
<origin xyz="0.05 0 -0.4" rpy="0 0 0.3"/><axis xyz="0 1 0.2"/></joint></robot>"""
ROTORS = {
    "shoulder_rotor": {
        "coupling": {"shoulder": 9.0},
        "parent": "base",
        "origin": {"xyz": [0, -0.1, 0], "rpy": [0, 0, 0]},
        "axis": [1, 0, 0],
        "inertial": {"mass": 0.4, "com": [0.01, 0.003, 0], "inertia": [6e-4, 0, 3.5e-4, 0, 0, 3.5e-4]},
    },
    "elbow_rotor": {
        "coupling": {"shoulder": 2.0, "elbow": -8.0},
        "parent": "upper",
        "origin": {"xyz": [0, 0.05, -0.1], "rpy": [0.3, 0.2, 0.1]},
        "axis": [0.2, 1, -0.3],
        "inertial": {"mass": 0.3, "com": [0, 0.01, 0.004], "inertia": [3e-4, 0, 6e-4, 0, 0, 3e-4]},
    },
}
JOINTS = ("shoulder", "elbow")
FREE = {"rotors": ROTORS, "friction": dict.fromkeys(JOINTS, NO_FRICTION)}


@pytest.mark.parametrize("every", [0.02, 0.5])
def test_energy_is_kept(robot_of: ReadRobot, every: float) -> None:
    """Links and rotors as MuJoCo counts them, from four states; asked for often or now and then."""
    rng = np.random.default_rng(1)
    q0, v0 = rng.choice([-1, 1], (2, 4)) * rng.uniform(1.5, 2.5, (2, 4)), rng.normal(size=(2, 4)) * 3
    samples = np.linspace(0, 10, round(10 / every) + 1)
    q, v = run_rollouts(mechanism(robot_of(PENDULUM), FREE), q0, v0, zero_torque, samples)
    tree = Tree(PENDULUM, JOINTS, FREE)
    for w in range(4):
        states = zip(q[:, w].T, v[:, w].T, strict=True)
        potential, kinetic = np.transpose([tree.energy(*state) for state in states])
        total, span = potential + kinetic, np.ptp(potential) + np.ptp(kinetic)
        assert span > 5  # J: it has moved
        assert np.abs(total - total[0]).max() < 1e-6 * span


def test_the_pendulums_rotors_are_coupled(robot_of: ReadRobot) -> None:
    """What is kept is not the energy of rotors that only add inertia to their joints."""
    q0, v0 = np.array([0.5, -1.0]), np.array([2.0, 3.0])
    q, v = run_rollouts(mechanism(robot_of(PENDULUM), FREE), q0, v0, zero_torque, np.linspace(0, 2, 101))
    links = Tree(PENDULUM, JOINTS, {})
    spin = np.array([9.0**2 * 6e-4, 8.0**2 * 6e-4])
    total = [sum(links.energy(a, b)) + 0.5 * spin @ b**2 for a, b in zip(q[:, 0].T, v[:, 0].T, strict=True)]
    assert np.ptp(total) > 0.05


def pushes(t: Array) -> Array:
    """Smooth torques on the leg [N·m] that make it stop and turn, shape (3, N)."""
    return np.stack([4 * np.sin(5 * t) + 1.5 * np.sin(17 * t), 6 * np.sin(7 * t + 1), 4 * np.sin(9 * t + 2)])


def jagged(t: Array) -> Array:
    """The same, but straight from each 40 ms to the next."""
    knots = np.linspace(0, 1, 26)
    return np.stack([np.interp(t, knots, row) for row in pushes(knots)])


START = np.array([0.2, 0.5, -1.2]), np.zeros(3)
VISCOUS, COULOMB = (0.1, 0.1, 0.1), (2.0, 1.0, 1.0)  # as the leg's URDF has them


def leg_config(coulomb: Sequence[float]) -> dict[str, Any]:
    return {"rotors": LEG_ROTORS, "friction": friction(LEG_JOINTS, VISCOUS, coulomb)}


def errors(robot_of: ReadRobot, coulomb: Sequence[float], steps: Sequence[float]) -> Array:
    """Largest errors of the leg's positions in a second, per step length, against scipy on MuJoCo's equations."""
    config, samples = leg_config(coulomb), np.linspace(0, 1, 11)
    torque, level = torque_of_one_state(torque_of_time(pushes)), np.array(coulomb)
    witness = StickSlip(Tree(LEG, LEG_JOINTS, config), lambda t, q, v: torque(t, q, v) - 0.1 * v, lambda v: level)
    expected, _ = witness.run(*START, samples)
    assert bool(witness.changes) == bool(level.any())
    leg = mechanism(robot_of(LEG), config, LEG_JOINTS)
    found = [run_rollouts(leg, *START, torque_of_time(pushes), samples, step=step)[0][:, 0] for step in steps]
    return np.array([np.abs(q - expected).max() for q in found])


def test_halving_the_step_makes_smooth_motion_16_times_as_exact(robot_of: ReadRobot) -> None:
    found = errors(robot_of, (0, 0, 0), (1e-2, 5e-3, 2.5e-3, 1.25e-3))
    assert found[0] < 1e-6
    np.testing.assert_allclose(found[:-1] / found[1:], 16, rtol=0.15)


def test_halving_the_step_makes_reversals_four_times_as_exact_at_least(robot_of: ReadRobot) -> None:
    found = errors(robot_of, COULOMB, (1e-2, 5e-3, 2.5e-3, 1.25e-3))
    assert found[0] < 1e-6
    assert (found[:-1] / found[1:] > 4).all()


@pytest.mark.parametrize("torque", [pushes, jagged])
def test_the_leg_moves_as_in_mujoco(robot_of: ReadRobot, torque: Callable[[Array], Array]) -> None:
    """Sticking and turning; halving MuJoCo's steps shows its own error, which falls with them in proportion."""
    samples = np.linspace(0, 1, 101)
    config = {"rotors": LEG_ROTORS}
    q, v = run_rollouts(mechanism(robot_of(LEG), config, LEG_JOINTS), *START, torque_of_time(torque), samples)
    turns = [np.count_nonzero(np.diff(np.sign(row[row != 0]))) for row in v[:, 0]]
    assert min(turns) >= 1
    assert sum(turns) >= 5
    assert np.count_nonzero(v[0] == 0) > 20  # the abad sticks for more than 200 ms
    assert np.ptp(q[:, 0], axis=1).min() > 1
    coarse, fine = (
        Simulation(LEG, LEG_JOINTS, config, LEG_SPINS, step).run(*START, torque, samples) for step in (4e-5, 2e-5)
    )
    assert np.abs(coarse - fine).max() < 1e-4
    assert np.abs(q[:, 0, 1:] - fine).max() < 1e-4


def test_rollouts_do_not_know_of_each_other(robot_of: ReadRobot) -> None:
    """Each with its own torque, start and end; some stick, some turn, some are long done."""
    rng, count = np.random.default_rng(5), 9
    leg = mechanism(robot_of(LEG), {"rotors": LEG_ROTORS}, LEG_JOINTS)
    q0, v0, t0 = rng.normal(size=(3, count)), rng.normal(size=(3, count)), rng.uniform(0, 1, count)
    v0[:, 5:] = 0
    size, rate = 5 * rng.normal(size=(3, count)), rng.uniform(1, 30, (3, count))
    until = t0 + np.linspace(0.1, 0.5, 11)[:, None] * rng.uniform(0.5, 2, count)

    def run(these: NDArray[np.intp]) -> Array:
        def input_torque(t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
            return np.asarray(size[:, these[rollout_ids]] * np.sin(rate[:, these[rollout_ids]] * t))

        rollouts = Rollouts(leg, t0[these], q0[:, these], v0[:, these], input_torque)
        states = []
        for row in until:
            rollouts.advance(row[these])
            states.append(np.concatenate([rollouts.t[None], rollouts.q, rollouts.v]))
        return np.array(states)

    together = run(np.arange(count))
    np.testing.assert_array_equal(together[:, 0], until)
    assert 0 < np.count_nonzero(together[:, 4:] == 0) < together[:, 4:].size / 2
    for w in range(count):
        np.testing.assert_allclose(run(np.array([w]))[:, :, 0], together[:, :, w], rtol=0, atol=1e-12)


def test_rollouts_of_which_some_are_stiff_do_not_know_of_each_other(robot_of: ReadRobot) -> None:
    """One damping, that is stiff for the arm in one pose and not in the other."""
    config = {"rotors": LEG_ROTORS}
    leg = mechanism(robot_of(LEG), config, LEG_JOINTS)
    rng = np.random.default_rng(0)
    q0, v0 = rng.normal(size=(3, 4)), np.zeros((3, 4))
    tree = Tree(LEG, LEG_JOINTS, config)
    slowest = np.sort([np.linalg.eigvalsh(tree(q, v)[0])[0] for q, v in zip(q0.T, v0.T, strict=True)])
    assert slowest[-1] > 1.02 * slowest[0]
    samples = np.linspace(0, 0.1, 11)
    for stiff in (3e3, 6e3, 1e4):  # 1/s

        def input_torque(
            t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp], damping: float = stiff * slowest[2]
        ) -> Array:
            return pushes(t) - damping * v

        together = np.array(run_rollouts(leg, q0, v0, input_torque, samples))
        for w in range(4):
            one = np.array(run_rollouts(leg, q0[:, w], v0[:, w], input_torque, samples))
            np.testing.assert_allclose(one[:, :, 0], together[:, :, w], rtol=0, atol=1e-12)


LIGHT = 1e-5  # kg·m²


class Calls:
    """A drive that counts how often it is asked; at the joints' own rates, a second would take some 500,000 times."""

    def __init__(self, input_torque: InputTorqueFunction) -> None:
        self.input_torque, self.count = input_torque, 0

    def __call__(self, t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
        self.count += 1
        return self.input_torque(t, q, v, rollout_ids)


@pytest.mark.parametrize(("coulomb", "tolerance"), [(0.0, 3e-5), (0.3, 3e-5)])
def test_a_light_joint_follows_its_damping(robot_of: ReadRobot, coulomb: float, tolerance: float) -> None:
    """Viscous friction of 1 N·m·s/rad: it moves by what friction leaves of the torque, its inertia being nothing."""
    machine = mechanism(robot_of(hinge(LIGHT)), {"friction": friction(["x1"], [1.0], [coulomb])})
    calls = Calls(torque_of_time(lambda t: np.sin(5 * t)[None]))
    q, _ = run_rollouts(machine, [0.0], [0.0], calls, np.linspace(0, 1, 1001))
    assert calls.count < 10_000
    t = np.linspace(0, 1, 100_001)
    left = np.sign(np.sin(5 * t)) * np.maximum(np.abs(np.sin(5 * t)) - coulomb, 0)
    np.testing.assert_allclose(q[0, 0], cumulative_trapezoid(left, t, initial=0)[::100], rtol=0, atol=tolerance)


@pytest.mark.parametrize(("kp", "kd"), [(100.0, 2.0), (1e5, 10.0)])
def test_a_light_joint_follows_its_controller(robot_of: ReadRobot, kp: float, kd: float) -> None:
    """kp (r − q) + kd (r' − v) = b v, its inertia being nothing: rates of 300,000 and 1,100,000 1/s."""
    b = 1.0
    machine = mechanism(robot_of(hinge(LIGHT)), {"friction": friction(["x1"], [b], [0])})

    def input_torque(t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
        return np.asarray(kp * (np.sin(5 * t) - q) + kd * (5 * np.cos(5 * t) - v))

    samples, calls = np.linspace(0, 1, 1001), Calls(input_torque)
    q, _ = run_rollouts(machine, [0.0], [0.0], calls, samples)
    assert calls.count < 10_000
    found = solve_ivp(
        lambda t, q: (kp * (np.sin(5 * t) - q) + 5 * kd * np.cos(5 * t)) / (kd + b), (0, 1), [0.0], t_eval=samples,
        method="Radau", rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    np.testing.assert_allclose(q[0, 0], found.y[0], rtol=0, atol=5e-5)

"""Mass matrix and bias against the regressor, Pinocchio and MuJoCo, on random trees with rotors.

Letters: q, v, a positions, velocities, accelerations (nv, W), M mass matrices (W, nv, nv), h biases (nv, W).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forward import LEG, LEG_JOINTS, LEG_ROTORS, mechanism
from ground.quadruped import true_quadruped
from mujoco_robots import Tree
from numpy.random import Generator
from numpy.typing import NDArray
from reference import Reference
from robots import actuated, random_rotors, random_urdf
from standing_quadruped import BASE, PinocchioQuadruped, quadruped_model, random_state

from idtool.common.exceptions import ModelError
from idtool.data.signals import Motion
from idtool.dynamics.effects import RigidBodies
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.simulation.rigid_body_dynamics import RigidBodyDynamics
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

TREES = range(16)
W = 5


def tree(read: ReadRobot, seed: int, massless: float, **options: float) -> tuple[str, dict[str, Any], Robot]:
    """A random robot with a geared rotor, a belt and a differential, or without: text, configuration, robot."""
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, size=7, massless=massless, **options)
    robot = read(text)
    config: dict[str, Any] = {"gravity": (5 * rng.normal(size=3)).tolist()}
    if seed % 4 and len([j for j in robot.joints.values() if j.kind != "fixed"]) > 1:
        config["rotors"] = random_rotors(rng, robot)
    return text, config, robot


def states(seed: int, nv: int) -> Array:
    """q, v and a, shape (3, nv, W)."""
    return np.random.default_rng([seed, 1]).normal(size=(3, nv, W)) * np.array([1.0, 3.0, 10.0])[:, None, None]


def torque(M: Array, h: Array, a: Array) -> Array:
    """M a + h, shape (nv, W)."""
    return np.einsum("wij,jw->iw", M, a) + h


def columns_torque(machine: Mechanism, q: Array, v: Array, a: Array) -> Array:
    """Y pi, shape (nv, W)."""
    nothing, still = np.zeros_like(q), np.full(len(q), 1e-6)
    motion = Motion(
        t=np.arange(float(W)), q=q, v=v, a=a, tau=nothing, logged_tau=nothing, velocity_deadband=still, dt=1.0
    )
    return LinearModel(machine.model.names, (RigidBodies(machine.model),)).torque(motion, machine.pi.ravel())


def assert_same(ours: Array, expected: Array) -> None:
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("seed", TREES)
def test_the_torque_is_the_regressors(robot_of: ReadRobot, seed: int) -> None:
    """For parameters other than the URDF's, too."""
    _, config, robot = tree(robot_of, seed, massless=0.15)
    machine = mechanism(robot, config)
    q, v, a = states(seed, len(machine.model.joints))
    machine.pi *= np.random.default_rng([seed, 2]).uniform(0.5, 1.5, machine.pi.shape)
    assert_same(torque(*RigidBodyDynamics(machine)(q, v), a), columns_torque(machine, q, v, a))


@pytest.mark.parametrize("seed", TREES)
def test_the_torque_is_pinocchios(robot_of: ReadRobot, seed: int) -> None:
    text, config, robot = tree(robot_of, 100 + seed, massless=0.15)
    machine = mechanism(robot, config)
    q, v, a = states(seed, len(machine.model.joints))
    reference = Reference(text, machine.model.names, config)
    expected = np.stack([reference.torque(*state) for state in zip(q.T, v.T, a.T, strict=True)], axis=1)
    assert_same(torque(*RigidBodyDynamics(machine)(q, v), a), expected)


@pytest.mark.parametrize("seed", TREES)
def test_mass_matrix_and_bias_are_mujocos(robot_of: ReadRobot, seed: int) -> None:
    text, config, robot = tree(robot_of, 200 + seed, massless=0.0)
    machine = mechanism(robot, config)
    q, v, _ = states(seed, len(machine.model.joints))
    M, h = RigidBodyDynamics(machine)(q, v)
    witness = Tree(text, machine.model.names, config)
    for w in range(W):
        expected = witness(q[:, w], v[:, w])
        assert_same(M[w], expected[0])
        assert_same(h[:, w], expected[1])


def test_the_random_trees_hold_what_they_should(robot_of: ReadRobot) -> None:
    """Branches, prismatic and mimic joints, and rotors that more than one joint turns or that a moving link carries."""
    found = set()
    for seed in TREES:
        for first, massless in ((0, 0.15), (100, 0.15), (200, 0.0)):
            _, config, robot = tree(robot_of, first + seed, massless)
            bodies = mechanism(robot, config).model.bodies
            mounts = [body.mount.body for body in bodies if body.kind == "link"]
            found |= {"branch"} if len(set(mounts)) < len(mounts) else set()
            found |= {"prismatic"} if any(body.prismatic for body in bodies) else set()
            found |= {"mimic"} if len(mounts) > len(actuated(robot)) else set()
            rotors = [body for body in bodies if body.kind == "rotor"]
            found |= {"coupled"} if any(np.count_nonzero(body.ratios) > 1 for body in rotors) else set()
            found |= {"carried"} if any(body.mount.body >= 0 for body in rotors) else set()
    assert found == {"branch", "prismatic", "mimic", "coupled", "carried"}


@pytest.mark.parametrize("seed", TREES)
def test_the_mass_matrix_is_symmetric_and_positive_definite(robot_of: ReadRobot, seed: int) -> None:
    _, config, robot = tree(robot_of, 300 + seed, massless=0.0)
    machine = mechanism(robot, config)
    q, v, _ = states(seed, len(machine.model.joints))
    M, _ = RigidBodyDynamics(machine)(q, v)
    np.testing.assert_allclose(M, M.transpose(0, 2, 1), rtol=0, atol=1e-12 * np.abs(M).max())
    assert np.linalg.eigvalsh(M).min() > 0


@pytest.mark.parametrize("seed", range(4))
def test_states_do_not_know_of_each_other(robot_of: ReadRobot, seed: int) -> None:
    _, config, robot = tree(robot_of, seed, massless=0.15)
    machine = mechanism(robot, config)
    q, v, _ = states(seed, len(machine.model.joints))
    dynamics = RigidBodyDynamics(machine)
    M, h = dynamics(q, v)
    for w in np.random.default_rng(seed).permutation(W):
        one, bias = dynamics(q[:, [w]], v[:, [w]])
        np.testing.assert_allclose(one[0], M[w], rtol=0, atol=1e-13 * np.abs(M).max())
        np.testing.assert_allclose(bias[:, 0], h[:, w], rtol=0, atol=1e-13 * np.abs(h).max())


def test_inertia_on_a_joint_adds_to_its_own(robot_of: ReadRobot) -> None:
    machine = mechanism(robot_of(LEG), {"rotors": LEG_ROTORS}, LEG_JOINTS)
    q, v, _ = states(0, 3)
    M, h = RigidBodyDynamics(machine)(q, v)
    machine.armature[:] = 0.1, 0.0, 0.3
    more, same = RigidBodyDynamics(machine)(q, v)
    np.testing.assert_allclose(more - M, np.broadcast_to(np.diag([0.1, 0.0, 0.3]), M.shape), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(same, h)


def test_gravity_is_the_mechanisms(robot_of: ReadRobot) -> None:
    """It can be tilted against the model's."""
    machine = mechanism(robot_of(LEG), {"rotors": LEG_ROTORS}, LEG_JOINTS)
    q = states(0, 3)[0]
    machine.gravity = np.array([1.0, -2.0, 3.0])
    config = {"rotors": LEG_ROTORS, "gravity": [1.0, -2.0, 3.0]}
    expected = [Tree(LEG, LEG_JOINTS, config)(column, 0 * column)[1] for column in q.T]
    assert_same(RigidBodyDynamics(machine)(q, 0 * q)[1], np.transpose(expected))


def test_a_body_with_inertia_but_no_mass_is_refused(robot_of: ReadRobot) -> None:
    machine = mechanism(robot_of(LEG), {"rotors": LEG_ROTORS}, LEG_JOINTS)
    machine.pi[1, 0] = 0.0
    with pytest.raises(ModelError, match="thigh_link: has inertia but no mass"):
        RigidBodyDynamics(machine)


def test_a_body_that_is_nothing_moves_along(robot_of: ReadRobot) -> None:
    machine = mechanism(robot_of(LEG), {"rotors": LEG_ROTORS}, LEG_JOINTS)
    q, v, a = states(0, 3)
    machine.pi[2] = 0.0
    assert_same(torque(*RigidBodyDynamics(machine)(q, v), a), columns_torque(machine, q, v, a))


def test_joints_on_a_moving_base_are_those_of_pinocchio(tmp_path: Path, rng: Generator) -> None:
    """With the motion of the base given, the joints' rows are those of the robot on a free-flyer."""
    robot, _ = quadruped_model(tmp_path, true_quadruped(0))
    machine = Mechanism(robot)
    machine.pi = np.stack([body.pi for body in robot.bodies])
    motion = random_state(rng)
    base = np.concatenate([motion.v[BASE], motion.a[BASE]])
    M, h = RigidBodyDynamics(machine)(motion.q[:12], motion.v[:12], base)
    witness = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    expected = np.stack([witness.torque(motion, k) for k in range(len(motion.t))], axis=1)
    assert_same(torque(M, h, motion.a[:12]), expected[:12])

"""The model along a motion: how its torque changes, against Pinocchio's derivatives and torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray
from prescribed_motions import sines
from reference import Reference
from robots import actuated, random_urdf

from idtool.data.signals import Motion
from idtool.dynamics.effects import build_effects
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

GRAVITY = [1.0, -3.0, -9.0]
SPIN, RATIO = 2e-3, 9.0  # kg·m² of a round rotor about its axis; its gear ratio


def sampled(q: Array, v: Array, a: Array, dt: float = 0.01) -> Motion:
    """A motion, (nv, N) each, under any torque; so far apart that derivatives are taken at every sample."""
    tau = np.random.default_rng(8).normal(size=q.shape)
    return Motion(np.arange(q.shape[1]) * dt, q, v, a, tau, tau, np.full(len(q), 1e-6), dt)


def round_rotor(joint: str, base: str, axis: list[float]) -> dict[str, Any]:
    """A rotor in the base, so that no joint carries it, which is the same all round."""
    inertial = {"mass": 0.3, "com": [0.0, 0, 0], "inertia": [SPIN, 0, SPIN, 0, 0, SPIN]}
    origin = {"xyz": [0.1, 0.2, 0.3], "rpy": [0.4, 0.5, 0.6]}
    return {"coupling": {joint: RATIO}, "parent": base, "origin": origin, "axis": axis, "inertial": inertial}


class Case:
    """A random tree along a few random states: idtool's model and Pinocchio's."""

    def __init__(self, robot_of: ReadRobot, seed: int, rotor: bool = False, **config: Any) -> None:
        rng = np.random.default_rng(seed)
        self.text = random_urdf(rng, size=6)
        self.robot = robot_of(self.text)
        self.names = tuple(actuated(self.robot))
        base = next(iter(self.robot.links))
        rotors = {"motor": round_rotor(self.names[0], base, [0.6, 0, 0.8])} if rotor else {}
        self.config: dict[str, Any] = {
            "gravity": GRAVITY,
            "friction": {"viscous": False, "coulomb": False},
            "rotors": rotors,
            **config,
        }
        self.motion = sampled(*rng.normal(size=(3, len(self.names), 5)))
        self.linearized = self.along(self.motion)

    def along(self, motion: Motion) -> LinearizedModel:
        parsed = parse_config(self.config, "")
        model = build_model(self.robot, parsed, self.names)
        linear = LinearModel(model.names, build_effects(model, parsed))
        return LinearizedModel(linear, linear.prior, motion)

    def reference(self, **changes: Any) -> Reference:
        return Reference(self.text, self.names, {**self.config, **changes})

    def torque(self, motion: Motion, **changes: Any) -> Array:
        """Pinocchio's, shape (nv, N)."""
        found = self.reference(**changes)
        states = zip(motion.q.T, motion.v.T, motion.a.T, strict=True)
        return np.array([found.torque(*state) for state in states]).T


def slopes(found: Reference, q: Array, v: Array, a: Array, free: Array | None = None) -> list[Array]:
    """dtau/dq, dtau/dv and M by Pinocchio, shape (nv, nv) each; ``free`` (nv_tree, nv) is what then moves the tree."""
    G = found.G if free is None else free
    pin.computeRNEADerivatives(found.tree, found.data, *found._state(q, v, a))
    M = np.triu(found.data.M) + np.triu(found.data.M, 1).T
    return [found.G.T @ x @ G for x in (found.data.dtau_dq, found.data.dtau_dv, M)]


def assert_moved(case: Case, motion: Motion, by: Array, free: Callable[[Reference], Array] | None = None) -> None:
    """Every joint in turn is off by ``by``, (3, N)."""
    found = case.reference()
    for joint in range(len(case.names)):
        ours = case.along(motion).torque_change_by_motion(joint, *by)
        for n, change in enumerate(by.T):
            state = motion.q[:, n], motion.v[:, n], motion.a[:, n]
            D = slopes(found, *state, None if free is None else free(found))
            expected = sum(D[k][:, joint] * change[k] for k in range(3))
            size = max(np.abs(d[:, joint] * x).max() for d, x in zip(D, change, strict=True))
            np.testing.assert_allclose(ours[:, n], expected, rtol=0, atol=5e-4 * size + 1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_a_change_of_motion_changes_the_torque_as_pinocchios_derivatives_say(robot_of: ReadRobot, seed: int) -> None:
    case = Case(robot_of, seed)
    rng = np.random.default_rng(seed)
    assert_moved(case, case.motion, rng.normal(size=(3, 5)))
    for kind in range(3):  # each by itself, the others exactly nothing
        by = np.zeros((3, 5))
        by[kind] = rng.normal(size=5)
        assert_moved(case, case.motion, by)


@pytest.mark.parametrize("seed", range(3))
def test_a_rotor_stays_with_its_motor(robot_of: ReadRobot, seed: int) -> None:
    """The same for Pinocchio's tree whose rotor is not moved by what moves the links."""
    case = Case(robot_of, seed, rotor=True)

    def links_alone(found: Reference) -> Array:
        G = found.G.copy()
        G[found.tree.joints[found.index["motor"]].idx_v] = 0
        return G

    by = np.random.default_rng(seed).normal(size=(3, 5))
    assert_moved(case, case.motion, by, links_alone)
    with_rotor = slopes(case.reference(), *(x[:, 0] for x in (case.motion.q, case.motion.v, case.motion.a)))[2]
    assert with_rotor[0, 0] < 100 * SPIN * RATIO**2  # it would be seen


def test_between_the_samples_that_it_looks_at_the_change_is_as_good(robot_of: ReadRobot) -> None:
    case = Case(robot_of, 3)
    dt, count = 1e-3, 61
    q, v, a = (x.T for x in sines(np.arange(count) * dt, len(case.names)))
    motion = sampled(q, v, a, dt)
    by = np.random.default_rng(2).normal(size=(3, count))
    ours = case.along(motion).torque_change_by_motion(0, *by)
    found = case.reference()
    expected = np.stack(
        [
            sum(d[:, 0] * x for d, x in zip(slopes(found, q[:, n], v[:, n], a[:, n]), by[:, n], strict=True))
            for n in range(count)
        ],
        axis=1,
    )
    np.testing.assert_allclose(ours, expected, rtol=0, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("rotor", [False, True])
def test_another_gravity_pulls_as_pinocchios(robot_of: ReadRobot, rotor: bool) -> None:
    case, change = Case(robot_of, 4, rotor), np.array([2.0, 0.5, -1.0])
    expected = case.torque(case.motion, gravity=(np.array(GRAVITY) + change).tolist()) - case.torque(case.motion)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(case.linearized.torque_change_by_gravity(change), expected, atol=1e-9)


def entry(effect: str, joint: str, **parameters: float) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, "joint": joint, "parameters": parameters}


def test_what_is_predicted_is_pinocchios_torque_and_the_effects(robot_of: ReadRobot) -> None:
    """Whatever was measured; as it was, not as a sensor with a gain gives it."""
    plain = Case(robot_of, 5)
    first, last = plain.names[0], plain.names[-1]
    assert first != last
    effects = [
        entry("parallel_spring", first, stiffness=7.0, rest_position=0.2),
        {"effect": "time_delay", "parameters": {"delay": 0.02}},
    ]
    friction = {first: {"viscous": 0.4, "coulomb": False}, last: {"viscous": False, "coulomb": 0.3}}
    plain.motion.v[-1] = np.abs(plain.motion.v[-1])  # a sign that changes from sample to sample is none
    case = Case(robot_of, 5, effects=effects, friction=friction)
    case.motion.v[-1] = plain.motion.v[-1]
    expected = plain.torque(case.motion)
    expected[0] += 7.0 * (case.motion.q[0] - 0.2) + 0.4 * case.motion.v[0]
    expected[-1] += 0.3
    np.testing.assert_allclose(case.linearized.predicted_torque, expected, atol=1e-9)
    again = case.along(replace(case.motion, tau=case.motion.tau + 5))
    np.testing.assert_allclose(again.predicted_torque, expected, atol=1e-9)
    late = case.linearized.true_motion.tau
    np.testing.assert_allclose(case.linearized.residual, late - expected, atol=1e-9)
    assert np.abs(late - case.motion.tau).max() > 0.1


ROTORS: dict[str, Mapping[str, Any]] = {
    "none": {},
    "a body": {"rotor": True},
    "an effect": {"effects": [{"effect": "rotor_inertia", "parameters": {"inertia": SPIN * RATIO**2}}]},
}


@pytest.mark.parametrize("how", ROTORS)
@pytest.mark.parametrize("seed", range(3))
def test_a_link_carries_what_pinocchio_says_of_the_tree_without_the_rotor(
    robot_of: ReadRobot, seed: int, how: str
) -> None:
    plain, config = Case(robot_of, seed), dict(ROTORS[how])
    if "effects" in config:
        config["effects"] = [{**config["effects"][0], "joint": plain.names[0]}]
    case = Case(robot_of, seed, **config)
    torque, inertia = case.linearized.link_load(case.motion, 0)
    np.testing.assert_allclose(torque, plain.torque(case.motion)[0], atol=1e-9)
    found, m = plain.reference(), case.motion
    M = [slopes(found, *state)[2][0, 0] for state in zip(m.q.T, m.v.T, m.a.T, strict=True)]
    np.testing.assert_allclose(inertia, M, rtol=1e-6)


@pytest.mark.parametrize(("factor", "is_rotors"), [(1.05, True), (0.5, False)])
def test_an_identified_rotor_inertia_counts_only_near_its_prior(
    robot_of: ReadRobot, factor: float, is_rotors: bool
) -> None:
    """What is identified far from it belongs to the link, from whose inertia the motion does not tell it."""
    case = Case(robot_of, 0, rotor=True)
    equation, motion = case.linearized.equation, case.motion
    theta = case.linearized.theta.copy()
    for i, coefficient in enumerate(equation.coefficients):
        if coefficient.owner == "motor" and coefficient.name.startswith("I"):
            theta[i] *= factor
    _, inertia = case.linearized.link_load(motion, 0)
    _, changed = LinearizedModel(equation, theta, motion).link_load(motion, 0)
    gained = 0.0 if is_rotors else (factor - 1) * SPIN * RATIO**2
    np.testing.assert_allclose(changed, inertia + gained, rtol=1e-6)


def test_dry_friction_is_the_part_of_the_friction_that_does_not_grow_with_velocity(robot_of: ReadRobot) -> None:
    names = Case(robot_of, 0).names
    viscous = {"effect": "viscous_friction", "joint": names[0], "parameters": {"viscous": 0.4}}
    coulomb = {"effect": "coulomb_friction", "joint": names[0], "parameters": {"coulomb": 0.7}}
    stribeck = {
        "effect": "stribeck_friction",
        "joint": names[0],
        "parameters": {"stribeck": 0.3, "velocity": 0.5},
    }
    case = Case(robot_of, 0, effects=[viscous, coulomb, stribeck])
    # Friction is averaged over a sample: the velocity changes slowly, and once its sign.
    v = np.linspace(-0.6, 0.6, 400)
    linearized = case.along(sampled(*np.tile([v, v, v], (len(names), 1, 1)).swapaxes(0, 1)))
    torque, level = linearized.dry_friction(0)
    expected = 0.7 + 0.3 * np.exp(-np.square(v / 0.5))
    np.testing.assert_allclose(level, expected, rtol=1e-3)
    np.testing.assert_allclose(torque, expected * np.sign(v), rtol=1e-3)
    np.testing.assert_allclose(linearized.friction_torque(0) - torque, 0.4 * v, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(linearized.dry_friction(1), 0)

"""The torque equation against Pinocchio's, on random trees with rotors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray
from reference import Reference
from robots import actuated, leg_urdf, random_rotors, random_urdf

from idtool.data.signals import Batch, LowPass, Motion
from idtool.dynamics.effects import Coefficient, Effect, RigidBodies, build_effects, rigid_body
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

TREES = range(24)


def moving(q: Array, v: Array, a: Array) -> Motion:
    """A motion without torque."""
    nothing = np.zeros_like(q)
    still = np.full(len(q), 1e-6)
    return Motion(
        t=np.arange(float(q.shape[1])), q=q, v=v, a=a, tau=nothing, logged_tau=nothing, velocity_deadband=still, dt=1.0
    )


def random_motion(rng: np.random.Generator, nv: int, count: int = 4) -> Motion:
    q, v, a = rng.normal(size=(3, nv, count))
    return moving(q, v, a)


def assert_equal(motion: Motion, model: RobotModel, reference: Reference) -> None:
    """Columns and torque at the prior against the reference, zeros where a column is left out included."""
    bodies = RigidBodies(model)
    linear = LinearModel(model.names, (bodies,))
    columns, torque = linear.columns(motion), linear.torque(motion, linear.prior)
    torque_of_bodies = bodies.torque(linear.prior, motion)
    for n in range(len(motion.t)):
        state = motion.q[:, n], motion.v[:, n], motion.a[:, n]
        Y = np.zeros((len(model.names), len(linear.coefficients)))
        for row, active, block in zip(Y, linear.active(), columns, strict=True):
            row[active] = block[:-1, n]
        expected = reference.regressor([body.name for body in model.bodies], *state)
        np.testing.assert_allclose(Y, expected, rtol=0, atol=1e-10 * max(1, np.abs(expected).max()))
        tau = reference.torque(*state)
        for predicted in (torque, torque_of_bodies):
            np.testing.assert_allclose(predicted[:, n], tau, rtol=0, atol=1e-10 * max(1, np.abs(tau).max()))


@pytest.mark.parametrize("seed", TREES)
def test_columns_and_torque_are_pinocchios(robot_of: ReadRobot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, size=8)
    robot = robot_of(text)
    config = {"gravity": (5 * rng.normal(size=3)).tolist()}
    model = build_model(robot, parse_config(config, ""), actuated(robot))
    assert_equal(random_motion(rng, len(model.names)), model, Reference(text, model.names, config))


def test_the_random_trees_hold_what_they_should(robot_of: ReadRobot) -> None:
    joints = [
        joint for seed in TREES for joint in robot_of(random_urdf(np.random.default_rng(seed), size=8)).joints.values()
    ]
    kinds = {(joint.kind, joint.mimic is not None) for joint in joints}
    assert kinds >= {(kind, follows) for kind in ("revolute", "continuous", "prismatic") for follows in (False, True)}
    assert ("fixed", False) in kinds


@pytest.mark.parametrize("seed", range(12))
def test_rotors_belts_and_differentials_are_pinocchios(robot_of: ReadRobot, seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    text = random_urdf(rng, size=7)
    robot = robot_of(text)
    config = {"gravity": [0, 0, -9.81], "rotors": random_rotors(rng, robot)}
    model = build_model(robot, parse_config(config, ""), actuated(robot))
    assert [body.name for body in model.bodies[-4:]] == ["geared", "belt", "left", "right"]
    assert_equal(random_motion(rng, len(model.names)), model, Reference(text, model.names, config))


def test_the_order_of_the_joints_is_the_configurations(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    text = leg_urdf(rng)
    order = ["knee", "tail", "abad", "hip"]
    config = {"gravity": [0, 0, -9.81], "joints": order}
    model = build_model(robot_of(text), parse_config(config, ""), ("abad", "hip", "knee", "tail"))
    assert_equal(random_motion(rng, 4), model, Reference(text, order, config))


def test_without_gravity_and_motion_there_is_no_torque(build: Callable[..., RobotModel], leg: str) -> None:
    model = build(leg, ("abad", "hip", "knee"), gravity=[0, 0, 0])
    linear = LinearModel(model.names, (RigidBodies(model),))
    q = np.random.default_rng(0).normal(size=(3, 5))
    for block in linear.columns(moving(q, 0 * q, 0 * q)):
        np.testing.assert_array_equal(block, np.zeros_like(block))


def test_at_rest_the_torque_is_the_slope_of_the_potential_energy(build: Callable[..., RobotModel], leg: str) -> None:
    """A joint's work over a small motion is the change of −Σ m g · c, the centres of mass from Pinocchio."""
    g = np.array([1.0, -2.0, 3.0])
    model = build(leg, ("abad", "hip", "knee"), gravity=g.tolist())
    linear = LinearModel(model.names, (RigidBodies(model),))
    tree = pin.buildModelFromXML(leg)
    data = tree.createData()
    order = [tree.joints[tree.getJointId(name)].idx_q for name in model.names]

    def potential(q: Array) -> float:
        full = pin.neutral(tree)
        full[order] = q
        return float(-pin.computeTotalMass(tree) * g @ pin.centerOfMass(tree, data, full))

    q, h = np.array([0.3, -0.4, 0.8]), 1e-5
    slope = [(potential(q + h * e) - potential(q - h * e)) / (2 * h) for e in np.eye(3)]
    rest = np.zeros((3, 1))
    torque = linear.torque(moving(q[:, None], rest, rest), linear.prior)
    np.testing.assert_allclose(torque[:, 0], slope, rtol=1e-6, atol=1e-7)


def test_friction_and_offset_add_to_the_joints_that_have_them(build: Callable[..., RobotModel], leg: str) -> None:
    """Terms that a joint lacks leave no column in its equation; values are the prior."""
    friction = {
        "abad": {"viscous": 0.5, "coulomb": 0.7, "offset": 0.2},
        "hip": {"viscous": False, "coulomb": False},
        "knee": {"viscous": False, "coulomb": 0.3},
    }
    model = build(leg, ("abad", "hip", "knee"), friction=friction)
    config = parse_config({"friction": friction}, "")
    bare, linear = (
        LinearModel(model.names, effects) for effects in ((RigidBodies(model),), build_effects(model, config))
    )
    sizes = [len(after) - len(before) for after, before in zip(linear.active(), bare.active(), strict=True)]
    assert sizes == [3, 0, 1]
    owners = [(c.owner, c.name, c.unit) for c in linear.coefficients[len(bare.coefficients) :]]
    assert set(owners) == {
        ("abad", "viscous", "N·m·s/rad"),
        ("abad", "coulomb", "N·m"),
        ("abad", "offset", "N·m"),
        ("knee", "coulomb", "N·m"),
    }
    motion = random_motion(np.random.default_rng(3), 3, count=1)
    added = (linear.torque(motion, linear.prior) - bare.torque(motion, bare.prior))[:, 0]
    v = motion.v[:, 0]
    np.testing.assert_allclose(added, [0.5 * v[0] + 0.7 * np.sign(v[0]) + 0.2, 0, 0.3 * np.sign(v[2])], atol=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_effects_that_depend_on_the_torque_take_each_other_at_their_fitted_coefficients(
    build: Callable[..., RobotModel], leg: str, order: int
) -> None:
    leak, share = 0.3, 0.2
    coupling = {"effect": "transmission_coupling", "joint": "hip", "parameters": {"source": "knee", "coefficient": 0}}
    friction = {"effect": "load_dependent_friction", "joint": "knee", "parameters": {"coefficient": 0}}
    no_friction = {"viscous": False, "coulomb": False}
    config = {"friction": no_friction, "effects": [coupling, friction][::order]}
    model = build(leg, ("hip", "knee"), **config)
    hip, knee = model.names.index("hip"), model.names.index("knee")
    equation = LinearModel(model.names, build_effects(model, parse_config(config, "")))
    fitted = {"transmission_coupling": leak, "load_dependent_friction": share}
    theta = np.array([fitted.get(c.effect, c.prior) for c in equation.coefficients])
    motion = random_motion(np.random.default_rng(0), len(model.names), 50)
    motion.v[knee] = 0.1 + np.abs(motion.v[knee])

    bodies = LinearModel(model.names, (RigidBodies(model),))
    rigid = bodies.torque(motion, bodies.prior)
    # What the motor gives, x, overcomes the load and its own share: x = load + share abs(x).
    driven = rigid[knee] / (1 - share * np.sign(rigid[knee]))

    predicted = equation.linearized_at(theta).torque(motion, theta)
    np.testing.assert_allclose(predicted[knee], driven, rtol=1e-9)
    np.testing.assert_allclose(predicted[hip], rigid[hip] - leak * driven, rtol=1e-9)


class Nothing(Effect):
    """An effect without coefficients, that cannot know the first joint's columns at some samples."""

    coefficients: tuple[Coefficient, ...] = ()

    def __init__(self, nv: int, unknown: slice = slice(0)) -> None:
        self.active = (np.zeros(0, dtype=np.intp),) * nv
        self.unknown = unknown

    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        assert all(rows.shape == (0, len(motion.t)) for rows in out)

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        assert theta.shape == (0,)

    def invalid_mask(self, motion: Motion) -> dict[int, NDArray[np.bool_]]:
        mask = np.zeros(len(motion.t), dtype=bool)
        mask[self.unknown] = True
        return {0: mask}


def test_an_effect_without_coefficients_changes_nothing(build: Callable[..., RobotModel], leg: str) -> None:
    model = build(leg, ("abad", "hip", "knee"))
    bodies, motion = RigidBodies(model), random_motion(np.random.default_rng(4), 3)
    plain = LinearModel(model.names, (bodies,))
    for effects in ((Nothing(3), bodies), (bodies, Nothing(3))):
        linear = LinearModel(model.names, effects)
        np.testing.assert_array_equal(linear.prior, plain.prior)
        for ours, expected in zip(linear.columns(motion), plain.columns(motion), strict=True):
            np.testing.assert_array_equal(ours, expected)


def test_samples_of_a_resting_joint_are_left_out_of_its_block_only(build: Callable[..., RobotModel], leg: str) -> None:
    model = build(leg, ("abad", "hip", "knee"), friction={"hip": {"coulomb": False}})
    config = parse_config({"friction": {"hip": {"coulomb": False}}}, "")
    linear = LinearModel(model.names, build_effects(model, config))
    count, low_pass = 1000, LowPass(cutoff=20, order=2, dt=0.001)
    motion = random_motion(np.random.default_rng(6), 3, count)
    motion.v[:] = np.abs(motion.v) + 0.1
    motion.v[:2, 400:600] = 0  # abad and hip rest; the hip's equation does not need the sign
    motion.tau[:] = np.random.default_rng(7).normal(size=(3, count))
    batch = Batch(motion, 0, 0, low_pass)
    abad, hip, knee = linear.block(batch)
    whole = [batch.filter(columns) for columns in linear.columns(motion)]
    np.testing.assert_array_equal(hip, whole[1])
    np.testing.assert_array_equal(knee, whole[2])
    kept = [n for n in range(count) if (whole[0][:, n, None] == abad).all(axis=0).any()]
    assert set(range(400, 600)).isdisjoint(kept)
    assert set(range(400 - low_pass.reach)) | set(range(600 + low_pass.reach, count)) <= set(kept)
    np.testing.assert_array_equal(abad, whole[0][:, kept])


def test_effects_that_know_their_columns_at_different_times_leave_half_of_the_samples(
    build: Callable[..., RobotModel], leg: str
) -> None:
    """Where one is defined, the other is not: a velocity turns round as the torque of a spring is largest."""

    class Wave(Nothing):
        def invalid_mask(self, motion: Motion) -> dict[int, NDArray[np.bool_]]:
            return {0: (np.arange(len(motion.t)) - self.unknown.start) % 100 < 10}

    model, low_pass = build(leg, ("abad", "hip", "knee")), LowPass(cutoff=10, order=4, dt=0.001)
    waves = [Wave(3, slice(start, None)) for start in (0, 50)]
    motion = random_motion(np.random.default_rng(8), 3, 4000)
    batch = Batch(motion, low_pass.reach, low_pass.reach, low_pass)
    first, second, both = (
        LinearModel(model.names, effects).clean_samples(batch)[0]
        for effects in ((waves[0],), (waves[1],), tuple(waves))
    )
    np.testing.assert_allclose([first.mean(), second.mean()], 0.5, atol=0.02)
    assert (first & second).mean() < 0.1
    assert both.mean() >= 0.5


def test_what_any_effect_cannot_know_is_left_out(build: Callable[..., RobotModel], leg: str) -> None:
    model = build(leg, ("abad", "hip", "knee"))
    unknown = slice(100, 200), slice(700, 800)
    linear = LinearModel(model.names, (RigidBodies(model), *(Nothing(3, part) for part in unknown)))
    batch = Batch(random_motion(np.random.default_rng(8), 3, 1000), 0, 0, LowPass(cutoff=200, order=1, dt=0.001))
    abad, hip, _ = linear.block(batch)
    clear = np.ones(1000, dtype=bool)
    for part in unknown:
        clear[part] = False
    least = int(clear.sum()) - 4 * batch.low_pass.reach
    assert hip.shape[1] == 1000
    assert least <= abad.shape[1] <= clear.sum()
    whole = batch.filter(linear.columns(batch.motion)[0])
    kept = {tuple(column) for column in abad.T}
    assert kept.isdisjoint({tuple(column) for column in whole[:, ~clear].T})


@pytest.mark.parametrize("buffer", [1, 1 << 18])
@pytest.mark.parametrize("seed", range(4))
def test_filtered_columns_are_the_columns_filtered(
    robot_of: ReadRobot, monkeypatch: pytest.MonkeyPatch, seed: int, buffer: int
) -> None:
    """Body by body, and of each a few joints at once or all."""
    monkeypatch.setattr(rigid_body, "_BUFFER", buffer)
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=6))
    config = parse_config({"rotors": random_rotors(rng, robot)}, "")
    bodies = RigidBodies(build_model(robot, config, actuated(robot)))
    motion = random_motion(rng, len(bodies.active), count=9)

    def low_pass(x: Array) -> Array:
        return x[..., ::2] + x[..., :1]

    unfiltered = [np.full((len(active), 9), np.nan) for active in bodies.active]
    bodies.columns(motion, unfiltered)
    filtered = [np.full((len(active), 5), np.nan) for active in bodies.active]
    bodies.filtered_columns(motion, low_pass, filtered)
    for own, expected in zip(filtered, unfiltered, strict=True):
        np.testing.assert_array_equal(own, low_pass(expected))

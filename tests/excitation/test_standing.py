"""Motions of robots whose feet stay on the ground: kinematics, forces and gradients, by Pinocchio and by theorems."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ground.humanoid import true_humanoid
from ground.logs import config_text
from ground.quadruped import FEET, FOOT_RADIUS, JOINTS, true_quadruped
from ground.robot import Array, urdf_text
from standing_quadruped import PinocchioQuadruped, quadruped_model

from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.safe_yaml import parse_yaml
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import equality_constraints
from idtool.excitation.patterns import Fourier, PatternSpec
from idtool.excitation.standing.kinematics import BASE_MOTION
from idtool.excitation.standing.objective import StandingObjective
from idtool.excitation.standing.task import StandingOptions, StandingTask, make_standing_task
from idtool.robot.config import parse_config
from idtool.robot.config.config import Config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import read_robot

QUADRUPED = true_quadruped(0)
HUMANOID = true_humanoid(0)
SIZE = np.array([0.02, 0.02, 0.03, 0.1, 0.1, 0.15])  # m and rad, of the base's motion


def task_of(model: RobotModel, config: Config, **options: Any) -> StandingTask:
    contacts = ContactModel(model, config.contacts, np.ones(len(model.names)))
    equation = LinearModel(model.names, build_effects(model, config), contacts=contacts)
    standing: dict[str, Any] = {"feet": (), "friction_coefficient": 0.6, "sole_size": (0.18, 0.09), "start": {}}
    return make_standing_task(
        model,
        equation,
        equality_constraints(config, model, equation),
        config,
        StandingOptions(**{**standing, **options}),
        None,
        rate=500.0,
        margin=0.1,
        clearance=0.01,
        criterion="d",
        favour=(),
        noise={},
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("standing")


@pytest.fixture(scope="module")
def quadruped(folder: Path) -> StandingTask:
    """Without rotors and friction."""
    return task_of(*quadruped_model(folder, QUADRUPED, friction={"viscous": False, "coulomb": False}))


@pytest.fixture(scope="module")
def humanoid(folder: Path) -> StandingTask:
    path = folder / "humanoid.urdf"
    path.write_text(urdf_text(HUMANOID))
    content = parse_yaml(path, config_text(HUMANOID).encode())
    config = parse_config({**content, "rotors": {}}, "")
    return task_of(build_model(read_robot(path), config, HUMANOID.joints), config)


def swaying(task: StandingTask, t: Array) -> tuple[Array, Array, Array]:
    """Sines of the independent coordinates, with both derivatives."""
    d = len(task.kinematics.coordinates)
    rng = np.random.default_rng(0)
    w, phase = rng.uniform(1, 5, (d, 1)), rng.uniform(0, 6, (d, 1))
    size = np.concatenate([SIZE, np.full(d - 6, 0.1)])[:, None]
    u = task.kinematics.home[:, None] + size * np.sin(w * t + phase)
    return u, size * w * np.cos(w * t + phase), -size * w**2 * np.sin(w * t + phase)


@pytest.mark.parametrize("robot", ["quadruped", "humanoid"])
def test_derivatives_are_those_of_the_motion(robot: str, request: pytest.FixtureRequest) -> None:
    task = request.getfixturevalue(robot)
    t = np.linspace(0, 0.2, 401)
    dt = t[1]
    samples = task.kinematics.samples(*swaying(task, t))
    assert samples.is_reached.all()
    np.testing.assert_allclose(np.gradient(samples.w, dt, axis=1)[:, 2:-2], samples.dw[:, 2:-2], atol=2e-5)
    np.testing.assert_allclose(np.gradient(samples.dw, dt, axis=1)[:, 2:-2], samples.ddw[:, 2:-2], atol=2e-4)
    base = task.model.base_coordinates
    to_world = samples.base_to_world
    turn = np.einsum("nij,jn->in", to_world, samples.motion.v[base][3:])
    expected = np.einsum("nji,jn->in", to_world, np.gradient(turn, dt, axis=1))
    np.testing.assert_allclose(samples.motion.a[base][3:, 2:-2], expected[:, 2:-2], atol=2e-4)


@pytest.mark.parametrize("robot", ["quadruped", "humanoid"])
def test_tangents_are_derivatives_by_the_coordinates(robot: str, request: pytest.FixtureRequest) -> None:
    task = request.getfixturevalue(robot)
    u, du, ddu = swaying(task, np.linspace(0, 2, 15))
    tangents = task.kinematics.tangents(task.kinematics.samples(u, du, ddu))
    step = 1e-5
    for k in (0, 2, 4, len(u) - 1):
        moved = np.zeros_like(u)
        moved[k] = step
        after, before = task.kinematics.samples(u + moved, du, ddu), task.kinematics.samples(u - moved, du, ddu)
        faster, slower = task.kinematics.samples(u, du + moved, ddu), task.kinematics.samples(u, du - moved, ddu)
        for signal, tangent in (("w", tangents.first), ("dw", tangents.rate), ("ddw", tangents.second)):
            difference = (getattr(after, signal) - getattr(before, signal)) / (2 * step)
            np.testing.assert_allclose(tangent[:, :, k].T, difference, atol=1e-4)
        np.testing.assert_allclose(2 * tangents.rate[:, :, k].T, (faster.ddw - slower.ddw) / (2 * step), atol=1e-4)


def test_feet_stay_and_balls_roll_in_pinocchio(quadruped: StandingTask, folder: Path) -> None:
    """The lowest point of every ball stands still, but for half the product of its turn and its angular velocity."""
    model = pin.buildModelFromUrdf(str(folder / "quadruped.urdf"), pin.JointModelFreeFlyer())
    data = model.createData()
    joints = [model.joints[model.getJointId(name)] for name in JOINTS]
    stance = pin.neutral(model)
    stance[[joint.idx_q for joint in joints]] = quadruped.kinematics.stance.q
    pin.framesForwardKinematics(model, data, stance)
    upright = {foot: data.oMf[model.getFrameId(foot)].rotation.copy() for foot in FEET}
    samples = quadruped.kinematics.samples(*swaying(quadruped, np.linspace(0, 3, 30)))
    for k in range(30):
        q, v = pin.neutral(model), np.zeros(model.nv)
        q[:3] = samples.w[12:15, k]
        q[3:7] = pin.Quaternion(samples.base_to_world[k]).coeffs()
        q[[joint.idx_q for joint in joints]] = samples.w[:12, k]
        v[[joint.idx_v for joint in joints]] = samples.dw[:12, k]
        v[:3] = samples.base_to_world[k].T @ samples.dw[12:15, k]
        v[3:6] = samples.motion.v[15:18, k]
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacements(model, data)
        for foot in FEET:
            frame = model.getFrameId(foot)
            velocity = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            at_lowest = velocity.linear + np.cross(velocity.angular, [0, 0, -FOOT_RADIUS])
            turn = np.linalg.norm(pin.log3(data.oMf[frame].rotation @ upright[foot].T))
            assert np.linalg.norm(at_lowest) < 0.55 * FOOT_RADIUS * turn * np.linalg.norm(velocity.angular) + 1e-9
            assert abs(velocity.linear[2]) < 1e-9


def test_soles_stay_and_stand_flat(humanoid: StandingTask) -> None:
    samples = humanoid.kinematics.samples(*swaying(humanoid, np.linspace(0, 3, 20)))
    assert samples.is_reached.all()
    assert humanoid.kinematics.foot_displacements(samples.w).max() < 1e-9
    jacobian = humanoid.kinematics.foot_jacobian(samples.w)
    velocity = samples.motion.v.copy()
    linear = samples.dw[humanoid.model.joint_count :][:3]
    velocity[humanoid.model.base_coordinates][:3] = np.einsum("nji,jn->in", samples.base_to_world, linear)
    assert np.abs(np.einsum("nkj,jn->nk", jacobian, velocity)).max() < 1e-9
    assert set(humanoid.kinematics.coordinates) == set(BASE_MOTION) | set(HUMANOID.joints[12:])  # all but the legs


def test_torques_and_ground_forces_hold_the_motion_in_pinocchio(quadruped: StandingTask, folder: Path) -> None:
    t = np.linspace(0, 3, 12)
    samples = quadruped.kinematics.samples(*swaying(quadruped, t))
    motion = quadruped.standing_motion(samples, t, np.ones(18))
    required = quadruped.equation.torque(motion, quadruped.theta)
    jacobian = quadruped.kinematics.foot_jacobian(samples.w)
    F, torque = quadruped.robot.forces.distribute(jacobian, required)
    reference = PinocchioQuadruped(folder / "quadruped.urdf")
    for k in range(len(t)):
        generalized = np.zeros(18)
        generalized[:12] = torque[:, k]
        for i, foot in enumerate(FEET):
            J = reference.contact_jacobian(motion, k, foot, FOOT_RADIUS)
            generalized += J[:3].T @ F[3 * i : 3 * i + 3, k]
        np.testing.assert_allclose(generalized, reference.torque(motion, k), atol=1e-8)
    weight = 9.81 * quadruped.model.mass
    vertical = F[2::3].sum(axis=0)
    np.testing.assert_allclose(vertical.mean(), weight, rtol=0.1)


def test_no_other_forces_take_less_energy_of_the_controllers(quadruped: StandingTask) -> None:
    t = np.linspace(0, 3, 6)
    samples = quadruped.kinematics.samples(*swaying(quadruped, t))
    required = quadruped.equation.torque(quadruped.standing_motion(samples, t, np.ones(18)), quadruped.theta)
    jacobian = quadruped.kinematics.foot_jacobian(samples.w)
    _, torque = quadruped.robot.forces.distribute(jacobian, required)
    rng = np.random.default_rng(1)
    for k in range(len(t)):
        internal = np.linalg.svd(jacobian[k][:, 12:].T)[2][6:]  # forces that leave the base alone
        for _ in range(20):
            change = -jacobian[k][:, :12].T @ (internal.T @ rng.normal(size=6))
            assert np.square(torque[:, k] + change).sum() > np.square(torque[:, k]).sum()


def test_gradient_is_that_of_the_objective(quadruped: StandingTask) -> None:
    limits = quadruped.coordinate_limits
    pattern = Fourier(PatternSpec(quadruped.model, limits, quadruped.kinematics.home, 3.0, 1.0))
    size = len(quadruped.base)
    objective = StandingObjective(quadruped, pattern, np.zeros((size, size)), 1, 8.0)
    objective.penalty_weight = 10.0
    rng = np.random.default_rng(0)
    x = 0.8 * pattern.draw(rng)
    direction = rng.normal(size=len(x)) / np.sqrt(len(x))
    value, gradient = objective(x)
    step = 1e-4
    slope = (objective(x + step * direction)[0] - objective(x - step * direction)[0]) / (2 * step)
    assert np.isfinite(value)
    assert gradient @ direction == pytest.approx(slope, rel=1e-2)


def test_stances_are_found_with_level_feet_below_the_hips(quadruped: StandingTask, humanoid: StandingTask) -> None:
    for task, crouch in ((quadruped, 0.75), (humanoid, 0.4)):
        poses = task.kinematics.feet.poses(task.kinematics.stance.q[:, None])
        assert np.ptp([pose.p[0, 2] for pose in poses]) < 1e-5
        assert np.abs(task.kinematics.stance.q).max() > crouch
    for pose in humanoid.kinematics.feet.poses(humanoid.kinematics.stance.q[:, None]):
        np.testing.assert_allclose(pose.R[0], np.eye(3), atol=1e-5)


def test_given_stance_is_taken_and_levelled(folder: Path) -> None:
    model, config = quadruped_model(folder, QUADRUPED)
    low = {}
    for leg in ("FL", "FR"):
        low |= {f"{leg}_hip_joint": 0.0, f"{leg}_thigh_joint": 0.9, f"{leg}_calf_joint": -1.8}
    for leg in ("RL", "RR"):
        low |= {f"{leg}_hip_joint": 0.0, f"{leg}_thigh_joint": 0.75, f"{leg}_calf_joint": -1.5}
    task = task_of(model, config, start=low)
    pitch = np.arcsin(-task.kinematics.stance.R[2, 0])
    assert pitch == pytest.approx(np.arctan2(0.42 * (np.cos(0.75) - np.cos(0.9)), 0.38), rel=0.02)
    uneven = {**low, "RR_calf_joint": -1.0}
    with pytest.raises(ConfigError, match="above and below one plane"):
        task_of(model, config, start=uneven)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"feet": ("FL",)}, "FL is not a contact .* FL_foot"),
        ({"feet": ("FL_foot", "FR_foot")}, "at least three points"),
        ({"start": {"FL_knee": 0.1}}, "FL_knee is not a moving joint"),
        ({"friction_coefficient": 0.1}, "no posture was found"),
    ],
)
def test_what_cannot_stand_is_refused(folder: Path, options: dict[str, Any], message: str) -> None:
    model, config = quadruped_model(folder, QUADRUPED)
    with pytest.raises((ConfigError, ModelError), match=message):
        task_of(model, config, **options)


def test_soles_without_geometry_need_a_size(folder: Path) -> None:
    path = folder / "humanoid.urdf"
    content = parse_yaml(path, config_text(HUMANOID).encode())
    config = parse_config({**content, "rotors": {}}, "")
    with pytest.raises(ConfigError, match="give --sole-size LENGTH WIDTH"):
        task_of(build_model(read_robot(path), config, HUMANOID.joints), config, sole_size=None)

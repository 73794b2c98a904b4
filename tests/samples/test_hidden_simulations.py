"""Kinds of friction, of noise, of motors and of pushes that the hidden-effect benchmark simulates."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
from hidden_effects.case_files import write_case
from hidden_effects.case_list import COMBINATIONS, Case, list_cases
from hidden_effects.effects import HiddenEffect, apply_effects
from hidden_effects.friction import FRICTION_KINDS, FreeStep, Friction, MujocoFrictionLoss, draw_friction, friction_law
from hidden_effects.logs import NOISE_KINDS, Sensors, noisy_torque, record
from hidden_effects.motion import draw_motion, nominal_torque
from hidden_effects.plant import AddedPhysics, Contact, MujocoTree, Plant
from hidden_effects.robots import LEG3, PLANAR2, ROBOTS, Robot, draw_truth, urdf_text
from numpy.typing import NDArray

Array = NDArray[np.float64]

WEIGHTLESS = AddedPhysics(gravity=(0.0, 0.0, 0.0))
DT = 1e-4


def one_mass(friction: Friction, level: float, inertia: float = 1.0) -> Any:
    """Function from a velocity and a torque to the velocity after a step, of one mass with friction."""
    M = np.array([[inertia]])
    law = friction_law(friction, np.array([level]), 1 / np.diag(M), DT)

    def velocity_after(v: float, torque: float) -> float:
        free = FreeStep(M, 1 / M, np.array([v]), np.array([v + DT * torque / inertia]), DT)
        return float(law.velocity_after(free, np.array([level]))[0])

    return velocity_after


@pytest.mark.parametrize("kind", FRICTION_KINDS)
def test_every_friction_is_coulombs_in_steady_motion(kind: str) -> None:
    for v in (0.5, -0.5):
        velocity_after = one_mass(draw_friction(kind, 0), 2.0)
        for _ in range(200):  # 0.01 rad, many displacements of a bristle
            resisting = -(velocity_after(v, 0.0) - v) / DT
        assert resisting == pytest.approx(2.0 * np.sign(v), rel=1e-6)


@pytest.mark.parametrize("v", [-0.03, -0.004, 0.0, 0.01])
def test_rounded_friction_is_a_hyperbolic_tangent(v: float) -> None:
    velocity_after = one_mass(Friction("tanh", width=0.008), 2.0)
    assert (v - velocity_after(v, 0.0)) / DT == pytest.approx(2.0 * np.tanh(v / 0.008), abs=1e-9)


def test_bristles_hold_like_a_spring_with_a_damper() -> None:
    """Below the level, the mass comes to rest near torque / stiffness, and oscillates before that at its frequency."""
    friction = Friction("lugre", displacement=5e-4, damping_ratio=0.1)
    velocity_after, v, q, motion = one_mass(friction, 2.0), 0.0, 0.0, []
    for _ in range(20_000):
        v = velocity_after(v, 0.004)
        q += DT * v
        motion.append(v)
    assert q == pytest.approx(0.004 / (2.0 / 5e-4), rel=0.05)
    crossings = np.flatnonzero(np.diff(np.sign(motion[:5000])))
    half_period = DT * np.mean(np.diff(crossings))
    assert np.pi / half_period == pytest.approx(np.sqrt(2.0 / 5e-4 * (1 - 0.1**2)), rel=0.03)


@pytest.mark.parametrize("kind", FRICTION_KINDS)
def test_a_joint_rests_below_the_level_and_moves_above_it(kind: str) -> None:
    """The smooth laws creep, but no faster than they are wide."""
    truth = draw_truth(PLANAR2, 0)
    rest = MujocoTree(PLANAR2, truth, AddedPhysics()).mass_matrix_and_bias(np.zeros(2), np.zeros(2))[1]
    speeds = []
    for share in (0.9, 1.3):
        plant = Plant(PLANAR2, truth, AddedPhysics(), DT, np.zeros(2), np.zeros(2), draw_friction(kind, 0))
        for _ in range(2000):
            plant.step(rest + np.array([0.0, share * truth.coulomb[1]]))
        speeds.append(plant.v[1])
    assert abs(speeds[0]) < 0.04
    assert speeds[1] > 0.15


def test_frictionloss_is_that_of_a_whole_mujoco_model(rng: np.random.Generator) -> None:
    """Without rotors, but with armature, the robot can be simulated by MuJoCo alone."""
    spec = mujoco.MjSpec.from_string(urdf_text(LEG3))
    spec.option.timestep = DT
    spec.option.tolerance = 1e-10
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_LIMIT
    for joint, level in zip(spec.joints, (0.3, 0.2, 0.4), strict=True):
        joint.armature = 0.02
        joint.frictionloss = level
    model = spec.compile()
    data = mujoco.MjData(model)
    law = MujocoFrictionLoss(model.dof_invweight0, DT)
    M = np.zeros((3, 3))
    for v_scale in (1e-3, 0.02, 1.0):
        for q, v, tau in rng.normal(size=(5, 3, 3)):
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v_scale * v, tau
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, M)
            free = FreeStep(M, np.linalg.inv(M), data.qvel.copy(), data.qvel + DT * data.qacc_smooth, DT)
            after = law.velocity_after(free, model.dof_frictionloss)
            np.testing.assert_allclose((after - free.v) / DT, data.qacc, rtol=1e-6, atol=1e-5)
            assert np.abs(data.qacc - data.qacc_smooth).max() > 0.1


@pytest.mark.parametrize("kind", FRICTION_KINDS)
def test_friction_takes_energy(kind: str) -> None:
    """Without gravity and motors, the kinetic energy decreases, apart from what the bristles give back."""
    truth = draw_truth(LEG3, 2)
    friction = draw_friction(kind, 2)
    plant = Plant(LEG3, truth, WEIGHTLESS, DT, np.array([0.1, 0.5, -1.2]), np.array([2.0, -3.0, 4.0]), friction)
    tree = MujocoTree(LEG3, truth, WEIGHTLESS)
    energies = []
    for _ in range(8000):
        M, _ = tree.mass_matrix_and_bias(plant.x, plant.v)
        energies.append(plant.v @ M @ plant.v / 2)
        plant.step(np.zeros(3))
    in_bristles = np.sum(truth.coulomb) * friction.displacement if kind == "lugre" else 0.0
    assert np.diff(energies).max() < 1e-6 * energies[0] + in_bristles
    assert energies[-1] < 1e-3 * energies[0]


def noise_of(kind: str, samples: int = 200_000) -> tuple[Array, Array]:
    """Noise of unit size on a torque, shape (N, 1), and its reported size."""
    rng = np.random.default_rng(3)
    tau = np.sqrt(2) * np.sin(np.arange(samples)[:, None] * np.pi / 71)
    noisy, size = noisy_torque(tau, Sensors(noise=kind, torque_noise=1.0), rng)
    return noisy - tau, size


def power_density(x: Array, frequency: float) -> float:
    """Mean power density of a signal at 1 kHz, between 0.8 and 1.25 times a frequency."""
    frequencies = np.fft.rfftfreq(len(x), 1e-3)
    power = 2e-3 * np.abs(np.fft.rfft(x)) ** 2 / len(x)
    return float(np.mean(power[(frequencies > 0.8 * frequency) & (frequencies < 1.25 * frequency)]))


def test_noise_has_its_size_and_spectrum() -> None:
    white, size = noise_of("white")
    assert np.std(white) == pytest.approx(1.0, rel=0.02)
    assert size == pytest.approx(1.0, rel=1e-4)
    assert power_density(white[:, 0], 1.0) == pytest.approx(power_density(white[:, 0], 200.0), rel=0.2)
    coloured, size = noise_of("coloured")
    assert np.std(coloured) == pytest.approx(1.0, rel=0.05)
    assert size == pytest.approx(1.0, rel=1e-4)
    correlation = np.array([np.mean(coloured[lag:, 0] * coloured[: len(coloured) - lag, 0]) for lag in (20, 80)])
    assert correlation[0] > np.exp(-1) - 0.05  # the correlation times are 20 to 80 ms
    assert correlation[1] < np.exp(-1) + 0.05
    assert power_density(coloured[:, 0], 20.0) > 30 * power_density(coloured[:, 0], 200.0)


def test_a_coarse_torque_has_few_values_and_none_has_no_noise() -> None:
    error, size = noise_of("quantised")
    quantum = 0.005 * np.sqrt(2)
    assert np.abs(error).max() <= quantum / 2 * (1 + 1e-9)
    assert size == pytest.approx(quantum / np.sqrt(12), rel=1e-3)
    assert np.std(error) == pytest.approx(float(size[0]), rel=0.15)
    error, size = noise_of("none")
    assert not error.any()
    assert not size.any()


def test_clean_cases_have_all_combinations_by_turns() -> None:
    cases = list_cases("clean", ["planar2"], seeds=range(16))
    assert {(case.friction, case.sensors.noise) for case in cases} == set(COMBINATIONS)
    assert len(COMBINATIONS) == len(FRICTION_KINDS) * len(NOISE_KINDS) == 16
    for case in cases:
        assert f"_{case.friction}_{case.sensors.noise}_" in case.name


def test_options_force_a_friction_and_a_noise() -> None:
    for kind in ("clean", "single"):
        cases = list_cases(kind, ["leg3"], ["strong"], range(5), friction="lugre", noise="none")
        assert {(case.friction, case.sensors.noise) for case in cases} == {("lugre", "none")}
        assert all("_lugre_none_" in case.name for case in cases)
    usual = list_cases("single", ["leg3"], ["strong"], [1])
    assert list_cases("single", ["leg3"], ["strong"], [1], friction="sign", noise="white") == usual


@pytest.mark.parametrize("seed", range(4))
def test_a_clean_case_can_be_written_with_every_friction(seed: int, tmp_path: Path) -> None:
    (case,) = list_cases("clean", ["planar2"], seeds=[seed], seconds=1.0)
    files = write_case(case, tmp_path)
    truth = json.loads(files.truth.read_text())
    assert truth["friction"]["kind"] == case.friction == FRICTION_KINDS[seed]
    table = np.loadtxt(files.log, delimiter=",", skiprows=1)
    assert len(table) == 1000
    assert np.isfinite(table).all()


@pytest.mark.parametrize("kind", FRICTION_KINDS[1:])
def test_other_frictions_move_a_robot_like_coulombs(kind: str) -> None:
    """They differ where a joint hardly moves, but not in the torque of usual motion."""
    truth, motion = draw_truth(PLANAR2, 2), draw_motion(PLANAR2, 2, 2.0)
    logs = []
    for friction in (Friction("sign"), draw_friction(kind, 2)):
        logs.append(record(PLANAR2, truth, (), motion, Sensors(noise="none"), 2, friction))
    moving = (np.abs(motion.v.T) > 0.3)[200:]
    difference = (logs[1].tau - logs[0].tau)[200:]
    for j in range(2):
        assert np.median(np.abs(difference[moving[:, j], j])) < 0.05 * truth.coulomb[j]
        assert np.abs(difference[:, j]).max() > 1e-4


@pytest.mark.parametrize(
    ("form", "parameters"), [("motor_clip", {"level": 5.0}), ("motor_tanh", {"level": 4.0, "span": 2.0})]
)
def test_a_motor_gives_less_than_its_command(form: str, parameters: dict[str, float]) -> None:
    effect = HiddenEffect("torque_saturation", "elbow", parameters={"form": form, **parameters})
    _, physics, errors = apply_effects(PLANAR2, draw_truth(PLANAR2, 0), (effect,))
    commanded = np.linspace(-30, 30, 601)
    true = np.array([physics.motor_torque(np.array([30.0, tau])) for tau in commanded])
    assert (true[:, 0] == 30.0).all()
    small = np.abs(commanded) <= parameters["level"]
    np.testing.assert_allclose(true[small, 1], commanded[small])
    limit = parameters["level"] + parameters.get("span", 0.0)
    assert np.abs(true[:, 1]).max() == pytest.approx(limit, rel=1e-6)
    assert (np.diff(true[:, 1]) >= 0).all()
    np.testing.assert_allclose(true, -true[::-1] + [60.0, 0.0])
    assert not errors.torque_maps  # the log has the command


def test_a_saturated_motor_is_logged_as_commanded() -> None:
    truth, motion = draw_truth(PLANAR2, 1), draw_motion(PLANAR2, 1, 3.0)
    level = 0.85 * np.abs(nominal_torque(PLANAR2, motion)[1]).max()
    effect = HiddenEffect("torque_saturation", "elbow", parameters={"form": "motor_clip", "level": level})
    log = record(PLANAR2, truth, (effect,), motion, Sensors(noise="none"), 1)
    assert np.abs(log.tau[:, 1]).max() > 1.02 * level


def test_motors_are_strong_enough_to_keep_their_command(tmp_path: Path) -> None:
    parameters = {"form": "motor_clip", "level": 2.8, "command_limit": 30.0}
    effect = HiddenEffect("torque_saturation", "elbow", parameters=parameters)
    files = write_case(Case("weak", "planar2", (effect,), 1, seconds=3.0), tmp_path)
    (hidden,) = json.loads(files.truth.read_text())["hidden"]
    strengthening = np.log(hidden["parameters"]["level"] / 2.8) / np.log(1.05)
    assert strengthening == pytest.approx(round(strengthening), abs=1e-6)
    assert strengthening > 0.5
    assert hidden["parameters"]["command_limit"] == 30.0
    tau = np.loadtxt(files.log, delimiter=",", skiprows=1)[:, -1]
    assert np.abs(tau).max() > hidden["parameters"]["level"]


def test_a_force_off_the_origin_acts_by_its_jacobian() -> None:
    """By virtual work: the torque is the derivative of force · position by the joints' positions."""
    truth = draw_truth(LEG3, 0)
    tree = MujocoTree(LEG3, truth, AddedPhysics())
    force, point = np.array([3.0, -2.0, 5.0]), np.array([0.03, -0.02, -0.15])
    contact = Contact("shank", [[0.0, 1.0]], np.concatenate([force, np.zeros(3)]), point=point.tolist())
    q = np.array([0.2, 0.7, -1.3])

    def work(q: Array) -> float:
        tree.mass_matrix_and_bias(q, np.zeros(3))
        body = tree.model.body("shank").id
        return float(force @ (tree.data.xpos[body] + tree.data.xmat[body].reshape(3, 3) @ point))

    steps = 1e-6 * np.eye(3)
    derivative = [(work(q + step) - work(q - step)) / 2e-6 for step in steps]
    work(q)
    np.testing.assert_allclose(tree.contact_torque(contact, 1.0), derivative, rtol=1e-6)


def test_pushes_rise_and_fall() -> None:
    wrench = np.ones(6)
    half_sine = Contact("shank", [[1.0, 1.4]], wrench, is_half_sine=True)
    shares = [half_sine.acting_share(t) for t in (0.9, 1.1, 1.2, 1.3, 1.5)]
    np.testing.assert_allclose(shares, [0, np.sqrt(0.5), 1, np.sqrt(0.5), 0], atol=1e-12)
    trapezoid = Contact("shank", [[1.0, 2.0]], wrench, rise_time=0.2)
    shares = [trapezoid.acting_share(t) for t in (0.89, 1.0, 1.11, 1.89, 2.0, 2.11)]
    np.testing.assert_allclose(shares, [0, 0.5, 1, 1, 0.5, 0], atol=1e-12)


def test_variants_have_the_effects_that_an_engineer_expects() -> None:
    cases = list_cases("variants")
    assert {effect.effect for case in cases for effect in case.hidden} == {
        "torque_saturation",
        "external_contact",
        "transmission_coupling",
        "presliding_hysteresis",
        "joint_elasticity",
        "load_dependent_friction",
    }
    for case in cases:
        places = [effect.location for effect in case.hidden]
        robot = ROBOTS[case.robot]
        assert set(places) <= {*robot.names, *robot.links}
        if len(places) == 2:
            assert robot.index(places[1]) == robot.index(places[0]) + 1
        assert (case.logs > 1) == (case.hidden[0].effect == "torque_saturation")


@pytest.mark.parametrize("robot", [LEG3, PLANAR2], ids=lambda robot: robot.name)
def test_a_faster_motion_has_more_speed_and_torque(robot: Robot) -> None:
    usual, faster = (draw_motion(robot, 1, 15.0, relative_pace=pace) for pace in (1.0, 1.2))
    assert len(faster.t) == round(len(usual.t) / 1.2)
    np.testing.assert_allclose(np.ptp(faster.q, axis=1), np.ptp(usual.q, axis=1), rtol=0.05)
    np.testing.assert_allclose(np.abs(faster.v).max(axis=1), 1.2 * np.abs(usual.v).max(axis=1), rtol=0.05)
    peaks = [np.abs(nominal_torque(robot, motion)).max(axis=1) for motion in (usual, faster)]
    assert (peaks[1] > 1.05 * peaks[0]).all()


def test_a_case_with_several_logs_has_another_of_the_first_motion_faster(tmp_path: Path) -> None:
    case = Case("two", "planar2", (), 3, seconds=1.0, logs=2)
    files = write_case(case, tmp_path)
    assert [path.name for path in files.logs] == ["log1.csv", "log2.csv"]
    assert files.unseen is not None
    assert not (tmp_path / "log.csv").exists()
    paths = [*files.logs, files.unseen]
    first, second, unseen = (np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:3] for path in paths)
    assert np.abs(first - second).max() > 0.1
    k = np.arange(0, 800, 100)
    np.testing.assert_allclose(unseen[k], first[np.round(1.2 * k).astype(int)], atol=0.02)
    noise = json.loads(files.truth.read_text())["torque_noise"]
    assert list(noise) == ["log1.csv", "log2.csv", "unseen.csv"]
    alone = write_case(replace(case, logs=1), tmp_path / "alone")
    assert alone.log.read_bytes() == files.logs[0].read_bytes()
    assert alone.unseen is None

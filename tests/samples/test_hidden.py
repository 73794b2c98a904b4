"""The generator of logs with hidden effects does what it says, by Pinocchio, by closed forms, and by `idtool fit`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from hidden_effects.case_files import write_case
from hidden_effects.case_list import KINDS, Case, list_cases
from hidden_effects.effects import HiddenEffect, PreslidingFriction, SensorErrors, apply_effects, saturated_torque
from hidden_effects.friction import velocity_by_sweeps, velocity_with_dry_friction
from hidden_effects.logs import Sensors, measured_torque, record
from hidden_effects.magnitudes import EFFECTS
from hidden_effects.motion import draw_motion, nominal_torque
from hidden_effects.plant import AddedPhysics, JointState, MujocoTree, Plant
from hidden_effects.robots import (
    ARM6,
    LEG3,
    PLANAR2,
    ROBOTS,
    Robot,
    Truth,
    draw_truth,
    links_with_motors,
    rotor,
    urdf_text,
)
from numpy.typing import NDArray
from scoreboard import read_outcome

Array = NDArray[np.float64]


def torque_by_pinocchio(robot: Robot, truth: Truth, q: Array, v: Array, a: Array) -> Array:
    """Inverse dynamics of links and of rotors that spin beside them, each on a joint of its own."""
    model = pin.buildModelFromXML(urdf_text(robot, truth.links))
    names = {f"{joint.name}_rotor": joint for joint in robot.joints}
    for name, joint in names.items():
        frame = model.frames[model.getFrameId(joint.parent)]
        kind = pin.JointModelRevoluteUnaligned(np.array(joint.axis, float))
        place = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(*joint.rpy), np.array(joint.xyz, float))
        index = model.addJoint(frame.parentJoint, kind, place, name)
        body = truth.rotors[joint.name]
        model.appendBodyToJoint(index, pin.Inertia(body.mass, body.com, body.inertia), pin.SE3.Identity())
    G = np.zeros((model.nv, len(robot.joints)))
    for j, joint in enumerate(robot.joints):
        G[model.joints[model.getJointId(joint.name)].idx_v, j] = 1.0
        G[model.joints[model.getJointId(f"{joint.name}_rotor")].idx_v, j] = joint.gear
    return np.asarray(G.T @ pin.rnea(model, model.createData(), G @ q, G @ v, G @ a))


@pytest.mark.parametrize("robot", [LEG3, ARM6], ids=lambda robot: robot.name)
def test_bodies_and_rotors_are_those_of_pinocchio(robot: Robot, rng: np.random.Generator) -> None:
    truth = draw_truth(robot, 3)
    tree = MujocoTree(robot, truth, AddedPhysics())
    for q, v, a in rng.normal(size=(5, 3, len(robot.joints))):
        M, bias = tree.mass_matrix_and_bias(q, v)
        np.testing.assert_allclose(M @ a + bias, torque_by_pinocchio(robot, truth, q, v, a), rtol=1e-9, atol=1e-9)


def test_motors_without_a_rotor_of_their_own_are_part_of_their_links() -> None:
    joint = ARM6.joints[4]
    links = links_with_motors(ARM6, {joint.name})
    body = rotor(joint)
    motor = pin.Inertia(body.mass, body.com, body.inertia)
    place = pin.SE3(pin.rpy.rpyToMatrix(*joint.rpy), np.array(joint.xyz))
    link = ARM6.links[joint.parent]
    expected = pin.Inertia(link.mass, link.com, link.inertia) + place.act(motor)
    joined = links[joint.parent]
    assert joined.mass == pytest.approx(expected.mass)
    np.testing.assert_allclose(joined.com, expected.lever, atol=1e-12)
    np.testing.assert_allclose(joined.inertia, expected.inertia, atol=1e-12)
    assert {name for name, body in links.items() if body is not ARM6.links[name]} == {joint.parent}


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)
def test_the_truth_is_no_urdf_but_a_machine_that_could_be(robot: Robot) -> None:
    changes = []
    for seed in range(5):
        truth = draw_truth(robot, seed)
        for name, body in truth.links.items():
            assert np.linalg.eigvalsh(np.trace(body.inertia) / 2 * np.eye(3) - body.inertia)[0] > 0
            believed = robot.links[name]
            changes.append(np.linalg.norm(body.inertia - believed.inertia) / np.linalg.norm(believed.inertia))
        assert draw_truth(robot, seed, exact=True).links == robot.links
    assert 0.08 < np.median(changes) < 0.25
    assert max(changes) < 0.5


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)
def test_motions_keep_within_the_limits_and_turn_round_slowly(robot: Robot) -> None:
    motion = draw_motion(robot, 1, 12.0)
    lower, upper, velocity, effort = np.transpose([(j.lower, j.upper, j.velocity, j.effort) for j in robot.joints])
    away = np.abs(motion.q - ((lower + upper) / 2)[:, None]).max(axis=1) / ((upper - lower) / 2)
    assert (away < 0.8).all()
    assert (np.abs(motion.v).max(axis=1) < 0.8 * velocity).all()
    assert (np.abs(nominal_torque(robot, motion)).max(axis=1) < 0.81 * effort).all()
    np.testing.assert_allclose(np.gradient(motion.q, 1e-3, axis=1)[:, 1:-1], motion.v[:, 1:-1], atol=2e-3)
    np.testing.assert_allclose(np.gradient(motion.v, 1e-3, axis=1)[:, 1:-1], motion.a[:, 1:-1], atol=0.02)
    speed = np.abs(motion.v)
    assert (np.mean((speed > 0.005) & (speed < 0.2), axis=1) > 0.1).all()
    assert (np.count_nonzero(np.diff(np.sign(motion.v)), axis=1) > 8).all()


def test_dry_friction_holds_or_resists(rng: np.random.Generator) -> None:
    for _ in range(100):
        A, free, most = rng.normal(size=(4, 4)), rng.normal(size=4), rng.uniform(0, 1, 4)
        W, before = A @ A.T + 0.5 * np.eye(4), rng.normal(size=4)
        after = velocity_with_dry_friction(W, free, most, before)
        impulse = np.linalg.solve(W, free - after)
        assert (np.abs(impulse) <= most + 1e-6).all()
        moving = np.abs(after) > 1e-6
        np.testing.assert_allclose(impulse[moving], (most * np.sign(after))[moving], atol=1e-6)
        by_sweeps = velocity_by_sweeps(W, free, most, before)  # where the choice of those at rest does not settle
        np.testing.assert_allclose(after, by_sweeps, atol=1e-5)


def test_a_joint_sticks_until_the_torque_is_larger() -> None:
    truth = draw_truth(PLANAR2, 0)
    rest = MujocoTree(PLANAR2, truth, AddedPhysics()).mass_matrix_and_bias(np.zeros(2), np.zeros(2))[1]
    for share, moves in ((0.98, False), (1.02, True)):
        plant = Plant(PLANAR2, truth, AddedPhysics(), 2.5e-4, np.zeros(2), np.zeros(2))
        for _ in range(40):
            plant.step(rest + np.array([0.0, share * truth.coulomb[1]]))
        assert (plant.x[1] > 1e-7) == moves


def test_bristles_wear_off_after_a_few_displacements() -> None:
    p = {"amplitude": 2.0, "displacement": 0.01}
    bristle, torque = PreslidingFriction(p, 0), []
    for v in np.repeat([1.0, -1.0], 200):
        torque.append(float(bristle(JointState(0.0, np.zeros(1), np.array([v]), np.zeros(1), np.zeros(1), 2.5e-4))))
    way = 2.5e-4 * np.arange(200) / 0.01
    np.testing.assert_allclose(torque[:200], 2.0 * (1 - np.exp(-way)), atol=1e-12)
    np.testing.assert_allclose(torque[200:], 2.0 * (2.0 * np.exp(-way) - 1), atol=0.04)


@pytest.mark.parametrize("bend", [0.02, -0.02])
def test_saturation_is_that_of_idtool(bend: float) -> None:
    true = np.linspace(-25, 25, 101)
    measured = saturated_torque(true, 10.0, bend)
    x, y = np.maximum(np.abs(true) - 10, 0), np.maximum(np.abs(measured) - 10, 0)
    np.testing.assert_allclose(*((x, y + bend / 2 * y**2) if bend > 0 else (y, x - bend / 2 * x**2)), atol=1e-12)
    np.testing.assert_array_equal(np.sign(measured), np.sign(true))


def test_a_late_torque_is_late() -> None:
    t = np.arange(1000.0)[:, None]
    wave = np.sin(t / 100) * [1.0, 1.0]
    late = measured_torque(wave, SensorErrors(np.array([0.0, 3.4e-3]), np.zeros(2)))
    np.testing.assert_array_equal(late[:, 0], wave[:, 0])
    np.testing.assert_allclose(late[10:, 1], np.sin((t[10:, 0] - 3.4) / 100), atol=2e-5)


def hidden_run(effect: str, joint: str, **parameters: Any) -> tuple[Plant, float]:
    """The planar arm, held still by a motor's side for half a second; the torque that it takes at a joint."""
    truth, one = draw_truth(PLANAR2, 0), HiddenEffect(effect, joint, parameters=parameters)
    truth, physics, _ = apply_effects(PLANAR2, replace(truth, coulomb=np.zeros(2)), (one,))
    start = np.array([0.4, 0.3])
    plant = Plant(PLANAR2, truth, physics, 1e-4, start, np.zeros(2))
    for _ in range(5_000):
        tau = 3000 * (start - plant.x[plant.motors]) - 60 * plant.v[plant.motors]
        plant.step(tau)
    return plant, float(tau[PLANAR2.index(joint)])


def test_a_gear_gives_way_by_torque_over_stiffness_and_play() -> None:
    elastic, tau = hidden_run("joint_elasticity", "elbow", stiffness=500.0, damping=1.0)
    np.testing.assert_allclose(elastic.x[2] - elastic.x[1], tau / 500, rtol=1e-3)
    loose, tau = hidden_run("backlash", "elbow", stiffness=500.0, damping=1.0, width=0.02)
    np.testing.assert_allclose(loose.x[2] - loose.x[1], tau / 500 + 0.01 * np.sign(tau), rtol=1e-3)


def test_cases_have_names_of_their_own_and_leave_nothing_out() -> None:
    every = [case for kind in KINDS for case in list_cases(kind)]
    assert len({case.name for case in every}) == len(every)
    for robot in ROBOTS:
        assert {case.hidden[0].effect for case in list_cases("single", [robot])} == set(EFFECTS)
    assert {len(case.hidden) for case in list_cases("triples")} == {3}


def test_a_seed_says_it_all(tmp_path: Path) -> None:
    (case,) = (case for case in list_cases("several", ["planar2"], ["strong"], [0], 1.0) if "ripple" in case.name)
    first, again = (write_case(case, tmp_path / name) for name in ("a", "b"))
    other = write_case(replace(case, seed=1), tmp_path / "c")
    for name in ("urdf", "config", "log", "truth"):
        assert getattr(first, name).read_bytes() == getattr(again, name).read_bytes()
    assert first.log.read_bytes() != other.log.read_bytes()


def test_idtool_fits_a_clean_log_down_to_its_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from idtool.estimation.dataset.experiment import prepare
    from idtool.estimation.fit import fit
    from idtool.robot.config import read_config
    from idtool.robot.urdf.reading import read_robot

    def slippery(robot: Robot, seed: int, exact: bool = False) -> Truth:
        return replace(draw_truth(robot, seed, exact), coulomb=np.zeros(len(robot.joints)))

    monkeypatch.setattr("hidden_effects.case_files.draw_truth", slippery)
    case = Case("smooth", "leg3", (), 4, seconds=4.0, sensors=Sensors(encoder_bits=26, torque_noise=0.0))
    files = write_case(case, tmp_path)
    experiment = prepare(read_robot(files.urdf), read_config(files.config), [files.log], holdout=0.0)
    found = fit(experiment, lambda *_: None)
    tau = np.loadtxt(files.log, delimiter=",", skiprows=1)[:, -3:]
    left = found.train.errors["identified"].rms(experiment.model.names)["overall"]
    assert left < 3e-4 * np.sqrt(np.mean(np.square(tau)))


def test_hidden_effects_change_what_is_measured() -> None:
    """Every effect, by itself, against the clean run of the same robot and command."""
    truth, motion = draw_truth(PLANAR2, 2), draw_motion(PLANAR2, 2, 2.0)
    clean = record(PLANAR2, truth, (), motion, Sensors(torque_noise=0.0), 2)
    one = HiddenEffect("parallel_spring", "elbow", parameters={"stiffness": 3.0, "rest_position": 0.2})
    sprung = record(PLANAR2, truth, (one,), motion, Sensors(torque_noise=0.0), 2)
    more = sprung.tau[200:, 1] - clean.tau[200:, 1]
    slope = np.polyfit(clean.q[200:, 1], more, 1)
    np.testing.assert_allclose(slope, [3.0, -0.6], rtol=0.05)


def report_of(*steps: dict[str, Any]) -> dict[str, Any]:
    """A diagnosis.json with these steps."""
    level = {"train": {}, "simulation": {}}
    return {
        "before": {**level, "validation": {"shoulder": 1.0, "elbow": 3.0, "overall": 2.0}},
        "after": {**level, "validation": {"shoulder": 1.0, "elbow": 1.2, "overall": 1.1}},
        "noise_floor": {"shoulder": 1.0, "elbow": 1.0, "overall": 1.0},
        "steps": list(steps),
        "verdict": "explained",
        "data_faults": [],
    }


def step(effect: str, joint: str | None = "elbow", pair: bool = False) -> dict[str, Any]:
    other = {"effect": "stribeck_friction", "joint": "elbow", "link": None, "score": 0.5}
    errors = {"validation_rms_before": {"elbow": 1.0, "overall": 1.0}, "validation_rms_after": {"elbow": 0.5}}
    content = {"effect": effect, "joint": joint, "link": None, "evidence": {"pair": pair}, "alternatives": [other]}
    return {**content, **errors}


@pytest.mark.parametrize(
    ("steps", "right"),
    [
        ([step("stribeck_friction")], "is_exact is_exact_with_pairs has_right_first has_all"),
        ([step("presliding_hysteresis", pair=True)], "is_exact_with_pairs"),
        ([step("presliding_hysteresis")], ""),
        ([step("stribeck_friction", "shoulder")], ""),
        ([step("torque_offset"), step("stribeck_friction")], "has_all"),
        ([step("stribeck_friction"), step("torque_offset")], "has_right_first has_all"),
        ([step("stribeck_friction"), step("unknown")], "is_exact is_exact_with_pairs has_right_first has_all"),
        ([step("unknown")], ""),
        ([], ""),
    ],
)
def test_the_scoreboard_reads_a_diagnosis(steps: list[dict[str, Any]], right: str) -> None:
    case = Case("one", "planar2", (HiddenEffect("stribeck_friction", "elbow"),))
    outcome = read_outcome(case, report_of(*steps), 3.0)
    names = ("is_exact", "is_exact_with_pairs", "has_right_first", "has_all")
    assert [name for name in names if getattr(outcome, name)] == right.split()
    np.testing.assert_allclose(outcome.closed_gap, [0.9, 0.9])


def test_what_is_exact_is_exact_with_pairs_whichever_effect_a_pair_stands_for() -> None:
    hidden = (HiddenEffect("stribeck_friction", "elbow"), HiddenEffect("torque_offset", "elbow"))
    steps = (step("torque_offset", pair=True), step("stribeck_friction"))
    outcome = read_outcome(Case("two", "planar2", hidden), report_of(*steps), 1.0)
    assert outcome.is_exact
    assert outcome.is_exact_with_pairs


def test_delays_of_all_joints_are_one_delay() -> None:
    case = Case("late", "planar2", (HiddenEffect("time_delay"),))
    assert read_outcome(case, report_of(step("time_delay", "elbow"), step("time_delay", "shoulder")), 1.0).is_exact
    assert read_outcome(case, report_of(step("time_delay", None)), 1.0).is_exact
    assert not read_outcome(case, report_of(step("time_delay", "elbow")), 1.0).is_exact


def test_the_scoreboard_counts_steps_that_increase_an_error() -> None:
    case = Case("one", "planar2", ())
    before = {"shoulder": 1.0, "elbow": 1.0, "overall": 1.0}
    expected = {
        (1.01, 0.9, 0.95): (False, False),
        (1.03, 0.9, 0.97): (False, True),
        (1.01, 1.01, 1.01): (True, False),
        (None, None, 1.1): (True, False),
    }
    for after, properties in expected.items():
        errors = {"validation_rms_before": before, "validation_rms_after": dict(zip(before, after, strict=True))}
        (reported,) = read_outcome(case, report_of({**step("torque_offset"), **errors}), 1.0).steps
        assert (reported.increases_error, reported.increases_joint_error) == properties


def test_the_scoreboard_sees_a_disagreement_that_was_missed() -> None:
    case, report = Case("one", "planar2", ()), report_of()
    assert read_outcome(case, report, 1.0).joints_above_floor == ()
    assert not read_outcome(case, {**report, "verdict": "no_disagreement"}, 1.0).has_missed_disagreement
    report["after"]["validation"]["elbow"] = 1.4
    assert read_outcome(case, report, 1.0).joints_above_floor == ("elbow",)
    assert not read_outcome(case, report, 1.0).has_missed_disagreement
    assert read_outcome(case, {**report, "verdict": "no_disagreement"}, 1.0).has_missed_disagreement

"""Mass matrix and bias of the exported file in MuJoCo against Pinocchio's of the robot with its rotors."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import SAMPLES
from exported import (
    EXACT,
    InMujoco,
    arm,
    balanced,
    mass_and_bias,
    model_of,
    sample,
    state,
    unsupported_parts,
    with_couplings,
)
from reference import Reference
from robots import actuated, random_rotor, random_urdf

from idtool.common.exceptions import ModelError
from idtool.reporting.export import to_drake, to_mujoco
from idtool.robot.urdf.reading import read_robot


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Where a test writes its robot."""
    return tmp_path / "identified.urdf"


@pytest.mark.parametrize("seed", range(12))
def test_mass_matrix_and_bias_of_random_trees(urdf: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, mimic=0.0, massless=0.0)
    urdf.write_text(text)
    gravity = rng.normal(scale=5, size=3).tolist()
    names = actuated(read_robot(urdf))
    found = InMujoco(to_mujoco(model_of(urdf, gravity=gravity)), names)
    reference = Reference(text, names, {"gravity": gravity})
    for _ in range(3):
        q, v = state(rng, len(names))
        for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
            np.testing.assert_allclose(ours, theirs, **EXACT)


@pytest.mark.parametrize("seed", range(6))
def test_joints_that_are_locked_are_built_into_their_place(urdf: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, mimic=0.0, massless=0.0)
    urdf.write_text(text)
    every = actuated(read_robot(urdf))
    free = rng.random(len(every)) < 0.5
    free[0] = True
    locked = {name: float(rng.uniform(-1, 1)) for name, moves in zip(every, free, strict=True) if not moves}
    names = [name for name, moves in zip(every, free, strict=True) if moves]
    export = to_mujoco(model_of(urdf, joints=names, locked_joints=locked))
    assert {part.of for part in export.carried if part.what == "locked_joint"} == set(locked)
    found, reference = InMujoco(export, names), Reference(text, every, {"gravity": [0, 0, -9.81]})
    q, v = state(rng, len(every))
    q[~free], v[~free] = list(locked.values()), 0.0
    M, h = mass_and_bias(reference, q, v)
    own_M, own_h = found.mass_and_bias(q[free], v[free])
    np.testing.assert_allclose(own_M, M[np.ix_(free, free)], **EXACT)
    np.testing.assert_allclose(own_h, h[free], **EXACT)


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_rotors_on_parallel_and_perpendicular_axes_are_carried_exactly(rng: np.random.Generator, robot: str) -> None:
    urdf = SAMPLES / f"{robot}.urdf"
    config = sample(urdf)
    export = to_mujoco(model_of(urdf, **config))
    assert unsupported_parts(export, "rotor") == []
    reference = Reference(urdf.read_text(), config["joints"], with_couplings(config))
    found = InMujoco(export, config["joints"])
    for _ in range(5):
        q, v = state(rng, 3)
        for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
            np.testing.assert_allclose(ours, theirs, **EXACT)
    assert found.model.nv == 3
    assert np.abs(np.array(found.model.tendon_armature)).min() > 0


@pytest.mark.parametrize("seed", range(12))
def test_rotors_as_bodies_are_carried_exactly(urdf: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, mimic=0.3, massless=0.0)
    urdf.write_text(text)
    robot = read_robot(urdf)
    names = actuated(robot)
    one, two = rng.choice([j.name for j in robot.joints.values() if j.kind != "fixed"], 2, replace=False)
    rotors = {
        "geared": random_rotor(rng, robot, {one: 9.5}),
        "belt": random_rotor(rng, robot, {one: 8.0, two: -3.0}),
    }
    config = {"gravity": [1.0, -2.0, -9.0], "rotors": rotors}
    identified = model_of(urdf, **config)
    export = to_mujoco(identified, rotor_bodies=True)
    assert export.not_carried == ()
    assert len(unsupported_parts(to_mujoco(identified), "rotor")) >= 2
    reference = Reference(text, names, config)
    rows = {name: reference.tree.joints[reference.index[name]].idx_v for name in reference.index if name not in names}
    places = {name: 0.0 if name in rotors else reference.offset[row] for name, row in rows.items()}
    found = InMujoco(export, names, {name: (reference.G[row], places[name]) for name, row in rows.items()})
    for _ in range(3):
        q, v = state(rng, len(names))
        for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-8)


def test_rotors_as_bodies_turn_with_their_joints(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 0 1", "0 1 0", "0 0 1")
    urdf.write_text(text)
    robot, names = read_robot(urdf), ["j1", "j2", "j3"]
    rotors = {
        "geared": random_rotor(rng, robot, {"j2": -9.5}),
        "belt": random_rotor(rng, robot, {"j1": 8.0, "j3": -3.0}),
    }
    config = {"gravity": [0, 0, -9.81], "rotors": rotors}
    export = to_mujoco(model_of(urdf, **config), rotor_bodies=True)
    ratios = {"geared": np.array([0, -9.5, 0]), "belt": np.array([8.0, 0, -3.0])}
    found = InMujoco(export, names, {name: (ratio, 0.0) for name, ratio in ratios.items()})
    (q, v), tau = state(rng, 3), rng.uniform(-5, 5, 3)
    M, h = mass_and_bias(Reference(text, names, config), q, v)
    expected = np.linalg.solve(M, tau - h)
    np.testing.assert_allclose(found.acceleration(q, v, tau), expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())
    for _ in range(300):
        mujoco.mj_step(found.model, found.data)
    for name, ratio in ratios.items():
        turned = ratio @ (found.state[0] - q)
        assert abs(turned) > 1
        assert found.data.joint(name).qpos[0] - ratio @ q == pytest.approx(turned, rel=1e-3)


def test_a_rotor_that_is_a_link_of_the_urdf_is_there_once(leg: str, urdf: Path) -> None:
    urdf.write_text(leg)
    rotors = {"hip_motor": {"joint": "hip", "gear_ratio": 6.0, "axis": [0, 0, 1]}}
    model = model_of(urdf, joints=["abad", "hip", "knee"], rotors=rotors)
    masses = [pi[0] for pi in model.robot.links.values() if pi is not None]
    for rotor_bodies in (False, True):
        found = mujoco.MjModel.from_xml_string(to_mujoco(model, rotor_bodies).text.decode())
        assert found.body_mass.sum() == pytest.approx(sum(masses), rel=1e-12)
        assert found.nv == 3 + rotor_bodies
        assert found.body("hip_motor").id > 0
    drakes = pin.buildModelFromXML(to_drake(model).text.decode())
    assert sum(inertia.mass for inertia in drakes.inertias) == pytest.approx(sum(masses), rel=1e-12)


def test_a_coupling_that_changes_with_the_pose_is_said_with_its_size(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 0 1", "0 1 0", "0 0 1")
    urdf.write_text(text)
    config = {"gravity": [0, 0, -9.81], "rotors": {"r": balanced([0, 0, 1], {"j3": 10.0}, "l2")}}
    export = to_mujoco(model_of(urdf, **config))
    (part,) = unsupported_parts(export, "rotor")
    assert (part.of, part.unit) == ("r", "kg·m²")
    assert part.value == pytest.approx(1e-3 * 10, rel=0.05)
    found, reference = InMujoco(export, ["j1", "j2", "j3"]), Reference(text, ["j1", "j2", "j3"], config)
    lost = []
    for _ in range(20):
        q, v = state(rng, 3)
        lost.append(np.abs(found.mass_and_bias(q, v)[0] - mass_and_bias(reference, q, v)[0]).max())
    assert 0.8 * part.value < max(lost) <= 1.01 * part.value


def test_a_coupling_across_branches_is_said_with_its_size(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 0 1", "0 1 0", "0 1 0").replace('<parent link="l2"/>', '<parent link="l1"/>')
    urdf.write_text(text)
    config = {"gravity": [0, 0, -9.81], "rotors": {"r": balanced([0, 1, 0], {"j2": 5.0, "j3": -4.0}, "l1")}}
    export = to_mujoco(model_of(urdf, **config))
    (part,) = unsupported_parts(export, "rotor")
    names = ["j1", "j2", "j3"]
    q, v = state(rng, 3)
    lost = InMujoco(export, names).mass_and_bias(q, v)[0] - mass_and_bias(Reference(text, names, config), q, v)[0]
    assert part.value == pytest.approx(np.abs(lost).max(), rel=1e-9)
    assert np.abs(lost[1, 2]) == pytest.approx(part.value)


def test_a_rotor_may_have_no_inertia_but_about_its_axis(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 0 1", "0 0 1")
    urdf.write_text(text)
    rotor = balanced([0, 0, 1], {"j2": 10.0}, "l1")
    rotor["inertial"]["inertia"] = [0, 0, 0, 0, 0, 1e-4]
    config = {"gravity": [0, 0, -9.81], "rotors": {"r": rotor}}
    export = to_mujoco(model_of(urdf, **config))
    assert unsupported_parts(export, "rotor") == []
    q, v = state(rng, 2)
    found, reference = InMujoco(export, ["j1", "j2"]), Reference(text, ["j1", "j2"], config)
    for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
        np.testing.assert_allclose(ours, theirs, **EXACT)
    rotor["inertial"]["inertia"] = [0, 0, 0, 0, 0, -1e-4]
    for to in (to_mujoco, to_drake):
        with pytest.raises(ModelError, match="rotor r: has an inertia that is not physically realizable"):
            to(model_of(urdf, **config))


def test_an_unbalance_is_said_as_torque_under_gravity(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 1 0")
    urdf.write_text(text)
    rotor = balanced([0, 1, 0], {"j1": 10.0}, "l0")
    rotor["inertial"]["com"] = [0.001, 0.0, 0.0]
    config = {"gravity": [0, 0, -9.81], "rotors": {"r": rotor}}
    export = to_mujoco(model_of(urdf, **config))
    (torque,) = [part for part in unsupported_parts(export, "rotor") if part.unit == "N·m"]
    found, reference = InMujoco(export, ["j1"]), Reference(text, ["j1"], config)
    still = np.zeros(1)
    lost = [
        float(np.abs(found.mass_and_bias(q, still)[1] - mass_and_bias(reference, q, still)[1])[0])
        for q in np.linspace(0, 0.7, 50)[:, None]
    ]
    assert max(lost) == pytest.approx(torque.value, rel=0.01)

"""`idtool init` on a quadruped in MuJoCo, whose configuration by hand is known, and on an arm with a wrench sensor."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ground.logs import Recording, config_text, write_csv, write_mcap
from ground.quadruped import FEET, FOOT_RADIUS, JOINTS
from ground.robot import Array, prior_robot, urdf_text
from quadruped_recordings import TRUTH, record_quadruped
from sensor_arm import CHANNELS, SENSOR, write_log
from sensor_arm import urdf_text as arm_text

import idtool
from idtool.common.safe_yaml import parse_yaml
from idtool.robot.urdf.reading import read_robot
from idtool.setup import InitialConfig, make_initial_config

BALL = f'<collision><geometry><sphere radius="{FOOT_RADIUS}"/></geometry></collision>'
KINDS = ("stand", "hang")
NO_TRIALS: Mapping[str, Any] = {"friction": {"viscous": True}, "effects": []}


@pytest.fixture(scope="module")
def recordings() -> dict[str, Recording]:
    return {kind: record_quadruped(kind, 5.0) for kind in KINDS}


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """The URDF of a user, whose masses are 10 to 30 % off, with balls as feet."""
    text = urdf_text(prior_robot(TRUTH, 0))
    for foot in FEET:
        text = text.replace(f'<link name="{foot}"/>', f'<link name="{foot}">{BALL}</link>')
    path = tmp_path / "quadruped.urdf"
    path.write_text(text)
    return path


def logs_of(folder: Path, recordings: Mapping[str, Recording], *without: str) -> list[Path]:
    """Logs without the channels that begin with some words."""
    paths = []
    for kind, recording in recordings.items():
        columns = {name: x for name, x in recording.columns.items() if not name.startswith(without)}
        paths.append(folder / f"{kind}.csv")
        write_csv(paths[-1], Recording(columns))
    return paths


def first_config(urdf: Path, logs: list[Path], given: Mapping[str, Any]) -> InitialConfig:
    return make_initial_config(read_robot(urdf), logs, given, None, lambda stage, share: None)


@pytest.mark.slow
def test_errors_are_those_of_the_configuration_by_hand(
    tmp_path: Path, urdf: Path, recordings: Mapping[str, Recording]
) -> None:
    logs = logs_of(tmp_path, recordings)
    result = idtool.init(urdf, logs)
    by_hand = parse_yaml(Path("by_hand"), config_text(TRUTH).encode())
    proposed = {contact["name"]: contact for contact in result.config["contacts"]}
    assert proposed == {contact["name"]: contact for contact in by_hand["contacts"]}
    assert not any(trial.kept for trial in result.trials if trial.effect in ("torque_offset", "time_delay"))

    fits = {}
    for name, config in (("init", result.config), ("hand", {**by_hand, "filter": result.config["filter"]})):
        model = idtool.Model(urdf, config=config)
        fits[name] = idtool.fit(model, logs, quick=True)
    errors = {name: fit.rms.validation for name, fit in fits.items()}
    assert errors["init"]["overall"] < 1.2 * errors["hand"]["overall"]
    ratios = {joint: errors["init"][joint] / errors["hand"][joint] for joint in JOINTS}
    assert max(ratios.values()) < 1.6, ratios
    robot = fits["init"].whole_robot
    assert robot is not None
    assert robot.mass == pytest.approx(TRUTH.mass, rel=5e-3)


@pytest.mark.slow
def test_what_holds_the_robot_without_a_flag_is_found(tmp_path: Path, urdf: Path) -> None:
    logs = logs_of(tmp_path, {kind: record_quadruped(kind, 3.0) for kind in KINDS}, "contact_", "force_")
    contacts = first_config(urdf, logs, NO_TRIALS).data["contacts"]
    assert [contact["flag"] for contact in contacts] == ["auto"] * (len(FEET) + 1)
    assert contacts[-1] == {"name": "support", "link": "trunk", "kind": "surface", "flag": "auto"}
    assert len(first_config(urdf, logs[:1], NO_TRIALS).data["contacts"]) == len(FEET)


@pytest.mark.slow
def test_mass_is_that_of_the_ground_logs_though_something_holds_the_robot_in_another(
    tmp_path: Path, urdf: Path, recordings: Mapping[str, Recording]
) -> None:
    logs = logs_of(tmp_path, recordings, "contact_rope", "force_")
    proposal = first_config(urdf, logs, {"friction": {"viscous": True, "coulomb": True}})
    assert proposal.data["contacts"][-1]["flag"] == "auto"
    assert not any(trial.kept for trial in proposal.trials if trial.effect == "time_delay")
    result = idtool.fit(idtool.Model(urdf, config=proposal.data), logs, quick=True)
    robot = result.whole_robot
    assert robot is not None
    assert robot.mass == pytest.approx(TRUTH.mass, rel=1e-2)
    assert robot.mass_standard_error is not None
    assert robot.mass_standard_error < 0.05 * TRUTH.mass
    (note,) = [notice for notice in result.notices if notice.code == "support_detected"]
    assert (note.subject, "100 %" in note.message) == ("hang.csv", True)


@pytest.mark.slow
def test_of_several_imus_the_one_in_all_logs_is_read(tmp_path: Path, urdf: Path) -> None:
    recordings = {kind: record_quadruped(kind, 2.0) for kind in KINDS}
    logs = [tmp_path / f"{kind}.mcap" for kind in KINDS]
    write_mcap(logs[0], TRUTH, recordings["stand"], imu_topics=("/cam", "/body/imu"))
    write_mcap(logs[1], TRUTH, recordings["hang"], imu_topics=("/body/imu",))
    first = first_config(urdf, logs, NO_TRIALS)
    assert first.data["base"]["imu"] == {"link": "imu_link", "topic": "/body/imu", "delay": "auto"}
    write_mcap(logs[1], TRUTH, recordings["hang"], imu_topics=("/head/imu",))
    with_none = first_config(urdf, logs, NO_TRIALS)
    assert "base" not in with_none.data
    assert "base.imu.topic" in [item.key for item in with_none.todo]


@pytest.mark.parametrize("frame", [pytest.param("world", marks=pytest.mark.slow), "link"])
def test_axes_of_measured_forces_are_found(tmp_path: Path, urdf: Path, frame: str) -> None:
    standing = record_quadruped("stand", 2.0)
    if frame == "link":
        standing = Recording({**standing.columns, **_forces_along_links(urdf, standing)})
    logs = logs_of(tmp_path, {"stand": standing}, "contact_")
    result = first_config(urdf, logs, NO_TRIALS)
    assert [contact["frame"] for contact in result.data["contacts"]] == len(FEET) * [frame]
    assert "contacts.frame" not in [item.key for item in result.todo]


def test_forces_are_along_the_links_if_no_orientation_was_logged(tmp_path: Path, urdf: Path) -> None:
    logs = logs_of(tmp_path, {"stand": record_quadruped("stand", 2.0)}, "contact_", "imu_q")
    result = first_config(urdf, logs, NO_TRIALS)
    assert {contact["frame"] for contact in result.data["contacts"]} == {"link"}
    assert "contacts.frame" in [item.key for item in result.todo]
    assert result.rms is not None  # so that the fit can read it


def _forces_along_links(urdf: Path, recording: Recording) -> dict[str, Array]:
    """The forces on the feet along the axes of the feet, by Pinocchio."""
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    data = model.createData()
    columns = recording.columns
    imu_to_base = pin.rpy.rpyToMatrix(0, 0, TRUTH.imu.turn)
    forces = {foot: np.stack([columns[f"force_{foot}_{axis}"] for axis in "xyz"], axis=1) for foot in FEET}
    for k in range(len(columns["t"])):
        quaternion = pin.Quaternion(np.array([columns[f"imu_q{part}"][k] for part in "xyzw"]))
        q = pin.neutral(model)
        q[3:7] = pin.Quaternion(quaternion.matrix() @ imu_to_base.T).coeffs()
        for joint in JOINTS:
            q[model.joints[model.getJointId(joint)].idx_q] = columns[f"q_{joint}"][k]
        pin.framesForwardKinematics(model, data, q)
        for foot, force in forces.items():
            force[k] = data.oMf[model.getFrameId(foot)].rotation.T @ force[k]
    return {f"force_{foot}_{axis}": forces[foot][:, i] for foot in FEET for i, axis in enumerate("xyz")}


@pytest.mark.parametrize(("sign", "with_torque"), [(1, True), (-1, True), (-1, False)])
def test_sign_of_a_wrench_sensor_is_found(tmp_path: Path, sign: int, with_torque: bool) -> None:
    urdf, log = tmp_path / "arm.urdf", tmp_path / "run.csv"
    urdf.write_text(arm_text())
    write_log(log, 6.0, np.array([3.0, -2.0, 5.0, 0.1, 0.2, -0.1]), with_torque)
    header, table = log.read_text().splitlines()[0].split(","), np.loadtxt(log, delimiter=",", skiprows=1)
    table[:, [header.index(channel) for channel in CHANNELS]] *= sign
    np.savetxt(log, table, fmt="%.9g", delimiter=",", header=",".join(header), comments="")
    result = idtool.init(urdf, log)
    assert result.config["wrench_sensors"] == [{"joint": SENSOR, "sign": sign, "offset": "fit"}]
    assert not [notice for notice in result.notices if notice.severity == "problem"]
    fit = idtool.fit(idtool.Model(urdf, config=result.config), log, quick=True)
    rows = [name for name in fit.rms.train if name.startswith(SENSOR)]
    assert len(rows) == len(CHANNELS)
    assert max(fit.rms.train[name] for name in rows) < 0.05  # N, N m; the arm weighs 3.4 kg


def without_balls(urdf: Path, geometry: str = "") -> None:
    """Give the feet another geometry in place of their balls."""
    urdf.write_text(urdf.read_text().replace(BALL, geometry))


def test_radius_of_feet_without_a_sphere_is_found_by_how_they_roll(
    tmp_path: Path, urdf: Path, recordings: Mapping[str, Recording]
) -> None:
    without_balls(urdf)
    first = first_config(urdf, logs_of(tmp_path, recordings), NO_TRIALS)
    radii = [contact["radius"] for contact in first.data["contacts"] if contact["name"] in FEET]
    assert len(radii) == len(FEET)
    assert len(set(radii)) == 1
    value, error = map(float, re.findall(r"([\d.]+) ± ([\d.]+) m, by how they roll", first.text)[0])
    assert value == pytest.approx(radii[0], abs=5e-4)
    assert abs(value - FOOT_RADIUS) < 2 * error  # soft feet seem to be smaller
    assert error < 0.3 * FOOT_RADIUS
    assert "radius of FL_foot, FR_foot, RL_foot, RR_foot: unknown" not in first.text


@pytest.mark.slow
def test_radius_is_left_to_the_user_without_standing_and_where_a_foot_slips(
    tmp_path: Path, urdf: Path, recordings: Mapping[str, Recording]
) -> None:
    without_balls(urdf)
    hanging = {"hang": recordings["hang"]}
    on_ice = record_quadruped("stand", 5.0, slippery_foot="FL_foot")
    for logs in (hanging, {"stand": on_ice}):
        first = first_config(urdf, logs_of(tmp_path, logs), NO_TRIALS)
        assert not any("radius" in contact for contact in first.data["contacts"])
        assert "contacts.radius" in [item.key for item in first.todo]


@pytest.mark.slow
def test_mesh_that_is_round_bounds_the_radius(tmp_path: Path, urdf: Path, recordings: Mapping[str, Recording]) -> None:
    """Without standing, which tells more."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    ball.apply_translation([0.0, 0.0, 0.005])
    ball.export(tmp_path / "foot.stl")
    without_balls(urdf, '<collision><geometry><mesh filename="foot.stl"/></geometry></collision>')
    hanging = first_config(urdf, logs_of(tmp_path, {"hang": recordings["hang"]}), NO_TRIALS)
    contacts = {contact["name"]: contact for contact in hanging.data["contacts"]}
    assert contacts["FL_foot"]["radius"] == pytest.approx(0.03, rel=0.02)
    assert contacts["FL_foot"]["point"] == pytest.approx([0, 0, 0.005], abs=1e-3)
    assert "of a ball about the mesh" in hanging.text
    standing = first_config(urdf, logs_of(tmp_path, {"stand": recordings["stand"]}), NO_TRIALS)
    contacts = {contact["name"]: contact for contact in standing.data["contacts"]}
    assert contacts["FL_foot"]["radius"] < 0.027
    assert "of a ball about the mesh" not in standing.text

"""`idtool init` with a configuration to start from: what is kept, what is said of it, and what is left."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import config_with, idtool, refuse
from recordings import ros2, write_mcap
from spatial_arm import ARM, JOINTS
from starts import arm, as_csv, as_states, filled, init, robot

from idtool.robot.config import Config

SIGNALS = ("position", "velocity", "effort")
GAINS = {"kp": dict.fromkeys(JOINTS, 50.0), "kd": dict.fromkeys(JOINTS, 1.0)}
ROTOR = {
    "joint": "lift",
    "gear_ratio": 9.0,
    "parent": "turret",
    "origin": {"xyz": [0, 0, 0]},
    "axis": [0, 1, 0],
    "inertial": {"mass": 0.1, "com": [0, 0, 0], "inertia": [1e-4, 0, 1e-4, 0, 0, 1e-4]},
}


def run(folder: Path, seconds: float = 4.0) -> Path:
    return as_csv(folder / "run.csv", arm(seconds))


def commanded(folder: Path) -> Path:
    """A log of a position controller, without torque."""
    log = arm(4.0)
    log["qcmd"] = log["q"] + (log["tau"] + log["v"]) / 50
    return as_csv(folder / "run.csv", log, signals=("q", "v", "qcmd"))


def blocks(report: dict[str, Any]) -> dict[str, str]:
    """What stands in the file that was written, by key, each on lines that are not wrapped."""
    key = re.compile(rf"^(?:# )?({'|'.join(Config.model_fields)}):", re.MULTILINE)
    parts = Path(report["file"]).read_text().split("\n\n")
    return {key.findall(part)[-1]: part.replace("\n# ", " ") for part in parts[1:]}


def test_what_is_given_and_what_is_found_are_told_apart(tmp_path: Path) -> None:
    given = {"gravity": [0.0, 0.0, -9.81], "velocity": "measured", "effects": [], "locked_joints": {"roll": 0.2}}
    report = init(robot(tmp_path), run(tmp_path), "--config", config_with(tmp_path / "given.yaml", **given))
    said = blocks(report)
    assert "# Given in given.yaml; idtool init finds the same value. Gravity" in said["gravity"]
    assert "# Given in given.yaml.\nvelocity: measured" in said["velocity"]
    assert "# Given in given.yaml.\neffects: []" in said["effects"]  # no trial found that there are none
    assert "given in given.yaml: roll" in said["locked_joints"]
    assert "median" not in said["locked_joints"]
    assert "Given" not in said["joints"]
    assert {trial["effect"] for trial in report["trials"]} == {"torque_offset"}


def test_joints_that_are_given_are_not_called_found(tmp_path: Path) -> None:
    config = config_with(tmp_path / "given.yaml", joints=["turn", "lift"], gravity=[0.0, 0.0, -9.8])
    report = init(robot(tmp_path), run(tmp_path), "--config", config)
    assert "# Given in given.yaml.\njoints" in blocks(report)["joints"]
    assert "# Given in given.yaml.\ngravity" in blocks(report)["gravity"]
    assert "left out of joints: roll" in blocks(report)["locked_joints"]


def test_joint_held_still_may_be_given_without_joints(tmp_path: Path) -> None:
    config = config_with(tmp_path / "given.yaml", locked_joints={"lift": 0.0, "roll": 0.0})
    report = init(robot(tmp_path), run(tmp_path), "--config", config)
    assert report["config"]["joints"] == ["turn"]
    assert report["found"][0] == "1 moving joint: turn"


def test_null_is_nothing_given(tmp_path: Path) -> None:
    (tmp_path / "given.yaml").write_text("joints:\ncontroller:\n")
    report = init(robot(tmp_path), run(tmp_path), "--config", tmp_path / "given.yaml")
    assert report["config"]["joints"] == list(JOINTS)


def test_log_options_stay_beside_the_topic_that_was_found_and_are_applied_once(tmp_path: Path) -> None:
    states = as_states(arm(4.0))
    part = [replace(x, names=JOINTS[:1], **{name: getattr(x, name)[:1] for name in SIGNALS}) for x in states]
    large = [replace(x, effort=[8 * tau for tau in x.effort]) for x in states]
    file = write_mcap(tmp_path / "run.mcap", ros2(part, "/part"), ros2(large, "/whole"))
    scale = {"tau": dict.fromkeys(JOINTS, 0.125)}
    report = init(robot(tmp_path), file, "--config", config_with(tmp_path / "given.yaml", log={"scale": scale}))
    assert report["config"]["log"] == {"scale": scale, "topic": "/whole"}
    plain = init(robot(tmp_path), run(tmp_path), "--force")
    assert report["rms"]["found"]["overall"] == pytest.approx(plain["rms"]["found"]["overall"], rel=0.05)


def test_rotor_that_is_given_is_no_effect_and_not_left_to_fill_in(tmp_path: Path) -> None:
    config = config_with(tmp_path / "given.yaml", rotors={"motor": ROTOR})
    report = init(robot(tmp_path), run(tmp_path), "--config", config)
    assert {trial["joint"] for trial in report["trials"] if trial["effect"] == "rotor_inertia"} == {"turn", "roll"}
    assert "rotors" not in {left["key"] for left in report["left"]}


def test_ellipsoids_that_are_given_are_not_left_to_fill_in(tmp_path: Path) -> None:
    shape = {"upper": [{"center": [0, 0, 0], "semi_axes": [0.5, 0.5, 0.5]}]}
    config = config_with(tmp_path / "given.yaml", bounding_ellipsoids=shape)
    report = init(robot(tmp_path), run(tmp_path), "--config", config)
    assert "bounding_ellipsoids" not in {left["key"] for left in report["left"]}


def test_delay_of_a_controller_is_kept_where_it_is_given_and_none_is_tried(tmp_path: Path) -> None:
    for controller, delay in ((GAINS, "auto"), ({**GAINS, "delay": 0.003}, 0.003)):
        config = config_with(tmp_path / "given.yaml", controller=controller)
        report = init(robot(tmp_path), commanded(tmp_path), "--config", config, "--force")
        assert report["config"]["controller"] == {**GAINS, "delay": delay}
        assert {trial["effect"] for trial in report["trials"]} == {"torque_offset", "rotor_inertia"}
        assert "a delay" not in blocks(report)["effects"] or "a delay was not tried" in blocks(report)["effects"]


def test_units_of_a_joint_that_slides(tmp_path: Path) -> None:
    text = ARM.replace('name="roll" type="revolute"', 'name="roll" type="prismatic"')
    report = init(robot(tmp_path, text), commanded(tmp_path))
    said = blocks(report)
    assert "kp N·m/rad or N/m, kd N·m·s/rad or N·s/m at the joint" in said["controller"]
    assert "scale: N·m or N per logged unit, if the log is not in N·m or N," in said["log"]
    report = init(robot(tmp_path), commanded(tmp_path), "--force")
    assert "kp N·m/rad, kd N·m·s/rad at the joint" in blocks(report)["controller"]


def test_next_command_names_a_file_that_lies_elsewhere(tmp_path: Path) -> None:
    urdf, other = robot(tmp_path), tmp_path / "other.yaml"
    log = run(tmp_path)
    assert init(urdf, log, "--out", other)["next"] == f"idtool fit {urdf} {log} --config {other}"
    log = commanded(tmp_path)
    report = init(urdf, log, "--out", other, "--force")
    assert report["next"] == f"idtool init {urdf} {log} --config {other} --out {other} --force"
    assert report["needed"] == ["controller"]
    done = idtool("init", urdf, log)
    assert done.out.splitlines()[-1].startswith("next, after filling in controller: idtool init ")


def test_place_that_cannot_be_written_to_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    urdf, log = robot(tmp_path), tmp_path / "none.csv"
    where = {"naming": "is a file, but a folder is needed; give another --out"}
    refuse(tmp_path, "init", urdf, log, "--out", urdf / "deeper" / "x.yaml", file="arm.urdf", **where)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_that_may_not_be_written_to_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    urdf, log = robot(tmp_path), tmp_path / "none.csv"
    tmp_path.chmod(0o555)
    try:
        assert "cannot be written to" in idtool("init", urdf, log).err
    finally:
        tmp_path.chmod(0o755)


def test_no_line_of_the_file_is_too_long_to_read(tmp_path: Path) -> None:
    text = ARM.replace('"roll"', f'"roll_{"of_the_arm_" * 4}"')
    log = as_csv(tmp_path / "run.csv", arm(4.0), (*JOINTS[:2], f"roll_{'of_the_arm_' * 4}"))
    report = init(robot(tmp_path, text), log)
    written = Path(report["file"]).read_text()
    assert max(map(len, written.splitlines())) <= 120
    assert yaml.safe_load(written) == report["config"]
    assert filled(written).rotors
    assert "Masses in the URDF: turret 2, upper 1.4, fore 0.9" in written

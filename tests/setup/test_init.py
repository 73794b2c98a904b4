"""`idtool init`: what it finds out, against arms that Pinocchio moves and effects that are put in by hand."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import LEG, SAMPLES, TRAIN, VALIDATE, config_with, fitted, idtool
from prescribed_motions import with_torque
from recordings import State, ros2, write_mcap
from spatial_arm import ARM, JOINTS
from starts import arm, as_csv, as_states, filled, init, robot

from idtool.robot.config import read_config

ARMATURE, OFFSET, LATE = 0.05, 0.4, 0.008  # kg·m², N·m, s


def test_what_the_log_shows_is_found_and_nothing_else(tmp_path: Path) -> None:
    log = arm()
    late = np.stack([np.interp(log["t"] - LATE, log["t"], x) for x in arm()["tau"].T], axis=1)
    hidden = with_torque(
        with_torque({**log, "tau": late}, 1, OFFSET), 2, ARMATURE * np.interp(log["t"] - LATE, log["t"], log["a"][:, 2])
    )
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", hidden))
    config = report["config"]
    assert config["joints"] == list(JOINTS)
    assert [name for name, terms in config["friction"].items() if terms["offset"]] == ["lift"]
    rotor, delay = sorted(config["effects"], key=lambda entry: str(entry["effect"]))
    assert (rotor["effect"], rotor["joint"], delay["effect"]) == ("rotor_inertia", "roll", "time_delay")
    assert rotor["parameters"]["inertia"] == pytest.approx(ARMATURE, rel=0.05)
    assert delay["parameters"]["delay"] == pytest.approx(LATE, abs=3e-4)
    assert report["rms"]["found"]["overall"] < 0.2 * report["rms"]["friction"]["overall"]


def test_of_a_rigid_arm_nothing_is_said_that_is_not_there(tmp_path: Path) -> None:
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", arm()))
    assert report["config"]["friction"] == {"viscous": True, "coulomb": True, "offset": False}
    assert report["config"]["effects"] == []
    assert not any(trial["kept"] for trial in report["trials"])
    assert "found by trial: neither" in Path(report["file"]).read_text()


def test_of_torque_with_the_wrong_sign_nothing_is_believed(tmp_path: Path) -> None:
    log = arm()
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", {**log, "tau": -log["tau"]}))
    assert report["config"]["effects"] == []
    assert not any(trial["kept"] for trial in report["trials"])
    assert any(
        "a large fraction of the held-out torque (rms) is unexplained: " in warning and "check its sign" in warning
        for warning in report["warnings"]
    )


def test_cutoff_lies_above_the_motion_which_is_below_3_hz(tmp_path: Path) -> None:
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", arm()))
    assert 2.6 < report["band_hz"] < 20
    slow = arm()
    few = {name: x[::50] for name, x in slow.items()}  # 20 Hz
    report = init(robot(tmp_path), as_csv(tmp_path / "slow.csv", few), "--force")
    assert report["band_hz"] <= 4.0  # a fifth of the rate


def test_joints_that_stand_still_are_locked_where_they_are(tmp_path: Path) -> None:
    log = arm()
    log["q"][:, 0], log["v"][:, 0] = 0.7, 0.0
    unlogged = ARM.replace('lower="-3" upper="3"', 'lower="0.4" upper="3"')  # of the roll, as of all
    report = init(robot(tmp_path, unlogged), as_csv(tmp_path / "run.csv", log, JOINTS[:2]))
    assert report["config"]["joints"] == ["lift"]
    assert report["config"]["locked_joints"] == {"turn": 0.7, "roll": 0.4}
    text = Path(report["file"]).read_text()
    assert "# does not move: turn" in text
    assert "# not in every log: roll" in text


def test_without_torque_or_gains_it_says_what_is_missing_and_the_second_run_does_the_rest(tmp_path: Path) -> None:
    log = arm()
    log["qcmd"] = log["q"] + (log["tau"] + 1.0 * log["v"]) / 50
    urdf, run = robot(tmp_path), as_csv(tmp_path / "run.csv", log, signals=("q", "v", "qcmd"))
    first = init(urdf, run)
    assert [left["key"] for left in first["left"] if left["needed"]] == ["controller"]
    assert "kp and kd of turn, lift, roll" in first["left"][0]["what"]
    assert not {"controller", "friction", "effects"} & set(first["config"])
    assert first["next"].endswith("--config " + str(urdf.with_suffix(".yaml")) + " --force")
    file = urdf.with_suffix(".yaml")
    config = filled(file.read_text(), 50.0)
    assert config.controller is not None
    assert set(config.controller.kp) == set(JOINTS)
    gains = {"kp": dict.fromkeys(JOINTS, 50.0), "kd": dict.fromkeys(JOINTS, 1.0)}
    config_with(file, file, controller=gains)
    second = init(urdf, run, "--config", file, "--force")
    assert not [left for left in second["left"] if left["needed"]]
    assert second["config"]["controller"] == {**gains, "delay": "auto"}
    assert second["config"]["effects"] == []
    assert second["rms"]["found"]["overall"] < 0.1


def test_what_is_given_is_kept(tmp_path: Path) -> None:
    given = {"gravity": [0.0, 0.0, -9.8], "friction": {"viscous": True, "coulomb": False}, "seed": 7}
    given |= {"filter": {"cutoff_hz": 12.5}, "locked_joints": {"roll": 0.0}, "joints": ["turn", "lift"]}
    config = config_with(tmp_path / "given.yaml", **given)
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", arm()), "--config", config)
    assert {key: report["config"][key] for key in given} == given
    assert report["band_hz"] == 12.5
    assert {trial["effect"] for trial in report["trials"]} == {"time_delay", "rotor_inertia"}
    assert "Given in given.yaml" in Path(report["file"]).read_text()


def test_of_several_topics_the_robots_own_is_read(tmp_path: Path) -> None:
    states = as_states(arm(4.0))
    others = [State(s.stamp, ("finger", "thumb"), s.position[:2], logged=s.logged) for s in states]
    file = write_mcap(tmp_path / "run.mcap", ros2(others, "/hand"), ros2(states, "/arm"))
    urdf = robot(tmp_path)
    assert "set log.topic" in idtool("fit", urdf, file, "--out", tmp_path / "x").err
    report = init(urdf, file)
    assert report["config"]["log"] == {"topic": "/arm"}
    assert fitted(tmp_path / "out", urdf, file)["joints"] == list(JOINTS)


def test_leg_from_scratch_is_as_good_as_with_the_configuration_by_hand(tmp_path: Path) -> None:
    for name in ("own", "hand"):
        shutil.copy(LEG, tmp_path / f"{name}.urdf")
    report = init(tmp_path / "own.urdf", TRAIN)
    rotors = {entry["joint"]: entry["parameters"]["inertia"] for entry in report["config"]["effects"]}
    true = yaml.safe_load((SAMPLES / "truth.yaml").read_text())["leg"]["bodies"]
    ratio = yaml.safe_load((SAMPLES / "leg.yaml").read_text())["rotors"]["hip_rotor"]["gear_ratio"]
    about_axis = {joint: max(true[f"{joint}_rotor"]["inertia"]) for joint in ("abad", "hip", "knee")}
    assert rotors == {joint: pytest.approx(ratio**2 * own, rel=0.1) for joint, own in about_axis.items()}
    assert set(report["config"]["bounding_ellipsoids"]) == {"abad_link", "thigh_link", "shank_link"}
    config_with(tmp_path / "hand.yaml", SAMPLES / "leg.yaml", filter={"cutoff_hz": report["band_hz"]})
    rms = {
        name: fitted(tmp_path / name, tmp_path / f"{name}.urdf", TRAIN, "--validate", VALIDATE)["rms"]["validation"]
        for name in ("own", "hand")
    }
    assert rms["own"]["overall"] < 1.2 * rms["hand"]["overall"]
    assert read_config(tmp_path / "own.yaml").filter.cutoff_hz == report["band_hz"]

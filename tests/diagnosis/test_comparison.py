"""`idtool diagnose --against` and `idtool export --patch`: MuJoCo as the user's simulator, and as the robot."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import LEG, TRAIN, VALIDATE, idtool, refuse
from simulator_pair import JOINTS, KD, KP, MJCF, ROBOT, URDF, Machine, robot, write_log, write_pair

from idtool.data.pairing import LogPair
from idtool.diagnosis.comparison import _is_foreign_to_simulators, _pair_notices
from idtool.dynamics.effects import effect_from_entry
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

DELAY = 0.004  # s
EFFECTS = ("--effects", "rotor_inertia,time_delay,payload", "--no-simulation")
MORE_EFFECTS = ("--effects", "viscous_friction,coulomb_friction,rotor_inertia,time_delay,payload,quadratic_drag")
CHANGED = {
    ("viscous_friction", "yaw"): ("viscous", 0.5, 0.9),
    ("coulomb_friction", "shoulder"): ("coulomb", 0.1, 0.8),
    ("rotor_inertia", "shoulder"): ("inertia", 0.0, 0.08),
    ("rotor_inertia", "elbow"): ("inertia", 0.0, 0.03),
}
PAYLOAD = {"mass": 0.1, "com": [0.0, 0.0, 0.1], "inertia": [1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]}
HEAVY = MJCF.replace('mass="1" diaginertia="0.008 0.008 0.001"', 'mass="1.5" diaginertia="0.016 0.016 0.002"')


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the logs of robot and simulator, and the diagnosis in ``out``."""
    folder = tmp_path_factory.mktemp("pair")
    write_pair(folder)
    diagnosed(folder, "robot/run1.csv", "--against", "simulator", "--out", "out", *MORE_EFFECTS)
    return folder


def diagnosed(folder: Path, *arguments: object) -> dict[str, Any]:
    done = idtool("diagnose", "arm.urdf", *arguments, "--json", folder=folder)
    assert done.code == 0, done.err
    return done.json


@pytest.fixture(scope="module")
def report(pair: Path) -> dict[str, Any]:
    data = json.loads((pair / "out" / "diagnosis.json").read_text())
    assert isinstance(data, dict)
    return data


def by_owner(changes: list[dict[str, Any]]) -> dict[tuple[str, str | None], dict[str, Any]]:
    return {(change["effect"], change["joint"] or change["link"]): change["parameters"] for change in changes}


def test_the_changes_are_those_that_were_made_with_their_values(report: dict[str, Any]) -> None:
    assert report["inertia"] == "fixed"
    against = report["against"]
    changes = by_owner(against["changes"])
    assert set(changes) == {*CHANGED, ("time_delay", None)}
    for owner, (name, before, after) in CHANGED.items():
        found = changes[owner][name]
        assert found["simulator"] == pytest.approx(before, rel=0.02, abs=2e-4)
        assert found["robot"] == pytest.approx(after, rel=0.02)
        assert 0 < found["robot_standard_error"] < 0.02 * after
    delay = changes["time_delay", None]["delay"]
    assert delay["simulator"] - delay["robot"] == pytest.approx(DELAY, rel=0.05)
    unchanged = by_owner(against["unchanged"])
    assert {owner for effect, owner in unchanged if effect == "coulomb_friction"} == {"yaw", "elbow"}
    assert unchanged["coulomb_friction", "elbow"]["coulomb"]["robot"] == pytest.approx(0.2, rel=0.05)


def test_the_largest_change_comes_first_and_the_gap_closes(report: dict[str, Any]) -> None:
    against = report["against"]
    shares = [change["share"] for change in against["changes"]]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.3
    assert against["torque_after"]["overall"] < 0.02 * against["torque_before"]["overall"]
    assert against["position_after"]["overall"] < 0.02 * against["position_before"]["overall"]
    (log,) = against["pairs"]
    assert (log["log"], log["simulation"], log["offset"]) == ("robot/run1.csv", "simulator/run1.csv", 0.0)
    assert log["torque_rms"]["overall"] > 0.5
    assert "the simulator's torque error on the robot's logs goes from" in against["summary"]
    assert against["simulator_effects"] == []
    assert (against["inconclusive"], against["advice"]) == ("", "")


def test_the_page_shows_the_changes(pair: Path) -> None:
    page = (pair / "out" / "diagnosis.html").read_text()
    for heading in (
        "Changes to make in the simulator",
        "Gap between simulator and robot",
        "Effects that need no change",
    ):
        assert heading in page
    assert "Against the simulator" in page


@pytest.fixture(scope="module")
def patched(pair: Path) -> str:
    done = idtool("export", "out", "--patch", "scene.xml", "--json", folder=pair)
    assert (done.code, done.json["patched"], done.json["file"]) == (0, "scene.xml", "scene_patched.xml")
    assert {(part["what"], part["of"]) for part in done.json["carried"]} == set(CHANGED)
    (delay,) = done.json["not_carried"]
    assert (delay["what"], delay["unit"]) == ("time_delay", "s")
    assert delay["value"] == pytest.approx(DELAY, rel=0.05)
    assert (pair / "scene.xml").read_text() == MJCF
    return (pair / "scene_patched.xml").read_text()


def test_the_patched_file_reproduces_the_robot(patched: str) -> None:
    """Torque of the closed loop, which must make up for what the simulator lacks, along a motion not used before."""
    real = robot(DELAY).play(6.0, seed=7)
    errors = {}
    for name, machine in {
        "before": Machine(MJCF),
        "patched": Machine(patched),
        "with the delay": Machine(patched, delay=DELAY),
    }.items():
        log = machine.play(6.0, seed=7)
        errors[name] = np.sqrt(np.mean(np.square(log - real)[:, 1:4])), np.sqrt(np.mean(np.square(log - real)[:, 7:]))
    for before, after in zip(errors["before"], errors["patched"], strict=True):
        assert after < 0.3 * before
    position, torque = errors["with the delay"]
    assert position < 0.03 * errors["before"][0]
    assert torque < 0.05 * errors["before"][1]  # most of which is the noise of the robot's torque


def test_every_other_byte_of_the_file_is_kept(patched: str) -> None:
    lines = list(zip(MJCF.splitlines(), patched.splitlines(), strict=True))
    changed = [(old, new) for old, new in lines if old != new]
    assert [old.split('name="')[1].split('"')[0] for old, _ in changed] == list(JOINTS)
    yaw = changed[0][1]
    assert yaw.startswith('      <joint name="yaw" axis="0 0 1" damping="0.9')
    assert yaw.endswith("frictionloss='0.4'/>")


def test_the_simulators_log_is_among_the_inputs(pair: Path, report: dict[str, Any]) -> None:
    inputs = {entry["kind"]: (entry["path"], entry["sha256"]) for entry in report["inputs"]}
    assert list(inputs) == ["URDF", "log", "simulator's log"]
    content = (pair / "simulator" / "run1.csv").read_bytes()
    assert inputs["simulator's log"] == ("simulator/run1.csv", hashlib.sha256(content).hexdigest())


def test_a_urdf_is_patched_with_what_it_can_carry(pair: Path) -> None:
    done = idtool("export", "out", "--patch", "arm.urdf", "--out", "new.urdf", "--json", folder=pair)
    frictions = {("viscous_friction", "yaw"), ("coulomb_friction", "shoulder")}
    assert {(part["what"], part["of"]) for part in done.json["carried"]} == frictions
    assert {part["what"] for part in done.json["not_carried"]} == {"rotor_inertia", "time_delay"}
    text = (pair / "new.urdf").read_text()
    assert text.count("<dynamics") == 2
    assert re.sub(r"\s*<dynamics [^>]*/>", "", text) == URDF


@pytest.mark.slow
def test_among_all_effects_the_changes_are_the_same(pair: Path, report: dict[str, Any]) -> None:
    found = diagnosed(pair, "robot/run1.csv", "--against", "simulator", "--out", "all", "--no-simulation")["against"]
    assert set(by_owner(found["changes"])) == set(by_owner(report["against"]["changes"]))


@pytest.mark.slow
def test_a_robot_that_is_the_simulator_needs_no_change(pair: Path) -> None:
    again = Machine(MJCF, noise=0.02).play(12.0, seed=1)
    write_log(pair / "same.csv", again)
    found = diagnosed(pair, "same.csv", "--against", "simulator/run1.csv", "--out", "same", *EFFECTS)["against"]
    assert (found["changes"], found["inconclusive"]) == ([], "")
    start = "No change to make in the simulator was found. The torque error of its model on the robot's logs is "
    assert found["summary"].startswith(start)
    done = idtool("export", "same", "--patch", "scene.xml", "--out", "same.xml", folder=pair)
    assert done.out.startswith("nothing to change in the file\n")
    assert (pair / "same.xml").read_text() == MJCF
    (pair / "same.xml").write_text("patched earlier")
    done = idtool("export", "same", "--patch", "scene.xml", "--out", "same.xml", folder=pair)
    assert done.out.endswith("not written: same.xml is left as it was\n")
    assert (pair / "same.xml").read_text() == "patched earlier"
    done = idtool("export", "same", "--patch", "scene.xml", "--out", "same.xml", "--json", folder=pair)
    assert done.json["file"] is None


@pytest.mark.slow
def test_changes_that_only_make_up_for_each_other_are_not_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sample leg as its own simulator: the URDF's bodies are wrong, so each log gets effects of its own."""
    monkeypatch.setattr(LogPair, "is_unrelated", False)
    logs = (TRAIN, "--against", VALIDATE)
    done = idtool("diagnose", LEG, *logs, "--no-simulation", "--json", "--out", tmp_path)
    against = done.json["against"]
    assert against["torque_after"]["overall"] <= against["torque_before"]["overall"]
    assert against["changes"] == []
    codes = {notice["code"] for notice in done.json["notices"]}
    assert codes & {"simulator_bodies_differ", "simulator_unexplained"}
    assert "pair_differs" in codes  # the leg's two logs show different motions


@pytest.fixture(scope="module")
def heavy(pair: Path) -> Path:
    """Logs of a robot whose last link is heavier, and of the simulator at half the rate on another clock."""
    write_log(pair / "heavy.csv", Machine(HEAVY, noise=0.01).play(10.0, seed=2))
    rows = Machine(MJCF).play(10.0, seed=2)[::2]
    rows[:, 0] += 1000.0
    write_log(pair / "light.csv", rows)
    return pair


@pytest.mark.parametrize("inertia", ["fixed", pytest.param("refit", marks=pytest.mark.slow)])
def test_a_heavier_link_is_found_and_written(heavy: Path, inertia: str) -> None:
    found = diagnosed(heavy, "heavy.csv", "--against", "light.csv", "--inertia", inertia, "--out", inertia, *EFFECTS)
    changes = by_owner(found["against"]["changes"])
    if inertia == "fixed":
        assert list(changes) == [("payload", "lower")]
        assert changes["payload", "lower"]["mass"]["robot"] == pytest.approx(0.5, rel=0.05)
        assert changes["payload", "lower"]["mass"]["simulator"] is None
    else:
        assert set(changes) == {("rigid_body", name) for name in ("column", "upper", "lower")}
        assert changes["rigid_body", "lower"]["mass"]["simulator"] == 1.0
        assert "the inertia of the links (column, upper, lower)" in found["against"]["summary"]
    done = idtool("export", inertia, "--patch", "scene.xml", "--out", f"{inertia}.xml", folder=heavy)
    assert "inertial, mass 1 → 1." in done.out
    text = (heavy / f"{inertia}.xml").read_text()
    real, before, after = (Machine(scene).play(4.0, seed=5)[:, 7:] for scene in (HEAVY, MJCF, text))
    assert np.sqrt(np.mean(np.square(after - real))) < 0.1 * np.sqrt(np.mean(np.square(before - real)))


@pytest.mark.slow
def test_a_simulator_of_another_robot_is_named(heavy: Path) -> None:
    found = diagnosed(heavy, "light.csv", "--against", "heavy.csv", "--out", "other", *EFFECTS)
    (notice,) = [notice for notice in found["notices"] if notice["code"] == "simulator_bodies_differ"]
    assert notice["subject"] == "lower"
    assert "payload (mass 0.5" in notice["message"]


@pytest.mark.parametrize(
    ("entry", "is_foreign"),
    [
        ({"effect": "torque_gain", "joint": "elbow", "parameters": {"gain": 0.999}}, True),
        ({"effect": "gravity_tilt", "parameters": {"gravity": [0.1, 0.0, -9.81]}}, True),
        ({"effect": "payload", "link": "lower", "parameters": PAYLOAD}, True),
        ({"effect": "torque_saturation", "joint": "elbow", "parameters": {"level": 2.0, "bend": -0.1}}, False),
        ({"effect": "quadratic_drag", "joint": "elbow", "parameters": {"drag": 0.1}}, False),
        ({"effect": "rotor_inertia", "joint": "elbow", "parameters": {"inertia": 0.01}}, False),
    ],
    ids=lambda given: given["effect"] if isinstance(given, dict) else str(given),
)
def test_what_a_simulator_of_the_urdf_cannot_have(
    build: Callable[..., RobotModel], entry: dict[str, Any], is_foreign: bool
) -> None:
    model = build(URDF, JOINTS)
    effect = effect_from_entry(EffectEntry(**entry), model)
    assert _is_foreign_to_simulators(effect, model) is is_foreign


def test_logs_of_different_motions_are_refused_before_any_search(
    pair: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("arm.urdf", "robot"):
        source = pair / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    (tmp_path / "simulator").mkdir()
    monkeypatch.setattr("idtool.diagnosis.comparison.diagnose", None)
    other = Machine(MJCF).play(12.0, seed=7)
    ran_away = other.copy()
    ran_away[:, 1:4] += np.square(other[:, :1])
    for rows in (other, ran_away):
        write_log(tmp_path / "simulator" / "run1.csv", rows)
        arguments = ("diagnose", "arm.urdf", "robot/run1.csv", "--against", "simulator", "--out", "out")
        naming = "simulator/run1.csv: does not show the motion of the robot's log robot/run1.csv: the positions differ"
        refuse(tmp_path, *arguments, naming=naming)
        shutil.rmtree(tmp_path / "out")


@pytest.mark.slow
def test_a_log_with_jumps_makes_the_comparison_inconclusive(pair: Path) -> None:
    """As that of a simulation that restarts from the measured state every 2 s."""
    table = pair / "simulator" / "run1.csv"
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    rows[:, 1:4] += 0.05 * (rows[:, :1] % 2)
    write_log(pair / "jumps.csv", rows)
    found = diagnosed(pair, "robot/run1.csv", "--against", "jumps.csv", "--out", "jumps", *EFFECTS)
    against = found["against"]
    assert found["verdict"] == "partly_explained"
    assert "have jumps, as after restarts (5 jumps of q on yaw, " in against["inconclusive"]
    assert against["summary"].startswith(f"The comparison is not conclusive: {against['inconclusive']}. ")
    assert found["next"][0] == against["advice"]
    assert "use `--closed-loop`, `--track` or `--window 0`" in against["advice"]
    assert not any(text.startswith(("Make the changes", "Check the final model")) for text in found["next"])
    page = (pair / "jumps" / "diagnosis.html").read_text()
    assert '<li class="note"><b>Against the simulator.</b> The comparison is not conclusive' in page


def test_logs_of_motions_that_are_hardly_alike_are_named() -> None:
    log_pair = LogPair(
        measured=Path("robot/log.csv"),
        simulated=Path("simulator/log.csv"),
        offset=0.0,
        seconds=10.0,
        torque=None,
        position={"yaw": 0.4, "overall": 0.4},
        motion={"yaw": 0.5, "overall": 0.5},
    )
    (notice,) = _pair_notices([log_pair], {"yaw": "N·m"})
    assert notice.message == (
        "robot/log.csv and simulator/log.csv do not show the same motion: the positions differ by 0.4 rad RMS, and the "
        "robot moves by 0.5 rad RMS"
    )


@pytest.mark.slow
def test_the_delay_of_a_position_controller_is_compared(tmp_path: Path) -> None:
    """Logs with commands and no torque; the torque is that of the controller in the configuration."""
    (tmp_path / "arm.urdf").write_text(URDF)
    gains = {"kp": dict(zip(JOINTS, KP.tolist(), strict=True)), "kd": dict(zip(JOINTS, KD.tolist(), strict=True))}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump({"controller": gains}))
    for name, machine in {"robot": Machine(MJCF, ROBOT, command_delay=0.006), "simulator": Machine(MJCF)}.items():
        write_log(tmp_path / f"{name}.csv", machine.play(12.0, seed=1, commands=True), commands=True)
    found = diagnosed(tmp_path, "robot.csv", "--against", "simulator.csv", "--out", "out", *EFFECTS)["against"]
    changes = by_owner(found["changes"])
    assert set(changes) == {*CHANGED, ("command_delay", None)}
    delay = changes["command_delay", None]["delay"]
    assert delay["robot"] - delay["simulator"] == pytest.approx(0.006, rel=0.05)
    for owner, (name, before, after) in CHANGED.items():
        assert changes[owner][name]["robot"] == pytest.approx(after, rel=0.1)
        assert changes[owner][name]["simulator"] == pytest.approx(before, rel=0.1, abs=2e-3)
    done = idtool("export", "out", "--patch", "arm.urdf", "--json", folder=tmp_path)
    assert ("command_delay", "the controller") in {(part["what"], part["of"]) for part in done.json["not_carried"]}


def test_what_cannot_be_paired_is_refused(pair: Path, tmp_path: Path) -> None:
    for name in ("arm.urdf", "robot", "simulator"):
        source = pair / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    log, simulated = tmp_path / "robot" / "run1.csv", tmp_path / "simulator" / "run1.csv"
    lines = simulated.read_text().splitlines()
    (tmp_path / "short.csv").write_text("\n".join(lines[:3000]) + "\n")
    without_elbow = [",".join(line.split(",")[:3] + line.split(",")[4:]) for line in lines]
    (tmp_path / "elbow.csv").write_text("\n".join(without_elbow) + "\n")
    (tmp_path / "robot" / "run2.csv").write_bytes(log.read_bytes())
    command = ("diagnose", "arm.urdf", "robot/run1.csv", "--out", "out", "--against")
    refuse(tmp_path, *command, "short.csv", naming="lasts 3 s, and run1.csv lasts 12 s", file="short.csv")
    shutil.rmtree(tmp_path / "out")
    refuse(tmp_path, *command, "elbow.csv", naming="no position of joint elbow", file="elbow.csv")
    shutil.rmtree(tmp_path / "out")
    refuse(tmp_path, *command, "nowhere.csv", naming="there is no such file", file="nowhere.csv")
    shutil.rmtree(tmp_path / "out")
    refuse(tmp_path, *command, "simulator", "robot/run2.csv", naming="no log named run2", file="simulator")
    shutil.rmtree(tmp_path / "out")
    both = ("simulator/run1.csv", "--against", "simulator/run1.csv")
    refuse(tmp_path, *command, *both, naming="2 simulated for 1 measured", file="--against")
    for name in ("robot/run1.csv", "robot/run2.csv"):  # a copy
        shutil.rmtree(tmp_path / "out")
        naming = f"{name}: is the same recording as the robot's log run1.csv; as --against, give the simulator's"
        refuse(tmp_path, *command, name, naming=naming)


def test_what_cannot_be_patched_is_refused(pair: Path, tmp_path: Path) -> None:
    shutil.copytree(pair / "out", tmp_path / "model")
    (tmp_path / "scene.xml").write_text(MJCF)
    (tmp_path / "other.xml").write_text(MJCF.replace('name="elbow"', 'name="elbow_joint"'))
    (tmp_path / "parts.xml").write_text('<mujoco><include file="arm.xml"/><worldbody/></mujoco>')
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    (tmp_path / "site.xml").write_text("<html/>")
    (tmp_path / "entities.xml").write_text("<!DOCTYPE mujoco><mujoco/>")
    cases = {
        ("scene.xml", "--out", "scene.xml"): "is an input file",
        ("other.xml",): "has no joint named elbow; did you mean elbow_joint?",
        ("parts.xml",): "give the file that it includes",
        ("empty.xml",): "has no <worldbody>",
        ("site.xml",): "is neither MJCF nor URDF",
        ("entities.xml",): "declares a document type",
        ("nowhere.xml",): "cannot be read",
        ("scene.xml", "--to", "mujoco"): "--to: is not for --patch",
    }
    for arguments, what in cases.items():
        refuse(tmp_path, "export", "model", "--patch", *arguments, naming=what)
        shutil.rmtree(tmp_path / "out")
    (tmp_path / "model" / "diagnosis.json").write_text("{}")
    refuse(tmp_path, "export", "model", "--patch", "scene.xml", naming="is not the result of idtool diagnose")


def test_robot_differs_from_the_file_as_the_table_says() -> None:
    """That the truth of this module is that of the robot."""
    values = {(joint, name): value for joint, changes in ROBOT.items() for name, value in changes.items()}
    assert values == {
        ("yaw", "damping"): CHANGED["viscous_friction", "yaw"][2],
        ("shoulder", "frictionloss"): CHANGED["coulomb_friction", "shoulder"][2],
        ("shoulder", "armature"): CHANGED["rotor_inertia", "shoulder"][2],
        ("elbow", "armature"): CHANGED["rotor_inertia", "elbow"][2],
    }

"""Logs that are no use: unreadable, without samples, without what a fit needs, or in a state that tells nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import JOINTS, LEG, TRAIN, Row, column_set, columns_kept, config_with, csv_text, refuse, sample_table
from recordings import NAME, ROS2, Channel, State, ros2, states, write_mcap

TABLE = sample_table(1200)
HEADER, *SAMPLES = TABLE
LEG_YAML = LEG.with_suffix(".yaml")


def still(joint: str, table: list[Row] = TABLE) -> list[Row]:
    """The table with a joint that stands still."""
    return column_set(column_set(table, f"q_{joint}", lambda i: 0.1), f"v_{joint}", lambda i: 0)


def lacking(*starts: str) -> list[Row]:
    """The table without the columns that begin so."""
    return columns_kept(TABLE, lambda name: not name.startswith(starts))


def every(value: object) -> list[Row]:
    """The table with all but the time set to a value."""
    return [HEADER, *([row[0], *[str(value)] * (len(row) - 1)] for row in SAMPLES)]


CSV: dict[str, tuple[bytes | list[Row], str]] = {
    "empty": (b"", "is empty; check the logger, or give another log"),
    "blank lines": (b"\n\n\n", "is not a log"),
    "zeros": (bytes(5000), "is not a log"),
    "binary": (bytes(range(256)) * 20, "is not a log"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "is not a log"),
    "UTF-16": (csv_text(TABLE).encode("utf-16"), "is not a log"),
    "JSON": (b'{"q_hip": [1, 2, 3]}', "is not a log"),
    "only a header": ([HEADER], "has no samples"),
    "one sample": (TABLE[:2], "at least two"),
    "two samples": (TABLE[:3], "lasts 0.002 s"),
    "too short for the filter": (TABLE[:60], "no segment without gaps is longer than the"),
    "too short to fit": (TABLE[:101], "log.csv: "),
    "words in place of numbers": (column_set(TABLE, "q_hip", lambda i: "far"), "line 2, column q_hip: 'far' is no"),
    "one word": (column_set(TABLE, "v_hip", lambda i: "x" if i == 700 else 1), "line 702, column v_hip: 'x' is no"),
    "a line that is short": ([*TABLE[:500], ["1", "2"], *TABLE[500:]], "line 501 has 2 cells"),
    "a line that is long": ([*TABLE[:500], ["1"] * 20, *TABLE[500:]], "line 501 has 20 cells"),
    "nothing but nan": (every("nan"), "has no samples"),
    "nothing but infinity": (every("inf"), "no joint positions"),
    "one joint's position is nan": (column_set(TABLE, "q_hip", lambda i: "nan"), "joint hip has no position"),
    "one joint's position is infinite": (column_set(TABLE, "q_hip", lambda i: "inf"), "joint hip has no position"),
    "a position beyond all bounds": (column_set(TABLE, "q_hip", lambda i: 1e300), "q of joint hip reaches 1e+300"),
    "one torque beyond all bounds": (
        column_set(TABLE, "tau_hip", lambda i: -1e160 if i == 500 else 1),
        "tau of joint hip reaches 1e+160",
    ),
    "a velocity beyond all bounds": (column_set(TABLE, "v_hip", lambda i: 1e200), "v of joint hip reaches 1e+200"),
    "a time that stands still": (column_set(TABLE, "t", lambda i: 1.0), "time does not advance"),
    "a time that runs backwards": (column_set(TABLE, "t", lambda i: -i), "time does not advance"),
    "a time of nan": (column_set(TABLE, "t", lambda i: "nan"), "time does not advance"),
    "no time": (columns_kept(TABLE, lambda name: name != "t"), "no time column"),
    "two columns of one name": ([[*HEADER[:-1], "q_hip"], *SAMPLES], "two columns q_hip"),
    "two columns of one signal": ([[*HEADER[:-1], "hip.position"], *SAMPLES], "both match q_hip"),
    "no positions": (lacking("q_"), "no joint positions"),
    "no position of one joint": (lacking("q_hip"), "joint hip has no position"),
    "no torque and no command": (lacking("tau_"), "joint abad has neither torque nor position command"),
    "no torque of one joint": (lacking("tau_knee"), "joint knee has neither torque nor position command"),
    "a command and no controller": (
        [["qcmd_hip" if name == "tau_hip" else name for name in HEADER], *SAMPLES],
        "joint hip has no torque; set its gains controller.kp and kd",
    ),
    "joints of another robot": ([[name.replace("_", "_x") for name in HEADER], *SAMPLES], "abad"),
    "one joint is missing": (lacking("q_hip", "v_hip", "tau_hip"), "joints: hip: is not in every log"),
    "a joint that never moves": (still("hip"), "joint hip hardly moves"),
    "no joint moves": (still("abad", still("hip", still("knee"))), "hardly moves"),
    "all zero": (every(0), "hardly moves"),
    "a name that moves the cursor": ([["q_\x9b2Jhip" if n == "q_hip" else n for n in HEADER], *SAMPLES], "printed"),
}


@pytest.mark.parametrize(("contents", "naming"), CSV.values(), ids=CSV)
def test_csv(tmp_path: Path, contents: bytes | list[Row], naming: str) -> None:
    data = contents if isinstance(contents, bytes) else csv_text(contents).encode()
    (tmp_path / "log.csv").write_bytes(data)
    file = "" if naming.startswith("joints: ") or naming == "abad" else "log.csv: "
    refuse(tmp_path, "fit", LEG, "log.csv", "--out", "out", file=file, naming=naming)


def a_channel(topic: str, encoding: str, *schema: str, payload: bytes = b"{}") -> Channel:
    """Two messages that are not joint states, or claim to be."""
    name, kind, text = schema
    return Channel(topic, [1, 2], [payload] * 2, encoding, (name, kind, text.encode()))


def moving(count: int = 3000) -> list[State]:
    """States of the leg's joints, too wild for a motion."""
    return states(count)


MCAP: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no messages": (lambda path: write_mcap(path, ros2([])), "no topic carries joint states"),
    "no topics": (lambda path: write_mcap(path, Channel("/x", [], [])), "no topic carries joint states"),
    "no joint states": (
        lambda path: write_mcap(path, a_channel("/imu", "json", "Imu", "jsonschema", "{}")),
        "no topic carries joint states (sensor_msgs/msg/JointState); available: /imu (Imu, json)",
    ),
    "two topics of joint states": (
        lambda path: write_mcap(path, ros2(moving()), ros2(moving(), "/arm/joint_states")),
        "2 topics carry joint states; set log.topic to one of /joint_states, /arm/joint_states",
    ),
    "messages that are not joint states": (
        lambda path: write_mcap(path, a_channel("/x", "cdr", NAME, "ros2msg", ROS2, payload=b"nonsense")),
        "message 1 of /x",
    ),
    "JSON that is none": (
        lambda path: write_mcap(path, a_channel("/joint_states", "json", "JointState", "jsonschema", "{}")),
        "message 1 of /joint_states is not a joint state",
    ),
    "one message": (lambda path: write_mcap(path, ros2(moving(1))), "at least two"),
    "joints of another robot": (
        lambda path: write_mcap(path, ros2(states(3000, ("a", "b")))),
        "joints: abad: is not in every log; the joints in every log: a, b",
    ),
    "noise in place of a motion": (lambda path: write_mcap(path, ros2(moving())), "log.mcap: "),
    "cut off in its first bytes": (lambda path: path.write_bytes(TRAIN.read_bytes()[:5]), "log.mcap: "),
    "cut off behind the magic": (lambda path: path.write_bytes(TRAIN.read_bytes()[:8]), "before its first message"),
    "cut off in its header": (lambda path: path.write_bytes(TRAIN.read_bytes()[:30]), "before its first message"),
    "cut off in its first chunk": (lambda path: path.write_bytes(TRAIN.read_bytes()[:1000]), "cut off before its"),
    "damaged in the middle": (
        lambda path: path.write_bytes((data := TRAIN.read_bytes())[:1000] + bytes(8) + data[1008:]),
        "is damaged near byte",
    ),
    "a version that does not exist": (
        lambda path: path.write_bytes(TRAIN.read_bytes().replace(b"MCAP0", b"MCAP9", 1)),
        "unknown version",
    ),
}


@pytest.mark.parametrize(("make", "naming"), MCAP.values(), ids=MCAP)
def test_mcap(tmp_path: Path, make: Callable[[Path], Any], naming: str) -> None:
    make(tmp_path / "log.mcap")
    file = "" if naming.startswith("joints: ") else "log.mcap: "
    refuse(tmp_path, "fit", LEG, "log.mcap", "--out", "out", file=file, naming=naming)


OPTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "a topic that is not there": ({"topic": "/states"}, "has no topic /states; did you mean /joint_states?"),
    "a scale of an unknown joint": (
        {"scale": {"tau": {"hipp": 2}}},
        "log.scale: tau: the log has no joint hipp; did y",
    ),
    "a scale of a signal that is not there": ({"scale": {"qcmd": {"hip": 2}}}, "log.scale: the log has no qcmd"),
}


@pytest.mark.parametrize("command", ["fit", "validate", "inspect"])
@pytest.mark.parametrize(("options", "naming"), OPTIONS.values(), ids=OPTIONS)
def test_options_that_do_not_fit(tmp_path: Path, options: dict[str, Any], naming: str, command: str) -> None:
    config = config_with(tmp_path / "c.yaml", LEG_YAML, log=options)
    urdf = [] if command == "inspect" else [LEG, "--out", "out"]
    refuse(tmp_path, command, *urdf, TRAIN, "--config", config, file=f"{TRAIN}: ", naming=naming)


@pytest.mark.parametrize(
    ("columns", "naming"),
    [
        ({"t": "clock"}, "has no column clock"),
        ({"torque": "tau_hip"}, "log.columns: torque is not a canonical name"),
        ({"v_hip": "tau"}, "has no column tau; did you mean tau_"),
    ],
)
def test_columns_that_are_not_there(tmp_path: Path, columns: dict[str, str], naming: str) -> None:
    (tmp_path / "log.csv").write_text(csv_text(TABLE))
    config = config_with(tmp_path / "c.yaml", LEG_YAML, log={"columns": columns})
    refuse(tmp_path, "fit", LEG, "log.csv", "--config", config, file="log.csv: ", naming=naming)


@pytest.mark.parametrize(
    ("gains", "joint"), [({"kp": {"abad": 20, "hip": 20}}, "knee"), ({"kp": {}, "kd": {"abad": 1}}, "abad")]
)
def test_a_controller_without_a_joints_gain(tmp_path: Path, gains: dict[str, Any], joint: str) -> None:
    commands = {f"tau_{name}": f"qcmd_{name}" for name in JOINTS}
    table = [[commands.get(name, name) for name in HEADER], *SAMPLES]
    (tmp_path / "log.csv").write_text(csv_text(table))
    config = config_with(tmp_path / "c.yaml", LEG_YAML, controller=gains)
    naming = f"joint {joint} has no torque; set its gains controller.kp and kd"
    refuse(tmp_path, "fit", LEG, "log.csv", "--config", config, file="log.csv: ", naming=naming)


@pytest.mark.parametrize("command", ["fit", "validate", "inspect"])
@pytest.mark.parametrize(("path", "naming"), [("none.csv", "there is no such file"), (".", "is a folder")])
def test_files(tmp_path: Path, command: str, path: str, naming: str) -> None:
    urdf = [] if command == "inspect" else [LEG]
    refuse(tmp_path, command, *urdf, path, file=f"{path}: ", naming=naming)


def test_a_pipe_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    refuse(tmp_path, "inspect", "pipe", naming="pipe: ")


def test_times_in_milliseconds_are_said_where_the_filter_cannot_be(tmp_path: Path) -> None:
    table = [HEADER, *([repr(float(row[0]) * 1000), *row[1:]] for row in SAMPLES)]
    (tmp_path / "log.csv").write_text("\n".join(",".join(map(str, row)) for row in table))
    refuse(tmp_path, "fit", LEG, "log.csv", naming="its times seem to be in ms, not in s")

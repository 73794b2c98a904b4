"""Pairs of logs: which belongs to which, and their common clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from idtool.common.exceptions import IdtoolError
from idtool.data.logs import JointLog, make_log
from idtool.data.pairing import align, check_joints, paired_paths

JOINTS = ("hip", "knee")


def log(
    start: float, seconds: float, dt: float, stamp: float = 0.0, torque: float = 1.0, commands: bool = False
) -> JointLog:
    """A log of one motion, from some time on; its own clock starts at ``stamp``."""
    t = np.arange(0.0, seconds, dt)
    chirp = np.sin(2 * np.pi * (0.3 + 0.05 * (t + start)) * (t + start))
    q = np.stack([chirp, 0.5 * np.cos(2.2 * (t + start)) * chirp], axis=1)
    signals = {"q": q, "tau": torque * q}
    if commands:
        late = t + start + 0.2
        command = np.sin(2 * np.pi * (0.3 + 0.05 * late) * late)
        signals["qcmd"] = np.stack([command, command], axis=1)
    return make_log(Path(f"{start:g}.csv"), t + stamp, JOINTS, signals)


@pytest.mark.parametrize(("shift", "found"), [(0.0, 0.0), (0.03, 0.0), (1.7, 1.7), (-2.4, -2.4)])
def test_the_offset_of_two_clocks_is_found_and_a_delay_is_none(shift: float, found: float) -> None:
    """A simulator at another rate whose log starts later than the robot's, or earlier."""
    pair = align(log(5.0, 10.0, 0.001, stamp=1e6), log(5.0 + shift, 10.0, 0.004, torque=1.5), JOINTS)
    assert pair.offset == pytest.approx(found, abs=0.004)
    assert pair.seconds == pytest.approx(10.0 - abs(found), abs=0.01)
    if shift == found:
        assert pair.position["overall"] < 0.02
        assert pair.torque is not None
        assert pair.torque["hip"] == pytest.approx(0.5 * np.sqrt(0.5), rel=0.1)
    else:
        assert pair.position["hip"] > 0.02


def test_commands_tell_the_offset_better_than_positions() -> None:
    """The robot lags by 0.2 s, which the commands show; by the positions alone it would be one of the clocks."""
    robot, simulator = log(5.0, 10.0, 0.001, commands=True), log(5.2, 10.0, 0.001)
    signals = {**simulator.signals, "qcmd": robot.signals["qcmd"]}
    late = make_log(simulator.path, simulator.t, JOINTS, signals)
    assert align(robot, late, JOINTS).offset == 0.0
    assert align(robot, simulator, JOINTS).offset == pytest.approx(0.2, abs=0.002)


def test_a_missing_torque_is_no_torque() -> None:
    robot = log(0.0, 5.0, 0.001)
    silent = make_log(Path("silent.csv"), robot.t, JOINTS, {"q": robot.signals["q"]})
    pair = align(robot, silent, JOINTS)
    assert (pair.torque, pair.position["overall"]) == (None, 0.0)


def test_motions_under_other_commands_are_told_from_a_poor_simulator() -> None:
    robot = log(0.0, 10.0, 0.001)
    q = robot.signals["q"]
    poor = make_log(Path("poor.csv"), robot.t, JOINTS, {"q": 1.3 * q + 0.1})
    other = make_log(Path("other.csv"), robot.t, JOINTS, {"q": np.sin(2.2 * robot.t[:, None] + np.arange(2))})
    assert align(robot, poor, JOINTS).moves_alike
    assert not align(robot, other, JOINTS).moves_alike


def test_lengths_and_joints_must_go_together() -> None:
    with pytest.raises(IdtoolError, match=r"lasts 2 s, and 0\.csv lasts 10 s"):
        align(log(0.0, 10.0, 0.001), log(0.0, 2.0, 0.001), JOINTS)
    with pytest.raises(IdtoolError, match="no position of joint ankle"):
        check_joints(log(0.0, 2.0, 0.001), (*JOINTS, "ankle"))


def test_a_folder_is_paired_by_name_whatever_the_format(tmp_path: Path) -> None:
    names = ("run1.mcap", "run2.csv", "notes.txt", ".run1.swp")
    for name in names:
        (tmp_path / name).touch()
    bag = tmp_path / "run3"
    bag.mkdir()
    logs = [Path("robot/run2.mcap"), Path("robot/run1.csv"), Path("robot/run3.csv")]
    assert paired_paths(logs, [tmp_path]) == [tmp_path / "run2.csv", tmp_path / "run1.mcap", bag]
    (bag / "metadata.yaml").touch()
    assert paired_paths(logs[:1], [bag]) == [bag]  # a rosbag2 folder is one log
    assert paired_paths(logs[:2], [Path("a.csv"), Path("b.csv")]) == [Path("a.csv"), Path("b.csv")]
    with pytest.raises(IdtoolError, match=r"no log named run4 for run4\.csv"):
        paired_paths([Path("run4.csv")], [tmp_path])
    (tmp_path / "run1.csv").touch()
    with pytest.raises(IdtoolError, match=r"2 logs named run1"):
        paired_paths(logs, [tmp_path])

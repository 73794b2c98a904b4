"""The delay from command to torque of a robot with rotors that its model lacks; MuJoCo is the robot."""

from __future__ import annotations

from pathlib import Path

import pytest
from disturbed import silent
from simulator_pair import JOINTS, KD, KP, MJCF, ROBOT, URDF, Machine, write_log

from idtool.diagnosis.unbiased_delay import with_unbiased_delay
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

DELAY, HELD = 0.006, 0.0005  # s: of the command, and half of a sample, over which a command is held


def test_rotors_that_the_model_lacks_do_not_move_the_delay(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF)
    robot = Machine(MJCF, ROBOT, command_delay=DELAY)
    write_log(tmp_path / "robot.csv", robot.play(12.0, seed=1, commands=True), commands=True)
    kp = dict(zip(JOINTS, KP.tolist(), strict=True))
    kd = dict(zip(JOINTS, KD.tolist(), strict=True))
    config = parse_config({"controller": {"kp": kp, "kd": kd, "delay": "auto"}}, "")
    experiment = prepare(read_robot(tmp_path / "arm.urdf"), config, [tmp_path / "robot.csv"], holdout=0.3)

    _, biased, _ = with_delay(experiment, silent)
    fitted, _ = with_unbiased_delay(experiment, silent)
    assert biased is not None
    assert fitted.config.controller is not None
    delay = fitted.config.controller.known_delay
    assert delay is not None
    assert delay.value == pytest.approx(DELAY + HELD, abs=1e-4)
    assert biased.value > DELAY + HELD + 5e-4
    assert fitted.config.effects == ()

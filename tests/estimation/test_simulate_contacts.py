"""`simulate` of robots that touch something: only while no contact force acts, and as MuJoCo moves them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import config_text, write_csv
from ground.quadruped import JOINTS
from ground.robot import urdf_text as quadruped_urdf
from quadruped_recordings import TRUTH, record_quadruped
from sensor_arm import COULOMB, SENSOR, Push, urdf_text, write_log
from sensor_arm import JOINTS as ARM_JOINTS

import idtool
from idtool.common.exceptions import LogError
from idtool.common.safe_yaml import parse_yaml

PUSH = Push(np.array([12.0, -8.0, 15.0, 0.0, 0.0, 0.0]), np.array([0.2, 0.01, 0.03]))
SECONDS = 8.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robots")
    for kind in ("stand", "hang"):
        write_csv(path / f"{kind}.csv", record_quadruped(kind, 4.0))
    (path / "quadruped.urdf").write_text(quadruped_urdf(TRUTH))
    (path / "arm.urdf").write_text(urdf_text())
    write_log(path / "touched.csv", SECONDS, np.zeros(6), push=PUSH)
    return path


def quadruped(folder: Path) -> idtool.Model:
    """The true robot."""
    content = parse_yaml(Path("quadruped.yaml"), config_text(TRUTH, "unknown").encode())
    friction = {}
    for joint, viscous, coulomb in zip(JOINTS, TRUTH.viscous, TRUTH.coulomb, strict=True):
        friction[joint] = {"viscous": float(viscous), "coulomb": float(coulomb)}
    return idtool.Model(folder / "quadruped.urdf", config={**dict(content), "friction": friction})


def arm(folder: Path, **contact: Any) -> idtool.Model:
    """The true arm with an unknown force on its hand."""
    friction = {name: {"viscous": 0.0, "coulomb": COULOMB} for name in ARM_JOINTS}
    tool = {"name": "tool", "link": "hand", "point": [*PUSH.point], "flag": "contact_tool", "widen": 0.01, **contact}
    return idtool.Model(folder / "arm.urdf", config={"contacts": [tool], "friction": friction})


def test_hanging_legs_move_as_in_mujoco_and_the_log_is_read_again(folder: Path, tmp_path: Path) -> None:
    model = quadruped(folder)
    run = idtool.simulate(model, folder / "hang.csv", window=0.5)
    assert run.log.joints == JOINTS
    measured = idtool.read_log(folder / "hang.csv")
    travel = float(np.std(measured.q, axis=0).mean())
    assert run.rmse.position is not None
    assert run.rmse.position["overall"] < 0.1 * travel
    assert set(run.report.units) == set(JOINTS)
    steady = idtool.simulate(model, folder / "hang.csv", window=0)
    of_log = idtool.validate(model, folder / "hang.csv", simulation=False).rms.model
    for name in ("simulated.csv", "simulated.mcap"):
        steady.save(tmp_path / name)
        again = idtool.validate(model, tmp_path / name, simulation=False).rms.model
        errors = {joint: (again[joint] or np.nan, of_log[joint] or np.nan) for joint in JOINTS}
        assert all(own < 1.5 * noise for own, noise in errors.values()), errors


def test_standing_robot_is_not_simulated(folder: Path) -> None:
    with pytest.raises(
        LogError, match=r"stand\.csv: cannot be simulated: .* acts on the joints all the time; .* hangs"
    ):
        idtool.simulate(quadruped(folder), folder / "stand.csv")


def test_arm_is_simulated_between_touches(folder: Path, tmp_path: Path) -> None:
    run = idtool.simulate(arm(folder), folder / "touched.csv", window=0)
    assert run.report.log_seconds == pytest.approx(SECONDS, abs=0.01)
    free_seconds = (1 - PUSH.share) * SECONDS
    assert run.seconds == pytest.approx(free_seconds, rel=0.1)
    (notice,) = [notice for notice in run.notices if notice.code == "simulated_without_contact"]
    assert f"{run.seconds:.3g} s of {SECONDS:g} s" in notice.message
    assert len(run.log.segments) == SECONDS / PUSH.period
    assert not PUSH.is_touched(run.log.t).any()
    assert run.rmse.position is not None
    assert run.rmse.position["overall"] < 0.1 * np.std(run.log.q)
    run.save(tmp_path / "simulated.csv")
    again = idtool.simulate(arm(folder), tmp_path / "simulated.csv")
    assert again.seconds > 0.8 * run.seconds


def test_readings_of_wrench_sensors_are_not_simulated(folder: Path) -> None:
    sensors = [{"joint": SENSOR}]
    model = idtool.Model(folder / "arm.urdf", config={**arm(folder).config, "wrench_sensors": sensors})
    run = idtool.simulate(model, folder / "touched.csv")
    assert set(run.log.record.channels) == {"contact_tool"}
    assert run.log.joints == ARM_JOINTS
    assert "wrench_sensors_not_simulated" in [notice.code for notice in run.notices]
    write_log(folder / "without_torque.csv", 2.0, np.zeros(6), with_torque=False)
    without_contacts = idtool.Model(folder / "arm.urdf", config={"wrench_sensors": sensors})
    with pytest.raises(LogError, match="has no torque of turn, lift, bend"):
        idtool.simulate(without_contacts, folder / "without_torque.csv")


def test_arm_that_always_touches_is_not_simulated(folder: Path) -> None:
    with pytest.raises(LogError, match=r"acts on the joints all the time; .* check the flags"):
        idtool.simulate(arm(folder, flag=None), folder / "touched.csv")


def test_controller_tracks_the_arm_between_touches(folder: Path) -> None:
    model = arm(folder)
    gains = {"kp": dict.fromkeys(ARM_JOINTS, 200.0), "kd": dict.fromkeys(ARM_JOINTS, 8.0), "delay": 0.0}
    tracking = idtool.Model(folder / "arm.urdf", config={**model.config, "controller": gains})
    run = idtool.simulate(tracking, folder / "touched.csv", track=True)
    assert run.kind == "closed_loop"
    assert len(run.log.segments) == SECONDS / PUSH.period
    assert run.rmse.position is not None
    assert run.rmse.position["overall"] < 0.3 * np.std(run.log.q)

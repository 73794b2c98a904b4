"""`idtool excite --stand`: the command, and the quadruped in MuJoCo along what it designs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import idtool
from exciting import derivatives
from ground.logs import Recording, config_text, record, write_csv
from ground.playback import play
from ground.quadruped import FEET, JOINTS
from ground.robot import prior_robot, urdf_text
from quadruped_recordings import TRUTH, record_quadruped

import idtool as api
from idtool.common.safe_yaml import parse_yaml
from idtool.data.logs import read_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("standing")
    (path / "quadruped.urdf").write_text(urdf_text(prior_robot(TRUTH, 0)))
    (path / "quadruped.yaml").write_text(config_text(TRUTH))
    return path


@pytest.fixture(scope="module")
def report(folder: Path) -> dict[str, Any]:
    options = ("--stand", "--duration", "3", "--slow", "0", "--iterations", "1", "--rate", "200", "--noise", "0.05")
    done = idtool("excite", folder / "quadruped.urdf", *options, "--json", "--out", folder / "stand.csv")
    assert done.code == 0, done.err
    return done.json


def test_the_ground_and_all_limits_are_respected(report: dict[str, Any]) -> None:
    standing = report["standing"]
    assert set(standing["feet"]) == set(FEET)
    for foot in standing["feet"].values():
        assert foot["friction_coefficient"] < 0.45
        assert foot["min_force"] > 0.44 * 9.81 * TRUTH.mass / 4
        assert foot["pressure"] is None
    assert 0.3 < standing["tightest_use"] <= 1
    assert max(abs(end) for end in standing["base"]["base_yaw"]) > 0.01
    assert report["criteria"]["design"]["d"] <= report["criteria"]["random"]["d"]
    assert "robot_must_stand" in [notice["code"] for notice in report["notices"]]
    for use in report["use"].values():
        assert max(use.values()) <= 1


def test_commands_are_consistent_and_begin_and_end_at_rest(report: dict[str, Any]) -> None:
    log = read_log(report["file"])
    assert log.joints == JOINTS
    _, v, _ = derivatives(log)
    np.testing.assert_allclose(log.signals["vcmd"][2:-2], v, atol=2e-3)
    assert np.abs(log.signals["vcmd"][[0, -1]]).max() < 1e-9
    home = [report["home"][joint] for joint in JOINTS]
    np.testing.assert_allclose(log.signals["qcmd"][[0, -1]], [home, home], atol=1e-8)
    np.testing.assert_allclose(home, np.tile([0, 0.75, -1.5], 4), atol=0.05)


def test_page_and_terminal_show_the_feet(report: dict[str, Any]) -> None:
    page = Path(report["file"]).with_suffix(".html").read_text()
    assert "Feet on the ground" in page
    assert "The tightest limit is" in page


@pytest.mark.slow
@pytest.mark.parametrize("base_sensor", ["pose", "imu and pose"])
def test_pose_of_the_base_may_be_configured(folder: Path, base_sensor: str) -> None:
    """In place of an IMU or beside it: errors are predicted all the same."""
    content = dict(parse_yaml(folder / "quadruped.yaml", config_text(TRUTH).encode()))
    base = dict(content["base"])
    if base_sensor == "pose":
        del base["imu"]
    model = api.Model(folder / "quadruped.urdf", config={**content, "base": {**base, "pose": {}}})
    result = api.excite(model, stand=True, duration=3, slow=0.0, iterations=1, rate=100, noise=0.05)
    assert result.base_parameters


@pytest.mark.slow
def test_errors_are_predicted_in_the_band_of_a_pose(folder: Path) -> None:
    """12 Hz, as `fit` has it for a base without IMU, though the joints' rate allows 40 Hz."""
    content = dict(parse_yaml(folder / "quadruped.yaml", config_text(TRUTH, base_sensor="pose").encode()))
    errors = {}
    for band in (None, 12.0, 40.0):
        config = content if band is None else {**content, "filter": {"cutoff_hz": band}}
        model = api.Model(folder / "quadruped.urdf", config=config)
        options: dict[str, Any] = {"duration": 3, "slow": 0.0, "iterations": 0, "rate": 200, "noise": 0.05}
        result = api.excite(model, stand=True, max_frequency=1.0, **options)
        errors[band] = np.array([p.standard_error for p in result.base_parameters], dtype=float)
    np.testing.assert_allclose(errors[None], errors[12.0])
    assert np.median(errors[None] / errors[40.0]) > 1.3


@pytest.mark.slow
def test_logs_whose_torque_wrench_sensors_replace_are_refused(folder: Path) -> None:
    columns = record_quadruped("stand", 1.0).columns
    without_torque = {name: x for name, x in columns.items() if not name.startswith("tau_")}
    write_csv(folder / "without_torque.csv", Recording(without_torque))
    content = dict(parse_yaml(folder / "quadruped.yaml", config_text(TRUTH).encode()))
    model = api.Model(folder / "quadruped.urdf", config={**content, "wrench_sensors": [{"joint": "FL_foot_joint"}]})
    message = (
        r"without_torque\.csv: no torque was logged of .*FL_hip_joint.*leaves out the wrench sensors that replace it"
    )
    with pytest.raises(api.LogError, match=message):
        api.excite(model, logs=[folder / "without_torque.csv"], stand=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--feet", "FL_foot"], "--feet: is for a robot that stands; add --stand"),
        (["--sole-size", "0.1", "0.1"], "--sole-size: is for a robot that stands; add --stand"),
        (["--stand", "--ground-friction", "0"], "--ground-friction: 0 is not between 0.05 and 2"),
        (["--stand", "--tip", "FL_calf"], "--tip: is not for a robot that stands"),
        (["--stand", "--pattern", "shell"], "shell is not a pattern for a standing robot"),
        (["--stand", "--start", "*_knee=1"], r"--start: \*_knee matches no moving joint"),
        (["--stand", "--start", "*_calf_joint=-5"], r"--start: FL_calf_joint = -5 is not between"),
        (["--stand", "--feet", "rope"], "--feet: rope is not a contact of the configuration off the base"),
    ],
)
def test_bad_options_are_named(folder: Path, options: list[str], message: str) -> None:
    done = idtool("excite", folder / "quadruped.urdf", *options, "--out", folder / "none.csv")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert re.search(message, done.err)
    assert not (folder / "none.csv").exists()


def test_a_fixed_base_cannot_stand(folder: Path) -> None:
    with pytest.raises(api.ConfigError, match="--stand: needs a floating base"):
        api.excite(api.Model(folder / "quadruped.urdf", config={}), stand=True)


@pytest.mark.slow
def test_quadruped_in_mujoco_keeps_its_feet_on_the_ground_and_tells_mass_and_centre_of_mass(folder: Path) -> None:
    """Designed with bodies that are 10 to 30 % off, played by joint controllers."""
    model = api.Model(folder / "quadruped.urdf")
    api.excite(model, stand=True, duration=6, slow=0.0, iterations=8).save(folder / "designed_commands.csv")
    table = np.genfromtxt(folder / "designed_commands.csv", delimiter=",", names=True)
    recording, feet = play(TRUTH, {name: table[name] for name in table.dtype.names})
    assert feet.open_share == 0
    assert feet.friction < 0.9  # 0.8 is that of the ground; the rest is noise of the force
    write_csv(folder / "designed.csv", recording)
    write_csv(folder / "hang.csv", record(TRUTH, "hang", 6.0, 0))
    robot = api.fit(model, [folder / "designed.csv", folder / "hang.csv"], quick=True).whole_robot
    assert robot is not None
    assert robot.mass == pytest.approx(TRUTH.mass, rel=1e-3)
    assert np.linalg.norm(np.asarray(robot.com) - TRUTH.center_of_mass) < 4e-4

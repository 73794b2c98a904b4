"""A quadruped in MuJoCo of which motion capture tells the pose of the base, in place of an IMU or beside it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import Recording, Sensors, config_text, record, write_csv
from ground.quadruped import FEET
from ground.robot import prior_robot, urdf_text
from quadruped_recordings import TRUTH, record_quadruped
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

import idtool
from idtool.common.notice import Notice
from idtool.common.safe_yaml import parse_yaml
from idtool.data.base_sensors import POSE, POSE_CUTOFF
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot
from idtool.setup import make_initial_config

BY_POSE = dict(parse_yaml(Path("pose.yaml"), config_text(TRUTH, base_sensor="pose").encode()))
IMU = "imu_"


@pytest.fixture(scope="module")
def stand() -> Recording:
    return record_quadruped("stand", 4.5, sensors=Sensors(pose_rate=250, pose_delay=0.02))


@pytest.fixture(scope="module")
def walk() -> Recording:
    return record_quadruped("walk", 4.0, seed=1, sensors=Sensors(pose_rate=1000))


def write_robot(folder: Path) -> Path:
    urdf = folder / "quadruped.urdf"
    urdf.write_text(urdf_text(prior_robot(TRUTH, 0)))
    return urdf


def write_log(path: Path, recording: Recording, without: str = "none") -> Path:
    columns = {name: x for name, x in recording.columns.items() if not name.startswith(without)}
    write_csv(path, Recording(columns))
    return path


def notices(folder: Path, recording: Recording, content: Mapping[str, Any], **columns: Any) -> list[Notice]:
    log = write_log(folder / "log.csv", Recording({**recording.columns, **columns}))
    experiment = prepare(read_robot(write_robot(folder)), parse_config(content, ""), [log], holdout=0.0)
    return list(experiment.notices)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1000, 250])
def test_mass_and_centre_of_mass_are_found_without_imu(tmp_path: Path, rate: int) -> None:
    """From a URDF whose masses are 10 to 30 % off, with 0.1 mm and 0.5 mrad of noise."""
    logs = []
    for kind in ("stand", "walk", "hang"):
        recording = record(TRUTH, kind, 6.0, seed=0, sensors=Sensors(pose_rate=rate))
        logs.append(write_log(tmp_path / f"{kind}.csv", recording, without=IMU))
    model = idtool.Model(write_robot(tmp_path), config=BY_POSE)
    robot = idtool.fit(model, logs, quick=True).whole_robot
    assert robot is not None
    assert robot.mass == pytest.approx(TRUTH.mass, rel=6e-3)
    np.testing.assert_allclose(robot.com, TRUTH.center_of_mass, atol=1.5e-3)


def test_delay_of_the_pose_is_found_and_its_band_is_lower(tmp_path: Path, stand: Recording) -> None:
    log = write_log(tmp_path / "log.csv", stand, without=IMU)
    experiment = prepare(read_robot(write_robot(tmp_path)), parse_config(BY_POSE, ""), [log], holdout=0.0)
    assert experiment.band_hz == POSE_CUTOFF
    assert experiment.config.base.sensor.known_delay == pytest.approx(0.02, abs=3e-3)
    assert experiment.config.base.uses_pose
    assert "imu_delay" in [notice.code for notice in experiment.notices]
    assert not {"foot_slip", "imu_mount", "imu_against_feet"} & {notice.code for notice in experiment.notices}


def test_init_proposes_the_pose_where_there_is_no_imu(tmp_path: Path, stand: Recording) -> None:
    urdf = write_robot(tmp_path)
    given = {"friction": {"viscous": True}, "effects": []}
    log = write_log(tmp_path / "log.csv", stand, without=IMU)
    first = make_initial_config(read_robot(urdf), [log], given, None, lambda stage, share: None)
    assert first.data["base"] == {"kind": "floating", "link": "trunk", "pose": {"link": "trunk", "delay": "auto"}}
    assert [contact["name"] for contact in first.data["contacts"]][: len(FEET)] == list(FEET)
    assert first.data["filter"]["cutoff_hz"] <= POSE_CUTOFF
    assert "base.pose.link" in [item.key for item in first.todo]
    beside_imu = write_log(tmp_path / "log.csv", stand)
    with_imu = make_initial_config(read_robot(urdf), [beside_imu], given, None, lambda stage, share: None)
    assert "pose" not in with_imu.data["base"]


@pytest.mark.parametrize(
    ("pose", "columns", "error"),
    [
        ({"link": "nose"}, {}, r"base\.pose\.link: nose: is not a link of the URDF"),
        ({"link": "FL_calf"}, {}, r"base\.pose\.link: FL_calf: moves against the root link trunk"),
        ({}, dict.fromkeys(POSE, np.nan), "channel base_x has no values"),
        ({}, dict.fromkeys(POSE[3:], 0.0), "the orientation of the pose .* is zero; log it, from link to world"),
        ({}, dict.fromkeys(POSE, 0.5), "the pose of the base has a constant reading; log it, or remove base.pose"),
    ],
)
def test_pose_that_cannot_be_used_is_refused(
    tmp_path: Path, stand: Recording, pose: Mapping[str, str], columns: Mapping[str, float], error: str
) -> None:
    content = {**BY_POSE, "base": {**BY_POSE["base"], "pose": pose}}
    constant = {name: np.full(len(stand.columns["t"]), value) for name, value in columns.items()}
    with pytest.raises(idtool.IdtoolError, match=error):
        notices(tmp_path, stand, content, **constant)


def test_log_without_the_pose_is_refused(tmp_path: Path, stand: Recording) -> None:
    log = write_log(tmp_path / "log.csv", stand, without="base_")
    with pytest.raises(idtool.IdtoolError, match="has no channel base_x"):
        prepare(read_robot(write_robot(tmp_path)), parse_config(BY_POSE, ""), [log], holdout=0.0)
    config = tmp_path / "pose.yaml"
    config.write_text(config_text(TRUTH, base_sensor="pose"))
    found = idtool.inspect(log, config=config).notices
    assert [notice.subject for notice in found if notice.code == "sensor_unusable"] == ["pose"]


def test_pose_that_is_turned_against_the_imu_is_named(tmp_path: Path, stand: Recording) -> None:
    both = {**BY_POSE, "base": {**BY_POSE["base"], "imu": {"link": "imu_link"}}}
    both["base"]["pose"] = {"link": "imu_link", "delay": 0.02}
    assert "pose_against_imu" not in [notice.code for notice in notices(tmp_path, stand, both)]
    names = POSE[3:]
    orientation = Rotation.from_quat(np.stack([stand.columns[name] for name in names])[:, ::4].T)
    turned = np.full((4, len(stand.columns["t"])), np.nan)
    turned[:, ::4] = (orientation * Rotation.from_euler("z", 90, degrees=True)).as_quat().T
    found = notices(tmp_path, stand, both, **dict(zip(names, turned, strict=True)))
    (notice,) = [notice for notice in found if notice.code == "pose_against_imu"]
    assert re.search(r"90° about the axis \(-?0\.00, -?0\.00, 1\.00\) of the base", notice.message)


def test_with_a_pose_the_slip_of_single_feet_is_known(tmp_path: Path, walk: Recording) -> None:
    """The hind feet drag over the ground while two feet or one stand; that of which no pose tells which."""
    slips = [notice for notice in notices(tmp_path, walk, BY_POSE) if notice.code == "foot_slip"]
    named = {notice.subject for notice in slips}
    assert named
    assert named <= set(FEET)
    t = walk.columns["t"]
    for foot in named:
        k = FEET.index(str(foot))
        speed = uniform_filter1d(np.gradient(walk.truth["slip"][:, k], t), 50)
        is_on_ground = walk.columns[f"contact_{foot}"] > 0.5
        assert (speed[is_on_ground] > 0.06).mean() > 0.05

"""Feet that slip, and an IMU that is turned against its link, of a quadruped in MuJoCo."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import Recording, config_text, write_csv
from ground.quadruped import FEET
from ground.robot import Robot, prior_robot, urdf_text
from quadruped_recordings import TRUTH, record_quadruped
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

import idtool
from idtool.common.notice import Notice
from idtool.common.safe_yaml import parse_yaml
from idtool.diagnosis.data_faults import find_data_faults
from idtool.estimation.dataset import foot_kinematics
from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.dataset.foot_kinematics import FootMotion
from idtool.estimation.dataset.foot_slip import FootSlip, SlipSearch, slip_notices
from idtool.estimation.dataset.kinematic_checks import kinematic_notices
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

CODES = ("foot_slip", "imu_mount", "imu_against_feet")


@pytest.fixture(scope="module")
def stand() -> Recording:
    return record_quadruped("stand", 4.0)


@pytest.fixture(scope="module")
def walk() -> Recording:
    return record_quadruped("walk", 4.0, seed=1)


@pytest.fixture(scope="module")
def on_ice() -> Recording:
    return record_quadruped("stand", 4.0, slippery_foot="FL_foot")


def write_robot(folder: Path, recording: Recording, robot: Robot = TRUTH) -> tuple[Path, Path]:
    """URDF, with its configuration beside it, and log."""
    urdf, log = folder / "quadruped.urdf", folder / "log.csv"
    urdf.write_text(urdf_text(prior_robot(robot, 0)))
    urdf.with_suffix(".yaml").write_text(config_text(TRUTH))
    write_csv(log, recording)
    return urdf, log


def checked(folder: Path, recording: Recording, robot: Robot = TRUTH, **columns: Any) -> list[Notice]:
    """Notices of the checks about a recording with other columns."""
    urdf, log = write_robot(folder, Recording({**recording.columns, **columns}), robot)
    config = parse_config(parse_yaml(urdf.with_suffix(".yaml"), config_text(TRUTH).encode()), "")
    experiment = prepare(read_robot(urdf), config, [log], holdout=0.0)
    return [notice for notice in experiment.notices if notice.code in CODES]


def test_feet_that_stand_and_walk_on_rough_ground_do_not_slip(
    tmp_path: Path, stand: Recording, walk: Recording
) -> None:
    """Though they scuff while they touch down and lift off: they slip by 5 cm a second in all."""
    assert checked(tmp_path, stand) == []
    assert np.ptp(walk.truth["slip"], axis=0).min() > 0.1
    assert checked(tmp_path, walk) == []


def test_foot_on_ice_is_named_with_its_true_slip(tmp_path: Path, on_ice: Recording) -> None:
    (notice,) = checked(tmp_path, on_ice)
    assert (notice.code, notice.severity, notice.subject) == ("foot_slip", "warning", "FL_foot")
    share, speed, way = map(float, re.findall(r"([\d.]+) (?:%|m/s|cm)", notice.message))
    windows = [tuple(map(float, window)) for window in re.findall(r"([\d.]+) to ([\d.]+) s", notice.message)]
    t = on_ice.columns["t"]
    slip = on_ice.truth["slip"][:, FEET.index("FL_foot")]
    true_speed = uniform_filter1d(np.gradient(slip, t), 100)
    is_named = np.any([(t > begin) & (t < end) for begin, end in windows], axis=0)
    named_way = true_speed[is_named].sum() * (t[1] - t[0])
    assert way == pytest.approx(100 * named_way, rel=0.25)
    assert named_way > 0.6 * np.ptp(slip)  # it creeps in the rest
    assert share / 100 == pytest.approx(is_named.mean(), abs=0.08)
    assert speed == pytest.approx(float(np.median(true_speed[is_named])), rel=0.3)


def test_foot_in_the_air_with_its_flag_set_is_named(tmp_path: Path, walk: Recording) -> None:
    """While the other pair of feet stands, it swings."""
    always_set = np.ones(len(walk.columns["t"]))
    notices = checked(tmp_path, walk, contact_RR_foot=always_set)
    assert "RR_foot" in [notice.subject for notice in notices if notice.code == "foot_slip"]


def test_joints_in_degrees_are_named_in_place_of_slipping_feet(tmp_path: Path, walk: Recording) -> None:
    in_degrees = {name: np.rad2deg(x) for name, x in walk.columns.items() if name[:2] in ("q_", "v_")}
    urdf, log = write_robot(tmp_path, Recording({**walk.columns, **in_degrees}))
    result = idtool.inspect(log, urdf=urdf)
    notice, *others = [notice for notice in result.notices if notice.severity != "note"]
    assert notice.code == "beyond_limits"
    assert "set log.scale of q and v to 0.0174533" in notice.advice
    assert others == []


@pytest.mark.parametrize("turn", [(0, 0, 90), (0, 0, 180), (180, 0, 0), (-90, 0, 0), (0, 0, 20)])
def test_imu_that_is_turned_against_its_link_is_named_with_its_true_place(
    tmp_path: Path, stand: Recording, turn: tuple[int, ...]
) -> None:
    """The robot's IMU is turned by 0.3 rad about z; the URDF tells another orientation."""
    urdf, log = write_robot(tmp_path, stand)
    in_urdf = Rotation.from_euler("z", 0.3) * Rotation.from_rotvec(turn, degrees=True).inv()
    rpy = " ".join(map(str, in_urdf.as_euler("xyz")))
    text = urdf.read_text()
    urdf.write_text(re.sub(r'(<joint name="imu_joint".*?rpy=")[^"]*', rf"\g<1>{rpy}", text))
    result = idtool.inspect(log, config=urdf.with_suffix(".yaml"))
    (notice,) = [notice for notice in result.notices if notice.code in CODES]
    assert (notice.code, notice.severity, notice.subject) == ("imu_mount", "problem", "imu")
    axis = "xyz"[int(np.abs(turn).argmax())]
    found = re.search(r"rotated by ([+-]\d+)° about the (.) axis", notice.message)
    assert found is not None
    assert found[2] == axis
    assert abs(int(found[1])) == pytest.approx(abs(sum(turn)), abs=3)
    given = re.search(r'set rpy="(.*)" in the origin of the joint imu_joint', notice.advice)
    assert given is not None
    right = Rotation.from_euler("xyz", list(map(float, given[1].split())))
    assert (right.inv() * Rotation.from_euler("z", 0.3)).magnitude() < np.deg2rad(3)


def test_gyroscope_with_a_wrong_sign_or_scale_is_named(tmp_path: Path, stand: Recording) -> None:
    (sign,) = checked(tmp_path, stand, imu_wy=-stand.columns["imu_wy"])
    assert (sign.code, sign.message[:38]) == ("imu_mount", "its gyroscope has the wrong sign about")
    assert " y," in sign.message
    rates = {name: 1.4 * stand.columns[name] for name in ("imu_wx", "imu_wy", "imu_wz")}
    (scale,) = checked(tmp_path, stand, **rates)
    assert scale.code == "imu_against_feet"
    assert float(re.findall(r"([\d.]+) times", scale.message)[0]) == pytest.approx(1.4, rel=0.05)


def test_inspection_names_what_holds_the_robot_without_a_flag(tmp_path: Path, stand: Recording) -> None:
    changed = dict(stand.columns)
    for foot in FEET:
        changed[f"contact_{foot}"] = (stand.columns["t"] < 2.0).astype(float)
    urdf, log = write_robot(tmp_path, Recording(changed))
    config = urdf.with_suffix(".yaml")
    config.write_text(config.read_text().replace("contact_rope", "auto"))
    codes = {notice.code for notice in idtool.inspect(log, config=config).notices}
    assert "support_detected" in codes
    assert "floating_base_not_simulated" not in codes  # says nothing about the log


def test_inspection_compares_with_the_urdf_beside_the_configuration(tmp_path: Path, on_ice: Recording) -> None:
    urdf, log = write_robot(tmp_path, on_ice)
    other = tmp_path / "other.yaml"
    other.write_text(config_text(TRUTH))

    def codes(**options: Any) -> set[str]:
        return {notice.code for notice in idtool.inspect(log, **options).notices}

    assert "foot_slip" in codes(config=urdf.with_suffix(".yaml"))
    assert "foot_slip" in codes(urdf=urdf)
    assert "foot_slip" in codes(config=other, urdf=urdf)
    assert "foot_slip" not in codes(config=other)
    urdf.write_text("<robot")
    assert "not_compared_with_urdf" in codes(config=urdf.with_suffix(".yaml"))
    with pytest.raises(idtool.IdtoolError):
        idtool.inspect(log, config=other, urdf=urdf)


def test_inspection_names_torques_of_the_wrong_sign(tmp_path: Path, stand: Recording) -> None:
    torques = {name: -x for name, x in stand.columns.items() if name.startswith("tau_")}
    urdf, log = write_robot(tmp_path, Recording({**stand.columns, **torques}))
    result = idtool.inspect(log, config=urdf.with_suffix(".yaml"))
    assert ("torque_sign", "tau") in [(notice.code, notice.subject) for notice in result.notices]


def test_slip_is_a_data_fault_and_named_with_its_log(tmp_path: Path, on_ice: Recording, stand: Recording) -> None:
    urdf, log = write_robot(tmp_path, on_ice)
    other = tmp_path / "rough.csv"
    write_csv(other, stand)
    config = parse_config(parse_yaml(urdf.with_suffix(".yaml"), config_text(TRUTH).encode()), "")
    experiment = prepare(read_robot(urdf), config, [log, other], holdout=0.0)
    (fault,) = [fault for fault in find_data_faults(experiment, lambda stage, share: None) if fault.code in CODES]
    assert (fault.code, fault.subject) == ("foot_slip", "FL_foot")
    assert fault.message.endswith("(log.csv)")
    (notice,) = [notice for notice in experiment.notices if notice.code in CODES]
    assert notice.subject == "log.csv"
    assert notice.message.startswith("FL_foot: it slips")


def motion(velocities: dict[int, float], count: int, seconds: float = 2.0) -> FootMotion:
    """Feet on the ground without turning of the base, some of which move along x [m/s]."""
    t = np.arange(0, seconds, 0.006)
    by_joints = np.zeros((count, 3, len(t)))
    for foot, speed in velocities.items():
        by_joints[foot, 0] = speed
    nothing = np.zeros_like(by_joints)
    return FootMotion(t, by_joints, nothing, nothing[0], np.ones((count, len(t)), dtype=bool))


def slips(part: FootMotion) -> list[FootSlip]:
    search = SlipSearch(["a", "b", "c", "d"][: len(part.by_joints)], 0.0)
    search.add(part)
    return search.slips()


@pytest.mark.parametrize(
    ("velocities", "count", "feet"),
    [
        ({}, 4, []),
        ({1: 0.1}, 4, [("b",)]),
        ({0: 0.1, 1: -0.1}, 4, [("a",), ("b",)]),
        ({1: 0.2}, 3, [("b",)]),
        ({1: 0.2}, 2, [("a", "b")]),  # one of them
        ({0: 0.1, 1: 0.1}, 4, [("a", "b", "c", "d")]),  # two and two
        ({0: 0.01}, 4, []),  # as soft feet do
    ],
)
def test_feet_that_most_others_disagree_with_slip(
    velocities: dict[int, float], count: int, feet: list[tuple[str, ...]]
) -> None:
    assert [slip.feet for slip in slips(motion(velocities, count))] == feet


def test_way_of_a_long_slip_is_written_without_an_exponent() -> None:
    """A foot that is in the air for a minute moves by metres."""
    (slip,) = slips(motion({1: 0.1}, 4, seconds=60.0))
    (notice,) = slip_notices([slip])
    way = re.search(r"(\d+) cm in all", notice.message)
    assert way is not None
    assert int(way[1]) == pytest.approx(600, rel=0.01)


def test_slip_is_found_beside_a_stretch_of_one_sample(
    tmp_path: Path, on_ice: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No velocity changes in it, and it has no sample time."""
    urdf, log = write_robot(tmp_path, on_ice)
    config = parse_config(parse_yaml(urdf.with_suffix(".yaml"), config_text(TRUTH).encode()), "")
    experiment = prepare(read_robot(urdf), config, [log], holdout=0.0)
    (run,) = experiment.runs
    signals = run.signals
    (samples,) = signals.ranges
    last = 2 * signals.low_pass.edge + 1
    monkeypatch.setattr(foot_kinematics, "_MAX_SECONDS", (samples.stop - samples.start - last) * signals.log.dt)
    found = kinematic_notices(signals, experiment.model, experiment.config)
    assert [(notice.code, notice.subject) for notice in found] == [("foot_slip", "FL_foot")]


def test_share_way_and_windows_of_a_slip_follow_from_its_times() -> None:
    """0.1 m/s for 0.5 s of 4 s, of which the ends are not checked."""
    part = motion({}, 4, seconds=4.0)
    is_slipping = (part.t > 1.5) & (part.t < 2.0)
    by_joints = part.by_joints.copy()
    by_joints[2, 1, is_slipping] = 0.1
    (slip,) = slips(replace(part, by_joints=by_joints))
    assert slip.feet == ("c",)
    assert slip.way == pytest.approx(0.05, rel=0.25)
    assert slip.share == pytest.approx(0.5 / 3.85, rel=0.8)
    ((begin, end),) = slip.windows
    assert begin < 1.52
    assert end > 1.98
    assert slip.median_speed == pytest.approx(0.1, rel=0.3)

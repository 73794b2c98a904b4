"""Faults of an IMU, on a recording of a hanging quadruped whose trunk swings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ground.logs import Recording
from ground.quadruped import JOINTS
from quadruped_recordings import record_quadruped

from idtool.data.inspection.imu_findings import imu_findings
from idtool.data.logs import JointLog, make_log
from idtool.data.logs.log import Channel


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record_quadruped("hang", 3.0)


def log_of(columns: dict[str, np.ndarray]) -> JointLog:
    q = np.stack([columns[f"q_{joint}"] for joint in JOINTS], axis=1)
    log = make_log(Path("log.csv"), columns["t"], JOINTS, {"q": q})
    channels = {name: Channel(columns["t"], x) for name, x in columns.items() if name.startswith("imu_")}
    return JointLog(log.path, log.joints, log.t, log.signals, log.segments, log.dt, channels=channels)


def scaled(prefix: str, factor: float) -> dict[str, float]:
    return {f"{prefix}{axis}": factor for axis in "xyz"}


@pytest.mark.parametrize(
    ("factors", "code", "words"),
    [
        ({}, None, ""),
        (scaled("imu_a", 1 / 9.81), "imu_unit", "it is in g"),
        (scaled("imu_a", 1.3), "imu_scale", "12.8 m/s"),
        (scaled("imu_w", 180 / np.pi), "imu_unit", "in degrees per second"),
        (scaled("imu_q", 0.0) | {"imu_qw": 0.0}, "imu_orientation", "is zero at some samples"),
    ],
)
def test_wrong_sizes_are_named(recording: Recording, factors: dict[str, float], code: str | None, words: str) -> None:
    columns = {name: x * factors.get(name, 1.0) for name, x in recording.columns.items()}
    found = list(imu_findings(log_of(columns)))
    assert [notice.code for notice in found] == ([code] if code else [])
    assert not found or words in found[0].message


@pytest.mark.parametrize(("prefix", "dead"), [("imu_a", "accelerometer"), ("imu_w", "gyroscope")])
@pytest.mark.parametrize("reading", [0.0, 1.0])
def test_sensor_that_was_not_connected_is_named(recording: Recording, prefix: str, dead: str, reading: float) -> None:
    columns = dict(recording.columns)
    columns |= {name: np.full_like(columns[name], reading) for name in scaled(prefix, 0.0)}
    (notice,) = imu_findings(log_of(columns))
    assert (notice.code, notice.message) == ("imu_dead", f"the {dead} has a constant reading")


def test_removed_gravity_is_named(recording: Recording) -> None:
    """The robot hangs level but for its swinging, so that gravity is along z."""
    columns = dict(recording.columns)
    columns["imu_az"] = columns["imu_az"] - 9.81
    (notice,) = imu_findings(log_of(columns))
    assert (notice.code, notice.severity) == ("imu_without_gravity", "problem")


def test_orientation_of_another_kind_is_named(recording: Recording) -> None:
    """An IMU that is mounted with its z axis 60° from the vertical."""
    tilt = np.deg2rad(60)
    columns = dict(recording.columns)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    for kind in "wa":
        rotated = turn @ np.stack([columns[f"imu_{kind}{axis}"] for axis in "xyz"])
        columns |= {f"imu_{kind}{axis}": x for axis, x in zip("xyz", rotated, strict=True)}
    x, y, z, w = (columns[f"imu_q{part}"] for part in "xyzw")
    s, c = np.sin(tilt / 2), np.cos(tilt / 2)
    true = {"x": x * c + w * s, "y": y * c + z * s, "z": z * c - y * s, "w": w * c - x * s}
    columns |= {f"imu_q{part}": value for part, value in true.items()}
    assert not list(imu_findings(log_of(columns)))

    first = {"imu_qx": true["w"], "imu_qy": true["x"], "imu_qz": true["y"], "imu_qw": true["z"]}
    (notice, *_) = imu_findings(log_of({**columns, **first}))
    assert notice.code == "imu_orientation"
    assert "qw seems to be the first" in notice.message

    inverse = {f"imu_q{part}": -true[part] for part in "xyz"}
    (notice, *_) = imu_findings(log_of({**columns, **inverse}))
    assert "from world to link" in notice.message

    (notice, *_) = imu_findings(log_of({**columns, "imu_qw": -true["w"], "imu_qy": true["y"] + 1.0}))
    assert notice.code == "imu_orientation"


def test_reverse_orientation_about_the_vertical_is_named(recording: Recording) -> None:
    """Gravity does not tell it: the robot turns about the vertical alone."""
    columns = dict(recording.columns)
    t = columns["t"]
    yaw = 0.5 * np.sin(2 * np.pi * 0.4 * t)
    columns |= {"imu_wx": 0 * t, "imu_wy": 0 * t, "imu_wz": np.gradient(yaw, t)}
    columns |= {"imu_ax": 0.01 * np.sin(t), "imu_ay": 0.01 * np.cos(t), "imu_az": 9.81 + 0 * t}
    columns |= {"imu_qx": 0 * t, "imu_qy": 0 * t, "imu_qz": np.sin(yaw / 2), "imu_qw": np.cos(yaw / 2)}
    assert not list(imu_findings(log_of(columns)))
    (notice,) = imu_findings(log_of({**columns, "imu_qz": -columns["imu_qz"]}))
    assert notice.code == "imu_orientation"
    assert "from world to link" in notice.message

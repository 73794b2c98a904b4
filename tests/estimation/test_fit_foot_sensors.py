"""A quadruped in MuJoCo with sensors of force and moment above its feet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import config_text, write_csv
from ground.quadruped import FEET, FOOT_RADIUS
from ground.robot import prior_robot, urdf_text
from numpy.typing import NDArray
from quadruped_recordings import TRUTH, record_quadruped
from scipy.spatial.transform import Rotation

import idtool
from idtool.common.safe_yaml import parse_yaml

OFFSET = np.array([4.0, -3.0, 10.0, 0.2, 0.1, -0.2])
PARTS = ("x", "y", "z", "mx", "my", "mz")


def about(axis: tuple[int, int, int], angle: NDArray[np.float64]) -> Rotation:
    return Rotation.from_rotvec(np.outer(angle, axis))


def readings(columns: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """What sensors above the feet read, which have no mass: the opposite of the ground's wrench, and an offset."""
    imu = Rotation.from_quat(np.stack([columns[f"imu_q{part}"] for part in "xyzw"], axis=1))
    base = imu * Rotation.from_rotvec([0, 0, TRUTH.imu.turn]).inv()
    found = {}
    for foot in FEET:
        leg = foot.removesuffix("_foot")
        hip, thigh, calf = (columns[f"q_{leg}_{part}_joint"] for part in ("hip", "thigh", "calf"))
        orientation = base * about((1, 0, 0), hip) * about((0, 1, 0), thigh + calf)
        force = np.stack([columns[f"force_{foot}_{axis}"] for axis in "xyz"], axis=1)
        moment = np.cross([0, 0, -FOOT_RADIUS], force)
        in_foot = np.hstack([orientation.inv().apply(-force), orientation.inv().apply(-moment)]) + OFFSET
        found |= {f"force_{foot}_joint_{part}": own for part, own in zip(PARTS, in_foot.T, strict=True)}
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("quadruped")
    for kind in ("stand", "hang"):
        recording = record_quadruped(kind, 5.0)
        columns = dict(recording.columns)
        write_csv(path / f"{kind}.csv", type(recording)({**columns, **readings(columns)}))
    (path / "prior.urdf").write_text(urdf_text(prior_robot(TRUTH, 0)))
    return path


def settings() -> dict[str, Any]:
    config = dict(parse_yaml(Path("quadruped.yaml"), config_text(TRUTH).encode()))
    return {**config, "wrench_sensors": [{"joint": f"{foot}_joint"} for foot in FEET]}


@pytest.mark.slow
def test_sensors_above_the_feet_tell_the_mass_that_the_ground_carries(folder: Path) -> None:
    """Their offsets too, though the ground's forces on the feet are unknown."""
    model = idtool.Model(folder / "prior.urdf", config=settings())
    result = idtool.fit(model, [folder / "stand.csv", folder / "hang.csv"], quick=True)
    robot = result.whole_robot
    assert robot is not None
    assert robot.mass == pytest.approx(TRUTH.mass, rel=5e-3)
    for foot in FEET:
        np.testing.assert_allclose(result.wrench_sensors[f"{foot}_joint"].offset, OFFSET, atol=0.3)

    result.save(folder / "out")
    again = idtool.validate(folder / "out" / "identified.urdf", [folder / "stand.csv", folder / "hang.csv"])
    assert again.rms.model["overall"] == pytest.approx(result.rms.train["overall"], rel=0.1)

"""A humanoid in MuJoCo that stands on flat feet, with a wrench sensor in each ankle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.humanoid import SIDES, sensor_joint, true_humanoid
from ground.logs import config_text, record, write_csv
from ground.robot import urdf_text

import idtool
from idtool.api.data import load_experiment
from idtool.common.safe_yaml import parse_yaml

TRUTH = true_humanoid(0)
SENSORS = tuple(sensor_joint(side) for side in SIDES)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("humanoid")
    write_csv(path / "stand.csv", record(TRUTH, "stand", seconds=1.0, seed=0))
    (path / "true.urdf").write_text(urdf_text(TRUTH))
    return path


def settings(forces: str) -> dict[str, Any]:
    """Configuration without the rope, with the true friction and offsets of the sensors."""
    content = dict(parse_yaml(Path("humanoid.yaml"), config_text(TRUTH, forces).encode()))
    content["contacts"] = [contact for contact in content["contacts"] if contact["name"] != "rope"]
    friction = {}
    for joint, viscous, coulomb in zip(TRUTH.joints, TRUTH.viscous, TRUTH.coulomb, strict=True):
        friction[joint] = {"viscous": float(viscous), "coulomb": float(coulomb)}
    for sensor in content.get("wrench_sensors", []):
        sensor["offset"] = TRUTH.wrench_sensors[sensor["joint"]].tolist()
    return {**content, "friction": friction}


@pytest.mark.parametrize("forces", ["measured", "sensors"])
def test_true_robot_explains_the_ground_s_wrench_and_the_sensors(folder: Path, forces: str) -> None:
    """Of 170 N on each foot, but for noise: of the torque at the ankles, of accelerations at the base."""
    model = idtool.Model(folder / "true.urdf", config=settings(forces))
    rms = idtool.validate(model, folder / "stand.csv", simulation=False).rms.model
    for side in SIDES:
        assert rms[f"{side}_ankle_pitch_joint"] < 0.04
        assert rms[f"{side}_ankle_roll_joint"] < 0.04
    for axis in "xyz":
        assert rms[f"base_force_{axis}"] < 1.5
        assert rms[f"base_moment_{axis}"] < 0.7
        if forces == "sensors":
            assert all(rms[f"{sensor}_force_{axis}"] < 0.6 for sensor in SENSORS)
            assert all(rms[f"{sensor}_moment_{axis}"] < 0.06 for sensor in SENSORS)


def test_contacts_are_detected_beside_wrench_sensors(folder: Path) -> None:
    """By the torque of the legs, if the feet count as points."""
    config = settings("sensors")
    for contact in config["contacts"]:
        contact |= {"kind": "point", "flag": "auto"}
    experiment = load_experiment(idtool.Model(folder / "true.urdf", config=config), (), folder / "stand.csv")
    (notice,) = [notice for notice in experiment.notices if notice.code == "contacts_detected"]
    assert "l_sole 100 %, r_sole 100 %" in notice.message
    (batch, *_) = experiment.batches(experiment.runs[0], held_out=True)
    assert batch.motion.contacts is not None
    assert np.all(batch.motion.contacts.is_closed[:2])

"""A model with a wrench sensor in simulators: it is the same robot as without one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from sensor_arm import JOINTS, LINKS, SENSOR, urdf_text

import idtool
from idtool.robot.urdf.reading import read_robot

OFFSET = [3.0, -2.0, 5.0, 0.1, 0.2, -0.3]
MASS = {link.name: link.mass for link in LINKS}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a fit writes; a motor before the sensor and one behind it turn the last joint."""
    inertial = {"mass": 0.1, "inertia": [5e-5, 0, 8e-5, 0, 0, 5e-5]}
    rotor = {"joint": "bend", "gear_ratio": 20.0, "axis": [0, 1, 0], "origin": {"xyz": [0.1, 0, 0]}}
    rotors = {f"rotor_of_{link}": {**rotor, "parent": link, "inertial": inertial} for link in ("lower", "upper")}
    config: dict[str, Any] = {"joints": list(JOINTS), "rotors": rotors}
    config["wrench_sensors"] = [{"joint": SENSOR, "offset": OFFSET}]
    (tmp_path / "identified.urdf").write_text(urdf_text())
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(config))
    return tmp_path


def torque(path: Path) -> NDArray[np.float64]:
    """Torque of the joints by a simulator's file for one motion."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qacc[:] = [0.3, -0.7, 1.1], [1.0, -2.0, 1.5], [3.0, -5.0, 20.0]
    mujoco.mj_inverse(model, data)
    return np.array(data.qfrc_inverse)


def test_sensor_does_not_change_the_dynamics_in_mujoco(folder: Path) -> None:
    exported = idtool.export(folder, "mujoco")
    path = exported.save()
    with_sensor = torque(path)
    bodies = mujoco.MjModel.from_xml_path(str(path))
    assert bodies.body("hand").mass[0] == pytest.approx(MASS["hand"])
    assert bodies.body_mass.sum() == pytest.approx(sum(MASS.values()) + 2 * 0.1)
    offsets = [part.detail for part in exported.not_carried if part.what == "torque_offset"]
    assert offsets == ["it belongs to the sensors, not to the robot"] * 6

    config = yaml.safe_load((folder / "model.yaml").read_text())
    del config["wrench_sensors"]
    (folder / "model.yaml").write_text(yaml.safe_dump(config))
    without_sensor = torque(idtool.export(folder, "mujoco").save())
    np.testing.assert_allclose(with_sensor, without_sensor, atol=1e-12)


def test_drake_file_and_patch_have_all_links(folder: Path, tmp_path: Path) -> None:
    heavier = urdf_text()
    for mass in MASS.values():
        heavier = heavier.replace(f'mass value="{mass}"', f'mass value="{1.3 * mass:g}"')
    (tmp_path / "heavier.urdf").write_text(heavier)
    patched = idtool.export(folder, patch=tmp_path / "heavier.urdf").save()
    assert masses(patched) == pytest.approx(MASS)
    drake = idtool.export(folder, "drake").save()  # whose rotors are dead weight
    assert masses(drake) == pytest.approx({**MASS, "lower": MASS["lower"] + 0.1, "upper": MASS["upper"] + 0.1})


def masses(path: Path) -> dict[str, float]:
    """Masses of a URDF's links."""
    return {name: float(pi[0]) for name, pi in read_robot(path).links.items() if pi is not None}

"""Reflected rotor inertias under `armature`: known ones are kept, unknown ones are estimated, as under `effects`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import JOINTS, LEG, TRAIN, idtool, refuse

INERTIA = 0.08  # kg·m², near the true one of the hip
ROTOR = {"joint": "hip", "gear_ratio": 10.604, "inertia": 6.75e-4}


def fitted(folder: Path, **config: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Inertias by joint as a fit of the leg with a configuration finds them, and its model.yaml."""
    (folder / "leg.yaml").write_text(yaml.safe_dump(config))
    done = idtool("fit", LEG, TRAIN, "--config", "leg.yaml", "--quick", "--json", "--out", "out", folder=folder)
    assert done.code == 0, done.err
    effects = [entry for entry in done.json["effects"] if entry["effect"] == "rotor_inertia"]
    model = yaml.safe_load((folder / "out" / "model.yaml").read_text())
    return {entry["joint"]: entry["parameters"]["inertia"] for entry in effects}, model


def test_auto_is_a_rotor_inertia_on_every_joint(tmp_path: Path) -> None:
    zero = [{"effect": "rotor_inertia", "joint": name, "parameters": {"inertia": 0}} for name in JOINTS]
    long, long_model = fitted(tmp_path, effects=zero)
    short, model = fitted(tmp_path, armature="auto")
    assert short == long
    assert set(short) == set(JOINTS)
    assert model["effects"] == long_model["effects"]


def test_a_known_value_is_kept_and_a_measured_one_gives_way(tmp_path: Path) -> None:
    measured = {"value": 0.5, "standard_error": 0.5}
    found, model = fitted(tmp_path, armature={"hip": INERTIA, "knee": measured})
    assert set(found) == {"hip", "knee"}
    assert found["hip"] == pytest.approx(INERTIA, rel=1e-9)
    assert 0.05 < found["knee"] < 0.1
    assert model["armature"] == {"hip": {"value": INERTIA}, "knee": measured}


def test_the_model_of_a_fit_with_armature_is_complete(tmp_path: Path) -> None:
    fitted(tmp_path, armature={"hip": INERTIA, "knee": "auto"})
    names = idtool("validate", "out/identified.urdf", TRAIN, "--no-simulation", "--json", folder=tmp_path)
    assert names.code == 0, names.err
    again = idtool("fit", LEG, TRAIN, "--config", "out/model.yaml", "--quick", "--json", folder=tmp_path)
    inertias = {entry["joint"]: entry["parameters"]["inertia"] for entry in again.json["effects"]}
    assert inertias["hip"] == pytest.approx(INERTIA, rel=1e-9)
    exported = idtool("export", "out", "--to", "mujoco", "--json", "--out", "leg.xml", folder=tmp_path)
    assert exported.code == 0, exported.err
    assert f'armature="{INERTIA}' in (tmp_path / "leg.xml").read_text()


def test_a_number_for_all_joints_is_for_those_without_a_rotor_or_an_entry(tmp_path: Path) -> None:
    entry = {"effect": "rotor_inertia", "joint": "knee", "parameters": {"inertia": 0}}
    found, model = fitted(tmp_path, armature=INERTIA, effects=[entry], rotors={"hip_rotor": ROTOR})
    assert set(found) == {"abad", "knee"}
    assert found["abad"] == pytest.approx(INERTIA, rel=1e-9)
    assert found["knee"] != pytest.approx(INERTIA, rel=1e-3)
    assert model["armature"] == {"abad": {"value": INERTIA}}


def test_a_joint_that_stands_still_needs_no_armature(tmp_path: Path) -> None:
    found, _ = fitted(tmp_path, joints=["hip", "knee"], armature={"abad": INERTIA, "hip": "auto"})
    assert set(found) == {"hip"}


def test_a_rotor_and_an_armature_of_one_joint_are_refused(tmp_path: Path) -> None:
    config = {"armature": {"hip": INERTIA}, "rotors": {"hip_rotor": ROTOR}}
    (tmp_path / "leg.yaml").write_text(yaml.safe_dump(config))
    naming = "armature.hip: is also that of a rotor under rotors"
    refuse(tmp_path, "fit", LEG, TRAIN, "--config", "leg.yaml", "--out", "out", naming=naming)


def test_a_rotor_by_its_inertia_alone_is_fitted_and_written_in_full(tmp_path: Path) -> None:
    _, model = fitted(tmp_path, rotors={"hip_rotor": ROTOR})
    rotor = model["rotors"]["hip_rotor"]
    assert set(rotor) == {"joint", "gear_ratio", "inertial", "bounding_ellipsoid"}
    assert rotor["inertial"]["inertia"][2] * ROTOR["gear_ratio"] ** 2 == pytest.approx(0.086, rel=0.3)  # type: ignore[operator]
    assert idtool("validate", "out/identified.urdf", TRAIN, "--no-simulation", folder=tmp_path).code == 0


def test_one_gain_and_gains_by_joint_give_the_same_model(tmp_path: Path) -> None:
    by_joint, _ = fitted(tmp_path, controller={"kp": dict.fromkeys(JOINTS, 25.0)}, armature="auto")
    alike, model = fitted(tmp_path, controller={"kp": 25.0}, armature="auto")
    assert alike == by_joint
    assert model["controller"]["kp"] == 25.0


def test_one_scale_is_that_of_every_joint(tmp_path: Path) -> None:
    by_joint, _ = fitted(tmp_path, log={"scale": {"tau": dict.fromkeys(JOINTS, 0.5)}}, armature="auto")
    alike, _ = fitted(tmp_path, log={"scale": {"tau": 0.5}}, armature="auto")
    assert alike == by_joint

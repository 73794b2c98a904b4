"""Output of the commands: files, keys and shapes as documented; the files describe the identified model."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import (
    FIT_FILES,
    JOINTS,
    LEG,
    TRAIN,
    VALIDATE,
    VALIDATION_FILES,
    config_with,
    files,
    fitted,
    idtool,
    numbers,
    strict_json,
    validated,
)

from idtool import __version__
from idtool.robot.config import read_config
from idtool.robot.inertia import WRITTEN_DIGITS
from idtool.robot.urdf.reading import read_robot

BODIES = {"abad_link", "thigh_link", "shank_link", "abad_rotor", "hip_rotor", "knee_rotor"}
LEG_YAML = LEG.with_suffix(".yaml")

# Keys of report.json and of a body and the length of those that are lists.
REPORT = {
    "idtool",
    "schema",
    "joints",
    "samples",
    "band_hz",
    "rms",
    "rms_raw",
    "bodies",
    "friction",
    "solver",
    "simulation",
}
BODY = {
    **{"mass": None, "com": 3, "inertia_com": 6, "pi": 10, "standard_error": 10, "min_eig_pseudo_inertia": None},
    **{"ellipsoid_margin": None, "realizable": None, "identifiable": 10},
}
SOLVER = {"name": str, "status": str, "objective": float, "duality_gap": float, "iterations": int, "seconds": float}
WRITTEN = 10.0 ** (1 - WRITTEN_DIGITS)  # relative precision of what files hold
VALIDATION = {"idtool", "schema", "band_hz", "rms", "rms_raw", "nrms", "simulation", "bound", "ok"}
SIMULATION = {"kind", "position", "velocity", "baseline"}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that a fit to one log, validated on another, has written."""
    folder = tmp_path_factory.mktemp("fit")
    fitted(folder, LEG, TRAIN, "--validate", VALIDATE, simulated=True)
    return folder


@pytest.fixture(scope="module")
def report(out: Path) -> dict[str, Any]:
    """The fit's report.json."""
    return dict(strict_json((out / "report.json").read_text()))


@pytest.fixture(scope="module")
def validation(out: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A validation.json of the identified model and the prior."""
    folder = tmp_path_factory.mktemp("validate")
    arguments = ["--prior", LEG, "--max-rms", "hip=9", "--max-rms", "9"]
    validated(folder, out / "identified.urdf", VALIDATE, *arguments, simulated=True)
    assert {path.name for path in folder.iterdir()} == VALIDATION_FILES
    return dict(strict_json((folder / "validation.json").read_text()))


def is_rms(figures: object) -> bool:
    """Whether these are errors per joint and overall, that of all joints and samples together."""
    assert isinstance(figures, dict)
    joints = [figures[name] for name in JOINTS]
    overall = (sum(x**2 for x in joints) / len(joints)) ** 0.5
    return set(figures) == {*JOINTS, "overall"} and figures["overall"] == pytest.approx(overall, rel=1e-12)


def test_fit_writes_its_four_files(out: Path) -> None:
    assert set(files(out)) == FIT_FILES


def test_report_has_the_documented_keys(report: dict[str, Any]) -> None:
    assert list(report)[:2] == ["idtool", "schema"]
    assert (report["idtool"], report["schema"]) == (__version__, 1)
    assert set(report) >= REPORT
    assert report["joints"] == list(JOINTS)
    assert report["band_hz"] == 40
    assert all(9000 < samples <= 10_000 for samples in numbers(report["samples"]))
    for key in ("rms", "rms_raw"):
        assert set(report[key]) == {"train", "validation", "prior_validation"}
        assert all(map(is_rms, report[key].values()))


def test_report_of_bodies(report: dict[str, Any]) -> None:
    assert set(report["bodies"]) == BODIES
    for body in report["bodies"].values():
        assert set(body) >= set(BODY)
        for key, length in BODY.items():
            assert (len(body[key]) if isinstance(body[key], list) else None) == length
        assert body["realizable"] is True
        assert body["pi"][0] == body["mass"]
        for error, known in zip(body["standard_error"], body["identifiable"], strict=True):
            assert (error is not None) is known


def test_report_of_friction_and_solver(report: dict[str, Any]) -> None:
    assert set(report["friction"]) == set(JOINTS)
    for friction in report["friction"].values():
        terms = {"viscous", "coulomb", "offset"}
        assert set(friction) == terms | {"standard_error"}
        assert set(friction["standard_error"]) == terms
        assert friction["offset"] is None  # not in leg.yaml
        assert 0 < friction["standard_error"]["coulomb"] < 0.02 * friction["coulomb"]
        assert friction["viscous"] > 0
    for joint, limits in report["friction_intervals"].items():
        assert limits["offset"] is None
        for term in ("viscous", "coulomb"):
            assert limits[term][0] < report["friction"][joint][term] < limits[term][1]
    for key, kind in SOLVER.items():
        assert isinstance(report["solver"][key], kind)
    assert report["solver"]["name"] == "clarabel"


def test_validation_has_the_documented_keys(validation: dict[str, Any]) -> None:
    assert list(validation)[:2] == ["idtool", "schema"]
    assert (validation["idtool"], validation["schema"]) == (__version__, 1)
    assert set(validation) >= VALIDATION
    for key in ("rms", "rms_raw"):
        assert set(validation[key]) == {"model", "prior"}
        assert all(map(is_rms, validation[key].values()))
    assert set(validation["nrms"]) >= set(JOINTS)
    assert validation["bound"] == {"hip": 9, "overall": 9}
    assert validation["ok"] == {"hip": True, "overall": True}


@pytest.mark.parametrize("source", ["report", "validation"])
def test_simulation_has_the_documented_keys(source: str, request: pytest.FixtureRequest) -> None:
    """Both simulate the identified model and the prior on the same log, so they agree."""
    simulation = request.getfixturevalue(source)["simulation"]
    assert set(simulation) >= SIMULATION
    assert simulation["kind"] == "open_loop"
    assert simulation["window"] == 1.0
    assert simulation["units"] == dict.fromkeys(JOINTS, "rad")
    assert simulation["windows"] == {"simulated": 10, "of": 10}
    for figures in (simulation, simulation["baseline"], simulation["prior"]):
        assert is_rms(figures["position"])
        assert is_rms(figures["velocity"])
    assert [at["seconds"] for at in simulation["horizon"]] == [0.01, 0.05, 0.1, 0.5]
    for at in simulation["horizon"]:
        assert is_rms(at["position"])
        assert at["position"]["overall"] < at["prior"]["overall"]
        assert at["position"]["overall"] < at["baseline"]["overall"]
    other = request.getfixturevalue("validation" if source == "report" else "report")["simulation"]
    assert simulation["position"] == pytest.approx(other["position"], rel=1e-6)
    assert simulation["prior"]["velocity"] == pytest.approx(other["prior"]["velocity"], rel=1e-6)
    assert (simulation["lost"], simulation["prior_lost"]) == (0, 0)


def test_what_was_not_asked_for_is_not_simulated(tmp_path: Path) -> None:
    report = fitted(tmp_path, LEG, TRAIN)
    assert report["simulation"] is None
    assert report["seconds"]["simulate"] < 0.1
    assert validated(tmp_path, LEG, VALIDATE)["simulation"] is None


def test_what_is_printed_is_what_is_written(tmp_path: Path) -> None:
    printed = fitted(tmp_path, LEG, TRAIN)
    assert printed == strict_json((tmp_path / "report.json").read_text())
    printed = validated(tmp_path, LEG, VALIDATE)
    assert printed == strict_json((tmp_path / "validation.json").read_text())


def test_a_rerun_gives_the_same_model(out: Path, tmp_path: Path) -> None:
    fitted(tmp_path, LEG, TRAIN, "--validate", VALIDATE)
    for name in ("identified.urdf", "model.yaml"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()


CHANGES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "no prior": {"regularization": {"kind": "none"}},
    "a joint locked": {"joints": ["hip", "knee"], "locked_joints": {"abad": 0.2}},
    "other units, another gravity": {"log": {"scale": {"tau": {"hip": 2.0}}}, "gravity": [0, 1, -9]},
    "rollouts never restart": {"simulation": {"window": None}},
    "effects": {
        "effects": [
            {"effect": "parallel_spring", "joint": "hip", "parameters": {"stiffness": 0, "rest_position": 0.3}},
            {"effect": "torque_offset", "joint": "knee", "parameters": {"offset": 0.1}},
        ]
    },
    "a body on a union": {
        "bounding_ellipsoids": {
            "thigh_link": [
                {"center": [0, 0, -0.1], "semi_axes": [0.06, 0.06, 0.2]},
                {"center": [0, 0, -0.25], "semi_axes": [0.06, 0.06, 0.2]},
            ]
        }
    },
}


@pytest.mark.parametrize("changes", CHANGES.values(), ids=CHANGES)
def test_the_files_are_the_identified_model(tmp_path: Path, changes: dict[str, Any]) -> None:
    config = config_with(tmp_path / "leg.yaml", LEG_YAML, **changes)
    shutil.copy(LEG, tmp_path)
    report = fitted(tmp_path / "out", tmp_path / "leg.urdf", TRAIN, "--validate", VALIDATE)
    model, yaml_file = tmp_path / "out" / "identified.urdf", tmp_path / "out" / "model.yaml"
    given = validated(tmp_path / "1", model, VALIDATE, "--config", yaml_file, "--prior", tmp_path / "leg.urdf")
    found = validated(tmp_path / "2", model, VALIDATE)  # model.yaml beside identified.urdf
    for key in ("rms", "rms_raw"):
        assert given[key]["model"] == pytest.approx(report[key]["validation"], rel=1e-9)
        assert found[key]["model"] == pytest.approx(report[key]["validation"], rel=1e-9)
        assert given[key]["prior"] == pytest.approx(report[key]["prior_validation"], rel=1e-9)
    assert read_config(yaml_file).simulation == read_config(config).simulation


def test_model_yaml_carries_what_a_urdf_cannot(out: Path, report: dict[str, Any]) -> None:
    config = read_config(out / "model.yaml")
    assert config.joints == JOINTS
    for joint in JOINTS:
        for term in ("viscous", "coulomb"):
            given = getattr(config.friction_of(joint), term)
            assert given.value == pytest.approx(report["friction"][joint][term], rel=WRITTEN)
            assert given.standard_error == pytest.approx(report["friction"][joint]["standard_error"][term], rel=1e-3)
        inertial = config.rotors[f"{joint}_rotor"].inertial
        assert inertial is not None
        rotor = report["bodies"][f"{joint}_rotor"]
        assert inertial.mass == pytest.approx(rotor["mass"], rel=WRITTEN)
        assert list(inertial.inertia) == pytest.approx(rotor["inertia_com"], rel=1e-9, abs=1e-15)


def test_identified_urdf_carries_links_and_friction(out: Path, report: dict[str, Any]) -> None:
    robot = read_robot(out / "identified.urdf")
    for joint in JOINTS:
        assert robot.joints[joint].damping == pytest.approx(report["friction"][joint]["viscous"], rel=WRITTEN)
        assert robot.joints[joint].friction == pytest.approx(report["friction"][joint]["coulomb"], rel=WRITTEN)
        link = robot.joints[joint].child
        pi = report["bodies"][link]["pi"]
        np.testing.assert_allclose(robot.links[link], pi, rtol=0, atol=WRITTEN * pi[0])


def test_the_config_beside_the_urdf_is_found(tmp_path: Path) -> None:
    shutil.copy(LEG, tmp_path / "leg.urdf")
    assert set(fitted(tmp_path / "bare", tmp_path / "leg.urdf", TRAIN)["bodies"]) == BODIES & set(read_robot(LEG).links)
    config = shutil.copy(LEG_YAML, tmp_path / "leg.yaml")
    beside = fitted(tmp_path / "beside", tmp_path / "leg.urdf", TRAIN)
    given = fitted(tmp_path / "given", tmp_path / "leg.urdf", TRAIN, "--config", config)
    assert set(beside["bodies"]) == BODIES
    assert beside["rms"] == given["rms"]
    other = config_with(tmp_path / "other.yaml", LEG_YAML, filter={"cutoff_hz": 30})
    assert fitted(tmp_path / "other", tmp_path / "leg.urdf", TRAIN, "--config", other)["band_hz"] == 30


def test_where_files_go_without_out(tmp_path: Path) -> None:
    for command, log in (("fit", TRAIN), ("validate", VALIDATE)):
        assert idtool(command, LEG, log, "--quiet", "--no-simulation", folder=tmp_path).code == 0
    assert set(files(tmp_path)) == {f"leg_idtool/{name}" for name in FIT_FILES | VALIDATION_FILES}


def test_out_is_made_with_its_parents(tmp_path: Path) -> None:
    fitted(tmp_path / "a" / "b", LEG, TRAIN)
    assert set(files(tmp_path / "a" / "b")) == FIT_FILES


def test_holdout_is_the_last_part_of_every_log(tmp_path: Path) -> None:
    half = fitted(tmp_path, LEG, TRAIN, VALIDATE, "--holdout", "0.5")
    train, held_out = numbers(half["samples"])
    assert train == pytest.approx(held_out, rel=0.01)
    assert train + held_out == pytest.approx(20_000, rel=0.02)
    default, tenth = (fitted(tmp_path, LEG, TRAIN, *more) for more in ((), ("--holdout", "0.1")))
    assert list(numbers(default["samples"])) == pytest.approx([7000, 3000], rel=0.03)
    assert list(numbers(tenth["samples"])) == pytest.approx([9000, 1000], rel=0.07)


def test_nothing_held_out_is_said(tmp_path: Path) -> None:
    report = fitted(tmp_path, LEG, TRAIN, "--holdout", "0")
    assert report["rms"]["validation"] is report["rms"]["prior_validation"] is None
    assert is_rms(report["rms"]["train"])
    assert "no data were held out" in idtool("fit", LEG, TRAIN, "--holdout", "0", "--quick", folder=tmp_path).out


def test_validate_keeps_whole_logs(tmp_path: Path, report: dict[str, Any]) -> None:
    twice = fitted(tmp_path, LEG, TRAIN, "--validate", VALIDATE, "--validate", VALIDATE)
    samples = list(numbers(report["samples"]))
    assert list(numbers(twice["samples"])) == [samples[0], 2 * samples[1]]
    for part in ("train", "validation"):
        assert twice["rms"][part] == pytest.approx(report["rms"][part], rel=1e-9)

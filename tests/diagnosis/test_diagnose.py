"""`idtool diagnose` on MuJoCo's logs of a robot in which something is hidden: the command as a user runs it.

A sample; `make scoreboard` has all effects, robots and sizes.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import idtool
from hidden_effects.case_files import CaseFiles, write_case
from hidden_effects.case_list import Case
from hidden_effects.effects import HiddenEffect

from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.selection_round import fit_assumed_effect
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

SECONDS = 12.0
OUT = {"diagnosis.json", "diagnosis.html", "model.yaml", "identified.urdf"}


def logged(folder: Path, *hidden: HiddenEffect, inertia: str = "refit") -> CaseFiles:
    name = "_".join(one.effect for one in hidden) or "clean"
    return write_case(Case(name, "planar2", hidden, 0, inertia, SECONDS), folder / name)


def diagnosed(files: CaseFiles, out: Path, *options: str) -> dict[str, Any]:
    done = idtool("diagnose", files.urdf, files.log, "--config", files.config, "--out", out, "--json", *options)
    assert done.code == 0, done.err
    return done.json


def truth(files: CaseFiles) -> dict[str, Any]:
    """The parameters of what is hidden."""
    (one,) = json.loads(files.truth.read_text())["hidden"]
    parameters = one["parameters"]
    assert isinstance(parameters, dict)
    return parameters


def named(report: dict[str, Any]) -> list[tuple[str, str | None]]:
    return [(step["effect"], step["joint"] or step["link"]) for step in report["steps"]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hidden")


@pytest.fixture(scope="module")
def stribeck(folder: Path) -> CaseFiles:
    return logged(folder, HiddenEffect("stribeck_friction", "shoulder", None, "strong"))


@pytest.fixture(scope="module")
def stribeck_report(stribeck: CaseFiles, folder: Path) -> dict[str, Any]:
    """The report of a diagnosis in the folder ``out``."""
    return diagnosed(stribeck, folder / "out")


def test_friction_that_rises_at_low_speed_is_named_and_closes_the_gap(
    stribeck: CaseFiles, stribeck_report: dict[str, Any], folder: Path
) -> None:
    report = stribeck_report
    assert {path.name for path in (folder / "out").iterdir()} == OUT
    assert named(report) == [("stribeck_friction", "shoulder")]
    assert report["verdict"] == "explained"
    (step,) = report["steps"]
    for name, value in truth(stribeck).items():
        assert step["parameters"][name] == pytest.approx(value, rel=0.15)
        assert 0 < step["standard_error"][name] < 0.2 * value
    before, after, floor = (report[key] for key in ("before", "after", "noise_floor"))
    assert step["validation_rms_after"]["shoulder"] < 0.7 * step["validation_rms_before"]["shoulder"]
    assert after["validation"]["overall"] < 1.05 * floor["overall"] < before["validation"]["overall"]
    assert after["simulation"]["overall"] < before["simulation"]["overall"]
    assert json.loads((folder / "out" / "diagnosis.json").read_text()) == report
    # The last step leads to the final model, so that its figures are those of the joints.
    assert step["validation_rms_before"] == before["validation"]
    assert step["validation_rms_after"] == after["validation"]
    assert step["evidence"]["simulation_after"] == after["simulation"]
    profile = step["profile"]
    assert (profile["joint"], profile["cause"]) == ("shoulder", "velocity")
    power_before, power_after = (np.sum(np.square(profile[key]["mean"])) for key in ("before", "after"))
    assert power_after < 0.1 * power_before


@pytest.mark.slow
def test_play_with_friction_on_the_motor_side_is_found_in_both_parameters(folder: Path) -> None:
    """The best width on a coarse grid is another one with a wrong share of friction."""
    case = Case("backlash", "planar2", (HiddenEffect("backlash", "elbow", None, "strong"),), 718, "refit", 20.0)
    files = write_case(case, folder / "backlash")
    true = truth(files)
    assert 0.1 < true["motor_friction"] < 0.9
    report = diagnosed(files, folder / "backlash")
    assert named(report) == [("backlash", "elbow")]
    assert report["verdict"] == "explained"
    (step,) = report["steps"]
    assert step["parameters"]["width"] == pytest.approx(true["width"], rel=0.3)
    assert step["parameters"]["motor_friction"] == pytest.approx(true["motor_friction"], abs=0.2)
    assert report["after"]["validation"]["overall"] < 0.7 * report["before"]["validation"]["overall"]


@pytest.mark.slow
def test_a_wide_play_of_a_light_link_is_found_although_friction_slows_the_link_down(folder: Path) -> None:
    """A link that falls without friction would cross the play sooner, so that a play twice as wide would fit best."""
    case = Case("wide", "leg3", (HiddenEffect("backlash", "knee", None, "strong"),), 900, "refit", 20.0)
    files = write_case(case, folder / "wide")
    true = truth(files)
    report = diagnosed(files, folder / "wide")
    step = report["steps"][0]
    assert (step["effect"], step["joint"]) == ("backlash", "knee")
    assert step["parameters"]["width"] == pytest.approx(true["width"], rel=0.2)
    assert true["motor_friction"] == 0
    assert step["parameters"].get("motor_friction", 0) < 0.2
    before, after = (report[key] for key in ("before", "after"))
    assert after["simulation"]["overall"] < 0.2 * before["simulation"]["overall"]
    assert after["validation"]["overall"] < before["validation"]["overall"]  # by how much is a matter of milliseconds


def test_what_is_written_is_the_model_that_was_found(
    stribeck: CaseFiles, stribeck_report: dict[str, Any], folder: Path
) -> None:
    out, report = folder / "out", stribeck_report
    config = yaml.safe_load((out / "model.yaml").read_text())
    (entry,) = config["effects"]
    (step,) = report["steps"]
    assert entry["effect"] == "stribeck_friction"
    for name, given in entry["parameters"].items():
        assert given["value"] == pytest.approx(step["parameters"][name], rel=1e-6)
        assert given["standard_error"] == pytest.approx(step["standard_error"][name], rel=1e-3)
    again = idtool(
        *("validate", out / "identified.urdf", stribeck.log, "--config", out / "model.yaml"),
        *("--out", folder / "again", "--json", "--no-simulation"),
    )
    joined = np.hypot(*(report["after"][part]["overall"] * np.sqrt(share) for part, share in PARTS.items()))
    assert again.json["rms"]["model"]["overall"] == pytest.approx(joined, rel=0.02)


PARTS = {"train": 0.7, "validation": 0.3}


@pytest.mark.slow
def test_a_standard_error_does_not_depend_on_the_effects_searched_for(
    stribeck: CaseFiles, stribeck_report: dict[str, Any], folder: Path
) -> None:
    alone = diagnosed(stribeck, folder / "alone", "--no-simulation", "--effects", "stribeck_friction")
    errors, errors_alone = (report["steps"][0]["standard_error"]["stribeck"] for report in (stribeck_report, alone))
    assert errors == pytest.approx(errors_alone, rel=1e-3)


def test_nothing_is_found_where_nothing_is_hidden(folder: Path) -> None:
    report = diagnosed(logged(folder), folder / "clean", "--no-simulation")
    assert named(report) == []
    assert report["verdict"] == "no_disagreement"
    assert report["after"] == report["before"]


def test_of_a_log_of_two_seconds_agreement_is_not_reported(folder: Path) -> None:
    files = logged(folder)
    lines = files.log.read_text().splitlines()[: 2 * 1000 + 1]
    short = folder / "short.csv"
    short.write_text("\n".join(lines) + "\n")
    report = diagnosed(replace(files, logs=(short,)), folder / "short", "--no-simulation")
    assert (report["verdict"], report["noise_floor"]["overall"]) == ("unexplained", None)
    assert report["summary"].startswith("It is not known whether model and data agree: ")
    assert "noise_floor_unknown" in [notice["code"] for notice in report["notices"]]


@pytest.mark.slow
def test_a_payload_is_weighed_where_the_inertia_is_true(folder: Path) -> None:
    files = logged(folder, HiddenEffect("payload", None, "lower", "strong"), inertia="fixed")
    report = diagnosed(files, folder / "payload", "--no-simulation", "--inertia", "fixed")
    assert named(report) == [("payload", "lower")]
    found, true = report["steps"][0]["parameters"], truth(files)
    assert found["mass"] == pytest.approx(true["mass"], rel=0.02)
    assert found["com"][0] == pytest.approx(true["com"][0], abs=0.005)
    assert found["com"][2] == pytest.approx(true["com"][2], abs=0.005)


@pytest.mark.slow
def test_a_stop_is_found_at_either_end_of_the_travel_wherever_the_limits_are(folder: Path) -> None:
    """An obstacle far from the joint's limits: by them alone, it would act on the other side."""
    files = logged(folder, HiddenEffect("end_stop", "shoulder", None, "strong"))
    position = truth(files)["position"]
    lower, upper = (-9, 2.4) if position < 0 else (-2.4, 9)
    urdf = files.urdf.read_text()
    assert urdf.count('lower="-2.4" upper="2.4"') == 1
    wide = files.urdf.with_name("wide.urdf")
    wide.write_text(urdf.replace('lower="-2.4" upper="2.4"', f'lower="{lower}" upper="{upper}"'))

    report = diagnosed(replace(files, urdf=wide), folder / "stop")
    assert named(report) == [("end_stop", "shoulder")]
    found = report["steps"][0]["parameters"]
    assert found["side"] == np.sign(position)
    assert found["position"] == pytest.approx(position, abs=0.03)
    assert found["stiffness"] == pytest.approx(truth(files)["stiffness"], rel=0.05)
    assert report["after"]["simulation"]["overall"] < 0.3 * report["before"]["simulation"]["overall"]

    written = yaml.safe_load((folder / "stop" / "model.yaml").read_text())["effects"]
    assert [entry["parameters"]["side"] for entry in written if entry["effect"] == "end_stop"] == [np.sign(position)]


@pytest.mark.slow
def test_a_payload_heavier_than_the_robot_is_not_believed(folder: Path) -> None:
    """An arm in the horizontal plane, where no weight is felt: a rotor that its model lacks passes for a load."""
    level = {"gravity": [0.0, -9.81, 0.0]}
    hidden = (
        HiddenEffect("rotor_inertia", "shoulder", None, "strong", {"inertia": 2.0}),
        HiddenEffect("gravity_tilt", None, None, "strong", level),
    )
    files = logged(folder, *hidden, inertia="fixed")
    files.config.write_text(yaml.safe_dump({**yaml.safe_load(files.config.read_text()), **level}))
    out = folder / "heavy"
    report = diagnosed(files, out, "--no-simulation", "--inertia", "fixed", "--effects", "payload")
    assert ("payload", "lower") not in named(report)
    reasons = [one["reason"] for step in report["steps"] for one in step["rejected"] if one["link"] == "lower"]
    heavier = "is more than that of all bodies of the model"
    assert any(reason.startswith("its mass, 9.9") and heavier in reason for reason in reasons)
    assert report["verdict"] == "unexplained"
    right = diagnosed(files, folder / "right", "--no-simulation", "--inertia", "fixed", "--effects", "rotor_inertia")
    assert (right["verdict"], right["steps"][0]["evidence"]["doubt"]) == ("explained", "")


@pytest.mark.slow
def test_friction_that_builds_up_over_a_third_of_the_travel_is_found(folder: Path) -> None:
    """The search comes to a displacement of more than a quarter of the joint's travel, 3.2 rad."""
    friction = {"displacement": 0.9, "amplitude": 3.0, "damping": 0.0}
    files = logged(folder, HiddenEffect("presliding_hysteresis", "elbow", None, "strong", friction))
    report = diagnosed(files, folder / "long", "--no-simulation")
    assert named(report) == [("presliding_hysteresis", "elbow")]
    assert report["steps"][0]["parameters"]["displacement"] == pytest.approx(0.9, rel=0.05)
    assert report["steps"][0]["parameters"]["amplitude"] == pytest.approx(3.0, rel=0.1)
    assert report["verdict"] == "explained"


def test_what_is_in_no_library_is_unknown(folder: Path) -> None:
    files = logged(folder, HiddenEffect("unknown", "elbow", None, "strong", {"form": "friction_by_position"}))
    report = diagnosed(files, folder / "unknown", "--no-simulation")
    assert ("unknown", "elbow") in named(report)
    assert report["verdict"] in ("unexplained", "partly_explained")


def test_candidates_can_be_limited_assumed_and_only_reported(stribeck: CaseFiles, folder: Path) -> None:
    options = ("--no-simulation", "--report-only", "--effects", "quadratic_drag", "--assume", "torque_offset:elbow")
    report = diagnosed(stribeck, folder / "only", *options)
    assert {path.name for path in (folder / "only").iterdir()} == {"diagnosis.json", "diagnosis.html"}
    assert named(report)[0] == ("torque_offset", "elbow")
    assert report["steps"][0]["evidence"]["assumed"]
    assert "(assumed)" in report["summary"]
    assert set(named(report)[1:]) <= {("quadratic_drag", "shoulder"), ("unknown", "shoulder"), ("unknown", "elbow")}


def test_a_model_of_an_earlier_run_is_not_taken_for_that_of_a_report(stribeck: CaseFiles, folder: Path) -> None:
    out = folder / "earlier"
    out.mkdir()
    (out / "model.yaml").write_text("of an earlier run")
    options = ("--no-simulation", "--report-only", "--effects", "torque_offset")
    done = idtool("diagnose", stribeck.urdf, stribeck.log, "--config", stribeck.config, "--out", out, *options)
    assert done.code == 0
    assert "warning: not of this run, but of an earlier one: model.yaml" in done.out
    assert (out / "model.yaml").read_text() == "of an earlier run"


def test_what_is_assumed_is_fitted_and_not_the_friction_fitted_along(folder: Path) -> None:
    hidden = HiddenEffect("load_dependent_friction", "elbow", None, "ordinary")
    files = write_case(Case("short", "planar2", (hidden,), seconds=7.0), folder / "short")
    experiment = prepare(read_robot(files.urdf), read_config(files.config), [files.log], holdout=0.0)
    base = linearize_fit(experiment, lambda stage, share: None)
    for effect in ("viscous_friction", "presliding_hysteresis"):  # the model has the first already
        winner = fit_assumed_effect(base, lambda stage, share: None, effect, "elbow").winner
        assert winner is None or winner.probe.effect == effect


@pytest.mark.parametrize("assumed", ["stribeck_fiction:elbow", "stribeck_friction:elbw", "payload:lower"])
def test_what_cannot_be_assumed_is_refused(stribeck: CaseFiles, folder: Path, assumed: str) -> None:
    out = folder / "refused"
    done = idtool(
        "diagnose", stribeck.urdf, stribeck.log, "--config", stribeck.config, "--out", out, "--assume", assumed
    )
    assert (done.code, done.err.count("\n"), out.exists()) == (2, 1, False)
    assert done.err.startswith("error: --assume")


@pytest.mark.parametrize("budget", ["-1", "nan", "soon"])
def test_what_is_no_time_is_refused(stribeck: CaseFiles, folder: Path, budget: str) -> None:
    out = folder / "no_time"
    done = idtool("diagnose", stribeck.urdf, stribeck.log, "--out", out, "--budget", budget)
    assert (done.code, done.err.count("\n"), out.exists()) == (2, 1, False)
    assert done.err.startswith("error: ")
    assert "--budget" in done.err


def test_a_tiny_budget_gives_a_whole_result_that_says_so(stribeck: CaseFiles, folder: Path) -> None:
    out = folder / "tiny"
    report = diagnosed(stribeck, out, "--no-simulation", "--budget", "0.001")
    assert {path.name for path in out.iterdir()} == OUT
    assert named(report) in ([("unknown", "shoulder")], [("unknown", "shoulder"), ("unknown", "elbow")])
    assert report["verdict"] == "unexplained"
    (notice,) = [notice for notice in report["notices"] if notice["code"] == "search_interrupted"]
    assert notice["message"].startswith("the search reached its time limit")
    assert "the search reached its time limit" in (out / "diagnosis.html").read_text()

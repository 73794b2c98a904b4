"""Bounds that are met and missed: --max-rms, and the regression of the manifest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import (
    FIT_FILES,
    JOINTS,
    LEG,
    SAMPLES,
    TRAIN,
    VALIDATE,
    VALIDATION_FILES,
    files,
    fitted,
    idtool,
    strict_json,
)

MANIFEST = SAMPLES / "manifest.yaml"


def test_fit_holds_the_validation_error_to_the_bound(tmp_path: Path) -> None:
    rms = fitted(tmp_path, LEG, TRAIN)["rms"]
    for name in (JOINTS[-1], "overall"):
        for share, code in ((1.001, 0), (0.999, 1)):
            bound = f"{name}={rms['validation'][name] * share!r}"
            assert idtool("fit", LEG, TRAIN, "--max-rms", bound, "--quick", folder=tmp_path).code == code
    bound = repr(rms["validation"]["overall"] * 0.999)
    without = idtool("fit", LEG, TRAIN, "--max-rms", bound, "--quick", folder=tmp_path)
    assert without.code == 1
    assert "bound not met: overall" in without.out


def test_fit_without_holdout_holds_the_training_error_to_the_bound(tmp_path: Path) -> None:
    overall = fitted(tmp_path, LEG, TRAIN, "--holdout", "0")["rms"]["train"]["overall"]
    for share, code in ((1.001, 0), (0.999, 1)):
        bound = repr(overall * share)
        done = idtool("fit", LEG, TRAIN, "--holdout", "0", "--max-rms", bound, "--quick", folder=tmp_path)
        assert done.code == code


@pytest.mark.parametrize(
    ("command", "log", "written"), [("fit", TRAIN, FIT_FILES), ("validate", VALIDATE, VALIDATION_FILES)]
)
def test_files_are_written_where_a_bound_is_missed(tmp_path: Path, command: str, log: Path, written: set[str]) -> None:
    quick = ["--quick"] if command == "fit" else ["--no-simulation"]
    done = idtool(command, LEG, log, *quick, "--max-rms", "hip=0.001", "--out", tmp_path / "out", "--json")
    assert done.code == 1
    assert set(files(tmp_path / "out")) == written
    name = next(name for name in written if name.endswith(".json"))
    assert done.json == strict_json((tmp_path / "out" / name).read_text())
    assert "bound not met: hip" in done.err


def test_validation_says_which_bound_was_met(tmp_path: Path) -> None:
    bounds = ["--max-rms", "hip=9", "--max-rms", "knee=0.001", "--max-rms", "9"]
    done = idtool("validate", LEG, VALIDATE, *bounds, "--json", folder=tmp_path)
    assert done.code == 1
    assert done.json["bound"] == {"hip": 9, "knee": 0.001, "overall": 9}
    assert done.json["ok"] == {"hip": True, "knee": False, "overall": True}


def test_no_bound_is_no_bound(tmp_path: Path) -> None:
    done = idtool("validate", LEG, VALIDATE, "--json", folder=tmp_path)
    assert (done.code, done.json["bound"], done.json["ok"]) == (0, {}, {})


def test_the_regression_passes(tmp_path: Path) -> None:
    done = idtool("validate", "--json", folder=tmp_path)  # finds the sample logs from anywhere
    assert done.code == 0
    bounds = {
        (case["name"], joint): bound
        for case in yaml.safe_load(MANIFEST.read_text())["cases"]
        for joint, bound in case["max_rms"].items()
    }
    assert {(case["case"], case["joint"]): case["bound"] for case in done.json["cases"]} == bounds
    assert all(case["ok"] and case["rms"] <= case["bound"] < case["prior"] for case in done.json["cases"])
    assert files(tmp_path) == {}


def regression(folder: Path, **changes: Any) -> Path:
    """A folder whose manifest has the first case of the real one with its bounds changed."""
    (folder / "sample_logs").mkdir()
    case = yaml.safe_load(MANIFEST.read_text())["cases"][0]
    for name in (case["urdf"], case["config"], *case["fit"], *case["validation"]):
        (folder / "sample_logs" / name).symlink_to(SAMPLES / name)
    case["max_rms"] |= changes
    (folder / "sample_logs" / "manifest.yaml").write_text(yaml.safe_dump({"cases": [case]}))
    return folder


@pytest.mark.parametrize("joint", ["knee", "overall"])
def test_the_regression_fails_where_a_bound_is_missed(tmp_path: Path, joint: str) -> None:
    done = idtool("validate", "--json", folder=regression(tmp_path, **{joint: 0.01}))
    assert done.code == 1
    assert [case["joint"] for case in done.json["cases"] if not case["ok"]] == [joint]
    assert f"bound not met: leg {joint}" in done.err
    assert "NOT MET" in done.err


def test_a_manifest_here_goes_before_the_projects(tmp_path: Path) -> None:
    done = idtool("validate", "--json", folder=regression(tmp_path, hip=9.0))
    assert done.code == 0
    assert {case["case"] for case in done.json["cases"]} == {"leg"}

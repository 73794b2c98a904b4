"""`idtool compare`: what it prints and writes, and how it refuses what is no result of a fit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import LEG, SAMPLES, TRAIN, VALIDATE, files, fitted, idtool, strict_json

ARM, ARM_LOG = SAMPLES / "belt_arm.urdf", SAMPLES / "belt_arm_train.mcap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two results of the leg and one of an arm."""
    folder = tmp_path_factory.mktemp("compare")
    fitted(folder / "a", LEG, TRAIN)
    fitted(folder / "b", LEG, VALIDATE)
    fitted(folder / "arm", ARM, ARM_LOG)
    return folder


def test_the_first_line_is_the_answer(folder: Path, tmp_path: Path) -> None:
    done = idtool("compare", folder / "a", folder / "b", "--out", tmp_path / "out")
    assert done.code == 0, done.err
    first = done.out.splitlines()[0]
    assert first.startswith("The same, as far as the data tell: none of ")
    assert "a difference of" in first
    for heading in ("The two results", "RMS torque error, N·m", "Bodies", "Friction", "Rotors and effects"):
        assert f"\n{heading}" in done.out
    assert done.out.endswith("comparison.json, comparison.html\n")
    assert set(files(tmp_path / "out")) == {"comparison.json", "comparison.html"}


def test_what_is_printed_is_what_is_written(folder: Path, tmp_path: Path) -> None:
    reports = folder / "a" / "report.json", folder / "b" / "report.json"
    done = idtool("compare", *reports, "--json", "--quiet", "--out", tmp_path)
    assert done.code == 0, done.err
    assert done.json == strict_json((tmp_path / "comparison.json").read_text())
    assert done.json["idtool"]
    assert done.json["schema"] == 1
    assert [source["kind"] for source in done.json["inputs"]] == 2 * ["report", "configuration"]
    assert f"idtool compare {reports[0]}" in (tmp_path / "comparison.html").read_text()


def test_the_default_folder_is_in_the_working_directory(folder: Path, tmp_path: Path) -> None:
    done = idtool("compare", folder / "a", folder / "b", "--quiet", folder=tmp_path)
    assert done.code == 0, done.err
    assert set(files(tmp_path)) == {"comparison_idtool/comparison.json", "comparison_idtool/comparison.html"}


def test_different_robots_are_not_the_same(folder: Path, tmp_path: Path) -> None:
    done = idtool("compare", folder / "a", folder / "arm", "--out", tmp_path)
    assert done.code == 0, done.err
    first = done.out.splitlines()[0]
    assert first.startswith("Not the same joints: only A has abad, hip, knee, only B has waist, shoulder, elbow.")
    assert "cannot be told" in first


@pytest.mark.parametrize("given", ["empty", "nowhere", "a/model.yaml", "damaged.json"])
def test_what_is_no_result_is_refused(folder: Path, given: str, tmp_path: Path) -> None:
    (folder / "empty").mkdir(exist_ok=True)
    report = json.loads((folder / "a" / "report.json").read_text())
    (folder / "damaged.json").write_text(json.dumps({**report, "joints": "hip"}))
    for arguments in ((folder / "a", folder / given), (folder / given, folder / "a")):
        done = idtool("compare", *arguments, "--out", tmp_path / "out")
        assert done.code == 2
        assert done.out == ""
        assert done.err.startswith(f"error: {folder / given}: ")
        assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_names_of_strangers_do_not_steer_the_terminal(folder: Path, tmp_path: Path) -> None:
    report = json.loads((folder / "a" / "report.json").read_text())
    report["urdf"] = "\x1b[31m[bold]red.urdf"
    report["bodies"]["\x1b]0;title\x07"] = report["bodies"].pop("thigh_link")
    (tmp_path / "report.json").write_text(json.dumps(report))
    done = idtool("compare", folder / "a", tmp_path, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert "\x1b" not in done.out
    assert "[bold]red.urdf" in done.out

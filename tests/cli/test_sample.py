"""`idtool sample`: which files it writes, and that it overwrites none without being told."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path
from unittest import mock

import pytest
from commands import SAMPLES, files, idtool, refuse

import idtool as package
from idtool.common import samples
from idtool.common.exceptions import ConfigError

NAMES = ("leg", "belt_arm", "quadruped", "hidden", "pair")


@pytest.mark.parametrize("name", NAMES)
def test_the_files_of_a_sample_are_those_of_the_repository(name: str, tmp_path: Path) -> None:
    done = idtool("sample", name, "--json", folder=tmp_path)
    assert done.code == 0, done.err
    written = files(tmp_path)
    assert set(written) == set(done.json["files"])
    for path, content in written.items():
        assert content == (SAMPLES.parent / path).read_bytes()
    assert not [path for path in written if path.endswith(".py")]
    words = shlex.split(done.json["next"])
    named = [word for word in words if word.startswith("sample_logs/")]
    assert len(named) >= 2
    assert all((tmp_path / word).exists() for word in named)


def test_all_samples_together_are_all_files_but_the_scripts_and_the_manifest(tmp_path: Path) -> None:
    for name in NAMES:
        assert idtool("sample", name, "--out", tmp_path).code == 0
    left_out = {path for path in files(SAMPLES) if path.endswith((".py", ".pyc"))} | {"manifest.yaml"}
    assert set(files(tmp_path)) == set(files(SAMPLES)) - left_out


def test_results_beside_the_files_of_a_sample_are_no_part_of_it(tmp_path: Path) -> None:
    """As of a fit in the folder of a checkout."""
    shutil.copytree(SAMPLES / "quadruped", tmp_path / "all" / "quadruped")
    (tmp_path / "all" / "quadruped" / "quadruped_idtool").mkdir()
    (tmp_path / "all" / "quadruped" / "drafted.yaml").write_text("{}")
    with mock.patch.object(samples, "sample_folder", return_value=tmp_path / "all"):
        found = samples.find_sample("quadruped").files()
    assert set(found) == {f"quadruped/{path}" for path in files(SAMPLES / "quadruped")}


def test_other_files_of_the_folder_stay(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert idtool("sample", "leg", "--out", tmp_path, "--quiet").code == 0
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_second_time_nothing_is_written(tmp_path: Path) -> None:
    first = idtool("sample", "leg", folder=tmp_path)
    time = (tmp_path / "sample_logs" / "leg.urdf").stat().st_mtime_ns
    again = idtool("sample", "leg", folder=tmp_path)
    assert (first.code, again.code) == (0, 0)
    assert "written: sample_logs/leg.urdf" in first.out
    assert "already there: sample_logs/leg.urdf" in again.out
    assert "written" not in again.out
    assert (tmp_path / "sample_logs" / "leg.urdf").stat().st_mtime_ns == time


def test_a_file_that_is_not_the_sample_s_is_overwritten_only_with_force(tmp_path: Path) -> None:
    (tmp_path / "sample_logs").mkdir()
    (tmp_path / "sample_logs" / "leg_train.mcap").write_text("mine")
    refuse(tmp_path, "sample", "leg", naming="--force", file="sample_logs/leg_train.mcap")
    assert idtool("sample", "leg", "--force", folder=tmp_path).code == 0
    assert (tmp_path / "sample_logs" / "leg_train.mcap").read_bytes() == (SAMPLES / "leg_train.mcap").read_bytes()


def test_a_file_in_the_folder_s_place_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "sample_logs").write_text("a file")
    refuse(tmp_path, "sample", "leg", naming="give another --out")


def test_a_file_in_the_place_of_a_folder_within_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "sample_logs").mkdir()
    (tmp_path / "sample_logs" / "hidden").write_text("a file")
    refuse(tmp_path, "sample", "hidden", naming="give another --out")


def test_an_unknown_sample_is_an_error_that_names_the_others(tmp_path: Path) -> None:
    refuse(tmp_path, "sample", "arm", naming="'belt_arm', 'quadruped', 'hidden', 'pair'")
    with pytest.raises(ConfigError, match="leg, belt_arm, quadruped, hidden, pair"):
        package.sample("arm", tmp_path)  # type: ignore[arg-type]


def test_an_installation_without_samples_says_so(tmp_path: Path) -> None:
    with mock.patch.object(samples, "__file__", str(tmp_path / "idtool" / "common" / "samples.py")):
        refuse(tmp_path, "sample", "leg", naming="install idtool again")


def test_the_result_of_the_function_lists_the_files(tmp_path: Path) -> None:
    result = package.sample("pair", tmp_path)
    assert str(tmp_path / "pair" / "scene.xml") in result.files
    assert result.written == result.files
    assert "scene.xml" in repr(result)

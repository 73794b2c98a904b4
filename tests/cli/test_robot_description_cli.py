"""Commands that take the robot from a bag."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from commands import LEG, config_with, files, idtool
from descriptions import TEXT, described
from recordings import bag, ros2, states, write_mcap

from idtool.data.logs import read_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of the leg, without a robot and with one; and a configuration without rotors."""
    from commands import csv_text, sample_table

    folder = tmp_path_factory.mktemp("user")
    (folder / "log.csv").write_text(csv_text(sample_table(1300)))
    log = read_log(folder / "log.csv")
    items = [
        replace(state, position=q, velocity=v, effort=tau, stamp=round(t * 1e9), logged=round(t * 1e9))
        for state, t, q, v, tau in zip(
            states(len(log), log.joints),
            log.t.tolist(),
            *(log.signals[s].tolist() for s in ("q", "v", "tau")),
            strict=True,
        )
    ]
    write_mcap(folder / "run.mcap", described(TEXT), ros2(items))
    write_mcap(folder / "more.mcap", ros2(items))
    (folder / "leg.urdf").write_text(TEXT)
    for name in ("leg", "run", "split"):
        config_with(folder / f"{name}.yaml", LEG.with_suffix(".yaml"), rotors=None)
    split = bag(folder / "split", items[:600], items[600:])
    write_mcap(split / "split_0.mcap", described(TEXT), ros2(items[:600]))
    return folder


def adapted(folder: Path, *arguments: str) -> dict[str, Any]:
    done = idtool("adapt", *arguments, "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, "")
    return done.json


def test_a_command_takes_the_robot_from_the_bag(folder: Path) -> None:
    """The same as with the URDF, and with the configuration beside the bag."""
    expected = adapted(folder, "leg.urdf", "run.mcap")
    for name, log in (("run", "run.mcap"), ("split", "split")):
        report = adapted(folder, log)
        assert report["theta"] == expected["theta"]
        assert report["logs"] == [log]
        assert report["urdf"] == f"{log}/robot_description"
        assert set(files(folder / f"{name}_idtool")) == {"adapt.json", "adapt.html"}


def test_split_files_are_logs_of_their_own(folder: Path) -> None:
    both = [f"split/split_{i}.mcap" for i in range(2)]
    report = adapted(folder, *both, "--config", "leg.yaml", "--out", "both")
    assert report["logs"] == both
    assert report["urdf"] == "split/split_0.mcap/robot_description"
    assert report["theta"] != adapted(folder, "split")["theta"]


@pytest.mark.slow
def test_a_study_takes_the_robot_from_the_bag(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.estimation.study.study.LOCAL", {})
    done = idtool("study", "run.mcap", "--draws", "5", "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, "")
    assert (done.json["urdf"], done.json["logs"]) == ("run.mcap/robot_description", ["run.mcap"])
    assert set(files(folder / "run_idtool")) >= {"study.json", "study.html"}


def test_in_the_folder_of_the_bag(folder: Path) -> None:
    done = idtool("validate", ".", "--no-simulation", "--quiet", folder=folder / "split")
    assert (done.code, done.err) == (0, "")
    assert (folder / "split" / "split_idtool" / "validation.html").exists()
    report = adapted(folder / "split", ".")
    assert report["theta"] == adapted(folder, "split")["theta"]
    assert (folder / "split" / "split_idtool" / "adapt.json").exists()


@pytest.mark.parametrize("log", ["run.mcap", "split", "run_1.5kg"])
def test_a_first_configuration_is_written_beside_the_bag_where_fit_finds_it(folder: Path, log: str) -> None:
    if not (folder / log).exists():
        shutil.copytree(folder / "split", folder / log)
    file = folder / f"{log.removesuffix('.mcap')}.yaml"
    known = "known.yaml"
    (folder / known).write_text("filter: {cutoff_hz: 33}\nrotors: {}\n")
    done = idtool("init", log, "--config", known, "--force", "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, "")
    assert (done.json["file"], done.json["next"]) == (file.name, f"idtool fit {log}")
    fitted = idtool("fit", log, "--quick", "--json", "--quiet", folder=folder)
    assert (fitted.code, fitted.err, fitted.json["band_hz"]) == (0, "", 33)
    assert (folder / f"{log.removesuffix('.mcap')}_idtool" / "report.html").exists()


def test_a_bag_without_a_robot_needs_one(folder: Path) -> None:
    for arguments, naming in (
        (["more.mcap"], "more.mcap: no topic /robot_description carries"),
        (["leg.urdf"], "missing argument 'LOG'"),
        (["log.csv"], "missing argument 'LOG'"),
        (["none.mcap"], "none.mcap: there is no such file"),
        ([], "missing argument 'URDF'"),
    ):
        done = idtool("adapt", *arguments, folder=folder)
        assert (done.code, done.out) == (2, "")
        assert naming in done.err

"""`idtool study` and `idtool adapt` as a user runs them: files, where things are printed, exit codes, help."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
import yaml
from commands import (
    JOINTS,
    LEG,
    TRAIN,
    VALIDATE,
    config_with,
    csv_text,
    files,
    idtool,
    refuse,
    sample_table,
    strict_json,
)

from idtool import __version__
from idtool.cli import app
from idtool.common.number_text import number

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
LEG_YAML = LEG.with_suffix(".yaml")
BODIES = ("abad_link", "thigh_link", "shank_link", "abad_rotor", "hip_rotor", "knee_rotor")
STUDY_FILES, ADAPT_FILES = {"study.json", "study.html"}, {"adapt.json", "adapt.html"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two seconds of log, and the leg without rotors, so that a study takes little time."""
    folder = tmp_path_factory.mktemp("user")
    (folder / "log.csv").write_text(csv_text(sample_table(2000)))
    (folder / "leg.urdf").write_text(LEG.read_text())
    config_with(folder / "leg.yaml", LEG_YAML, rotors=None)
    return folder


@pytest.fixture(scope="module")
def studied(folder: Path) -> Any:
    """A study that writes files and prints JSON."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("idtool.estimation.study.learning._FEW_SAMPLES_FACTOR", 1)  # as many draws of few samples
        return idtool("study", "leg.urdf", "log.csv", "--draws", "5", "--out", "out", "--json", folder=folder)


@pytest.fixture(scope="module")
def adapted(folder: Path) -> Any:
    """Online identification that writes files and prints JSON."""
    return idtool("adapt", "leg.urdf", "log.csv", "--out", "adapted", "--json", folder=folder)


def test_a_study_writes_its_two_files_and_its_report_alone_to_standard_output(folder: Path, studied: Any) -> None:
    assert studied.code == 0
    assert set(files(folder / "out")) == STUDY_FILES
    assert list(studied.json)[:2] == ["idtool", "schema"]
    assert (studied.json["idtool"], studied.json["schema"]) == (__version__, 1)
    assert strict_json((folder / "out" / "study.json").read_text()) == studied.json
    assert "written: out/study.json, study.html" in studied.err


def test_a_study_says_what_it_found_in_tables(studied: Any) -> None:
    """On standard error, as standard output holds the JSON."""
    report, words = studied.json, studied.err.split()
    assert {*report["sets"], *report["estimators"], *report["learning"]["curves"]} <= set(words)
    for row in (*report["sets"].values(), *report["estimators"].values()):
        assert number(row["rms"]["validation"]["overall"]) in words
    for count in report["learning"]["counts"]:
        assert re.search(rf"^{count} ", studied.err, re.MULTILINE)
    for seconds in report["adaptation"]["time_to_10_percent"].values():
        assert "not reached" in studied.err if seconds is None else number(seconds) in words


def test_the_page_of_a_study(folder: Path, studied: Any) -> None:
    page = (folder / "out" / "study.html").read_text()
    assert "idtool study leg.urdf log.csv --draws 5" in page
    for name in studied.json["sets"]:
        assert name in page


@pytest.mark.usefixtures("short_study")
def test_a_quiet_study_prints_nothing_and_without_out_files_go_where_the_user_is(folder: Path, tmp_path: Path) -> None:
    log, urdf = folder / "log.csv", folder / "leg.urdf"
    done = idtool("study", urdf, log, "--draws", "5", "--quiet", folder=tmp_path)
    assert (done.code, done.out, done.err) == (0, "", "")
    assert idtool("adapt", urdf, log, "--quiet", folder=tmp_path).code == 0
    assert set(files(tmp_path)) == {f"leg_idtool/{name}" for name in STUDY_FILES | ADAPT_FILES}


def test_adapting_writes_its_two_files_and_its_report_alone_to_standard_output(folder: Path, adapted: Any) -> None:
    assert adapted.code == 0
    assert set(files(folder / "adapted")) == ADAPT_FILES
    assert (adapted.json["idtool"], adapted.json["schema"]) == (__version__, 1)
    assert strict_json((folder / "adapted" / "adapt.json").read_text()) == adapted.json
    assert f"{adapted.json['samples']} updates, one per downsampled sample: 166.7 Hz, in " in adapted.err
    assert "written: adapted/adapt.json, adapt.html" in adapted.err


def test_what_adapting_reports(adapted: Any) -> None:
    report = adapted.json
    assert report["joints"] == list(JOINTS)
    assert report["bodies"] == list(BODIES[:3])
    assert report["constraints"] == dict.fromkeys(BODIES[:3], "ellipsoid")
    assert report["forgetting"] == 20
    assert (report["urdf"], report["logs"]) == ("leg.urdf", ["log.csv"])
    theta, t = np.array(report["theta"]), np.array(report["t"])
    assert theta.shape == (len(t), len(report["coefficients"]))
    assert (np.diff(t) > 0).all()
    assert 1 < t[-1] < 2
    for i, name in enumerate(BODIES[:3]):
        body = report["final"]["bodies"][name]
        assert body["realizable"] is True
        np.testing.assert_allclose(body["pi"], theta[-1][10 * i : 10 * (i + 1)], rtol=1e-12)
    assert set(report["final"]["friction"]) == set(JOINTS)
    assert set(report["prediction_rms"]) == {*JOINTS, "overall"}
    assert number(report["prediction_rms"]["overall"]) in adapted.err.split()


def test_a_time_constant_without_end_is_null(folder: Path) -> None:
    done = idtool("adapt", "leg.urdf", "log.csv", "--forgetting", "inf", "--json", "--quiet", folder=folder)
    assert (done.code, done.err, done.json["forgetting"]) == (0, "", None)


def test_adapting_heeds_the_set_asked_for(folder: Path) -> None:
    for constraints in ("none", "full"):
        config_with(folder / "other.yaml", LEG_YAML, rotors=None, constraints=constraints)
        done = idtool("adapt", "leg.urdf", "log.csv", "--config", "other.yaml", "--json", "--quiet", folder=folder)
        assert set(done.json["constraints"].values()) == {constraints}


REFUSALS: dict[str, tuple[list[str], str]] = {
    "study: nothing held out": (
        ["study", "--holdout", "0"],
        "--holdout: a study compares errors on held-out data",
    ),
    "study: all held out": (["study", "--holdout", "1"], "--holdout: 1 is not a fraction"),
    "study: next to all held out": (["study", "--holdout", "0.999"], "log.csv"),
    "study: next to nothing held out": (["study", "--holdout", "0.001"], "--holdout: "),
    "study: no draws": (["study", "--draws", "0"], "--draws"),
    "study: draws in words": (["study", "--draws", "many"], "--draws"),
    "study: another log that is not there": (["study", "--validate", "none.mcap"], "none.mcap: there is no such file"),
    "study: a time constant": (["study", "--forgetting", "3"], "--forgetting"),
    "adapt: no time": (["adapt", "--forgetting", "0"], "--forgetting: 0 s is not a time constant; give a positive one"),
    "adapt: a negative time": (["adapt", "--forgetting", "-3"], "--forgetting: -3 s is not a time constant"),
    "adapt: a time that is none": (["adapt", "--forgetting", "nan"], "--forgetting: nan s is not a time constant"),
    "adapt: a time in words": (["adapt", "--forgetting", "long"], "--forgetting"),
    "adapt: a holdout": (["adapt", "--holdout", "0.3"], "--holdout"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_cannot_be_done_is_one_line(folder: Path, tmp_path: Path, case: str) -> None:
    for name in ("leg.urdf", "leg.yaml", "log.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    (command, *options), naming = REFUSALS[case]
    refuse(tmp_path, command, "leg.urdf", "log.csv", *options, "--out", "out", naming=naming)


@pytest.mark.parametrize("command", ["study", "adapt"])
@pytest.mark.parametrize(
    ("arguments", "naming"),
    [
        (["none.urdf", "log.csv"], "none.urdf: cannot be read"),
        (["leg.urdf", "none.csv"], "none.csv: there is no such file"),
        (["leg.urdf", "log.csv", "--config", "bad.yaml"], "bad.yaml: unknown key 'jonts'"),
        (["leg.urdf", "short.csv"], "short.csv"),
        (["leg.urdf"], "missing argument 'LOG'"),
    ],
    ids=["urdf", "log", "config", "short", "none"],
)
def test_what_cannot_be_read_is_one_line(
    folder: Path, tmp_path: Path, command: str, arguments: list[str], naming: str
) -> None:
    (tmp_path / "bad.yaml").write_text("jonts: [hip]")
    (tmp_path / "short.csv").write_text(csv_text(sample_table(30)))
    for name in ("leg.urdf", "leg.yaml", "log.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    refuse(tmp_path, command, *arguments, "--out", "out", naming=naming)


def help_of(name: str) -> str:
    done = idtool(name, "--help")
    assert (done.code, done.err) == (0, "")
    return " ".join(done.out.split())


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_documents_each_command(name: str) -> None:
    text = help_of(name)
    assert " ".join(COMMANDS[name].help.split()) in text
    assert f"Example: idtool {name} " in text
    for parameter in COMMANDS[name].params:
        assert parameter.help.split()[0] in text


@pytest.mark.usefixtures("short_study")
@pytest.mark.parametrize(
    ("name", "extra"),
    [("ellipsoids", []), ("adapt", []), pytest.param("study", ["--draws", "5"], marks=pytest.mark.slow)],
)
def test_the_examples_run_as_they_are_written(folder: Path, tmp_path: Path, name: str, extra: list[str]) -> None:
    """But with few draws."""
    for file in ("leg.urdf", "leg.yaml"):
        (tmp_path / file).write_bytes((folder / file).read_bytes())
    for log in ("run1.mcap", "run2.mcap"):
        (tmp_path / log).symlink_to(TRAIN if log == "run1.mcap" else VALIDATE)
    program, command, *arguments = shlex.split(COMMANDS[name].epilog.partition(": ")[2])
    assert (program, command) == ("idtool", name)
    done = idtool(command, *arguments, *extra, folder=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert "written: " in done.out


@pytest.mark.slow
def test_a_study_of_the_leg_with_the_default_draws(tmp_path: Path) -> None:
    done = idtool("study", LEG, TRAIN, "--validate", VALIDATE, "--out", tmp_path, "--json", "--quiet")
    assert done.code == 0
    assert done.json["learning"]["draws"] >= 30
    assert json.loads((tmp_path / "study.json").read_text()) == done.json
    assert set(done.json["sets"]["ellipsoid"]["masses"]) == set(BODIES)
    assert yaml.safe_load(LEG_YAML.read_text())["joints"] == done.json["joints"]

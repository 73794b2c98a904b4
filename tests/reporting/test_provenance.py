"""Every page and its JSON tell what was read, by its hash, with what, and by which command."""

from __future__ import annotations

import hashlib
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from commands import LEG, TRAIN, VALIDATE, idtool, strict_json
from pages import Page

from idtool import Log, Model, fit

LEG_YAML = LEG.with_suffix(".yaml")


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def entry(kind: str, path: Path, name: object = None) -> dict[str, Any]:
    return {"kind": kind, "path": str(name or path), "sha256": sha256(path)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a leg without rotors, two seconds of log, and a bag that holds the same."""
    folder = tmp_path_factory.mktemp("made by")
    (folder / "leg.urdf").write_bytes(LEG.read_bytes())
    (folder / "leg.yaml").write_text("friction: {viscous: true}\n")
    log = Log(TRAIN)
    few = slice(0, 2000)
    signals = {"q": log.q[few], "v": log.v[few], "tau": log.tau[few]}
    (folder / "bag").mkdir()
    Log.from_arrays("short", log.t[few], log.joints, **signals).save(folder / "bag" / "run 1.mcap")
    (folder / "bag" / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: ['run 1.mcap']}"
    )
    return folder


@pytest.mark.usefixtures("short_study")
@pytest.mark.parametrize(
    ("command", "page"),
    [
        (["fit", "leg.urdf", "bag", "--quick"], "report"),
        (["validate", "leg.urdf", "bag", "--no-simulation"], "validation"),
        (["diagnose", "leg.urdf", "bag", "--effects", "parallel_spring", "--no-simulation"], "diagnosis"),
        (["study", "leg.urdf", "bag", "--draws", "5"], "study"),
        (["adapt", "leg.urdf", "bag"], "adapt"),
    ],
    ids=lambda given: given if isinstance(given, str) else "",
)
def test_a_page_tells_the_command_the_versions_and_the_hashes(folder: Path, command: list[str], page: str) -> None:
    done = idtool(*command, "--out", f"{page} out", "--quiet", folder=folder)
    assert done.code == 0, done.err
    report = strict_json((folder / f"{page} out" / f"{page}.json").read_text())
    urdf, config, bag = folder / "leg.urdf", folder / "leg.yaml", folder / "bag"
    read = [entry("URDF", urdf, "leg.urdf"), entry("configuration", config, "leg.yaml")]
    read.append(entry("bag metadata", bag / "metadata.yaml", "bag/metadata.yaml"))
    read += [entry("log", path, path.relative_to(folder)) for path in bag.glob("*.mcap")]
    assert report["inputs"] == read
    assert report["versions"]["numpy"] == np.__version__
    text = Page((folder / f"{page} out" / f"{page}.html").read_text()).text
    for known in (shlex.join(["idtool", *command, "--out", f"{page} out"]), f"numpy {np.__version__}"):
        assert known in text
    assert all(f"SHA-256 {one['sha256']}" in text for one in read)


def test_a_designed_trajectory_tells_them_too(folder: Path) -> None:
    done = idtool("excite", "leg.urdf", "--duration", "5", "--iterations", "1", "--json", "--quiet", folder=folder)
    assert done.code == 0, done.err
    assert [one["sha256"] for one in done.json["inputs"]] == [sha256(folder / "leg.urdf"), sha256(folder / "leg.yaml")]
    assert sha256(folder / "leg.urdf") in (folder / "leg_idtool" / "excitation.html").read_text()


def test_a_log_given_twice_stands_once_and_the_prior_apart(folder: Path) -> None:
    (folder / "prior.urdf").write_bytes(LEG.read_bytes() + b"\n")
    (folder / "prior.yaml").write_bytes(LEG_YAML.read_bytes() + b"\n")
    done = idtool("validate", LEG, VALIDATE, VALIDATE, "--prior", "prior.urdf", "--json", "--quiet", folder=folder)
    assert done.code == 0, done.err
    assert done.json["inputs"] == [
        entry("URDF", LEG),
        entry("configuration", LEG_YAML),
        entry("log", VALIDATE),
        entry("prior's URDF", folder / "prior.urdf", "prior.urdf"),
        entry("prior's configuration", folder / "prior.yaml", "prior.yaml"),
    ]


def test_the_meshes_of_hulls_are_listed(folder: Path) -> None:
    """One that the configuration names, and one of the URDF."""
    (folder / "meshes").mkdir()
    files = {name: folder / "meshes" / f"{name}.stl" for name in ("thigh", "shank")}
    trimesh.creation.box((0.1, 0.1, 0.5)).export(files["thigh"])
    trimesh.creation.box((0.1, 0.1, 0.8)).export(files["shank"])
    visual = '<link name="shank_link"><visual><geometry><mesh filename="meshes/shank.stl"/></geometry></visual>'
    text = re.sub(r"<visual>.*?</visual>", "", LEG.read_text(), flags=re.DOTALL)
    (folder / "hulls.urdf").write_text(text.replace('<link name="shank_link">', visual))
    thigh = {"kind": "hull", "file": "meshes/thigh.stl"}
    shapes = {"thigh_link": [thigh], "shank_link": [{"kind": "hull"}]}
    (folder / "hulls.yaml").write_text(yaml.safe_dump({"bounding_shapes": shapes}))
    done = idtool("fit", "hulls.urdf", "bag", "--quick", "--json", "--quiet", folder=folder)
    assert done.code == 0, done.err
    inputs = done.json["inputs"]
    assert inputs[2:4] == [entry("mesh", files[name], f"meshes/{name}.stl") for name in ("shank", "thigh")]


def test_what_was_made_in_python_has_no_hash_and_says_so(folder: Path, tmp_path: Path) -> None:
    log = Log(folder / "bag")
    found = fit(
        Model(LEG, {"friction": {"viscous": True}}),
        Log.from_arrays("made up", log.t, log.joints, q=log.q, v=log.v, tau=log.tau),
        quick=True,
    )
    inputs = [(one["kind"], one["path"], one["sha256"]) for one in found.to_json()["inputs"]]
    assert inputs == [("URDF", str(LEG), sha256(LEG)), ("log", "made up", None)]
    found.save(tmp_path)
    assert "not from a file" in Page((tmp_path / "report.html").read_text()).text


def test_a_log_given_twice_counts_twice_and_that_is_said(folder: Path) -> None:
    done = idtool("fit", "leg.urdf", "bag", "bag", "--quick", "--json", "--quiet", folder=folder)
    (notice,) = [notice for notice in done.json["notices"] if notice["code"] == "duplicate_log"]
    assert notice["message"] == "bag is given more than once"
    assert notice["advice"].startswith("give it once: standard errors are too small")


def test_a_mistake_in_the_configuration_names_its_file(folder: Path) -> None:
    (folder / "wrong.yml").write_text("joints: [hipp]\n")
    (folder / "wrong.urdf").write_bytes(LEG.read_bytes())
    for options in (["wrong.urdf"], ["leg.urdf", "--config", "wrong.yml"]):
        done = idtool("fit", *options, "bag", "--out", "none", folder=folder)
        assert (done.code, done.out) == (2, "")
        assert done.err.startswith(
            "error: wrong.yml: joints: hipp: is not an actuated joint of the URDF; did you mean hip?"
        )
    assert not (folder / "none").exists()

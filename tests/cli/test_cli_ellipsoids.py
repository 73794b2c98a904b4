"""`idtool ellipsoids`: bounds as a configuration takes them, and a URDF checked and repaired."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import JOINTS, LEG, SAMPLES, TRAIN, config_with, files, fitted, idtool, refuse
from paths import REAL
from unreal_links import LINKS, WRONG, compiles, links_urdf, without_inertial

from idtool.robot.config import read_config
from idtool.robot.geometry import link_geometry
from idtool.robot.urdf.reading import read_robot

LEG_LINKS = ("abad_link", "thigh_link", "shank_link")


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A URDF with links that can exist and links that cannot."""
    (tmp_path / "robot.urdf").write_text(links_urdf(LINKS))
    return tmp_path / "robot.urdf"


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    """A URDF all of whose links can exist."""
    (tmp_path / "sound.urdf").write_text(links_urdf(LINKS.keys() - WRONG))
    return tmp_path / "sound.urdf"


def test_links_that_cannot_be_are_named_with_the_inequality(robot: Path) -> None:
    done = idtool("ellipsoids", robot, "--check")
    assert (done.code, done.err) == (1, "")
    lines = done.out.splitlines()
    for name, (*_, said) in LINKS.items():
        (row,) = [line for line in lines if line.split()[:1] == [name]]
        assert row.split()[-1] == ("NO" if said else "yes")
        assert f"{name}: {said}" in lines or not said
    assert f"{len(WRONG)} of {len(LINKS)} links have an inertia that is not physically realizable" in lines
    assert files(robot.parent) == {"robot.urdf": robot.read_bytes()}


def test_a_sound_urdf_passes(sound: Path) -> None:
    done = idtool("ellipsoids", sound, "--check")
    assert (done.code, done.err) == (0, "")
    assert "0 of 2 links have an inertia that is not physically realizable" in done.out


def test_the_check_as_json(robot: Path, sound: Path) -> None:
    done = idtool("ellipsoids", robot, "--check", "--json")
    assert done.code == 1
    assert list(done.json)[:2] == ["idtool", "schema"]
    assert done.json["urdf"] == str(robot)
    for name, (mass, *_, said) in LINKS.items():
        assert done.json["links"][name] == {"mass": mass, "violations": [said] if said else [], "nearest": None}
    assert "links have an inertia" in done.err
    quiet = idtool("ellipsoids", sound, "--check", "--json", "--quiet")
    assert (quiet.code, quiet.err) == (0, "")
    assert set(quiet.json["links"]) == LINKS.keys() - WRONG


def test_quiet_says_it_with_the_exit_code_alone(robot: Path, sound: Path) -> None:
    for path, code in ((robot, 1), (sound, 0)):
        done = idtool("ellipsoids", path, "--check", "--quiet")
        assert (done.code, done.out, done.err) == (code, "", "")


def test_the_repaired_urdf_differs_in_those_links_alone_and_passes(robot: Path) -> None:
    before, other = robot.read_bytes(), robot.parent / "new" / "repaired.urdf"
    done = idtool("ellipsoids", robot, "--check", "--repair", other)
    assert (done.code, done.err) == (0, "")
    assert f"written: {other}" in done.out
    assert robot.read_bytes() == before
    after = other.read_bytes()
    for name in WRONG:
        before, after = without_inertial(before, name), without_inertial(after, name)
    assert after == before
    assert idtool("ellipsoids", other, "--check", "--quiet").code == 0
    assert not compiles(robot.read_bytes())
    again = idtool("ellipsoids", other, "--check", "--repair", robot.parent / "again.urdf")
    assert again.code == 0
    assert (robot.parent / "again.urdf").read_bytes() == other.read_bytes()


def test_a_repair_as_json_says_what_moved(robot: Path) -> None:
    done = idtool("ellipsoids", robot, "--check", "--repair", robot.parent / "repaired.urdf", "--json")
    assert done.code == 0
    repaired = read_robot(robot.parent / "repaired.urdf").links
    for name, link in done.json["links"].items():
        assert (link["nearest"] is not None) is (name in WRONG)
        if link["nearest"] is not None:
            pi = repaired[name]
            assert pi is not None
            assert link["nearest"]["mass"] == pytest.approx(pi[0], rel=1e-12)
            assert len(link["nearest"]["com"]) == 3
            assert len(link["nearest"]["inertia_com"]) == 6
    assert done.json["links"]["just"]["nearest"]["moved"] == pytest.approx(0.0001 / 0.0201, rel=0.6)
    assert done.json["links"]["broken"]["nearest"]["mass"] == pytest.approx(2.0, rel=1e-12)


def test_mujoco_takes_the_repaired_urdf(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(links_urdf(LINKS.keys() - {"plate"}))
    assert not compiles((tmp_path / "robot.urdf").read_bytes())
    assert idtool("ellipsoids", "robot.urdf", "--check", "--repair", "new.urdf", folder=tmp_path).code == 0
    assert compiles((tmp_path / "new.urdf").read_bytes())


def test_nothing_to_repair_leaves_every_byte(sound: Path) -> None:
    done = idtool("ellipsoids", sound, "--check", "--repair", sound.parent / "same.urdf")
    assert done.code == 0
    assert (sound.parent / "same.urdf").read_bytes() == sound.read_bytes()


def test_the_configurations_bounds_are_heeded(tmp_path: Path) -> None:
    """Beside the URDF or given."""
    shutil.copy(LEG, tmp_path / "leg.urdf")
    narrow = {"thigh_link": [{"center": [0, 0, -0.171], "semi_axes": [0.03, 0.03, 0.1]}]}
    config_with(tmp_path / "narrow.yaml", bounding_ellipsoids=narrow)
    assert idtool("ellipsoids", "leg.urdf", "--check", folder=tmp_path).code == 0
    given = idtool("ellipsoids", "leg.urdf", "--check", "--config", "narrow.yaml", "--json", folder=tmp_path)
    assert given.code == 1
    (said,) = given.json["links"]["thigh_link"]["violations"]
    assert said.startswith("some mass lies beyond its ")
    assert not any(given.json["links"][name]["violations"] for name in ("abad_link", "shank_link"))
    shutil.move(tmp_path / "narrow.yaml", tmp_path / "leg.yaml")
    assert idtool("ellipsoids", "leg.urdf", "--check", folder=tmp_path).code == 1
    assert idtool("ellipsoids", "leg.urdf", "--check", "--repair", "leg.urdf", folder=tmp_path).code == 0
    assert idtool("ellipsoids", "leg.urdf", "--check", folder=tmp_path).code == 0


def test_the_leg_itself_passes_within_its_ellipsoids(tmp_path: Path) -> None:
    done = idtool("ellipsoids", LEG, "--check", "--json", folder=tmp_path)
    assert done.code == 0
    assert set(done.json["links"]) == set(LEG_LINKS)


REFUSALS: dict[str, tuple[list[str], str]] = {
    "a repair without a check": (["--repair", "new.urdf"], "--repair: requires --check"),
    "a place for the ellipsoids of a check": (["--check", "--out", "e.yaml"], "--out: cannot be combined with --check"),
    "a negative margin": (["--margin", "-0.1"], "--margin"),
    "bounds of another robot": (
        ["--check", "--config", "other.yaml"],
        "bounding_ellipsoids: sond: is not a link of the URDF; did you mean sound?",
    ),
    "a mesh that is not there": (["--check", "--config", "hull.yaml"], "no.stl"),
    "a configuration that is not there": (["--check", "--config", "none.yaml"], "none.yaml: cannot be read"),
    "a folder to write to": (["--check", "--repair", "folder"], "folder: is a folder"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_cannot_be_done_is_one_line(robot: Path, case: str) -> None:
    folder = robot.parent
    (folder / "folder").mkdir()
    config_with(folder / "other.yaml", bounding_ellipsoids={"sond": [{"semi_axes": [1, 1, 1]}]})
    config_with(folder / "hull.yaml", bounding_shapes={"sound": [{"kind": "hull", "file": "no.stl"}]})
    arguments, naming = REFUSALS[case]
    refuse(folder, "ellipsoids", "robot.urdf", *arguments, naming=naming)


def test_a_urdf_that_is_not_there(tmp_path: Path) -> None:
    refuse(tmp_path, "ellipsoids", "none.urdf", "--check", naming="none.urdf: cannot be read")


def test_the_ellipsoids_hold_the_links_geometry(tmp_path: Path) -> None:
    done = idtool("ellipsoids", LEG, "--out", tmp_path / "bounds.yaml")
    assert done.code == 0
    assert f"written: {tmp_path / 'bounds.yaml'}" in done.out
    config = read_config(tmp_path / "bounds.yaml")
    assert set(config.bounding_ellipsoids) == set(LEG_LINKS)
    for link, (bound,) in config.bounding_ellipsoids.items():
        points = link_geometry(read_robot(LEG), link).points
        assert bound.to_ellipsoid().contains(points).all()
        # The least one around a box has √3 times its half sides, here 5 % longer.
        expected = 1.05 * np.sqrt(3) * np.ptp(points, axis=0) / 2
        np.testing.assert_allclose(np.sort(bound.semi_axes), np.sort(expected), rtol=1e-3)


def test_the_margin_grows_them(tmp_path: Path) -> None:
    sizes = []
    for margin in ("0", "0.5"):
        done = idtool("ellipsoids", LEG, "--margin", margin, "--json", folder=tmp_path)
        sizes.append([bound["semi_axes"] for (bound,) in done.json["bounding_ellipsoids"].values()])
    np.testing.assert_allclose(sizes[1], 1.5 * np.array(sizes[0]), rtol=1e-9)


def test_what_is_printed_is_a_configuration(tmp_path: Path) -> None:
    """On standard output the same as in the file and in JSON; pasted into a configuration it bounds a fit."""
    printed = idtool("ellipsoids", LEG, folder=tmp_path)
    assert (printed.code, printed.err) == (0, "")
    data = yaml.safe_load(printed.out)
    assert idtool("ellipsoids", LEG, "--out", "bounds.yaml", "--quiet", folder=tmp_path).out == ""
    assert yaml.safe_load((tmp_path / "bounds.yaml").read_text()) == data
    as_json = idtool("ellipsoids", LEG, "--json", folder=tmp_path).json
    assert as_json["bounding_ellipsoids"] == data["bounding_ellipsoids"]
    config = tmp_path / "leg.yaml"
    rest = {k: v for k, v in yaml.safe_load(LEG.with_suffix(".yaml").read_text()).items() if k != "bounding_ellipsoids"}
    config.write_text(yaml.safe_dump(rest) + "\n" + printed.out)
    report = fitted(tmp_path / "out", LEG, TRAIN, "--config", config)
    assert set(report["joints"]) == set(JOINTS)
    for link in LEG_LINKS:
        body = report["bodies"][link]
        assert (body["constraints"], body["realizable"]) == ("ellipsoid", True)
        (ours,), (theirs,) = body["ellipsoids"], data["bounding_ellipsoids"][link]
        assert ours == {key: pytest.approx(values, rel=1e-12, abs=1e-12) for key, values in theirs.items()}


def test_links_whose_meshes_are_missing_are_named(tmp_path: Path) -> None:
    text = LEG.read_text().replace(
        '<geometry><box size="0.06 0.06 0.342"/></geometry>',
        '<geometry><mesh filename="package://leg/thigh.stl"/></geometry>',
    )
    (tmp_path / "leg.urdf").write_text(text)
    done = idtool("ellipsoids", "leg.urdf", "--json", folder=tmp_path)
    assert done.code == 0
    assert set(done.json["bounding_ellipsoids"]) == {"abad_link", "shank_link"}
    (note,) = done.json["warnings"]
    assert note.startswith("thigh_link: no ellipsoid; ")
    assert "package://leg/thigh.stl is not found" in note
    (notice,) = done.json["notices"]
    assert notice["message"] in " ".join(done.err.split())
    assert notice["advice"] in " ".join(done.err.split())


@pytest.mark.parametrize("folder", ["go2", "panda"])
def test_real_robots(tmp_path: Path, folder: str) -> None:
    path = REAL / folder / f"{folder}.urdf"
    if not path.exists():
        pytest.skip("the real robots' files are not here")
    checked = idtool("ellipsoids", path, "--check", "--json", folder=tmp_path)
    assert checked.code == (1 if any(link["violations"] for link in checked.json["links"].values()) else 0)
    bounds = idtool("ellipsoids", path, "--json", folder=tmp_path)
    assert bounds.code == 0
    with_mass = {name for name, pi in read_robot(path).links.items() if pi is not None and pi[0] > 0}
    named = {notice["subject"] for notice in bounds.json["notices"]}
    assert set(bounds.json["bounding_ellipsoids"]) | named == with_mass
    assert not set(bounds.json["bounding_ellipsoids"]) & named


def test_the_samples_pass(tmp_path: Path) -> None:
    for path in sorted(SAMPLES.glob("*.urdf")):
        assert idtool("ellipsoids", path, "--check", "--quiet", folder=tmp_path).code == 0


@pytest.mark.parametrize("name", ["leg.urdf", "leg.yaml"])
def test_ellipsoids_take_no_inputs_place(tmp_path: Path, name: str) -> None:
    for file in (LEG, LEG.with_suffix(".yaml")):
        shutil.copy(file, tmp_path)
    done = idtool("ellipsoids", "leg.urdf", "--out", name, folder=tmp_path)
    assert (done.code, done.err) == (2, f"error: {name}: is an input file; give another --out\n")
    assert (tmp_path / name).read_bytes() == LEG.with_name(name).read_bytes()

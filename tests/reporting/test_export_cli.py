"""`idtool export` as a user runs it, on what `idtool fit` wrote."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import LEG, TRAIN, config_with, files, fitted, idtool
from exported import EXACT, InMujoco
from paths import CONFIGS, REAL
from robots import chain, link

from idtool.dynamics.simulation.rigid_body_dynamics import RigidBodyDynamics
from idtool.reporting.export import identified_model, to_drake, to_mujoco
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

FILES = {"mujoco": "mujoco.xml", "drake": "drake.urdf"}


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a fit, not to be written to."""
    folder = tmp_path_factory.mktemp("fit") / "leg_idtool"
    fitted(folder, LEG, TRAIN)
    return folder


@pytest.fixture
def out(fit: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(fit, tmp_path / "leg_idtool"))


@pytest.mark.parametrize("to", FILES)
def test_the_file_is_written_beside_the_fit_and_what_is_in_it_is_said(out: Path, to: str) -> None:
    before = files(out)
    done = idtool("export", "leg_idtool", "--to", to, folder=out.parent)
    assert (done.code, done.err) == (0, "")
    after = files(out)
    assert after.keys() - before.keys() == {FILES[to]}
    assert before == {name: after[name] for name in before}
    assert f"written: leg_idtool/{FILES[to]}\n" in done.out
    assert "exported: viscous_friction of abad, hip, knee\n" in done.out
    assert "not exported: rotor of abad_rotor, hip_rotor, knee_rotor: its unbalance" in done.out
    assert ("not exported: coulomb_friction" in done.out) == (to == "drake")


def test_json(out: Path) -> None:
    done = idtool("export", out, "--to", "mujoco", "--json", "--quiet")
    assert (done.code, done.err) == (0, "")
    assert list(done.json)[:5] == ["idtool", "schema", "file", "carried", "not_carried"]
    assert done.json["file"] == str(out / "mujoco.xml")
    for part in done.json["carried"] + done.json["not_carried"]:
        assert list(part) == ["what", "of", "detail", "value", "unit"]
    frictions = [part for part in done.json["carried"] if part["what"] == "coulomb_friction"]
    assert [part["of"] for part in frictions] == ["abad", "hip", "knee"]
    found = mujoco.MjModel.from_xml_path(done.json["file"])
    assert [part["value"] for part in frictions] == [found.joint(part["of"]).frictionloss[0] for part in frictions]


def test_out_and_quiet(out: Path, tmp_path: Path) -> None:
    before = files(out)
    file = tmp_path / "models" / "leg.xml"
    done = idtool("export", out, "--to", "mujoco", "--out", file, "--quiet")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert mujoco.MjModel.from_xml_path(str(file)).nv == 3
    assert files(out) == before


def test_rotors_as_bodies_carry_everything(out: Path) -> None:
    done = idtool("export", out, "--to", "mujoco", "--rotor-bodies", "--json")
    assert (done.code, done.json["not_carried"]) == (0, [])
    assert mujoco.MjModel.from_xml_path(done.json["file"]).nv == 6
    reflected = idtool("export", out, "--to", "mujoco")
    assert "note: use --rotor-bodies" in reflected.out


def refused(out: Path, *arguments: object) -> str:
    """The one line that a command ends with, nothing being written."""
    before = files(out.parent)
    done = idtool("export", *arguments, folder=out.parent)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert files(out.parent) == before
    return done.err


@pytest.mark.parametrize("missing", ["identified.urdf", "model.yaml"])
def test_a_folder_that_no_fit_wrote_is_refused(out: Path, missing: str) -> None:
    (out / missing).unlink()
    assert f"leg_idtool/{missing}: is missing" in refused(out, "leg_idtool", "--to", "mujoco")


def test_other_mistakes_are_refused(out: Path) -> None:
    assert "nowhere/identified.urdf: is missing" in refused(out, "nowhere", "--to", "drake")
    assert "gazebo" in refused(out, "leg_idtool", "--to", "gazebo")
    assert "--to" in refused(out, "leg_idtool")
    assert "--rotor-bodies" in refused(out, "leg_idtool", "--to", "drake", "--rotor-bodies")
    (out / "drake.urdf").mkdir()
    assert "drake.urdf: is a folder" in refused(out, "leg_idtool", "--to", "drake")
    config_with(out / "model.yaml", out / "model.yaml", joints=["abad", "wrist"])
    assert "joints: wrist" in refused(out, "leg_idtool", "--to", "mujoco")
    (out / "identified.urdf").write_text(chain(link(1)).replace("<robot", "<!DOCTYPE robot><robot"))
    assert "document type" in refused(out, "leg_idtool", "--to", "drake")


@pytest.mark.skipif(not REAL.is_dir(), reason="the shared development data is not here")
def test_go2_has_every_rotor_once() -> None:
    model = identified_model(read_robot(REAL / "go2" / "go2.urdf"), read_config(CONFIGS / "go2.yaml"))
    export = to_mujoco(model)
    assert {part.what for part in export.not_carried} <= {"geometry"}
    found = InMujoco(export, model.model.names)
    assert found.model.nv == 12
    assert {"FL_foot", "FL_hip_rotor"} <= {found.model.body(i).name for i in range(found.model.nbody)}
    masses = [pi[0] for pi in model.robot.links.values() if pi is not None]
    assert found.model.body_mass.sum() == pytest.approx(sum(masses), rel=1e-12)
    q, v = np.random.default_rng(0).uniform(-2, 2, (2, 12))
    M, h = RigidBodyDynamics(model.mechanism)(q[:, None], v[:, None])
    own_M, own_h = found.mass_and_bias(q, v)
    np.testing.assert_allclose(own_M, M[0], **EXACT)
    np.testing.assert_allclose(own_h, h[:, 0], **EXACT)
    drakes = pin.buildModelFromXML(to_drake(model).text.decode())
    assert sum(inertia.mass for inertia in drakes.inertias) == pytest.approx(sum(masses))


def test_the_model_itself_may_be_named_and_is_not_written_over(out: Path) -> None:
    before = files(out)
    done = idtool("export", "leg_idtool/identified.urdf", "--to", "drake", "--quiet", folder=out.parent)
    assert (done.code, done.err) == (0, "")
    assert files(out).keys() - before.keys() == {FILES["drake"]}
    for name in ("identified.urdf", "model.yaml"):
        done = idtool("export", out, "--to", "mujoco", "--out", out / name)
        assert (done.code, done.err) == (2, f"error: {out / name}: is an input file; give another --out\n")
        assert files(out)[name] == before[name]

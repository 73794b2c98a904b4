"""Meshes as they are drawn: with fewer faces, of links as they look, and found from where a fit is written to."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from commands import LEG, TRAIN

import idtool
from idtool.robot.geometry import link_surface
from idtool.robot.meshes import Mesh, merge_meshes, relocated_mesh, simplify_mesh
from idtool.robot.urdf.reading import Robot


def of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


def distance(a: Mesh, b: Mesh) -> float:
    """The largest distance of a corner of one from the nearest corner of the other."""
    return float(np.linalg.norm(a.points[:, None] - b.points, axis=2).min(axis=1).max())


@pytest.mark.parametrize("most", [200, 2000, pytest.param(20_000, marks=pytest.mark.slow)])
def test_a_mesh_with_fewer_faces_is_like_it(most: int) -> None:
    ring = of(trimesh.creation.torus(0.3, 0.1, major_sections=96, minor_sections=48))
    few = simplify_mesh(ring, most)
    assert 0 < len(few.faces) <= most
    assert few.faces.max() < len(few.points)
    assert (few is ring) == (most >= len(ring.faces))
    # A cell that leaves so few faces is about as large as a face.
    assert distance(few, ring) < 3 * np.sqrt(4 * np.pi**2 * 0.3 * 0.1 / most)
    corners = np.sort(few.faces, axis=1)
    assert (np.diff(corners) > 0).all()
    assert len(np.unique(corners, axis=0)) == len(corners)


def test_what_has_no_extent_has_no_faces() -> None:
    point = Mesh(np.zeros((3, 3)), np.tile(np.arange(3), (50, 1)))
    assert len(simplify_mesh(point, 10).faces) == 0
    assert len(simplify_mesh(merge_meshes([]), 10).faces) == 0


def test_meshes_together_keep_their_triangles() -> None:
    parts = [of(trimesh.creation.box((1, 2, 3))), of(trimesh.creation.icosphere(1))]
    whole = merge_meshes(parts)
    triangles = np.concatenate([part.points[part.faces] for part in parts])
    np.testing.assert_array_equal(whole.points[whole.faces], triangles)


def test_a_link_looks_as_its_visual_does(robot_of: Callable[[str | bytes], Robot], tmp_path: Path) -> None:
    """A mesh keeps its hollow, a primitive becomes its hull, what cannot be read is left out."""
    ring = trimesh.creation.torus(0.3, 0.1)
    ring.export(tmp_path / "ring.stl")
    mesh = f'<mesh filename="{tmp_path}/ring.stl" scale="2 2 2"/>'
    look = f"""<visual><origin xyz="0 0 1"/><geometry>{mesh}</geometry></visual>
      <visual><geometry><sphere radius="0.1"/></geometry></visual>
      <visual><geometry><mesh filename="none.stl"/></geometry></visual><visual><geometry/></visual>"""
    box = '<collision><geometry><box size="9 9 9"/></geometry></collision>'
    robot = robot_of(f'<robot name="r"><link name="a">{look}{box}</link></robot>')
    solid = trimesh.Trimesh(*(getattr(link_surface(robot, "a"), part) for part in ("points", "faces")), process=True)
    assert len(solid.faces) >= len(ring.faces)
    np.testing.assert_allclose(solid.bounds, [[-0.8, -0.8, -0.101], [0.8, 0.8, 1.2]], atol=2e-3)
    unread = '<visual><geometry><mesh filename="none.stl"/></geometry></visual>'
    only = robot_of(f'<robot name="r"><link name="a">{unread}{box}</link></robot>')
    np.testing.assert_allclose(np.ptp(link_surface(only, "a").points, axis=0), 9)
    assert len(link_surface(robot_of('<robot name="r"><link name="a"/></robot>'), "a").faces) == 0


def test_what_fit_writes_into_another_folder_finds_its_meshes(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.05, 0.05, 0.3))
    (tmp_path / "robot" / "meshes").mkdir(parents=True)
    box.export(tmp_path / "robot" / "meshes" / "shank.stl")
    urdf = tmp_path / "robot" / "leg.urdf"
    visual = '<link name="shank_link"><visual><geometry><mesh filename="meshes/shank.stl"/></geometry></visual>'
    urdf.write_text(LEG.read_text().replace('<link name="shank_link">', visual))
    assert visual in urdf.read_text()
    config = yaml.safe_load(LEG.with_suffix(".yaml").read_text())
    config["bounding_shapes"] = {"shank_link": [{"kind": "hull", "file": "meshes/shank.stl"}]}
    result = idtool.fit(idtool.Model(urdf, config), TRAIN, quick=True)
    for folder in (tmp_path / "a" / "b", urdf.parent / "out", urdf.parent):
        result.save(folder)
        (name,) = re.findall('mesh filename="(.*)"', (folder / "identified.urdf").read_text())
        assert (folder / name).samefile(urdf.parent / "meshes" / "shank.stl")
        (shape,) = yaml.safe_load((folder / "model.yaml").read_text())["bounding_shapes"]["shank_link"]
        assert shape["file"] == name
        identified = idtool.Model(folder / "identified.urdf", folder / "model.yaml")
        assert identified.bodies == result.model.bodies  # its shapes are read


def test_a_mesh_of_a_package_keeps_its_name_if_it_is_found_from_the_other_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "ros" / "leg" / "a.stl"
    file.parent.mkdir(parents=True)
    file.touch()
    urdf = file.with_name("leg.urdf")
    assert relocated_mesh(urdf, "package://leg/a.stl", tmp_path / "out") == "../ros/leg/a.stl"
    assert relocated_mesh(urdf, str(file), tmp_path / "out") == str(file)
    assert relocated_mesh(urdf, "none.stl", tmp_path / "out") == "none.stl"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros"))
    assert relocated_mesh(urdf, "package://leg/a.stl", tmp_path / "out") == "package://leg/a.stl"

"""The geometry of links: primitives in closed form, meshes in every format and wherever they may be, hostile files."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from idtool.common.exceptions import ModelError
from idtool.robot.geometry import link_geometry, link_vertices
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]
Read = Callable[[str | bytes], Robot]

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
ORIGIN = '<origin xyz="0.1 0.2 -0.3" rpy="0.3 -0.2 1.1"/>'
R, P = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix(), np.array([0.1, 0.2, -0.3])


def urdf(*geometries: str, tag: str = "collision", origin: str = ORIGIN) -> str:
    parts = "".join(f"<{tag}>{origin}<geometry>{geometry}</geometry></{tag}>" for geometry in geometries)
    return f'<robot name="r"><link name="base">{parts}</link></robot>'


def mesh(name: str, scale: str = "") -> str:
    return f'<mesh filename="{name}" {scale}/>'


def extents(points: Array, directions: Array) -> Array:
    """How far points reach along directions, shape (n,)."""
    return np.asarray((points @ directions.T).max(axis=0))


@pytest.fixture
def directions(rng: np.random.Generator) -> Array:
    x = rng.normal(size=(300, 3))
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


@pytest.fixture
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((0.2, 0.4, 0.6))


HALF = CORNERS * [0.1, 0.2, 0.3]


def same(points: Array, expected: Array) -> bool:
    """Whether two sets of points have the same convex hull."""
    hulls = [cloud[ConvexHull(cloud).vertices] for cloud in (points, expected)]
    near = np.linalg.norm(hulls[0][:, None] - hulls[1], axis=2)
    return bool(near.min(axis=0).max() < 1e-6 and near.min(axis=1).max() < 1e-6)


# --- primitives ---


@pytest.mark.parametrize(
    ("geometry", "extent"),
    [
        ('<box size="0.2 0.4 0.6"/>', lambda n: np.abs(n) @ [0.1, 0.2, 0.3]),
        ('<sphere radius="0.3"/>', lambda n: np.full(len(n), 0.3)),
        ('<cylinder radius="0.1" length="0.5"/>', lambda n: 0.1 * np.hypot(n[:, 0], n[:, 1]) + 0.25 * np.abs(n[:, 2])),
        ('<capsule radius="0.1" length="0.5"/>', lambda n: 0.1 + 0.25 * np.abs(n[:, 2])),
    ],
    ids=["box", "sphere", "cylinder", "capsule"],
)
def test_a_primitive_is_enclosed_within_one_percent(
    geometry: str, extent: Callable[[Array], Array], robot_of: Read, directions: Array
) -> None:
    found = link_geometry(robot_of(urdf(geometry)), "base")
    reach, true = extents(found.points, directions), extent(directions @ R) + directions @ P
    middle = directions @ P
    assert (reach >= true - 1e-12).all()
    assert (reach - middle <= 1.01 * (true - middle)).all()
    assert found.unreadable == ()
    assert len(found.parts_read) == 1


def test_all_parts_of_a_link_are_read(robot_of: Read) -> None:
    found = link_geometry(robot_of(urdf('<box size="1 1 1"/>', '<sphere radius="3"/>', origin="")), "base")
    assert found.parts_read == ("box", "sphere")
    assert np.linalg.norm(found.points, axis=1).max() == pytest.approx(3, rel=0.01)


def test_collision_comes_before_visual(robot_of: Read) -> None:
    text = urdf('<box size="1 1 1"/>', origin="").replace(
        "</link>", '<visual><geometry><box size="9 9 9"/></geometry></visual></link>'
    )
    assert link_geometry(robot_of(text), "base").points.max() == 0.5


def test_visual_takes_the_place_of_a_collision_that_is_not_found(robot_of: Read) -> None:
    text = urdf('<box size="1 1 1"/>', mesh("nowhere.stl"), origin="").replace(
        "</link>", '<visual><geometry><box size="9 9 9"/></geometry></visual></link>'
    )
    found = link_geometry(robot_of(text), "base")
    assert found.points.max() == 4.5
    assert found.unreadable == ()


def test_a_link_without_geometry_has_no_points(robot_of: Read) -> None:
    found = link_geometry(robot_of(urdf()), "base")
    assert found.points.shape == (0, 3)
    assert found.parts_read == found.unreadable == ()
    with pytest.raises(ModelError, match=r"link base: .* has no collision or visual geometry for the link"):
        link_vertices(robot_of(urdf()), "base")


@pytest.mark.parametrize(
    ("geometry", "note"),
    [
        ('<box size="1 1"/>', "line 1: box size '1 1' should be 3 finite numbers"),
        ('<box size="1 one 1"/>', "box size '1 one 1' should be 3 finite numbers"),
        ('<sphere radius="nan"/>', "sphere radius 'nan' should be a finite number"),
        ('<sphere radius="1e300"/>', "should be a finite number"),
        ('<box size="1 -1 1"/>', "line 1: box size '1 -1 1' is negative"),
        ("<cylinder/>", "cylinder radius '' should be a finite number"),
        ('<plane normal="0 0 1"/>', "plane is not a supported geometry"),
        ("", "line 1: collision has no geometry"),
        ("<!-- nothing -->", "collision has no geometry"),
        ("<mesh/>", "mesh  is not found"),
        (mesh("http://example.com/a.stl"), "is not downloaded"),
        (mesh("a.step"), "mesh a.step is not found"),
        (mesh("x" * 5000 + ".stl"), "is not found"),
    ],
)
def test_what_cannot_be_used_is_said(geometry: str, note: str, robot_of: Read) -> None:
    robot = robot_of(urdf('<box size="1 1 1"/>', geometry))
    found = link_geometry(robot, "base")
    assert len(found.points) == 8
    assert len(found.unreadable) == 1
    assert note in found.unreadable[0]
    with pytest.raises(ModelError, match="its geometry cannot be read"):
        link_vertices(robot, "base")


def test_an_origin_that_is_no_numbers_is_said(robot_of: Read) -> None:
    found = link_geometry(robot_of(urdf('<box size="1 1 1"/>', origin='<origin xyz="0 0"/>')), "base")
    assert found.parts_read == ()
    assert "origin xyz '0 0' should be 3 finite numbers" in found.unreadable[0]


# --- meshes ---


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the writer of DAE
@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "obj", "ply", "off", "dae"])
def test_every_format_holds_the_same_box(kind: str, box: trimesh.Trimesh, tmp_path: Path, robot_of: Read) -> None:
    name = f"m.{kind.removesuffix('_ascii').upper() if kind == 'stl' else kind.removesuffix('_ascii')}"
    data = box.export(file_type=kind)
    (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    found = link_geometry(robot_of(urdf(mesh(name))), "base")
    assert found.unreadable == ()
    assert found.parts_read == (f"mesh {name}",)
    assert same(found.points, HALF @ R.T + P)


def test_a_mesh_is_scaled_before_it_is_placed(box: trimesh.Trimesh, tmp_path: Path, robot_of: Read) -> None:
    box.export(tmp_path / "m.stl")
    found = link_geometry(robot_of(urdf(mesh("m.stl", 'scale="0.001 -2 1"'))), "base")
    assert same(found.points, HALF * [0.001, 2, 1] @ R.T + P)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the writer
def test_a_collada_scene_s_unit_and_places_count(box: trimesh.Trimesh, tmp_path: Path, robot_of: Read) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([1, 2, 3]))
    data = scene.to_mesh().export(file_type="dae")
    text = (data if isinstance(data, bytes) else data.encode()).decode()
    assert "<asset>" in text
    start, end = text.index("<asset>"), text.index("</asset>")
    asset = '<asset><unit meter="0.01" name="centimeter"/><up_axis>Y_UP</up_axis>'
    (tmp_path / "m.dae").write_text(text[:start] + asset + text[end:])
    points = link_geometry(robot_of(urdf(mesh("m.dae"), origin="")), "base").points
    assert same(points, 0.01 * (HALF + [1, 2, 3]))  # noqa: RUF005


def test_only_what_faces_use_is_read(tmp_path: Path, robot_of: Read) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 99 99 99\nf 1 2 3\n")
    points = link_vertices(robot_of(urdf(mesh("m.obj"), origin="")), "base")
    assert {tuple(x) for x in points.tolist()} == {(0, 0, 0), (1, 0, 0), (0, 1, 0)}


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("m.stl", "ws/pkg/urdf/m.stl"),
        ("meshes/m.stl", "ws/pkg/urdf/meshes/m.stl"),
        ("../meshes/m.stl", "ws/pkg/meshes/m.stl"),
        ("package://pkg/meshes/m.stl", "ws/pkg/meshes/m.stl"),
        ("package://other/meshes/m.stl", "ws/other/meshes/m.stl"),
        ("package://other/a/meshes/m.stl", "ws/pkg/urdf/meshes/m.stl"),
        ("package://other/a/meshes/m.stl", "ws/pkg/a/meshes/m.stl"),
        ("package://other/a/meshes/m.stl", "ws/pkg/urdf/m.stl"),
        ("model://pkg/meshes/m.stl", "ws/pkg/meshes/m.stl"),
        ("/home/someone/pkg/meshes/m.stl", "ws/pkg/meshes/m.stl"),
        ("package://ros1/meshes/m.stl", "ros/ros1/meshes/m.stl"),
        ("package://self/meshes/m.stl", "deep/self/meshes/m.stl"),
        ("package://ros2/meshes/m.stl", "prefix/share/ros2/meshes/m.stl"),
        ("file://{root}/far/a%20mesh.stl", "far/a mesh.stl"),
        ("{root}/far/m.stl", "far/m.stl"),
    ],
)
def test_where_a_mesh_may_be(
    name: str, place: str, box: trimesh.Trimesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path}/ros:{tmp_path}/deep/self")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/prefix")
    path, file = tmp_path / place, tmp_path / "ws/pkg/urdf/robot.urdf"
    for folder in (path.parent, file.parent):
        folder.mkdir(parents=True, exist_ok=True)
    text = urdf(mesh(name.replace("{root}", str(tmp_path))), origin="")
    file.write_text(text)
    assert "is not found" in link_geometry(read_robot(file), "base").unreadable[0]
    path.write_bytes(box.export(file_type="stl"))
    found = link_geometry(read_robot(file), "base")
    assert found.unreadable == ()
    assert same(found.points, HALF)


def test_a_file_takes_the_place_of_what_the_urdf_gives(box: trimesh.Trimesh, tmp_path: Path, robot_of: Read) -> None:
    box.export(tmp_path / "m.stl")
    robot = robot_of(urdf('<sphere radius="1"/>'))
    assert same(link_vertices(robot, "base", "m.stl"), HALF)
    assert len(link_vertices(robot, "base")) > 100
    with pytest.raises(ModelError, match=r"link base: mesh n\.stl is not found; give another file"):
        link_vertices(robot, "base", "n.stl")


# --- hostile files ---

LAUGHS = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><COLLADA>&b;</COLLADA>'
OUTSIDE = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><COLLADA>&a;</COLLADA>'


def nested(depth: int, times: int) -> str:
    """A COLLADA scene whose nodes repeat others, each several times."""
    nodes = "".join(f'<node id="n{i}">' + f'<instance_node url="#n{i + 1}"/>' * times + "</node>" for i in range(depth))
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>'
        f"<library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id='s'>"
        "<node><instance_node url='#n0'/></node></visual_scene></library_visual_scenes>"
        "<scene><instance_visual_scene url='#s'/></scene></COLLADA>"
    )


@pytest.mark.parametrize(
    ("name", "data", "note"),
    [
        ("m.stl", b"", "contains no faces"),
        ("m.stl", b"\x00" * 80 + b"\xff\xff\xff\xff" + b"\x00" * 50, "contains no faces"),
        ("m.stl", b"solid x\nfacet normal 0 0\n", "contains no faces"),
        ("m.stl", b"solid x\n" + b"\xff\xfe" * 50, "contains no faces"),
        ("m.obj", b"f 1 2 3\n", "contains no faces"),
        ("m.obj", b"mtllib ../../../etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "a vertex that is not within"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1e300 0\nf 1 2 3\n", "a vertex that is not within 1e+06 m"),
        ("m.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n",
         "is not well-formed ply"),
        ("m.off", b"OFF\n999999999 999999999 0\n", "is not well-formed off"),
        ("m.dae", b"<COLLADA>", "is not XML"),
        ("m.dae", b"<COLLADA/>", "is not well-formed dae"),
        ("m.dae", b"PK\x03\x04", "is not XML"),
        ("m.dae", LAUGHS.encode(), "declares a document type"),
        ("m.dae", OUTSIDE.encode(), "declares a document type"),
        ("m.dae", nested(40, 10).encode(), "contains itself"),
        ("m.dae", nested(1, 1).replace("#n1", "#n0").encode(), "contains itself"),
        ("m.dae", nested(5000, 1).encode(), "is not well-formed dae"),
        ("m.glb", b"glTF", "an unsupported format; save it as stl or obj"),
    ],
)  # fmt: skip
def test_a_hostile_mesh_is_one_plain_line(name: str, data: bytes, note: str, tmp_path: Path, robot_of: Read) -> None:
    (tmp_path / name).write_bytes(data)
    robot = robot_of(urdf(mesh(name)))
    (missing,) = link_geometry(robot, "base").unreadable
    assert note in missing
    assert "\n" not in missing
    with pytest.raises(ModelError) as caught:
        link_vertices(robot, "base", name)
    assert "\n" not in str(caught.value)


def test_a_folder_or_a_device_is_no_mesh(tmp_path: Path, robot_of: Read) -> None:
    (tmp_path / "folder.stl").mkdir()
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    found = link_geometry(robot_of(urdf(mesh("folder.stl"), mesh("zero.stl"))), "base")
    assert all("is not found" in note for note in found.unreadable)
    assert len(found.unreadable) == 2


def test_a_mesh_without_end_is_not_read(tmp_path: Path, robot_of: Read) -> None:
    with (tmp_path / "m.stl").open("wb") as file:
        file.truncate(5 << 30)  # sparse
    (missing,) = link_geometry(robot_of(urdf(mesh("m.stl"))), "base").unreadable
    assert "is larger than" in missing
